"""True intrinsics: which source is believed, what is passed over, and the ground resolution."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Optional

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from sensorgate.stages.focals import STALE
from sensorgate.stages.frame import FileCalibration, Frame
from sensorgate.stages.intrinsics import (
    SOURCES,
    Intrinsics,
    corrected_in_camera,
    equivalent_ratio,
    find_row,
    focal_plane_width_mm,
    gsd_cm,
    gsd_cm_from_ratio,
    resolve,
)
from sensorgate.stages.read import read_frame
from sensorgate.stages.sensors import Sheet, load_sheet

SHEET = load_sheet()
EMPTY = Sheet(())
REAL = Path(__file__).resolve().parents[2].parent / "shared/data/real_frames"


def frame(width: int = 5472, height: int = 3648, **facts: Any) -> Frame:
    return replace(Frame(path="in/a.jpg", size_bytes=1, format="jpeg", width=width, height=height), **facts)


P4P = frame(make="DJI", model="FC6310", focal_mm=8.8, focal_35mm=24.0)
CANON = frame(4000, 3000, make="Canon", model="Canon PowerShot SX260 HS", focal_mm=4.5, focal_plane_x_res=16393.44262)
DEWARP = FileCalibration(
    source="xmp-dewarp",
    focal_px=3713.29,
    center_px=(2647.0, 1969.4),
    distortion=(-0.111, 0.0122, -0.0002, -0.0001, -0.0269),
)
M3E = frame(5280, 3956, make="DJI", model="M3E", focal_mm=12.29, focal_35mm=24.0, calibration=DEWARP, dewarp_flag=0)


def rgb(shown: Frame, sheet: Sheet = SHEET) -> Intrinsics:
    return resolve(shown, "rgb", sheet)


def test_sheet() -> None:
    found = rgb(P4P)
    assert (found.focal_source, found.sensor_width_source) == ("sheet", "sheet")
    assert found.focal_ratio == pytest.approx(3666.67 / 5472, rel=0.002)
    assert found.distortion == (0.0,) * 5
    assert found.distortion_source == "corrected-in-camera"
    assert found.focal_trusted and found.complete and found.notes == ()


def test_equivalent_where_the_camera_is_unknown() -> None:
    found = rgb(replace(P4P, make="Nobody", model="Knows"))
    assert found.focal_source == "equivalent-35mm"
    assert found.focal_ratio == pytest.approx(24 / 36, rel=1e-3)
    assert found.focal_mm == 8.8
    assert found.sensor_width_mm is None
    assert not found.focal_trusted and not found.complete


def test_missing_everything() -> None:
    assert rgb(frame()) == Intrinsics()
    assert rgb(frame(focal_mm=0.0, focal_35mm=0.0, digital_zoom=0.0)) == Intrinsics()
    assert rgb(frame(focal_mm=5.0)).focal_source == "unknown"
    assert rgb(frame(focal_mm=5.0)).focal_mm == 5.0


def test_fixed_lens_without_any_focal_tag_takes_the_sheets() -> None:
    thermal = frame(640, 512, make="DJI", model="MAVIC2-ENTERPRISE-ADVANCED")
    found = resolve(thermal, "thermal", SHEET)
    assert (found.focal_mm, found.sensor_width_mm, found.focal_source) == (9.0, 7.68, "sheet")
    assert found.focal_ratio is not None and found.focal_ratio * 640 == pytest.approx(750.0)


def test_focal_plane_in_every_unit() -> None:
    for unit, per_mm in ((2, 1 / 25.4), (3, 0.1), (4, 1.0), (5, 1000.0), (None, 1 / 25.4)):
        shown = frame(4000, 3000, focal_mm=4.5, focal_plane_unit=unit, focal_plane_x_res=4000 / 6.2 / per_mm)
        found = rgb(shown, EMPTY)
        assert found.sensor_width_mm == pytest.approx(6.2)
        assert found.focal_ratio == pytest.approx(4.5 / 6.2)
        assert (found.focal_source, found.sensor_width_source) == ("focal-plane", "focal-plane")
    assert focal_plane_width_mm(frame(focal_plane_unit=1, focal_plane_x_res=500.0)) is None
    assert focal_plane_width_mm(frame(focal_plane_unit=4, focal_plane_x_res=0.0)) is None
    only_y = frame(focal_plane_unit=4, focal_plane_x_res=0.0, focal_plane_y_res=400.0)
    assert focal_plane_width_mm(only_y) == pytest.approx(13.68)


def test_focal_plane_of_the_real_canon() -> None:
    found = rgb(CANON)
    assert found.focal_source == "focal-plane"
    assert found.sensor_width_mm == pytest.approx(6.1976, abs=1e-3)


@pytest.mark.parametrize("factor", [0.9, 0.5, 0.25, 2.0])
def test_stale_focal_plane_tags_are_passed_over_for_the_sheet(factor: float) -> None:
    resized = replace(CANON, width=round(4000 * factor), height=round(3000 * factor))
    assert focal_plane_width_mm(resized) == pytest.approx(6.1976 * factor, rel=1e-3)
    known = Sheet(
        tuple(
            replace(r, sizes=(*r.sizes, (resized.width, resized.height)), pitch_px=4000)
            for r in SHEET.rows_for("Canon", "Canon PowerShot SX260 HS")
        )
    )
    found = rgb(resized, known)
    assert found.focal_source == "sheet"
    assert found.sensor_width_mm == pytest.approx(6.17)
    assert found.notes[0].startswith(STALE)


def test_stale_focal_plane_tags_without_the_size_in_the_sheet() -> None:
    resized = replace(CANON, width=2000, height=1500, exif_width=4000, exif_height=3000)
    found = rgb(resized, EMPTY)
    assert found.focal_ratio == pytest.approx(4.5 / 6.1976, rel=1e-3)
    assert found.notes[0].startswith(STALE)
    by_equivalent = rgb(replace(resized, focal_35mm=25.0), EMPTY)
    assert by_equivalent.focal_source == "equivalent-35mm"
    assert by_equivalent.notes[0].startswith(STALE)


def test_focal_plane_tags_of_a_crop_stay_right() -> None:
    crop = replace(CANON, width=3000, height=3000, exif_width=4000, exif_height=3000)
    found = rgb(crop)
    assert found.focal_source == "focal-plane"
    assert found.sensor_width_mm == pytest.approx(6.1976 * 0.75, rel=1e-3)
    assert not found.notes


def test_a_crop_is_not_taken_for_a_reduction_of_the_sheets_size() -> None:
    crop_mode = frame(5168, 3448, make="Sony", model="ILCE-7RM2", focal_mm=35.0, focal_35mm=52.0)
    found = rgb(crop_mode)
    assert found.focal_source == "equivalent-35mm"
    assert found.sensor_width_mm is None
    assert found.notes


@pytest.mark.parametrize(
    "equivalent, width, height, truth",
    [
        (20.0, 4000, 2250, 3.61 / 6.2),
        (20.0, 4000, 3000, 3.61 / 6.2),
        (24.0, 5472, 3648, 3666.67 / 5472),
        (24.0, 5280, 3956, 3713.29 / 5280),
        (40.0, 640, 512, 9.1 / 7.68),
        (58.0, 640, 512, 13.5 / 7.68),
    ],
)
def test_equivalents_go_by_the_diagonal(equivalent: float, width: int, height: int, truth: float) -> None:
    assert equivalent_ratio(equivalent, width, height) == pytest.approx(truth, rel=0.025)


def test_equivalent_of_an_upright_frame() -> None:
    flat, upright = equivalent_ratio(24.0, 5472, 3648), equivalent_ratio(24.0, 3648, 5472)
    assert flat is not None and upright is not None
    assert flat * 5472 == pytest.approx(upright * 3648)
    assert equivalent_ratio(0.0, 4000, 3000) is None
    assert equivalent_ratio(None, 4000, 3000) is None


def test_dewarp_data_of_a_raw_frame() -> None:
    found = rgb(M3E)
    assert found.focal_source == "xmp-dewarp"
    assert found.focal_ratio == pytest.approx(3713.29 / 5280)
    assert (found.distortion, found.distortion_source) == (DEWARP.distortion, "xmp-dewarp")
    assert found.center_ratio == pytest.approx((7.0 / 5280, -8.6 / 5280))
    assert found.sensor_width_mm == 17.42 and found.complete and found.aspect_ratio == 1.0


def test_the_aspect_of_two_focals_goes_with_the_calibration_that_has_them() -> None:
    two = replace(M3E, calibration=replace(DEWARP, aspect_ratio=0.9993))
    assert rgb(two).aspect_ratio == 0.9993
    # Passed over: every other source says another focal.
    wild = rgb(replace(two, calibration=replace(DEWARP, focal_px=9000.0, aspect_ratio=0.9993)))
    assert wild.focal_source != "xmp-dewarp" and wild.aspect_ratio == 1.0


def test_a_dewarped_frame_has_no_distortion_left() -> None:
    found = rgb(replace(M3E, dewarp_flag=1))
    assert found.focal_source == "xmp-dewarp"
    assert (found.distortion, found.distortion_source) == ((0.0,) * 5, "corrected-in-camera")


def test_an_implausible_calibration_is_passed_over() -> None:
    assert M3E.calibration is not None
    wrong = replace(M3E, calibration=replace(M3E.calibration, focal_px=1800.0))
    found = rgb(wrong)
    assert found.focal_source == "sheet"
    assert found.distortion_source == "unknown" and found.center_ratio is None
    assert "passed over" in found.notes[0]
    alone = replace(wrong, make="", model="", focal_mm=None, focal_35mm=None)
    assert rgb(alone).focal_source == "xmp-dewarp"


def test_calibration_in_mm_needs_a_width() -> None:
    calibration = FileCalibration(source="xmp-camera", focal_mm=4.812073, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    shown = frame(4608, 3456, calibration=calibration, focal_plane_unit=4, focal_plane_x_res=746.2686793)
    assert rgb(shown, EMPTY).focal_ratio == pytest.approx(4.812073 / 6.17472, rel=1e-5)
    assert rgb(replace(shown, focal_plane_x_res=None), EMPTY).focal_source == "unknown"


def test_fisheye_is_kept_apart() -> None:
    calibration = FileCalibration(
        source="xmp-camera", projection="fisheye", focal_px=1064.0, distortion=(0, 1, 0.01, -0.1)
    )
    shown = frame(1280, 960, channels=1, make="Parrot", model="Sequoia", focal_mm=3.98, calibration=calibration)
    found = resolve(shown, "multispectral", SHEET, band="nir")
    assert (found.projection, found.distortion, found.complete) == ("fisheye", None, False)
    assert found.focal_ratio == pytest.approx(1064 / 1280)


def test_digital_zoom_multiplies() -> None:
    zoomed = rgb(replace(P4P, digital_zoom=2.0))
    plain = rgb(P4P)
    assert plain.focal_ratio and zoomed.focal_ratio == pytest.approx(2 * plain.focal_ratio)
    for unused in (0.0, 1.0, None):
        assert rgb(replace(P4P, digital_zoom=unused)).focal_ratio == plain.focal_ratio
    unknown = replace(P4P, make="", model="", digital_zoom=2.0)
    assert rgb(unknown).focal_ratio == pytest.approx(4 / 3, rel=1e-3)


@pytest.mark.parametrize("tag", [24.0, 4.0])
def test_a_wrong_tag_on_a_fixed_lens(tag: float) -> None:
    found = rgb(replace(P4P, focal_mm=tag))
    assert (found.focal_mm, found.focal_source) == (8.8, "sheet")
    assert found.notes
    undecided = rgb(replace(P4P, focal_mm=tag, focal_35mm=None))
    assert (undecided.focal_mm, undecided.focal_source) == (8.8, "generic-width")
    assert not undecided.focal_trusted


def test_firmware_drift_of_the_tag_is_kept() -> None:
    found = rgb(replace(P4P, focal_mm=8.5))
    assert found.focal_mm == 8.5 and found.focal_source == "sheet"


def test_zoom_lens_follows_its_tag() -> None:
    for tag in (4.4, 8.0):
        found = rgb(frame(4000, 3000, make="DJI", model="FC2204", focal_mm=tag))
        assert found.focal_ratio == pytest.approx(tag / 6.2)
    assert rgb(frame(4000, 3000, make="DJI", model="FC2204")).focal_source == "unknown"


def test_users_sheet_wins_over_everything(tmp_path: Path) -> None:
    own = tmp_path / "own.csv"
    own.write_text(
        "make,model,width,height,focal_px,k1,k2,cx,cy\nDJI,M3E,5280,3956,3700,-0.1,0.01,2645,1970\n", encoding="utf-8"
    )
    found = rgb(M3E, load_sheet(own))
    assert found.focal_source == "user-sheet"
    assert found.focal_ratio == pytest.approx(3700 / 5280)
    assert (found.distortion, found.distortion_source) == ((-0.1, 0.01, 0.0, 0.0, 0.0), "user-sheet")
    assert found.center_ratio == pytest.approx((5 / 5280, -8 / 5280))
    half = replace(M3E, width=2640, height=1978, calibration=None)
    assert rgb(half, load_sheet(own)).focal_ratio == pytest.approx(3700 / 5280)


def test_corrected_in_camera() -> None:
    row = find_row(P4P, "rgb", SHEET)
    assert corrected_in_camera(P4P, row)
    assert not corrected_in_camera(replace(P4P, format="dng"), row)
    assert not corrected_in_camera(P4P, None)
    assert not corrected_in_camera(M3E, find_row(M3E, "rgb", SHEET))
    assert corrected_in_camera(replace(M3E, dewarp_flag=1), None)


def test_gsd() -> None:
    assert gsd_cm(13.2, 100.0, 8.8, 5472) == pytest.approx(2.741, abs=1e-3)
    assert gsd_cm_from_ratio(8.8 / 13.2, 100.0, 5472) == pytest.approx(gsd_cm(13.2, 100.0, 8.8, 5472))


POSITIVE = st.one_of(st.none(), st.floats(min_value=0, max_value=1e7, allow_nan=False))


@example(
    focal=5e-324,
    equivalent=24.0,
    resolution=5e-324,
    unit=4,
    zoom=1e7,
    named=("DJI", "FC6310"),
    size=(5472, 3648),
    calibrated=5e-324,
)
@given(
    focal=POSITIVE,
    equivalent=POSITIVE,
    resolution=POSITIVE,
    unit=st.sampled_from([None, 1, 2, 3, 4, 5, 9]),
    zoom=POSITIVE,
    named=st.sampled_from([("DJI", "FC6310"), ("Sony", "ILCE-7RM2"), ("", ""), ("DJI", "M3T")]),
    size=st.sampled_from([(5472, 3648), (4000, 3000), (640, 512), (3000, 5000)]),
    calibrated=POSITIVE,
)
def test_laws_of_any_frame(
    focal: Optional[float],
    equivalent: Optional[float],
    resolution: Optional[float],
    unit: Optional[int],
    zoom: Optional[float],
    named: Any,
    size: Any,
    calibrated: Optional[float],
) -> None:
    shown = frame(
        *size,
        make=named[0],
        model=named[1],
        focal_mm=focal,
        focal_35mm=equivalent,
        focal_plane_x_res=resolution,
        focal_plane_unit=unit,
        digital_zoom=zoom,
        calibration=FileCalibration(source="xmp-calibrated", focal_px=calibrated),
    )
    found = rgb(shown)
    assert found.focal_source in SOURCES and found.sensor_width_source in SOURCES
    assert (found.focal_ratio is None) == (found.focal_source == "unknown")
    assert (found.sensor_width_mm is None) == (found.sensor_width_source == "unknown")
    assert found.focal_ratio is None or found.focal_ratio > 0
    assert found.focal_mm is None or found.focal_mm > 0
    assert found == rgb(shown)


@given(scale=st.sampled_from([0.25, 0.5, 2.0]), equivalent=st.integers(min_value=10, max_value=400))
def test_uniform_scaling_keeps_the_equivalents_ratio(scale: float, equivalent: int) -> None:
    full = equivalent_ratio(float(equivalent), 4000, 3000)
    reduced = equivalent_ratio(float(equivalent), round(4000 * scale), round(3000 * scale))
    assume(full is not None)
    assert reduced == pytest.approx(full)


REAL_RATIOS = {
    "brighton_p3_rgb/DJI_0018.JPG": ("sheet", 0.5851),
    "caliterra_canon_rgb/IMG_9374.jpg": ("focal-plane", 0.7261),
    "garfield_sequoia_rgb_ms/IMG_161122_163234_0000_RGB.JPG": ("xmp-camera", 0.7793),
    "garfield_sequoia_rgb_ms/IMG_161122_163234_0000_NIR.TIF": ("xmp-camera", 0.8314),
    "micasense_rededge_capture/IMG_0001_1.tif": ("xmp-camera", 1.1323),
    "thermal_samples/dji-zenmuse-xt2/DJI_XT2.jpg": ("sheet", 1.7463),
    "thermal_samples/dji-zenmuse-xts/DJI_XTS.jpg": ("sheet", 1.7463),
    "thermal_samples/dji-zh20t-thermal/DJI_H20T.jpg": ("sheet", 1.7578),
    "thermal_samples/dji-m2ea-thermal/DJI_0001_R.JPG": ("sheet", 1.1719),
    "thermal_samples/dji-m30t-thermal/DJI_0001_R.JPG": ("sheet", 1.1849),
    "thermal_samples/flir-e40/FLIR_E40.jpg": ("sheet", 2.25),
}


@pytest.mark.parametrize("file", sorted(REAL_RATIOS))
def test_real_frames(file: str) -> None:
    if not (REAL / file).exists():
        pytest.skip("the real frames are not here")
    shown = read_frame(REAL / file, file)
    spectrum = "thermal" if "thermal" in file else "multispectral" if file.lower().endswith("tif") else "rgb"
    found = resolve(shown, spectrum, SHEET)
    source, ratio = REAL_RATIOS[file]
    assert found.focal_source == source
    assert found.focal_ratio == pytest.approx(ratio, abs=2e-4)
    assert found.notes == ()
