from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.align.matching import alike_pairs, match, signatures, unit
from sensorgate.stages.align.retrieval import retrieved
from sensorgate.stages.align.solution import Retrieval

from tests.stages.align.scenes import frames as scene_frames
from tests.stages.align.scenes import grid, job_for, request


def _descriptors(count, seed):
    return np.random.default_rng(seed).integers(0, 120, (count, 128)).astype(np.uint8)


def test_shuffled_features_find_their_partners():
    left = _descriptors(5000, 0)
    order = np.random.default_rng(1).permutation(5000)
    found = match(unit(left), unit(left[order]), 0.8)
    assert len(found) == 5000
    assert (order[found[:, 1]] == found[:, 0]).all()


def test_strangers_do_not_match():
    assert len(match(unit(_descriptors(800, 0)), unit(_descriptors(800, 1)), 0.8)) == 0


def test_a_repeated_feature_is_ambiguous():
    right = np.concatenate([_descriptors(50, 0), _descriptors(50, 0)[:1]])
    found = match(unit(_descriptors(50, 0)), unit(right), 0.8)
    assert 0 not in found[:, 0] and len(found) == 49


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 40), st.integers(0, 40), st.integers(0, 9))
def test_matches_are_one_to_one_and_within_bounds(n, m, seed):
    pool = _descriptors(40, seed)
    found = match(unit(pool[:n]), unit(pool[::-1][:m]), 0.95)
    assert len({a for a, _ in found.tolist()}) == len({b for _, b in found.tolist()}) == len(found)
    assert all(a < n and b < m for a, b in found.tolist())


def test_frames_of_the_same_ground_are_alike():
    ground = [_descriptors(300, s) for s in range(4)]
    frames = [np.concatenate([g[::2], g[1::3]]) for g in ground] + [g[50:] for g in ground] + [_descriptors(0, 0)]
    vectors = signatures(frames)
    assert alike_pairs(vectors, range(4), range(4, 9), 4, 0) == [(0, 4), (1, 5), (2, 6), (3, 7)]
    assert alike_pairs(vectors, [0], range(1, 9), 0, 1) == [(0, 4)]


def test_known_pairs_are_passed_over_before_any_is_counted():
    ground = [_descriptors(300, s) for s in range(4)]
    frames = [np.concatenate([g[::2], g[1::3]]) for g in ground] + [g[50:] for g in ground]
    vectors = signatures(frames)
    known = {(0, 4), (1, 5)}
    assert alike_pairs(vectors, range(4), range(4, 8), 2, 0, known) == [(2, 6), (3, 7)]


def test_a_job_gets_the_most_alike_of_the_pairs_that_it_lacks():
    ground = [_descriptors(300, s) for s in range(6)]
    frames = [g[::2] for g in ground] + [g[50:] for g in ground]
    asked = request(*[scene_frames(grid(2, 6), "a")])
    job = replace(job_for(asked), pairs=((0, 6), (1, 7)), apart=((2, 8),))
    wish = Retrieval(tuple(range(6)), tuple(range(6, 12)), count=3)
    assert retrieved(replace(job, retrieval=(wish,)), frames) == [(3, 9), (4, 10), (5, 11)]
    assert retrieved(job, frames) == []
