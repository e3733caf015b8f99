"""Rules about heights, views and hovering."""

from __future__ import annotations

from dataclasses import replace

from sensorgate.stages.gate import assess
from sensorgate.stages.rules.flights import hover_runs
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import strip, survey_of


def found(frames, code):
    return [f for f in assess(survey_of(frames), DEFAULTS).findings if f.code == code]


def later(shift_m, **changes):
    frames = strip(count=12, prefix="B_", start="2024-05-01T13:00:00", **changes)
    return [replace(f, altitude_m=f.altitude_m + shift_m) for f in frames]


def test_altitude_bias_of_two_flights_of_one_place_in_metres():
    (finding,) = found(strip(count=12) + later(34.0), "altitude-bias")
    assert finding.severity == "warning"
    assert finding.measured == 34.0
    assert "34 m" in finding.message
    assert len(finding.subjects) == 2


def test_no_altitude_bias_within_gps_spread_elsewhere_or_when_fixed():
    assert not found(strip(count=12) + later(6.0), "altitude-bias")
    assert not found(strip(count=12) + later(34.0, latitude=46.95), "altitude-bias")
    fixed = [replace(f, rtk_flag=50) for f in strip(count=12) + later(34.0)]
    assert not found(fixed, "altitude-bias")


def test_a_flight_at_another_height_is_no_bias():
    higher = later(40.0, relative_altitude_m=120.0)
    assert not found(strip(count=12) + higher, "altitude-bias")


def test_datum_is_said_only_where_the_camera_says_both():
    frames = strip(count=12, altitude_type="GpsFusionAlt")
    assert not found(frames, "altitude-datum-mixed")
    assert not found([replace(frames[0], altitude_type=""), *frames[1:]], "altitude-datum-mixed")
    (finding,) = found([replace(f, altitude_type="RtkAlt") if i < 4 else f for i, f in enumerate(frames)],
                       "altitude-datum-mixed")  # fmt: skip
    assert len(finding.subjects) == 4


def test_missing_and_zero_altitudes():
    frames = strip(count=12)
    mixed = [replace(frames[0], altitude_m=None), replace(frames[1], altitude_m=0.0), *frames[2:]]
    (finding,) = found(mixed, "altitude-missing")
    assert finding.subjects == tuple(f.path for f in frames[:2])
    assert not found(frames, "altitude-missing")


def test_oblique_frames_are_noted():
    frames = strip(count=12)
    tilted = [replace(f, pitch_deg=-45.0) if i < 3 else f for i, f in enumerate(frames)]
    (finding,) = found(tilted, "oblique-frames")
    assert finding.severity == "info" and finding.measured == 3.0
    assert not found([replace(f, pitch_deg=-70.0) for f in frames], "oblique-frames")


def test_hovering_is_many_frames_at_one_place_and_never_excludes():
    frames = strip(count=20)
    still = [replace(f, latitude=frames[5].latitude) if 5 <= i < 13 else f for i, f in enumerate(frames)]
    (finding,) = found(still, "hover-frames")
    assert finding.subjects == tuple(f.path for f in still[5:13])
    assert {f.excluded for f in survey_of(still).frames} == {None}
    short = [replace(f, latitude=frames[5].latitude) if 5 <= i < 8 else f for i, f in enumerate(frames)]
    assert not found(short, "hover-frames")


def test_a_facade_scanned_upwards_is_no_hovering():
    frames = strip(count=20, step_deg=0.0)
    rising = [replace(f, relative_altitude_m=20.0 + 3 * i, altitude_m=190.0 + 3 * i) for i, f in enumerate(frames)]
    assert hover_runs(rising, 2.0, 5) == []
    assert not found(rising, "hover-frames")
    assert len(hover_runs(frames, 2.0, 5)) == 1
