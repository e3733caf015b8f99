"""Heights over relief: the rule, its noise, and what is said of it."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.elevation import ElevationSource
from sensorgate.stages.gate import assess
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import strip, survey_of


class Slope:
    """Ground that rises by ``rise`` metres per 0.001 degree of latitude, known with cells of ``spacing`` metres."""

    def __init__(self, rise, base=100.0, spacing=1.0, vertical=""):
        self.rise, self.base, self.spacing = rise, base, spacing
        self.source = ElevationSource("slope.tif", 100, 100, vertical, "0" * 64)
        self.file = "/nowhere/slope.tif"

    def sample(self, points):
        return tuple(self.at(lat) if lat < 46.9 else None for lat, _ in points)

    def at(self, latitude):
        return self.base + self.rise * (latitude - 46.84) / 0.001

    def spacing_m(self, point):
        return self.spacing


def findings(survey, code):
    return [f for f in assess(survey, DEFAULTS).findings if f.code == code]


def flight(slope, above_ground_m, takeoff=True, count=20):
    """Terrain following at ``above_ground_m`` from a take-off at the foot of the slope."""
    frames = strip(count=count)
    start = slope.at(frames[0].latitude)
    flown = [replace(f, relative_altitude_m=above_ground_m + slope.at(f.latitude) - start) for f in frames]
    if takeoff:
        flown[0] = replace(flown[0], relative_altitude_m=2.0)
    return flown


def test_terrain_following_gets_its_height_above_ground_from_the_takeoff():
    slope = Slope(rise=40.0)
    frames = flight(slope, 60.0)
    plain = survey_of(frames)
    assert plain.flights[0].height_m > 85.0
    survey = survey_of(frames, elevation=slope)
    used = survey.usable
    assert len(used) == 19
    assert {f.height_source for f in used} == {"relative-altitude+dem"}
    assert [f.height_m for f in used] == pytest.approx([60.0] * 19)
    assert survey.flights[0].height_m == pytest.approx(60.0)
    assert [f.ground_m for f in survey.frames] == pytest.approx([slope.at(f.latitude) for f in frames])
    assert {f.ground_m for f in survey_of(frames).frames} == {None}
    (said,) = findings(survey, "ground-relief")
    assert said.severity == "info" and "above ground" in said.message


def test_without_a_takeoff_frame_the_height_stays_and_its_spread_says_so():
    slope = Slope(rise=40.0)
    survey = survey_of(flight(slope, 60.0, takeoff=False), elevation=slope)
    assert {f.height_source for f in survey.usable} == {"relative-altitude"}
    assert survey.usable[-1].height_m == pytest.approx(60.0 + 40.0 * 1.9)
    relief = 40.0 * 1.9
    assert survey.usable[0].height_sigma_m == pytest.approx(math.hypot(2.0, relief / math.sqrt(12.0)))
    (said,) = findings(survey, "ground-relief")
    assert said.severity == "warning" and "76 m" in said.message


def test_flat_ground_within_the_noise_of_the_model_changes_nothing():
    coarse = Slope(rise=3.0, spacing=30.0)  # 5.7 m of relief, 3 m of noise
    frames = flight(coarse, 60.0)
    with_model, without = survey_of(frames, elevation=coarse), survey_of(frames)
    assert [f.height_m for f in with_model.frames] == [f.height_m for f in without.frames]
    assert [f.height_sigma_m for f in with_model.frames] == [f.height_sigma_m for f in without.frames]


def test_takeoffs_from_different_heights_in_one_session_decide_nothing():
    slope = Slope(rise=40.0)
    frames = flight(slope, 60.0)
    frames[-1] = replace(frames[-1], relative_altitude_m=1.0)
    survey = survey_of(frames, elevation=slope)
    assert {f.height_source for f in survey.usable} == {"relative-altitude"}


@settings(max_examples=40, deadline=None)
@given(
    rise=st.floats(-60.0, 60.0),
    base=st.floats(-400.0, 4000.0),
    bias=st.floats(-80.0, 80.0),
)
def test_neither_the_zero_of_the_model_nor_gps_altitude_matters(rise, base, bias):
    slope = Slope(rise, base)
    frames = flight(slope, 90.0)
    shifted = [replace(f, altitude_m=f.altitude_m + bias) for f in frames]
    told = [f.height_m for f in survey_of(frames, elevation=slope).usable]
    again = [f.height_m for f in survey_of(shifted, elevation=Slope(rise, base + 37.0)).usable]
    assert told == pytest.approx(again, abs=1e-6)


def test_gps_altitude_minus_ground_where_nothing_else_is_known():
    slope = Slope(rise=10.0, spacing=30.0)
    survey = survey_of(strip(count=10, relative_altitude_m=None, altitude_m=200.0), elevation=slope)
    assert [f.height_m for f in survey.frames] == pytest.approx([100.0 - i for i in range(10)])
    assert {f.height_source for f in survey.frames} == {"dem"}
    assert survey.frames[0].height_sigma_m == pytest.approx(math.hypot(5.0, 3.0))
    (said,) = findings(survey, "ground-datum")
    assert said.severity == "info" and "does not say" in said.message


def test_heights_below_ground_and_ellipsoidal_altitudes_are_doubted():
    deep = survey_of(strip(count=10, relative_altitude_m=None, altitude_m=60.0), elevation=Slope(0.0))
    (said,) = findings(deep, "ground-datum")
    assert said.severity == "warning" and "below the ground" in said.message
    rtk = strip(count=10, relative_altitude_m=None, altitude_type="RtkAlt")
    (said,) = findings(survey_of(rtk, elevation=Slope(0.0)), "ground-datum")
    assert said.severity == "warning"
    (said,) = findings(survey_of(rtk, elevation=Slope(0.0, vertical="ellipsoid")), "ground-datum")
    assert said.severity == "info"


def test_frames_outside_the_model_are_named_and_keep_an_unknown_height():
    frames = strip(count=10, relative_altitude_m=None)
    frames[4] = replace(frames[4], latitude=46.9)
    survey = survey_of(frames, elevation=Slope(0.0))
    assert survey.frames[4].height_m is None and survey.frames[4].gsd_cm is None
    (said,) = findings(survey, "ground-outside")
    assert said.subjects == (frames[4].path,)
    assert not findings(survey_of(strip(count=10), elevation=Slope(0.0)), "ground-datum")
