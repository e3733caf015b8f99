"""Every way that a lens reaches ODM's cameras file, held against the lens itself: a grid moves less than 0.05 px.

The referees are OpenCV's own projection, COLMAP's own projection and Parrot's
polynomial; ODM's side is the entry as OpenSfM reads it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Sequence, Tuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.odm.cameras import CameraDecision, decision_from_intrinsics, entry
from sensorgate.plugin.odm.opensfm_cameras import camera_from_json, project
from sensorgate.stages.align.model import AlignCamera
from sensorgate.stages.align.models import camera_model, read_model
from sensorgate.stages.align.prepare import starting_camera
from sensorgate.stages.align.solution import CameraSetting, in_frame, in_work
from sensorgate.stages.focals import both_focals
from sensorgate.stages.frame import FileCalibration, Frame
from sensorgate.stages.intrinsics import Intrinsics, resolve
from sensorgate.stages.read import read_frame
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import REAL
from tests.stages.headers.build import packet, read, tiff_file

WORST_PX = DEFAULTS.conversion_error_px
BEND = (-0.1126, 0.0149, -0.00009, 0.0003, -0.0271)


def grid(size: Tuple[int, int], focal_px: float, widest: float = 1.0) -> np.ndarray:
    """Points (N, 3) in camera coordinates that fill a frame of ``size`` and a little more."""
    half = widest * np.asarray(size) / 2.0 / focal_px
    x, y = np.meshgrid(np.linspace(-half[0], half[0], 41), np.linspace(-half[1], half[1], 31))
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)


def as_odm(decision: CameraDecision, size: Tuple[int, int], points: np.ndarray) -> np.ndarray:
    """Pixels (0, 0 the centre of the first) where ODM puts points by the entry that it is given."""
    made = entry(decision, *size)
    assert made is not None
    middle = (np.asarray(size) - 1.0) / 2.0
    return project(camera_from_json("c", made), points) * max(size) + middle


def moved(ours: np.ndarray, truth: np.ndarray, size: Tuple[int, int]) -> float:
    """The largest distance inside the frame."""
    inside = ((truth > -1) & (truth < np.asarray(size))).all(axis=1)
    assert inside.sum() > 300
    return float(np.hypot(*(ours - truth)[inside].T).max())


def by_opencv(
    focals: Tuple[float, float], center: Sequence[float], bend: Sequence[float], points: np.ndarray
) -> np.ndarray:
    cv2 = pytest.importorskip("cv2")
    matrix = np.array([[focals[0], 0.0, center[0]], [0.0, focals[1], center[1]], [0.0, 0.0, 1.0]])
    found = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.asarray(bend))[0]
    return np.asarray(found).reshape(-1, 2)


@pytest.mark.parametrize("size", [(5280, 3956), (3956, 5280)], ids=["landscape", "portrait"])
@pytest.mark.parametrize("scale", [1.0, 1.5], ids=["native", "resampled"])
def test_a_calibration_out_of_the_file(size: Tuple[int, int], scale: float) -> None:
    focal, center = 3712.0, (size[0] / 2 + 7.02, size[1] / 2 - 8.72)
    given = FileCalibration("xmp-dewarp", focal_px=focal, center_px=center, distortion=BEND)
    frame = Frame(path="a.jpg", size_bytes=1, format="jpeg", width=size[0], height=size[1], calibration=given)
    decision = decision_from_intrinsics("p", resolve(frame, "rgb", load_sheet(None)))
    assert decision.focal_source == "xmp-dewarp" and decision.distortion == BEND
    written = (round(size[0] * scale), round(size[1] * scale))
    points = grid(written, focal * scale, 1.1)
    there = by_opencv((focal * scale, focal * scale), [c * scale - 0.5 for c in center], BEND, points)
    assert moved(as_odm(decision, written, points), there, written) < WORST_PX


# Fx and fy as the XMP of a Phantom 4 RTK and of a Mavic 3 Enterprise have them, and the size they count pixels of.
DJI = {"P4RTK": (3678.87, 3671.84, 5472, 3648), "M3E": (3713.29, 3710.7, 5280, 3956)}


def dewarped(name: str, bend: Sequence[float], written: Tuple[int, int]) -> Frame:
    """The frame of a file with ``DewarpData`` of two focals."""
    across, down, width, height = DJI[name]
    numbers = ",".join(repr(float(v)) for v in (across, down, 7.02, -8.72, *bend))
    attributes = (
        f'drone-dji:DewarpData="2024-01-01;{numbers}" drone-dji:DewarpFlag="0" '
        f'drone-dji:CalibratedOpticalCenterX="{width / 2}" drone-dji:CalibratedOpticalCenterY="{height / 2}"'
    )
    return read(tiff_file([(700, 1, list(packet(attributes=attributes)))], size=written, bits=8), "a.tif")


@pytest.mark.parametrize("bend", [BEND, (0.0,) * 5], ids=["bent", "straight"])
@pytest.mark.parametrize("scale", [1.0, 0.5], ids=["native", "resampled"])
@pytest.mark.parametrize("name", sorted(DJI))
def test_two_focals_from_the_file_to_odm_and_to_colmap_and_back(name: str, scale: float, bend: Sequence[float]) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    across, down, width, height = DJI[name]
    size = (round(width * scale), round(height * scale))
    known = resolve(dewarped(name, bend, size), "rgb", load_sheet(None))
    assert known.focal_source == "xmp-dewarp" and known.aspect_ratio == pytest.approx(down / across)
    points = grid(size, across * scale)
    center = [(s / 2 + c) * scale - 0.5 for s, c in zip((width, height), (7.02, -8.72))]
    there = by_opencv((across * scale, down * scale), center, bend, points)
    assert moved(as_odm(decision_from_intrinsics("p", known), size, points), there, size) < WORST_PX
    # The ratio matters: without it the same way goes wrong.
    square = decision_from_intrinsics("p", replace(known, aspect_ratio=1.0))
    assert moved(as_odm(square, size, points), there, size) > 3 * WORST_PX

    # The working size's shorter side is no whole number of pixels: rounding it squashes the picture.
    setting = starting_camera(AlignCamera("p", *size, known), 1600, DEFAULTS)
    assert setting.squash != 1.0
    model, values = camera_model(setting)
    assert model == ("FULL_OPENCV" if any(bend) else "PINHOLE")
    camera = pycolmap.Camera(model=model, width=setting.width, height=setting.height, params=values)
    work = np.asarray(size) / (setting.width, setting.height)
    seen = np.asarray([camera.img_from_cam(p) for p in points]) * work - 0.5
    assert moved(seen, there, size) < WORST_PX
    back = in_frame(read_model(setting, model, values))
    solved = CameraDecision(
        profile="p",
        focal_ratio=round(back.focal_ratio, 6),
        focal_source="solved",
        center_ratio=(round(back.center_ratio[0], 6), round(back.center_ratio[1], 6)),
        distortion=tuple(round(v, 6) for v in back.distortion),
        aspect_ratio=round(back.aspect_ratio, 6),
    )
    assert moved(as_odm(solved, size, points), there, size) < WORST_PX


@given(st.floats(0.9, 1.1), st.integers(300, 9000), st.integers(300, 9000), st.integers(100, 2000))
def test_focals_of_the_frame_come_back_from_the_working_size(aspect: float, width: int, height: int, side: int) -> None:
    known = Intrinsics(focal_ratio=0.7, focal_source="xmp-dewarp", distortion=BEND, aspect_ratio=aspect)
    setting = starting_camera(AlignCamera("p", width, height, known), side, DEFAULTS)
    back = in_frame(setting)
    assert back.focal_ratio == pytest.approx(0.7 * width / max(width, height)) and back.aspect_ratio == pytest.approx(
        aspect
    )
    assert in_work(back).focals_px == pytest.approx(setting.focals_px)
    if aspect != 1.0:
        across, down = both_focals(0.7 * width, aspect)
        expected = (across * setting.width / width, down * setting.height / height)
        assert setting.focals_px == pytest.approx(expected)


MODELS = {
    "SIMPLE_PINHOLE": (False, False, (0.0,) * 5),
    "PINHOLE": (False, False, (0.0,) * 5),
    "RADIAL": (True, False, (-0.09, 0.03, 0.0, 0.0, 0.0)),
    "OPENCV": (True, True, (-0.09, 0.03, 0.0007, -0.0004, 0.0)),
    "FULL_OPENCV": (False, False, BEND),
}


@pytest.mark.parametrize("size", [(4000, 3000), (3000, 4000)], ids=["landscape", "portrait"])
@pytest.mark.parametrize("model", sorted(MODELS))
def test_a_camera_that_the_alignment_solved(model: str, size: Tuple[int, int]) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    free, center, bend = MODELS[model]
    work = (size[0] * 2 // 5, size[1] * 2 // 5)
    setting = CameraSetting(
        "p", *work, 0.713, (0.004, -0.006), bend, solve_focal=free, solve_distortion=free, solve_center=center,
        aspect_ratio=1.0 if model == "SIMPLE_PINHOLE" else 0.998,
    )  # fmt: skip
    name, values = camera_model(setting)
    assert name == model
    solved = read_model(setting, name, values)
    decision = CameraDecision(
        profile="p",
        focal_ratio=round(solved.focal_ratio, 6) * max(size) / size[0],
        focal_source="solved",
        center_ratio=(round(solved.center_ratio[0], 6), round(solved.center_ratio[1], 6)),
        distortion=tuple(round(v, 6) for v in solved.distortion),
        aspect_ratio=round(solved.aspect_ratio, 6),
    )
    camera = pycolmap.Camera(model=name, width=work[0], height=work[1], params=values)
    points = grid(size, 0.713 * max(size))
    there = np.asarray([camera.img_from_cam(p) for p in points]) * (size[0] / work[0]) - 0.5
    assert moved(as_odm(decision, size, points), there, size) < WORST_PX


def by_polynomial(given: FileCalibration, size: Tuple[int, int], points: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """Parrot's lens: 90 degrees off the axis are 1, the polynomial times C pixels from the principal point."""
    assert given.distortion is not None and given.fisheye_affine is not None
    flat = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-12)
    angle = np.arctan2(flat, points[:, 2]) * 2.0 / math.pi
    radius = given.fisheye_affine[0] * sum(p * angle**k for k, p in enumerate(given.distortion))
    center = given.center_px or (size[0] / 2, size[1] / 2)
    square = np.array([1.0, given.fisheye_affine[3] / given.fisheye_affine[0]])
    return (points[:, :2] / flat[:, None] * radius[:, None] * square + np.asarray(center)) * scale - 0.5


def fisheye_error(frame: Frame, given: FileCalibration, spectrum: str, scale: float) -> float:
    decision = decision_from_intrinsics("p", resolve(frame, spectrum, load_sheet(None)))
    assert decision.projection == "fisheye"
    size = (round(frame.width * scale), round(frame.height * scale))
    assert given.fisheye_affine is not None
    points = grid(size, given.fisheye_affine[0] * scale * 2.0 / math.pi)
    there = by_polynomial(given, (frame.width, frame.height), points, scale)
    return moved(as_odm(decision, size, points), there, size)


@pytest.mark.parametrize("scale", [1.0, 2.0], ids=["native", "resampled"])
@pytest.mark.parametrize("aspect", [1.0, 0.997])
def test_a_fisheye_calibration_out_of_the_file(scale: float, aspect: float) -> None:
    given = FileCalibration(
        "xmp-camera",
        projection="fisheye",
        focal_mm=3.98,
        center_px=(655.2, 474.9),
        distortion=(0.0, 1.0, 0.00592627, -0.136981656),
        fisheye_affine=(1676.825547004, 0.0, 0.0, 1676.825547004 * aspect),
        aspect_ratio=aspect,
    )
    frame = Frame(
        path="a.tif", size_bytes=1, format="tiff", width=1280, height=960, focal_mm=3.98, calibration=given,
        focal_plane_x_res=266.667, focal_plane_y_res=266.667, focal_plane_unit=4,
    )  # fmt: skip
    assert fisheye_error(frame, given, "multispectral", scale) < WORST_PX


SEQUOIA = sorted((REAL / "garfield_sequoia_rgb_ms").glob("*_0000_*.TIF"))


@pytest.mark.skipif(not SEQUOIA, reason="the real frames are not there")
@pytest.mark.parametrize("number", range(4))
def test_fisheye_lenses_of_real_frames(number: int) -> None:
    frame = read_frame(SEQUOIA[number % len(SEQUOIA)], "a.tif")
    given = frame.calibration
    assert given is not None and given.projection == "fisheye"
    assert fisheye_error(frame, given, "multispectral", 1.0) < WORST_PX
