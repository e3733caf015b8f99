"""Groups and requests: what may share a project, and one camera in two sizes."""

from __future__ import annotations

from dataclasses import replace

from sensorgate.stages.assemble import groups_of, kin_of, left_out, level_of, request_of
from sensorgate.stages.elevation import ElevationSource
from sensorgate.stages.harmonize.model import untouched
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import P4P, strip, survey_of


def requested(survey):
    return [request_of(g, survey, untouched(survey.files), DEFAULTS) for g in groups_of(survey)]


def test_every_usable_frame_is_in_one_group():
    far = strip(count=8, prefix="F_", latitude=46.95, start="2024-05-01T12:00:00")
    heat = strip(P4P, 8, prefix="T_", model="ZH20T", width=640, height=512, focal_mm=13.5, focal_35mm=58.0,
                 thermal_payload="dji", image_source="InfraredCamera")  # fmt: skip
    survey = survey_of(strip(count=12) + far + heat)
    groups = groups_of(survey)
    paths = [p for g in groups for p in g.frames]
    assert sorted(paths) == sorted(f.path for f in survey.frames)
    assert [(g.name, g.spectrum, len(g.frames)) for g in groups] == [
        ("rgb", "rgb", 12),
        ("rgb-2", "rgb", 8),
        ("thermal", "thermal", 8),
    ]
    assert left_out(survey) == {}


def test_a_cut_file_goes_into_no_project():
    frames = strip(count=12)
    cut = replace(frames[3], problems=("jpeg-end-missing:the last rows are cut",))
    survey = survey_of([cut, *frames[:3], *frames[4:]])
    assert left_out(survey) == {cut.path: "picture-cut-short"}
    assert cut.path not in groups_of(survey)[0].frames


def test_one_camera_in_two_sizes_is_judged_as_one():
    frames = strip(count=12)
    frames[4] = replace(frames[4], width=2736, height=1824)
    survey = survey_of(frames)
    assert len(survey.profiles) == 2
    (request,) = requested(survey)
    assert len({f.payload for f in request.frames}) == 1
    assert len(request.cameras) == 2


def test_a_cut_frame_and_another_body_stay_apart():
    cut = strip(count=12)
    cut[4] = replace(cut[4], width=3648, height=3648)
    assert kin_of(survey_of(cut), DEFAULTS) == {}
    bodies = strip(count=6, serial="A1") + strip(count=6, serial="B2", prefix="X_", width=2736, height=1824)
    assert kin_of(survey_of(bodies), DEFAULTS) == {}


def test_a_wild_position_is_not_given_to_the_solver():
    frames = strip(count=12)
    frames[5] = replace(frames[5], latitude=10.0)
    (request,) = requested(survey_of(frames))
    assert [f.position for f in request.frames if f.path == frames[5].path] == [None]
    assert sum(f.position is not None for f in request.frames) == 11


def test_a_refused_band_leaves_the_rig_and_the_rig_is_of_another_kind():
    bands = ("Blue", "Green", "Red")
    frames = [
        replace(f, bands=(band,), capture_id=f"c{i}", path=f"/m/{i}_{n}.tif", format="tiff", bits=16, focal_35mm=None)
        for n, band in enumerate(bands)
        for i, f in enumerate(strip(count=6, make="MicaSense", model="RedEdge", width=1280, height=960, focal_mm=5.5))
    ]
    survey = survey_of(frames)
    (payload,) = survey.payloads
    (whole,) = groups_of(survey)
    assert len(whole.frames) == 18 and len(whole.solver_frames) == 6 and not whole.lone_band
    lone = next(p for p in payload.profiles if p != payload.primary)
    main, apart = groups_of(survey, {payload.id: (lone,)})
    assert len(main.frames) == 12 and main.solver_frames == whole.solver_frames
    assert apart.frames == apart.solver_frames and len(apart.frames) == 6
    assert apart.lone_band == survey.profile_of()[lone].band
    assert sorted(main.frames + apart.frames) == sorted(whole.frames)


class Ground:
    """An elevation model of level ground at 100 m."""

    file = "/nowhere/ground.tif"

    def __init__(self, vertical=""):
        self.source = ElevationSource("ground.tif", 100, 100, vertical, "0" * 64)

    def sample(self, points):
        return tuple(100.0 for _ in points)

    def spacing_m(self, point):
        return 1.0


def _level(frames, vertical=""):
    survey = survey_of(frames, elevation=Ground(vertical))
    (group,) = groups_of(survey)
    (request,) = requested(survey)
    assert request.elevation == Ground.file
    assert request.elevation_level_m == level_of(group.solver_frames, survey, DEFAULTS)
    return request.elevation_level_m


def test_the_zero_of_altitudes_is_known_where_both_count_from_the_ellipsoid_or_a_takeoff_shows_it():
    fixed = strip(count=12, rtk_flag=50, rtk_std_m=(0.01, 0.01, 0.02), altitude_m=227.5)
    assert _level(fixed) is None
    assert _level([replace(f, altitude_type="RtkAlt") for f in fixed], "ellipsoid") == (0.0, 0.0)
    assert _level([replace(f, altitude_type="RtkAlt") for f in fixed], "EGM2008 height") is None
    # Two metres above the ground its altitude is 149.5 m: the zeros lie 47.5 m apart.
    started = [replace(fixed[0], altitude_m=149.5, relative_altitude_m=2.0), *fixed[1:]]
    assert _level(started) == (47.5, DEFAULTS.takeoff_level_m)
    assert _level([replace(f, rtk_flag=16) for f in started]) is None
    (request,) = requested(survey_of(fixed))
    assert request.elevation == "" and request.elevation_level_m is None
