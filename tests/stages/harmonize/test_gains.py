"""What resampling is said to bring and cost: laws, and the measurements it rests on."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.gate import assess
from sensorgate.stages.harmonize.gains import expected_share, interpolated, mixed_share, restored_share
from sensorgate.stages.harmonize.model import HarmonizePlan
from sensorgate.stages.record import from_plain, to_plain
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import strip, survey_of

RATIO = st.floats(1.0, 50.0)


def gains(frames, **options):
    return {g.flight: g for g in assess(survey_of(frames), DEFAULTS, **options).plan.gains}


def two_heights(low=80.0, high=160.0, **changes):
    later = strip(count=12, prefix="B_", start="2024-05-01T13:00:00", relative_altitude_m=high, **changes)
    return strip(count=12, relative_altitude_m=low) + later


def test_the_measured_ratios():
    assert [round(mixed_share(r, DEFAULTS), 2) for r in (1.0, 1.25, 1.5, 2.0, 4.0)] == [1.0, 1.0, 1.0, 0.5, 0.17]
    assert [round(restored_share(r, DEFAULTS), 2) for r in (1.0, 1.5, 2.0, 4.0)] == [1.0, 1.0, 0.9, 0.4]
    assert 0.17 < mixed_share(3.0, DEFAULTS) < 0.5 and mixed_share(8.0, DEFAULTS) < 0.17


@given(RATIO, RATIO)
def test_more_difference_never_promises_more(a, b):
    low, high = sorted((a, b))
    assert 1.0 >= mixed_share(low, DEFAULTS) >= mixed_share(high, DEFAULTS) > 0.0
    assert expected_share(low, 1.0, DEFAULTS) == mixed_share(low, DEFAULTS)


@given(RATIO)
def test_enlarging_to_the_finest_never_loses_and_reducing_never_wins(ratio):
    as_it_is = expected_share(ratio, 1.0, DEFAULTS)
    assert expected_share(ratio, ratio, DEFAULTS) >= as_it_is
    assert expected_share(ratio, 0.5, DEFAULTS) <= as_it_is
    assert expected_share(ratio, ratio * 1.7, DEFAULTS) == pytest.approx(expected_share(ratio, ratio, DEFAULTS))


@settings(max_examples=60)
@given(st.floats(0.5, 6.0), st.floats(0.0, 3.0), st.floats(0.0, 3.0), RATIO, RATIO)
def test_any_thresholds_stay_monotone(hold, two, four, a, b):
    limits = replace(DEFAULTS, match_hold_ratio=hold, match_share_2x=two, match_share_4x=four)
    low, high = sorted((a, b))
    assert mixed_share(low, limits) >= mixed_share(high, limits)
    assert interpolated(((1.0, 1.0),), low) == 1.0


def test_a_coarse_flight_that_is_brought_to_the_fine():
    frames = two_heights(80.0, 112.0)
    found = gains(frames)
    coarse, fine = found["dji-fc6310:2"], found["dji-fc6310:1"]
    assert coarse.chosen and not fine.chosen
    assert coarse.ratio == pytest.approx(1.4) and fine.ratio == 1.0
    assert coarse.native.inliers == coarse.resampled.inliers == 1.0  # within 1.5 times nothing is gained
    assert coarse.resampled.scale == pytest.approx(1.4, abs=1e-3)
    assert coarse.resampled.megapixels == pytest.approx(1.96 * coarse.native.megapixels, rel=1e-3)
    assert coarse.native.size_bytes == sum(f.size_bytes for f in frames[12:])
    assert coarse.resampled.size_bytes == pytest.approx(coarse.native.size_bytes * 1.4**1.4, rel=1e-3)
    assert fine.resampled == fine.native


def test_what_a_flight_that_keeps_its_pixels_would_have_got():
    coarse = gains(two_heights(80.0, 160.0))["dji-fc6310:2"]  # 80 MP: beyond the limit
    assert not coarse.chosen
    assert coarse.native.inliers == pytest.approx(0.5, abs=1e-6)
    assert coarse.resampled.inliers == pytest.approx(0.9, abs=1e-6)
    assert coarse.resampled.width == 2 * coarse.native.width


def test_reduced_to_the_coarsest_saves_pixels_and_matches():
    fine = gains(two_heights(80.0, 160.0), gsd_target="coarsest")["dji-fc6310:1"]
    assert fine.chosen and fine.resampled.scale == 0.5
    assert fine.resampled.inliers == pytest.approx(0.5)
    assert fine.resampled.size_bytes == pytest.approx(fine.native.size_bytes / 4, rel=1e-6)


def test_unknown_resolution_has_no_gain_and_another_ground_no_part_in_it():
    frames = two_heights(80.0, 112.0)
    unknown = [replace(f, relative_altitude_m=None) for f in frames]
    assert gains(unknown) == {}
    elsewhere = gains(two_heights(80.0, 112.0, latitude=45.0))
    assert {g.ratio for g in elsewhere.values()} == {1.0}


def test_a_plan_with_gains_survives_json():
    plan = assess(survey_of(two_heights()), DEFAULTS).plan
    assert plan.gains and from_plain(HarmonizePlan, to_plain(plan)) == plan
