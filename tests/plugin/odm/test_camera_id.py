"""Ids as ODM 3.6.0 was seen to give them, for real frames and for every way it falls back."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.odm.camera_id import camera_id, file_key, odm_focal_ratio, sensor_string, table_width_mm
from sensorgate.stages.frame import Frame


def frame(**tags: object) -> Frame:
    base = {"path": "x.jpg", "size_bytes": 1, "format": "jpeg", "width": 4000, "height": 3000}
    return Frame(**{**base, **tags})  # type: ignore[arg-type]


# Tags of real files and the id that ODM printed for them.
OBSERVED = [
    (
        {"make": "DJI", "model": "FC300S", "width": 4000, "height": 2250, "focal_mm": 3.61, "focal_35mm": 20.0},
        "v2 dji fc300s 4000 2250 brown 0.5555",
    ),
    (
        {
            "make": "Canon",
            "model": "Canon PowerShot SX260 HS",
            "focal_mm": 4.5,
            "focal_plane_x_res": 4000000 / 244,
            "focal_plane_y_res": 3000000 / 183,
            "focal_plane_unit": 2,
        },
        "v2 canon canon powershot sx260 hs 4000 3000 brown 0.7260",
    ),
    (
        {
            "make": "Parrot",
            "model": "Sequoia",
            "width": 1280,
            "height": 960,
            "focal_mm": 3.98,
            "focal_35mm": 30.0,
            "focal_plane_x_res": 266.6666559,
            "focal_plane_unit": 4,
            "projection": "fisheye",
        },
        "v2 parrot sequoia 1280 960 fisheye_opencv 0.8333",
    ),
    (
        {
            "make": "MicaSense",
            "model": "RedEdge",
            "width": 1280,
            "height": 960,
            "focal_mm": 5.5,
            "focal_plane_x_res": 266.666667,
            "focal_plane_unit": 4,
            "projection": "perspective",
        },
        "v2 micasense rededge 1280 960 perspective 1.1458",
    ),
    (
        {"make": "DJI", "model": "M30T", "width": 1280, "height": 1024, "focal_mm": 9.1, "focal_35mm": 40.0},
        "v2 dji m30t 1280 1024 brown 1.1111",
    ),
    (
        {"make": "FLIR Systems AB", "model": "FLIR E40", "width": 320, "height": 240, "focal_mm": 18.0},
        "v2 flir systems ab flir e40 320 240 brown 0.85",
    ),
    (
        {"make": "DJI", "model": "XT S", "width": 640, "height": 512, "focal_mm": 19.0, "focal_plane_unit": 4},
        "v2 dji xt s 640 512 brown 0.85",
    ),
    (
        {"make": "DJI", "model": "MAVIC2-ENTERPRISE-ADVANCED", "width": 640, "height": 512},
        "v2 dji mavic2-enterprise-advanced 640 512 brown 0.85",
    ),
    ({"make": "DJI", "model": "FC6310", "focal_mm": 8.8}, "v2 dji fc6310 4000 3000 brown 0.6666"),
    ({"make": "DJI", "model": "FC6310", "focal_mm": 8.8, "focal_35mm": 0.0}, "v2 dji fc6310 4000 3000 brown 0.6666"),
    ({"width": 400, "height": 300, "focal_35mm": 24.0}, "v2   400 300 brown 0.6666"),
]


@pytest.mark.parametrize(("tags", "expected"), OBSERVED, ids=[o[1] for o in OBSERVED])
def test_ids_are_those_that_odm_gave(tags: dict, expected: str) -> None:
    assert camera_id(frame(**tags)) == expected
    assert odm_focal_ratio(frame(**tags)).sure


def test_digital_zoom_serial_and_lens_do_not_part_cameras() -> None:
    one = frame(make="DJI", model="FC3411", focal_mm=8.4, focal_35mm=22.0)
    other = replace(one, digital_zoom=2.0, serial="B", lens="other", software="2")
    assert camera_id(one) == camera_id(other)


def test_autofocus_jitter_makes_a_camera_of_every_step() -> None:
    tags = {"make": "DJI", "model": "X", "focal_plane_x_res": 4000 / 6.4, "focal_plane_unit": 4}
    ids = {camera_id(frame(focal_mm=f, **tags)) for f in (4.386, 4.387, 4.390, 4.400)}
    assert len(ids) == 4


@pytest.mark.parametrize("tag", ["FocalPlaneXResolution"])
def test_a_zero_denominator_kills_odm_even_beside_a_good_35mm_focal(tag: str) -> None:
    bad = frame(focal_35mm=24.0, focal_plane_unit=2, problems=(f"focal-plane-rational-zero:{tag}",))
    focal = odm_focal_ratio(bad)
    assert focal.ratio is None
    assert focal.how == "crash"
    assert camera_id(bad) == ""


def test_without_a_unit_odm_does_not_look_at_the_resolution() -> None:
    bad = frame(focal_35mm=24.0, focal_plane_unit=1, problems=("focal-plane-rational-zero:FocalPlaneXResolution",))
    assert odm_focal_ratio(bad).ratio == pytest.approx(24 / 36)


def test_resolution_of_zero_takes_the_vertical_one() -> None:
    tags = {"make": "Z", "model": "Y", "focal_mm": 8.0, "focal_plane_unit": 3, "width": 4000}
    zero = ("exif-not-positive:FocalPlaneXResolution",)
    assert odm_focal_ratio(frame(problems=zero, focal_plane_y_res=4000.0, **tags)).ratio == pytest.approx(0.8)
    dead = (*zero, "focal-plane-rational-zero:FocalPlaneYResolution")
    assert odm_focal_ratio(frame(problems=dead, **tags)).ratio is None


def test_lens_name_in_xmp_stands_in_for_a_missing_focal() -> None:
    tags = {"make": "DJI", "model": "ZENMUSEP1", "width": 8192, "height": 5460}
    assert odm_focal_ratio(frame(xmp_lens="DJI DL 35.0mm F2.8", **tags)).ratio == pytest.approx(35 / 35.9)
    assert odm_focal_ratio(frame(xmp_lens="1.2.3mm", **tags)).ratio == 0.85


def test_a_model_of_another_make_may_stand_in_odms_table() -> None:
    focal = odm_focal_ratio(frame(make="NIKON CORPORATION", model="NIKON D90", focal_mm=18.0))
    assert not focal.sure
    assert focal.ratio == 0.85


def test_the_make_is_taken_out_of_the_model_for_the_table_only() -> None:
    canon = frame(make="Canon", model="Canon EOS 5D")
    assert sensor_string(canon) == "canon eos 5d"
    assert "canon canon eos 5d" in camera_id(canon)


def test_make_and_model_of_xmp_serve_where_exif_has_none() -> None:
    assert camera_id(frame(xmp_make="DJI", xmp_model="FC6310", focal_mm=8.8)).startswith("v2 dji fc6310 ")
    assert camera_id(frame(make="A", xmp_make="DJI", model="B", xmp_model="C")).startswith("v2 a b ")


def test_models_that_odms_table_lacks_are_known_to_be_lacking() -> None:
    for key in ("dji m3t", "dji fc3582", "micasense altum", "parrot sequoia", "autel robotics xt705"):
        assert table_width_mm(key) == (None, True)
    assert table_width_mm("dji zh20t") == (7.68, True)


def test_resampling_a_stale_tag_doubles_the_ratio_and_a_rewritten_one_keeps_it() -> None:
    tags = {"make": "M", "model": "R", "focal_mm": 8.8, "focal_plane_x_res": 4000 / 13.2, "focal_plane_unit": 4}
    whole = frame(**tags)
    assert odm_focal_ratio(whole, width=2000).ratio == pytest.approx(2 * 8.8 / 13.2)
    assert camera_id(whole, 2000, 1500, focal_plane_scale=0.5) == "v2 m r 2000 1500 brown 0.6666"


@given(
    focal=st.floats(1.0, 200.0),
    sensor=st.floats(2.0, 60.0),
    width=st.integers(100, 20000),
    unit=st.sampled_from([2, 3, 4, 5]),
)
def test_focal_plane_ratio_is_focal_over_sensor_width(focal: float, sensor: float, width: int, unit: int) -> None:
    mm = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}[unit]
    shot = frame(width=width, focal_mm=focal, focal_plane_x_res=width * mm / sensor, focal_plane_unit=unit)
    ratio = odm_focal_ratio(shot).ratio
    assert ratio is not None
    assert math.isclose(ratio, focal / sensor, rel_tol=1e-9)
    assert camera_id(shot).split(" ")[-1] == str(ratio)[:6]


def test_the_cameras_file_spells_the_id_without_its_version() -> None:
    assert file_key("v2 dji fc6310 1 2 brown 0.6") == "dji fc6310 1 2 brown 0.6"
    assert file_key("dji fc6310 1 2 brown 0.6") == "dji fc6310 1 2 brown 0.6"
