"""Large blocks: what is sampled is dense, bounded, and ties every payload to another."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.align.pairs import plan_pairs
from sensorgate.stages.align.sample import samples
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import frames, grid, request

SMALL = DEFAULTS.replaced({"sample_above": 40, "sample_frames": 24})
EAST = np.array([1.0, 0.0, 0.0])


def test_a_small_block_is_solved_whole():
    asked = request(frames(grid(5, 8), "a"))
    (only,) = samples(asked, DEFAULTS)
    assert only.request == asked and not only.joins


def test_one_payload_is_sampled_in_one_dense_patch():
    asked = request(frames(grid(20, 20), "a"))
    (only,) = samples(asked, SMALL)
    assert len(only.request.frames) == 24
    plan = plan_pairs(only.request.frames, only.request.cameras, SMALL)
    assert len(set(plan.areas)) == 1 and not plan.blind


def test_payloads_that_meet_are_sampled_where_they_meet():
    second = grid(10, 10) + 300.0 * EAST
    asked = request(frames(grid(20, 20), "a"), frames(second, "b", 9000.0))
    (only,) = samples(asked, SMALL)
    count = {p: sum(f.payload == p for f in only.request.frames) for p in ("a", "b")}
    assert count == {"a": 12, "b": 12}
    plan = plan_pairs(only.request.frames, only.request.cameras, SMALL)
    assert len(set(plan.areas)) == 1


def test_a_chain_of_payloads_is_tied_link_by_link():
    """Three blocks side by side: the outer two never meet, so each is sampled with the middle one."""
    width = float(np.ptp(grid(12, 12)[:, 0]))
    groups = [frames(grid(12, 12) + i * 0.9 * width * EAST, name, 9000.0 * i) for i, name in enumerate("abc")]
    found = samples(request(*groups), SMALL)
    assert len(found) == 2 and not found[0].joins and found[1].joins
    sets = [{f.payload for f in s.request.frames} for s in found]
    assert {frozenset(s) for s in sets} == {frozenset("ab"), frozenset("bc")}
    assert found[1].joins in sets[1] - sets[0]


def test_without_positions_a_run_of_neighbours_is_taken():
    lost = [replace(f, position=None) for f in frames(grid(10, 10), "a")]
    (only,) = samples(request(lost), SMALL)
    times = sorted(f.time_s for f in only.request.frames)
    every = sorted(f.time_s for f in lost)
    start = every.index(times[0])
    assert times == every[start : start + 24]


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.integers(3, 9), st.floats(-400, 400)), min_size=1, max_size=4), st.randoms())
def test_every_payload_is_sampled_once_bounded_and_order_does_not_matter(blocks, dice: random.Random):
    groups = [frames(grid(9, n) + place * EAST, f"p{i}", 9000.0 * i) for i, (n, place) in enumerate(blocks)]
    asked = request(*groups)
    found = samples(asked, SMALL)
    assert {f.payload for s in found for f in s.request.frames} == {f.payload for f in asked.frames}
    for sample in found[1:]:
        assert len(sample.request.frames) <= SMALL.sample_frames
    shuffled = list(asked.frames)
    dice.shuffle(shuffled)
    again = samples(replace(asked, frames=tuple(shuffled)), SMALL)
    assert [{f.path for f in s.request.frames} for s in again] == [{f.path for f in s.request.frames} for s in found]
