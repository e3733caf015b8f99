"""Flights: sessions, roles, and one role for all bands of a trigger."""

from __future__ import annotations

import random
from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.flights import HORIZON, PANEL, SURVEY, TRANSIT, one_role_per_capture

from tests.frames import P4P, strip, survey_of

BANDS = (("Green", 1), ("Red", 2), ("NIR", 3))


def rig_flight(captures=20, **changes):
    """A five-second strip of a three-band rig; heights above take-off known."""
    base = strip(P4P, captures, step_s=5.0, **changes)
    frames = []
    for number, frame in enumerate(base):
        for band, place in BANDS:
            frames.append(
                replace(
                    frame,
                    path=f"in/IMG_{number:04d}_{place}.tif",
                    size_bytes=2_000_000 + 10 * number + place,
                    format="tiff",
                    channels=1,
                    bits=16,
                    width=1280,
                    height=960,
                    make="MicaSense",
                    model="RedEdge-M",
                    focal_mm=5.5,
                    focal_35mm=None,
                    bands=(band,),
                    capture_id=f"c{number:04d}",
                )
            )
    return frames


def role_of(frames):
    return {f.path: f.role for f in survey_of(frames).frames}


def edit(frames, captures, **changes):
    """Change the frames of these captures."""
    return [replace(f, **changes) if f.capture_id in captures else f for f in frames]


def test_a_rigs_frames_near_the_ground_at_an_end_are_panels_and_its_climb_is_transit():
    frames = edit(rig_flight(), {"c0000"}, relative_altitude_m=1.2)
    frames = edit(frames, {"c0001"}, relative_altitude_m=25.0)
    role = role_of(frames)
    assert {role[f"in/IMG_0000_{b}.tif"] for _, b in BANDS} == {PANEL}
    assert {role[f"in/IMG_0001_{b}.tif"] for _, b in BANDS} == {TRANSIT}
    assert sum(r == SURVEY for r in role.values()) == 18 * 3


def test_a_colour_camera_near_the_ground_is_taking_off():
    frames = strip(count=20)
    frames[0] = replace(frames[0], relative_altitude_m=1.0)
    assert role_of(frames)[frames[0].path] == TRANSIT


def test_the_cameras_own_panel_flag_counts_for_the_whole_trigger():
    frames = rig_flight()
    frames[1] = replace(frames[1], panel=True)
    role = role_of(frames)
    assert [role[f.path] for f in frames[:6]] == [PANEL] * 3 + [SURVEY] * 3


def test_a_still_burst_far_below_a_rigs_flight_is_the_panel_where_only_gps_altitudes_are_known():
    plain = [replace(f, relative_altitude_m=None) for f in rig_flight()]
    on_ground = {"c0000", "c0001"}
    frames = edit(plain, on_ground, altitude_m=150.0, latitude=46.83)
    role = role_of(frames)
    assert {role[f.path] for f in frames if f.capture_id in on_ground} == {PANEL}
    assert {role[f.path] for f in frames if f.capture_id not in on_ground} == {SURVEY}
    # Moving frames of a flight over a slope are none.
    slope = [replace(f, altitude_m=250.0 if i >= 9 else 200.0) for i, f in enumerate(plain)]
    assert set(role_of(slope).values()) == {SURVEY}


def test_a_climb_from_the_panel_is_transit_where_only_gps_altitudes_are_known():
    frames = [replace(f, relative_altitude_m=None) for f in rig_flight()]
    frames = edit(frames, {"c0000"}, altitude_m=170.0, panel=True)
    frames = edit(frames, {"c0001"}, altitude_m=195.0)
    frames = edit(frames, {"c0002"}, altitude_m=225.0)
    role = role_of(frames)
    assert [role[f.path] for f in frames[::3]] == [PANEL, TRANSIT] + [SURVEY] * 18


def test_a_few_frames_at_the_horizon_are_strays_and_a_facade_flight_is_not():
    frames = strip(count=20)
    strays = [replace(f, pitch_deg=-2.0) if i == 7 else f for i, f in enumerate(frames)]
    assert role_of(strays)[frames[7].path] == HORIZON
    assert set(role_of([replace(f, pitch_deg=-2.0) for f in frames]).values()) == {SURVEY}


def test_a_long_pause_and_a_far_jump_start_new_flights():
    later = strip(count=10, prefix="B_", start="2024-05-01T11:00:00")
    assert len(survey_of(strip(count=10) + later).flights) == 2
    far = strip(count=10, prefix="B_", start="2024-05-01T10:01:00", latitude=46.9)
    assert len(survey_of(strip(count=10) + far).flights) == 2


def test_a_wild_position_does_not_cut_a_flight():
    frames = strip(count=20)
    frames[9] = replace(frames[9], latitude=10.0)
    assert len(survey_of(frames).flights) == 1


@given(st.randoms(use_true_random=False))
@settings(max_examples=15, deadline=None)
def test_every_frame_is_in_one_flight_and_the_order_of_files_changes_nothing(rng: random.Random):
    frames = edit(rig_flight(12), {"c0000"}, relative_altitude_m=1.0) + strip(count=12, prefix="RGB_")
    frames[5] = replace(frames[5], time=None)
    shuffled = list(frames)
    rng.shuffle(shuffled)
    survey = survey_of(shuffled)
    assert survey == survey_of(frames)
    flown = [p for f in survey.flights for p in f.frames]
    assert sorted(flown) == sorted(f.path for f in frames)


@given(
    st.dictionaries(st.integers(0, 20), st.sampled_from((SURVEY, PANEL, TRANSIT, HORIZON)), min_size=1),
    st.integers(1, 5),
)
def test_one_role_per_capture(drawn, size):
    role = {str(k): v for k, v in drawn.items()}
    captures = {}
    for path in role:
        captures.setdefault(str(int(path) // size), []).append(path)
    primary = {c: paths[0] for c, paths in captures.items() if int(c) % 2}
    result = one_role_per_capture(role, captures, primary)
    assert set(result) == set(role)
    for capture, paths in captures.items():
        said = {result[p] for p in paths}
        assert len(said) == 1
        if capture in primary and role[primary[capture]] != SURVEY:
            assert said == {role[primary[capture]]}
