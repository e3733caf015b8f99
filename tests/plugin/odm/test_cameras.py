from __future__ import annotations

import math
from dataclasses import replace

import pytest
from sensorgate.plugin.odm.cameras import (
    CameraDecision,
    ProjectFrame,
    calibration_for,
    camera_uses,
    decision_from_intrinsics,
    entry,
)
from sensorgate.plugin.odm.cameras_file import check_cameras_file
from sensorgate.stages.frame import Frame
from sensorgate.stages.intrinsics import Intrinsics

KEY = "dji fc6310 5472 3648 brown 0.6666"


def shot(name: str = "a.jpg", **tags: object) -> Frame:
    base = {
        "path": name,
        "size_bytes": 1,
        "format": "jpeg",
        "width": 5472,
        "height": 3648,
        "make": "DJI",
        "model": "FC6310",
        "focal_mm": 8.8,
        "focal_35mm": 24.0,
    }
    return Frame(**{**base, **tags})  # type: ignore[arg-type]


def decided(profile: str = "p", ratio: float = 0.664, source: str = "sheet", **more: object) -> CameraDecision:
    return CameraDecision(profile=profile, focal_ratio=ratio, focal_source=source, **more)  # type: ignore[arg-type]


NONE = (0.0, 0.0, 0.0, 0.0, 0.0)


def test_the_worked_example_in_odms_format() -> None:
    # fx 3633.4 of 5472 px, cx 2742.1, cy 1819.1
    given = decided(
        ratio=3633.4 / 5472,
        center_ratio=((2742.1 - 2735.5) / 5472, (1819.1 - 1823.5) / 5472),
        distortion=(-0.006, 0.004, 0.0001, -0.0002, -0.002),
        lock=True,
    )
    plan = calibration_for([ProjectFrame(shot(), "p")], {"p": given})
    assert plan.lock
    assert list(plan.cameras) == [KEY]
    camera = plan.cameras[KEY]
    assert camera["projection_type"] == "brown"
    assert (camera["width"], camera["height"]) == (5472, 3648)
    assert camera["focal_x"] == camera["focal_y"] == pytest.approx(0.664, abs=1e-4)
    assert camera["c_x"] == pytest.approx(0.0012, abs=1e-5)
    assert camera["c_y"] == pytest.approx(-0.0008, abs=1e-5)
    assert [camera[k] for k in ("k1", "k2", "p1", "p2", "k3")] == [-0.006, 0.004, 0.0001, -0.0002, -0.002]


def test_no_file_where_odms_own_focal_will_do() -> None:
    plan = calibration_for([ProjectFrame(shot(), "p")], {"p": decided(ratio=0.664, distortion=NONE)})
    assert plan.cameras == {}
    assert not plan.lock


@pytest.mark.parametrize(
    ("tags", "ratio", "word"),
    [
        ({"focal_35mm": None, "model": "M3T", "focal_mm": 4.4}, 0.69, "0.85"),
        ({"focal_35mm": 28.0}, 0.664, "17"),
    ],
    ids=["default", "stale"],
)
def test_a_file_without_a_lock_where_odm_would_start_wrong(tags: dict, ratio: float, word: str) -> None:
    plan = calibration_for([ProjectFrame(shot(**tags), "p")], {"p": decided(ratio=ratio, distortion=NONE)})
    assert len(plan.cameras) == 1
    assert not plan.lock
    assert word in plan.reason


def test_a_worse_source_does_not_overrule_odms_own_focal() -> None:
    plan = calibration_for([ProjectFrame(shot(), "p")], {"p": decided(ratio=0.9, source="generic-width")})
    assert plan.cameras == {}


def test_portrait_frames_are_divided_by_the_longer_side() -> None:
    portrait = shot(width=3648, height=5472)
    plan = calibration_for(
        [ProjectFrame(portrait, "p")], {"p": decided(ratio=3633.4 / 3648, distortion=NONE, lock=True)}
    )
    (camera,) = plan.cameras.values()
    assert camera["focal_x"] == pytest.approx(3633.4 / 5472, abs=1e-7)


def test_portrait_focal_plane_tags_mislead_odm_by_the_aspect() -> None:
    # The tag's width is that of the shorter side: ODM divides by it, OpenSfM means the longer one.
    tags = {"focal_35mm": None, "focal_plane_x_res": 3648 / 8.8, "focal_plane_unit": 4, "width": 3648, "height": 5472}
    plan = calibration_for([ProjectFrame(shot(**tags), "p")], {"p": decided(ratio=1.0, source="focal-plane")})
    (camera,) = plan.cameras.values()
    assert camera["focal_x"] == pytest.approx(3648 / 5472, abs=1e-7)


def test_the_lock_needs_every_camera_and_a_calibration_that_is_no_guess() -> None:
    frames = [ProjectFrame(shot(), "p"), ProjectFrame(shot("b.jpg", model="FC300S"), "q")]
    held = decided("p", distortion=NONE, lock=True)
    full = {"p": held, "q": decided("q", distortion=NONE, lock=True)}
    assert calibration_for(frames, full).lock
    for spoiled in (
        {"p": held},
        {**full, "q": decided("q", distortion=NONE, lock=False)},
        {**full, "q": decided("q", distortion=None, lock=True)},
        {**full, "q": decided("q", source="equivalent-35mm", distortion=NONE, lock=True)},
    ):
        plan = calibration_for(frames, spoiled)
        assert not plan.lock
        assert "odm-lock-refused" in [f.code for f in plan.findings]


def test_secondary_bands_do_not_stand_in_the_way_of_the_lock() -> None:
    frames = [ProjectFrame(shot(), "p"), ProjectFrame(shot("b.tif", model="NIR"), "nir", primary=False)]
    plan = calibration_for(frames, {"p": decided(distortion=NONE, lock=True)})
    assert plan.lock


def test_an_id_that_hangs_on_odms_table_gets_no_entry() -> None:
    unsure = shot(make="NIKON CORPORATION", model="NIKON D90", focal_35mm=None)
    plan = calibration_for([ProjectFrame(unsure, "p")], {"p": decided(distortion=NONE, lock=True)})
    assert plan.cameras == {}
    assert {f.code for f in plan.findings} == {"odm-camera-id-unsure", "odm-lock-refused"}


def test_a_frame_that_kills_odm_leaves_no_cover() -> None:
    dead = shot("c.jpg", focal_plane_unit=2, problems=("focal-plane-rational-zero:FocalPlaneXResolution",))
    plan = calibration_for(
        [ProjectFrame(shot(), "p"), ProjectFrame(dead, "p")], {"p": decided(distortion=NONE, lock=True)}
    )
    assert not plan.lock


def test_two_true_cameras_under_one_id_are_said_and_not_locked() -> None:
    frames = [ProjectFrame(shot(), "p"), ProjectFrame(shot("b.jpg"), "q"), ProjectFrame(shot("c.jpg"), "q")]
    apart = {
        "p": decided("p", ratio=0.64, distortion=NONE, lock=True),
        "q": decided("q", ratio=0.70, distortion=NONE, lock=True),
    }
    plan = calibration_for(frames, apart)
    assert "odm-cameras-merged" in [f.code for f in plan.findings]
    assert not plan.lock
    (camera,) = plan.cameras.values()
    assert camera["focal_x"] == 0.70  # the profile with more frames
    alike = {**apart, "p": decided("p", ratio=0.699, distortion=NONE, lock=True)}
    assert calibration_for(frames, alike).lock


def test_fisheye_models_are_left_to_odm() -> None:
    plan = calibration_for(
        [ProjectFrame(shot(projection="fisheye"), "p")], {"p": decided(projection="fisheye", distortion=NONE)}
    )
    assert plan.cameras == {}
    assert [f.code for f in plan.findings] == ["odm-camera-model-not-expressible"]


def test_keys_follow_the_written_size_and_focal() -> None:
    plan = calibration_for(
        [ProjectFrame(shot(focal_35mm=28.0), "p", width=2736, height=1824, focal_35mm=24.0)],
        {"p": decided(distortion=NONE, lock=True)},
    )
    assert list(plan.cameras) == ["dji fc6310 2736 1824 brown 0.6666"]


def test_order_of_frames_changes_nothing() -> None:
    frames = [ProjectFrame(shot(f"{i}.jpg", focal_35mm=23.0 + i % 3), f"p{i % 2}") for i in range(6)]
    given = {p: decided(p, distortion=NONE, lock=True) for p in ("p0", "p1")}
    assert calibration_for(frames, given) == calibration_for(frames[::-1], given)
    assert [u.frames for u in camera_uses(frames)] == [2, 2, 2]


def test_an_entrys_focal_is_to_the_longer_side() -> None:
    for width, height, over_width in ((4000, 3000, 0.7), (3000, 4000, 0.7 * 4 / 3)):
        made = entry(replace(decided("p", distortion=NONE), focal_ratio=over_width), width, height)
        assert made is not None
        assert math.isclose(made["focal_x"], 0.7, abs_tol=1e-8)


def test_intrinsics_are_taken_as_they_are() -> None:
    known = Intrinsics(focal_ratio=0.6, focal_source="xmp-dewarp", center_ratio=(0.01, 0.0), distortion=NONE)
    made = decision_from_intrinsics("p", known, lock=True)
    assert (made.focal_ratio, made.focal_source, made.center_ratio, made.lock) == (0.6, "xmp-dewarp", (0.01, 0.0), True)


def test_a_users_cameras_file_is_held_against_the_ids() -> None:
    ids = [f"v2 {KEY}"]
    good = {"projection_type": "brown", "focal_x": 0.6, "focal_y": 0.6}
    assert check_cameras_file({KEY: good}, ids) == ()
    assert check_cameras_file({f"v2 {KEY}": good}, ids) == ()
    codes = [f.code for f in check_cameras_file({"all": good, KEY.replace("5472", "2736"): {**good, "k4": 0.1}}, ids)]
    assert codes == ["odm-camera-key-unmatched", "odm-cameras-file-invalid", "odm-camera-field-ignored"]
    assert [f.code for f in check_cameras_file([], ids)] == ["odm-cameras-file-invalid"]


def test_a_fisheye_that_three_coefficients_say_has_an_entry() -> None:
    lens = Intrinsics(
        focal_ratio=0.8314, focal_source="xmp-camera", distortion=(-0.02, 0.001, 0.0002), projection="fisheye",
        distortion_source="xmp-camera", converted_focal_ratio=0.832,
    )  # fmt: skip
    made = entry(decision_from_intrinsics("seq", lens), 1280, 960)
    assert made is not None and made["projection_type"] == "fisheye_opencv"
    assert (made["focal_x"], made["k1"], made["k2"], made["k3"]) == (0.832, -0.02, 0.001, 0.0002)
    assert not {"k4", "p1", "p2"} & set(made)
    assert entry(decision_from_intrinsics("seq", replace(lens, distortion=None)), 1280, 960) is None
    assert not lens.complete
