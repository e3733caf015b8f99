"""The gate's rules: each fires on the smallest survey that breaks it, and not beside it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.stages.errors import UsageError
from sensorgate.stages.frame import BrokenFrame
from sensorgate.stages.gate import assess
from sensorgate.stages.thresholds import DEFAULTS, Thresholds

from tests.frames import P4P, strip, survey_of


def codes(frames, limits=DEFAULTS, severity=None):
    report = assess(survey_of(frames, limits), limits)
    return {f.code for f in report.findings if severity in (None, f.severity)}


def test_a_clean_survey_is_consistent_and_says_nothing():
    report = assess(survey_of(strip(count=20)), DEFAULTS)
    assert report.verdict == "consistent"
    assert report.findings == ()


def test_no_frame_is_blocked():
    assert assess(survey_of([]), DEFAULTS).verdict == "blocked"


def test_one_broken_file_among_good_ones_is_inconsistent():
    survey = replace(survey_of(strip(count=20)), broken=(BrokenFrame("in/x.jpg", 0, "empty-file", "is empty"),))
    report = assess(survey, DEFAULTS)
    assert report.verdict == "inconsistent"
    assert report.findings[0].code == "empty-file"


def test_thermal_beside_colour_is_mixed_spectra():
    thermal = strip(P4P, 8, prefix="T_", model="ZH20T", width=640, height=512, focal_mm=13.5, focal_35mm=58.0,
                    thermal_payload="DJI raw in APP3", image_source="InfraredCamera")  # fmt: skip
    assert "mixed-spectra" in codes(strip(count=12) + thermal, severity="error")


def test_focal_rules():
    def with_focal(second):
        return [replace(f, focal_mm=8.8 if i < 10 else second) for i, f in enumerate(strip(count=20))]

    assert "focal-variance" in codes(with_focal(9.16), severity="error")
    assert "focal-jitter" in codes(with_focal(8.9), severity="warning")
    assert "two-lenses" in codes(with_focal(12.3))
    assert not codes(with_focal(8.8))


def test_two_places_are_separate_areas():
    far = strip(count=12, prefix="F_", latitude=46.95, start="2024-05-01T12:00:00")
    assert "separate-areas" in codes(strip(count=12) + far, severity="error")
    near = strip(count=12, prefix="F_", latitude=46.8401, start="2024-05-01T12:00:00")
    assert "separate-areas" not in codes(strip(count=12) + near)


def test_ground_resolutions_farther_apart_than_the_height_is_known():
    low = strip(count=12, prefix="L_", relative_altitude_m=60.0, start="2024-05-01T12:00:00")
    assert "gsd-mixed" in codes(strip(count=12) + low, severity="error")
    close = strip(count=12, prefix="L_", relative_altitude_m=79.0, start="2024-05-01T12:00:00")
    assert "gsd-mixed" not in codes(strip(count=12) + close)


def test_position_rules():
    frames = strip(count=12)
    assert "gps-missing" in codes([replace(frames[0], latitude=None, longitude=None), *frames[1:]])
    assert "gps-none" in codes([replace(f, latitude=None, longitude=None) for f in frames])
    assert "gps-zero" in codes([replace(frames[0], latitude=0.0, longitude=0.0), *frames[1:]])
    wild = [*frames[:5], replace(frames[5], latitude=10.0), *frames[6:]]
    found = assess(survey_of(wild), DEFAULTS)
    assert {f.code for f in found.findings} == {"gps-outlier"}


def test_rtk_mixed_counts_only_fixed_flags():
    frames = [replace(f, rtk_flag=50, rtk_std_m=(0.02, 0.02, 0.03)) for f in strip(count=12)]
    assert "rtk-mixed" not in codes(frames)
    assert "rtk-mixed" in codes([replace(frames[0], rtk_flag=16), *frames[1:]])


def test_few_frames_are_a_warning_never_an_error():
    assert "too-few-frames" in codes(strip(count=4), severity="warning")


def test_climb_frames_are_classed_and_low_flights_are_not():
    frames = strip(count=30)
    climbing = [replace(f, relative_altitude_m=5.0 + 10 * i) if i < 3 else f for i, f in enumerate(frames)]
    found = assess(survey_of(climbing), DEFAULTS)
    climbed = tuple(f"in/DJI_000{i}.JPG" for i in (1, 2, 3))
    assert [f.subjects for f in found.findings if f.code == "transit-frame"] == [climbed]
    low_flight = [replace(f, relative_altitude_m=30.0 if i < 15 else 90.0) for i, f in enumerate(frames)]
    assert "transit-frame" not in codes(low_flight)


def test_every_finding_says_a_way_out():
    for frames in (strip(count=4), [replace(f, latitude=None) for f in strip(count=9)]):
        for finding in assess(survey_of(frames), DEFAULTS).findings:
            assert finding.message and finding.remedy


def test_thresholds_are_set_by_name_and_checked():
    assert DEFAULTS.replaced({"min_inliers": 40}).min_inliers == 40
    for wrong in ({"nonsense": 1}, {"min_inliers": "many"}, {"min_inliers": 1.5}, {"focal_split": float("nan")}):
        with pytest.raises(UsageError):
            DEFAULTS.replaced(wrong)
    for name, entry in Thresholds.describe().items():
        assert entry["unit"] and entry["why"], name
