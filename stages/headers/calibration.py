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
from dataclasses import dataclass
from typing import List, Optional, Tuple

from ..focals import apart, mean_and_aspect
from ..frame import FileCalibration
from ..thresholds import Thresholds
from .values import Numbers, to_number
from .xmp import Xmp

UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}


@dataclass(frozen=True)
class Sizes:
    """Sizes of one picture, (width, height) in pixels.

    ``stored`` is what the file holds, ``written`` what Exif says the camera
    wrote, ``original`` what the file says that it was resampled from (DNG's
    OriginalDefaultFinalSize): XMP counts pixels of that.
    """

    stored: Tuple[int, int]
    written: Tuple[Optional[int], Optional[int]] = (None, None)
    original: Optional[Tuple[int, int]] = None

    def resized(self, tolerance: float) -> float:
        """How much smaller the frame is than Exif says; 1 where the shape says it was cropped instead."""
        width, height = self.written
        if not width or not height or width < 0 or height < 0:
            return 1.0
        across, down = self.stored[0] / width, self.stored[1] / height
        return across if abs(across / down - 1.0) <= tolerance else 1.0

    def resampled(self, tolerance: float) -> float:
        """Pixels of the frame per pixel that XMP counts in."""
        if self.original is None:
            return self.resized(tolerance)
        return self.stored[0] / self.original[0]


@dataclass(frozen=True)
class _Asked:
    """The frame that a calibration is wanted for.

    ``resized`` is its scale against the size in Exif, which the focal-plane
    tags go with, ``resampled`` against the one that XMP counts pixels of.
    """

    xmp: Xmp
    numbers: Numbers
    size: Tuple[int, int]
    original: Tuple[int, int]
    resized: float
    resampled: float
    focal_mm: Optional[float]
    pixels_per_mm: Optional[Tuple[float, float]]
    limits: Thresholds
    problems: List[str]

    def inside(self, center: Tuple[float, float]) -> Optional[Tuple[float, float]]:
        """A principal point where one can be in this frame, else ``None`` and a note."""
        margin = self.limits.center_margin
        if all(margin * s <= c <= (1.0 - margin) * s for c, s in zip(center, self.size)):
            return center
        self.problems.append("calibration-center-outside:principal point")
        return None

    def pixels(self, focal: float, name: str) -> Optional[float]:
        """A focal length that can be one in pixels of this frame, else ``None`` and a note."""
        if focal >= self.limits.focal_px_min_ratio * self.size[0]:
            return focal
        self.problems.append(f"calibration-focal-impossible:{name}")
        return None


def from_xmp(
    xmp: Xmp,
    sizes: Sizes,
    focal_mm: Optional[float],
    pixels_per_mm: Optional[Tuple[float, float]],
    limits: Thresholds,
    problems: List[str],
) -> Optional[FileCalibration]:
    """The best calibration of a file, in pixels as stored; ``pixels_per_mm`` is from the focal-plane tags."""
    asked = _Asked(
        xmp,
        Numbers(xmp, problems),
        sizes.stored,
        sizes.original or sizes.stored,
        sizes.resized(limits.aspect_tolerance),
        sizes.resampled(limits.aspect_tolerance),
        focal_mm,
        pixels_per_mm,
        limits,
        problems,
    )
    return _camera(asked) or _dewarp(asked) or _calibrated(asked)


def _camera(asked: _Asked) -> Optional[FileCalibration]:
    numbers, scale = asked.numbers, asked.resampled
    point = numbers.several("Camera:PrincipalPoint")
    center = None
    if len(point) == 2 and asked.pixels_per_mm is not None:
        across, down = (density * asked.resized for density in asked.pixels_per_mm)
        center = asked.inside((point[0] * across, point[1] * down))
    affine = numbers.several("Camera:FisheyeAffineMatrix")
    polynomial = numbers.several("Camera:FisheyePolynomial")
    if len(affine) == 4 and len(polynomial) >= 2 and affine[0] > 0 and polynomial[1] > 0:
        # An angle of 90 degrees is 1 on the polynomial's axis, so near the axis x = C * p1 * 2/pi * angle.
        mean, aspect = mean_and_aspect(affine[0], affine[3] if affine[3] > 0 else affine[0])
        return FileCalibration(
            source="xmp-camera",
            projection="fisheye",
            focal_px=mean * polynomial[1] * 2.0 / math.pi * scale,
            center_px=center,
            distortion=polynomial,
            fisheye_affine=tuple(a * scale for a in affine),
            aspect_ratio=aspect,
        )
    focal = numbers.one("Camera:PerspectiveFocalLength")
    if focal is None or focal <= 0:
        return None
    in_pixels = _in_pixels(asked, focal)
    r = numbers.several("Camera:PerspectiveDistortion")
    return FileCalibration(
        source="xmp-camera",
        focal_mm=None if in_pixels else focal,
        focal_px=focal * scale if in_pixels else None,
        center_px=center,
        distortion=(r[0], r[1], r[3], r[4], r[2]) if len(r) == 5 else None,
    )


def _in_pixels(asked: _Asked, focal: float) -> bool:
    unit = asked.xmp.text("Camera:PerspectiveFocalLengthUnits", "Camera:PerspectiveFocalLengthUnit").lower()
    if unit:
        return unit.startswith("p")
    factor = asked.limits.focal_mm_factor
    if asked.focal_mm is not None and 1.0 / factor <= focal / asked.focal_mm <= factor:
        return False
    return focal * asked.resampled >= asked.limits.focal_px_min_ratio * asked.size[0]


def _scale_of_sensor(asked: _Asked) -> float:
    """Pixels of the frame per pixel of the calibrated sensor.

    The calibrated optical centre is the middle of the full sensor, so twice it
    is the size that the calibration holds for: a frame as high or as wide as
    that is a crop, one that is neither is reduced.
    """
    x = asked.numbers.one("drone-dji:CalibratedOpticalCenterX")
    y = asked.numbers.one("drone-dji:CalibratedOpticalCenterY")
    if x is None or y is None or x <= 0 or y <= 0:
        return asked.resampled
    ratio = max(asked.original[0] / (2.0 * x), asked.original[1] / (2.0 * y))
    native = 1.0 if abs(ratio - 1.0) < asked.limits.calibrated_size_tolerance else ratio
    return native if asked.original == asked.size else native * asked.resampled


def _dewarp(asked: _Asked) -> Optional[FileCalibration]:
    text = asked.xmp.text("drone-dji:DewarpData")
    if not text:
        return None
    values = [to_number(p) for p in text.rpartition(";")[2].split(",")]
    known = [v for v in values if v is not None]
    if len(known) != 9 or len(values) != 9:
        asked.problems.append("xmp-not-a-number:DewarpData")
        return None
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = known
    if fx <= 0 or fy <= 0:
        return None
    if apart(fx, fy) > asked.limits.intrinsics_disagreement:
        asked.problems.append("calibration-focal-impossible:DewarpData")
        return None
    scale = _scale_of_sensor(asked)
    mean, aspect = mean_and_aspect(fx, fy)
    focal = asked.pixels(mean * scale, "DewarpData")
    if focal is None:
        return None
    center = asked.inside((asked.size[0] / 2.0 + cx * scale, asked.size[1] / 2.0 + cy * scale))
    return FileCalibration(
        source="xmp-dewarp",
        focal_px=focal,
        center_px=center,
        distortion=(k1, k2, p1, p2, k3),
        aspect_ratio=aspect,
    )


def _calibrated(asked: _Asked) -> Optional[FileCalibration]:
    given = asked.numbers.one("drone-dji:CalibratedFocalLength")
    if given is None or given <= 0:
        return None
    focal = asked.pixels(given * _scale_of_sensor(asked), "CalibratedFocalLength")
    if focal is None:
        return None
    return FileCalibration(source="xmp-calibrated", focal_px=focal)
