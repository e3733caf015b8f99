"""Groups and requests: what may share a project, and one camera in two sizes."""

from __future__ import annotations

from dataclasses import replace

from sensorgate.stages.assemble import groups_of, kin_of, left_out, request_of
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
