"""The camera calibration that a file carries in its XMP.

``Camera:`` tags follow Pix4D's published camera namespace (focal and principal
point in mm, principal point from the sensor's top left corner, distortion R1,
R2, R3, T1, T2; fisheye polynomial and affine matrix); MicaSense writes the
focal in pixels in some firmware. DJI's ``DewarpData`` is
``date;fx,fy,cx,cy,k1,k2,p1,p2,k3`` in pixels of the full sensor with cx, cy
counted from its centre; ``CalibratedFocalLength`` and
``CalibratedOpticalCenterX/Y`` are pixels. Principal points are given with 0 at
the left or upper edge of the first pixel.
"""

from __future__ import annotations

import math
from typing import List, Optional, Tuple

from ..frame import FileCalibration
from ..thresholds import DEFAULTS
from .values import Numbers, to_number
from .xmp import Xmp

UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}


def from_xmp(
    xmp: Xmp,
    size: Tuple[int, int],
    written_size: Tuple[Optional[int], Optional[int]],
    focal_mm: Optional[float],
    pixels_per_mm: Optional[Tuple[float, float]],
    problems: List[str],
) -> Optional[FileCalibration]:
    """The best calibration of a file.

    ``size`` is the frame as stored, ``written_size`` as the camera wrote it
    (Exif), ``pixels_per_mm`` from the focal-plane tags.
    """
    numbers = Numbers(xmp, problems)
    scale = _resized(size, written_size)
    return (
        _camera(xmp, numbers, size, scale, focal_mm, pixels_per_mm, problems)
        or _dewarp(xmp, numbers, size, scale, problems)
        or _calibrated(numbers, size, scale, problems)
    )


def _resized(size: Tuple[int, int], written: Tuple[Optional[int], Optional[int]]) -> float:
    """How much smaller the frame is than the camera wrote it; 1 where the shape says it was cropped instead."""
    if not written[0] or not written[1]:
        return 1.0
    across, down = size[0] / written[0], size[1] / written[1]
    return across if abs(across / down - 1.0) <= DEFAULTS.aspect_tolerance else 1.0


def _inside(
    center: Optional[Tuple[float, float]], size: Tuple[int, int], problems: List[str]
) -> Optional[Tuple[float, float]]:
    """A principal point in the outer quarter of the frame belongs to another picture size."""
    if center is None:
        return None
    if all(0.25 * s <= c <= 0.75 * s for c, s in zip(center, size)):
        return center
    problems.append("calibration-center-outside:principal point")
    return None


def _camera(
    xmp: Xmp,
    numbers: Numbers,
    size: Tuple[int, int],
    scale: float,
    focal_mm: Optional[float],
    pixels_per_mm: Optional[Tuple[float, float]],
    problems: List[str],
) -> Optional[FileCalibration]:
    point = numbers.several("Camera:PrincipalPoint")
    center = None
    if len(point) == 2 and pixels_per_mm is not None:
        center = _inside((point[0] * pixels_per_mm[0] * scale, point[1] * pixels_per_mm[1] * scale), size, problems)
    affine = numbers.several("Camera:FisheyeAffineMatrix")
    polynomial = numbers.several("Camera:FisheyePolynomial")
    if len(affine) == 4 and len(polynomial) >= 2 and affine[0] > 0 and polynomial[1] > 0:
        # angle of 90 degrees is 1 on the polynomial's axis, so near the axis x = C * p1 * 2/pi * angle
        return FileCalibration(
            source="xmp-camera",
            projection="fisheye",
            focal_px=affine[0] * polynomial[1] * 2.0 / math.pi * scale,
            center_px=center,
            distortion=polynomial,
            fisheye_affine=tuple(a * scale for a in affine),
        )
    focal = numbers.one("Camera:PerspectiveFocalLength")
    if focal is None or focal <= 0:
        return None
    in_pixels = _in_pixels(xmp, focal, size[0], focal_mm)
    r = numbers.several("Camera:PerspectiveDistortion")
    return FileCalibration(
        source="xmp-camera",
        focal_mm=None if in_pixels else focal,
        focal_px=focal * scale if in_pixels else None,
        center_px=center,
        distortion=(r[0], r[1], r[3], r[4], r[2]) if len(r) == 5 else None,
    )


def _in_pixels(xmp: Xmp, focal: float, width: int, focal_mm: Optional[float]) -> bool:
    unit = xmp.text("Camera:PerspectiveFocalLengthUnits", "Camera:PerspectiveFocalLengthUnit").lower()
    if unit:
        return unit.startswith("p")
    if focal_mm is not None and 0.5 <= focal / focal_mm <= 2.0:
        return False
    return focal >= DEFAULTS.focal_px_min_ratio * width


def _full_scale(numbers: Numbers, size: Tuple[int, int], scale: float) -> Tuple[float, Optional[Tuple[float, float]]]:
    """Pixels of the frame per pixel of the calibrated sensor, and the calibrated centre.

    The calibrated optical centre is the middle of the full sensor, so twice it
    is the size that the calibration holds for: a smaller frame of the same
    height or width is a crop, of neither is a reduced one.
    """
    x = numbers.one("drone-dji:CalibratedOpticalCenterX")
    y = numbers.one("drone-dji:CalibratedOpticalCenterY")
    if x is None or y is None or x <= 0 or y <= 0:
        return scale, None
    ratio = max(size[0] / (2.0 * x), size[1] / (2.0 * y))
    return (1.0 if abs(ratio - 1.0) < 0.02 else ratio), (x, y)


def _dewarp(
    xmp: Xmp, numbers: Numbers, size: Tuple[int, int], scale: float, problems: List[str]
) -> Optional[FileCalibration]:
    text = xmp.text("drone-dji:DewarpData")
    if not text:
        return None
    parts = [to_number(p) for p in text.rpartition(";")[2].split(",")]
    values = [p for p in parts if p is not None]
    if len(values) != len(parts) or len(values) != 9:
        problems.append("xmp-not-a-number:DewarpData")
        return None
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = values
    if fx <= 0 or fy <= 0:
        return None
    scale, _ = _full_scale(numbers, size, scale)
    focal = (fx + fy) / 2.0 * scale
    if focal < DEFAULTS.focal_px_min_ratio * size[0]:
        problems.append("calibration-focal-impossible:DewarpData")
        return None
    center = _inside((size[0] / 2.0 + cx * scale, size[1] / 2.0 + cy * scale), size, problems)
    return FileCalibration(source="xmp-dewarp", focal_px=focal, center_px=center, distortion=(k1, k2, p1, p2, k3))


def _calibrated(
    numbers: Numbers, size: Tuple[int, int], scale: float, problems: List[str]
) -> Optional[FileCalibration]:
    focal = numbers.one("drone-dji:CalibratedFocalLength")
    if focal is None or focal <= 0:
        return None
    scale, _ = _full_scale(numbers, size, scale)
    if focal * scale < DEFAULTS.focal_px_min_ratio * size[0]:
        problems.append("calibration-focal-impossible:CalibratedFocalLength")
        return None
    return FileCalibration(source="xmp-calibrated", focal_px=focal * scale, center_px=(size[0] / 2.0, size[1] / 2.0))
