from __future__ import annotations

import random
from collections import Counter
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.align.pairs import footprints, plan_pairs, strips
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import frames, grid, request


def _plan(*groups):
    asked = request(*groups)
    return asked, plan_pairs(asked.frames, asked.cameras, DEFAULTS)


def _degrees(pairs):
    count = Counter()
    for a, b in pairs:
        count[a] += 1
        count[b] += 1
    return count


def test_limits_per_frame_and_ties_to_the_other_payload():
    asked, plan = _plan(frames(grid(5, 8), "a"), frames(grid(5, 8, 75.0), "b", 9000.0))
    degrees = _degrees(plan.pairs)
    assert max(degrees.values()) <= DEFAULTS.pairs_per_frame
    cross = Counter()
    for a, b in plan.pairs:
        if asked.frames[a].payload != asked.frames[b].payload:
            cross[a] += 1
            cross[b] += 1
    assert min(cross[i] for i in range(80)) >= DEFAULTS.pairs_cross


def test_every_frame_reaches_neighbouring_strips():
    group = frames(grid(5, 9))
    asked, plan = _plan(group)
    lines = strips(asked.frames, footprints(asked.frames, asked.cameras, DEFAULTS))
    assert len({number for _, number in lines}) == 5
    across = Counter()
    for a, b in plan.pairs:
        if lines[a] != lines[b]:
            across[a] += 1
            across[b] += 1
    assert min(across[i] for i in range(len(group))) >= DEFAULTS.pairs_strip


def test_frames_that_cannot_overlap_are_not_paired():
    far = grid() + np.array([900.0, 0.0, 0.0])
    asked, plan = _plan(frames(grid(), "a"), frames(far, "b", 9000.0))
    assert all(asked.frames[a].payload == asked.frames[b].payload for a, b in plan.pairs)
    assert sorted(set(plan.areas)) == [0, 1]
    assert plan.dropped > 0


def test_wide_gps_errors_keep_pairs_that_sharp_ones_drop():
    group, far = frames(grid(), "a"), frames(grid() + np.array([230.0, 0.0, 0.0]), "b", 9000.0)
    sharp = [replace(f, sigma_m=(0.02, 0.03)) for f in group], [replace(f, sigma_m=(0.02, 0.03)) for f in far]
    loose = [replace(f, sigma_m=(30.0, 50.0)) for f in group], [replace(f, sigma_m=(30.0, 50.0)) for f in far]
    assert len(set(_plan(*sharp)[1].areas)) == 2
    assert len(set(_plan(*loose)[1].areas)) == 1


def test_one_capture_is_never_matched_with_itself():
    a = [replace(f, capture=f"c{i}") for i, f in enumerate(frames(grid(), "a"))]
    b = [replace(f, capture=f"c{i}") for i, f in enumerate(frames(grid(), "b"))]
    asked, plan = _plan(a, b)
    assert plan.pairs
    assert all(asked.frames[i].capture != asked.frames[j].capture for i, j in plan.pairs)


def test_without_positions_all_pairs_up_to_the_limit_then_sequence_and_likeness():
    few = [replace(f, position=None) for f in frames(grid(4, 10))]
    _, plan = _plan(few)
    assert len(plan.pairs) == 40 * 39 // 2 and not plan.blind
    many = [replace(f, position=None) for f in frames(grid(8, 10))]
    _, plan = _plan(many)
    assert len(plan.blind) == 80 and len(plan.pairs) < 80 * 4


def test_a_small_payload_over_a_large_one_keeps_its_own_chain():
    asked, plan = _plan(frames(grid(6, 12, step_m=8.0), "big"), frames(grid(2, 5, step_m=12.0), "tiny", 9000.0))
    own = Counter()
    for a, b in plan.pairs:
        if asked.frames[a].payload == asked.frames[b].payload == "tiny":
            own[a] += 1
            own[b] += 1
    assert len(own) == 10 and min(own.values()) >= 1
    assert max(_degrees(plan.pairs).values()) <= DEFAULTS.pairs_per_frame


def test_an_oblique_frame_looks_ahead():
    ahead = replace(frames(grid(1, 1))[0], pitch_deg=-45.0, yaw_deg=90.0)
    asked = request([ahead])
    shown = footprints(asked.frames, asked.cameras, DEFAULTS)[0]
    assert shown is not None and shown.east > 40.0 and abs(shown.north) < 5.0


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_order_of_frames_changes_nothing(seed):
    group = frames(grid(3, 6), "a") + frames(grid(2, 6, 70.0), "b", 9000.0)
    asked, plan = _plan(group)
    named = {frozenset((asked.frames[a].path, asked.frames[b].path)) for a, b in plan.pairs}
    mixed = list(group)
    random.Random(seed).shuffle(mixed)
    again = request(sorted(mixed, key=lambda f: f.path))
    other = plan_pairs(again.frames, again.cameras, DEFAULTS)
    assert {frozenset((again.frames[a].path, again.frames[b].path)) for a, b in other.pairs} == named
