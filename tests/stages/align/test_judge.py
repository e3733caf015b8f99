from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sensorgate.stages.align.judge import FAIL, PASS, UNPROVEN, judge, overall
from sensorgate.stages.align.measure import measure
from sensorgate.stages.align.pairs import plan_pairs
from sensorgate.stages.align.world import ground_of
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import by_payload, frames, grid, moved, neighbours, request, solution


def _verdicts(asked, solved):
    areas = plan_pairs(asked.frames, asked.cameras, DEFAULTS).areas
    return by_payload(
        judge(
            measure(asked.frames, solved, ground_of(asked.frames, asked.cameras, 1200, DEFAULTS), areas, DEFAULTS),
            DEFAULTS,
        )
    )


def _two(places_b=None, cross=80, **more):
    """Payload a (18 frames) and b (12), tied by cross pairs; b solved at ``places_b`` times the truth."""
    a, b = grid(), grid(2, 6, 70.0)
    asked = request(frames(a, "a"), frames(b, "b", 5000.0, **more))
    ties = [(i, 18 + i, cross) for i in range(10)]
    pairs = neighbours(18) + neighbours(12, start=18) + ties
    return asked, np.concatenate([a, b if places_b is None else places_b]), pairs


def test_a_right_block_passes():
    asked, places, pairs = _two()
    found = _verdicts(asked, solution(asked, places, pairs=pairs))
    assert {p.verdict for p in found.values()} == {PASS}
    assert found["b"].together.horizontal_m < 0.01
    assert found["a"].height_m == pytest.approx(60.0, abs=0.5)
    assert found["b"].cross_inliers == 80 and found["b"].strong_cross_pairs == 10


def test_full_registration_and_small_error_do_not_save_a_wrong_model():
    """All 30 registered at 0.5 px, but b's part is half as large as it should be."""
    b = grid(2, 6, 70.0)
    asked, places, pairs = _two(b * 0.4 + [40.0, 0.0, 20.0])
    found = _verdicts(asked, solution(asked, places, pairs=pairs))
    assert found["b"].verdict == FAIL
    assert found["b"].registered == 12 and found["b"].mean_reproj_error_px == pytest.approx(0.5)
    assert found["a"].verdict == PASS
    assert any("wrongly attached" in r for r in found["b"].reasons)


def test_a_shifted_gps_is_no_geometry():
    a, b = grid(), grid(2, 6, 70.0)
    asked = request(frames(a, "a"), moved(frames(b, "b", 5000.0), (30.0, 0.0, 0.0)))
    _, places, pairs = _two()
    found = _verdicts(asked, solution(asked, places, pairs=pairs))
    assert found["b"].verdict == PASS
    assert found["b"].together.horizontal_m == pytest.approx(30.0, abs=0.5)
    assert found["b"].alone.horizontal_m < 0.05
    assert np.allclose(found["b"].gps_offset_m, (30.0, 0.0, 0.0), atol=0.1)


def test_the_same_registered_frames_in_two_models_are_refused():
    asked, places, pairs = _two(cross=0)
    found = _verdicts(asked, solution(asked, places, model=[0] * 18 + [1] * 12, pairs=pairs))
    assert found["a"].verdict == PASS
    assert found["b"].verdict == FAIL and found["b"].in_main_component == 0


@pytest.mark.parametrize(("ties", "own", "close"), [(3, 120, True), (4, 120, False), (10, 31, True), (10, 34, False)])
def test_near_a_limit_is_close(ties, own, close):
    asked, places, _ = _two()
    pairs = neighbours(18, own) + neighbours(12, own, start=18) + [(i, 18 + i, 80) for i in range(ties)]
    found = _verdicts(asked, solution(asked, places, pairs=pairs))
    assert {p.verdict for p in found.values()} == {PASS}
    assert any(p.close for p in found.values()) == close
    assert close == any("(close)" in r for p in found.values() for r in p.reasons)


@pytest.mark.parametrize(("ties", "own", "close"), [(2, 120, True), (1, 120, False), (10, 28, True), (2, 10, False)])
def test_what_fails_by_figures_close_to_their_limits_alone_is_close(ties, own, close):
    asked, places, pairs = _two()
    pairs = neighbours(18, inliers=own) + neighbours(12, start=18) + pairs[-10:][:ties]
    found = _verdicts(asked, solution(asked, places, pairs=pairs))
    failed = [p for p in found.values() if p.verdict == FAIL]
    assert failed and all(p.close for p in failed) == close


@pytest.mark.parametrize(("inliers", "expected"), [(29, FAIL), (30, PASS), (200, PASS)])
def test_thirty_inliers_across(inliers, expected):
    asked, places, pairs = _two(cross=inliers)
    assert _verdicts(asked, solution(asked, places, pairs=pairs))["b"].verdict == expected


@pytest.mark.parametrize(("error", "expected"), [(1.9, PASS), (2.0, PASS), (2.01, FAIL), (float("nan"), FAIL)])
def test_reprojection_error_is_necessary(error, expected):
    asked, places, pairs = _two()
    found = _verdicts(asked, solution(asked, places, pairs=pairs, error_px=error))
    assert {p.verdict for p in found.values()} == {expected}
    if error == 1.9:
        assert any("close" in r for r in found["a"].reasons)


def test_five_frames_are_unproven_however_well_they_fit():
    a, b = grid(), grid(1, 5)
    asked = request(frames(a, "a"), frames(b, "b", 5000.0))
    pairs = neighbours(18) + neighbours(5, start=18) + [(i, 18 + i, 80) for i in range(5)]
    found = _verdicts(asked, solution(asked, np.concatenate([a, b]), pairs=pairs))
    assert found["b"].verdict == UNPROVEN and found["a"].verdict == PASS


def test_one_straight_strip_alone_is_unproven():
    places = grid(1, 14)
    asked = request(frames(places))
    found = _verdicts(asked, solution(asked, places, pairs=neighbours(14)))
    assert found["a"].verdict == UNPROVEN
    assert any("one line" in r for r in found["a"].reasons)


def test_without_positions_nothing_is_proven():
    places = grid()
    asked = request([replace(f, position=None) for f in frames(places)])
    found = _verdicts(asked, solution(asked, places, pairs=neighbours(18)))
    assert found["a"].verdict == UNPROVEN


def test_rtk_is_held_to_its_own_accuracy():
    rng = np.random.default_rng(0)
    a = grid()
    asked = request([replace(f, rtk=True, sigma_m=(0.03, 0.05)) for f in frames(a)])
    good = _verdicts(asked, solution(asked, a + rng.normal(0, 0.02, a.shape), pairs=neighbours(18)))
    bad = _verdicts(asked, solution(asked, a + rng.normal(0, 0.5, a.shape), pairs=neighbours(18)))
    assert good["a"].verdict == PASS and bad["a"].verdict == FAIL


def test_a_model_turned_over_is_refused():
    asked = request(frames(grid()))
    solved = solution(asked, grid(), pairs=neighbours(18))
    over = replace(solved, rotation=np.diag([1.0, -1.0, -1.0]) @ solved.rotation)
    assert _verdicts(asked, over)["a"].verdict == FAIL


def test_one_wild_position_does_not_fail_a_payload():
    group = frames(grid())
    group[7] = moved([group[7]], (3000.0, 0.0, 0.0))[0]
    asked = request(group)
    assert _verdicts(asked, solution(asked, grid(), pairs=neighbours(18)))["a"].verdict == PASS


def test_the_gap_between_the_centres_of_a_capture_is_judged():
    places = grid()
    a = [replace(f, capture=f"c{i}") for i, f in enumerate(frames(places, "a"))]
    b = [replace(f, capture=f"c{i}") for i, f in enumerate(frames(places, "b"))]
    asked = request(a, b)
    pairs = neighbours(18) + neighbours(18, start=18) + [(i, 19 + i, 60) for i in range(16)]
    near = _verdicts(asked, solution(asked, np.concatenate([places, places + np.array([0.2, 0, 0])]), pairs=pairs))
    far = _verdicts(asked, solution(asked, np.concatenate([places, places + np.array([5.5, 0, 0])]), pairs=pairs))
    assert near["b"].verdict == PASS
    assert far["b"].verdict == FAIL and any("one capture" in r for r in far["b"].reasons)


def test_one_payload_over_two_grounds_may_have_two_models():
    here, there = grid(), grid() + np.array([5000.0, 0.0, 0.0])
    places = np.concatenate([here, there])
    asked = request(frames(places))
    solved = solution(asked, places, model=[0] * 18 + [1] * 18, pairs=neighbours(18) + neighbours(18, start=18))
    areas = plan_pairs(asked.frames, asked.cameras, DEFAULTS).areas
    measured = measure(asked.frames, solved, ground_of(asked.frames, asked.cameras, 1200, DEFAULTS), areas, DEFAULTS)
    assert measured.areas == 2 and measured.components == 2
    assert judge(measured, DEFAULTS)[0].verdict == PASS


def test_a_flat_zero_altitude_is_no_measurement():
    group = [replace(f, position=(*f.position[:2], 0.0)) for f in frames(grid())]
    asked = request(group)
    found = _verdicts(asked, solution(asked, grid(), pairs=neighbours(18)))
    assert found["a"].together.vertical_m is None and found["a"].verdict == PASS


def test_overall_needs_every_payload():
    asked, places, pairs = _two()
    good = tuple(_verdicts(asked, solution(asked, places, pairs=pairs)).values())
    assert overall(good) == PASS
    assert overall((*good, replace(good[0], verdict=UNPROVEN))) == UNPROVEN
    assert overall((*good, replace(good[0], verdict=FAIL))) == FAIL
    assert overall(()) == FAIL
