"""What each single source says of a frame's focal length: sheet, 35 mm equivalent, focal-plane tags, XMP.

Every function gives an ``Estimate`` or ``None`` and appends to ``notes`` what
it passed over, and why. ``intrinsics.resolve`` weighs them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional, Tuple

from .frame import FileCalibration, Frame
from .sensors import EXACT, GENERIC, USER, SheetRow, general_width_mm
from .thresholds import DEFAULTS, Thresholds

# First word of the note on focal-plane tags that belong to another picture size.
STALE = "stale-focal-plane"

# Tag 41488 as cameras write it, in mm (4 and 5 are outside the Exif standard and
# written by MicaSense, Parrot and others).
UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
_INCH = 2

# Diagonal of the 36 x 24 mm frame that 35 mm equivalents refer to.
FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)


@dataclass(frozen=True)
class Estimate:
    """What one source says; ``ratio`` is focal over sensor width with the digital zoom in it."""

    source: str
    ratio: Optional[float] = None
    focal_mm: Optional[float] = None
    width_mm: Optional[float] = None


def positive(value: Optional[float]) -> Optional[float]:
    """The value where it is a positive number, else ``None`` (cameras write 0 for unknown)."""
    return value if value is not None and math.isfinite(value) and value > 0 else None


def apart(a: float, b: float) -> float:
    """How far apart two positive numbers are, as a share of the smaller (infinite where one vanishes)."""
    smaller = min(a, b)
    return max(a, b) / smaller - 1.0 if smaller > 0.0 else math.inf


def both_focals(mean: float, aspect_ratio: float) -> Tuple[float, float]:
    """Focal lengths across and down (fx, fy) of their mean and their ratio fy / fx."""
    across = 2.0 * mean / (1.0 + aspect_ratio)
    return across, across * aspect_ratio


def mean_and_aspect(across: float, down: float) -> Tuple[float, float]:
    """Mean of two focal lengths (positive) and the ratio of the one down to the one across."""
    return (across + down) / 2.0, down / across


def digital_zoom(frame: Frame) -> float:
    """The digital zoom ratio, 1 where there is none (Exif writes 0 for unused)."""
    zoom = positive(frame.digital_zoom)
    return zoom if zoom is not None and zoom > 1.0 else 1.0


def focal_plane_width_mm(frame: Frame, width_px: Optional[int] = None) -> Optional[float]:
    """Sensor width by tags 41486-41488 for ``width_px`` (default: the frame's own).

    Without an X resolution the Y resolution stands in (square pixels); a
    missing unit is inches, as Exif says.
    """
    unit = UNIT_MM.get(_INCH if frame.focal_plane_unit is None else frame.focal_plane_unit)
    resolution = positive(frame.focal_plane_x_res) or positive(frame.focal_plane_y_res)
    if unit is None or resolution is None:
        return None
    return (width_px or frame.width) * unit / resolution


def equivalent_ratio(
    focal_35mm: Optional[float], width: int, height: int, thresholds: Thresholds = DEFAULTS
) -> Optional[float]:
    """Focal over sensor width from a 35 mm equivalent, by the diagonal.

    Cameras compare diagonals (43.27 mm), not widths (36 mm); on 3:2 frames both
    say the same. Against calibration: DJI M3E tag 24 is 0.693 by the diagonal,
    0.667 by the width, written calibration 0.703; M30T thermal tag 40: 1.184,
    1.111, sheet 1.185; H20T thermal tag 58: 1.717, 1.611, sheet 1.758. Parrot's
    Sequoia is an exception (4 % off by the diagonal), within what an integer
    tag can say. Stills wider than ``equivalent_crop_aspect`` are cut from a 4:3
    sensor at full width and keep the tag of the whole sensor (DJI FC300S,
    4000x2250: tag 20 is 0.578 so, 0.530 by the cut's own diagonal, sheet 0.582).
    """
    value = positive(focal_35mm)
    if value is None or width <= 0 or height <= 0:
        return None
    long_side, short_side = float(max(width, height)), float(min(width, height))
    if long_side / short_side > thresholds.equivalent_crop_aspect:
        short_side = long_side * 0.75
    return value * math.hypot(long_side, short_side) / FULL_FRAME_DIAGONAL_MM / width


def possible(ratio: Optional[float], thresholds: Thresholds) -> Optional[float]:
    """The ratio where a real lens can have it."""
    if ratio is None or not thresholds.focal_ratio_min <= ratio <= thresholds.focal_ratio_max:
        return None
    return ratio


def from_sheet(frame: Frame, row: Optional[SheetRow], thresholds: Thresholds, notes: List[str]) -> Optional[Estimate]:
    """Width by the sheet, focal by the tag where it is plausible for the sheet's lens, else the sheet's own.

    A camera that no sheet has is looked up in the general table.
    """
    zoom, tag = digital_zoom(frame), positive(frame.focal_mm)
    if row is None:
        width = general_width_mm(frame.make or frame.xmp_make, frame.model or frame.xmp_model, *frame.camera_size)
        return None if width is None else _at(GENERIC, tag, width, zoom, thresholds)
    source, width = row.width_source, row.sensor_width_mm
    if row.origin == USER and row.focal_px is not None:
        ratio = row.focal_px / row.sizes[0][0]
        return Estimate(source, ratio * zoom, row.focal_mm or (ratio * width if width else None), width)
    if width is None:
        return None
    if row.origin == USER and row.focal_mm is not None:
        return Estimate(source, row.focal_mm / width * zoom, row.focal_mm, width)
    fixed = None if row.zoom else row.focal_mm
    if tag is None or fixed is None or apart(tag, fixed) <= thresholds.intrinsics_disagreement:
        return _at(source, tag or fixed, width, zoom, thresholds)
    return _contradicted(frame, tag, fixed, width, source, thresholds, notes)


def _at(source: str, focal_mm: Optional[float], width_mm: float, zoom: float, thresholds: Thresholds) -> Estimate:
    ratio = possible(focal_mm / width_mm * zoom, thresholds) if focal_mm else None
    return Estimate(source, ratio, focal_mm, width_mm)


def _contradicted(
    frame: Frame, tag: float, fixed: float, width: float, source: str, thresholds: Thresholds, notes: List[str]
) -> Estimate:
    """The tag names another focal length than the sheet's fixed lens: the 35 mm equivalent is the judge."""
    zoom = digital_zoom(frame)
    equivalent = equivalent_ratio(frame.focal_35mm, frame.width, frame.height, thresholds)
    said = f"The focal length tag says {tag:g} mm, the calibration sheet {fixed:g} mm"
    if equivalent is not None and apart(equivalent, fixed / width) <= thresholds.intrinsics_disagreement:
        notes.append(f"{said}; the 35 mm equivalent agrees with the sheet, so the tag is passed over.")
        return _at(source, fixed, width, zoom, thresholds)
    if equivalent is not None and apart(equivalent, tag / width) <= thresholds.intrinsics_disagreement:
        notes.append(f"{said}; the 35 mm equivalent agrees with the tag, so this is another lens than the sheet's.")
        return _at(GENERIC, tag, width, zoom, thresholds)
    notes.append(f"{said} and nothing else decides; the sheet's is used, as a guess.")
    return _at(GENERIC, fixed, width, zoom, thresholds)


def from_equivalent(
    frame: Frame, sheet_says: Optional[Estimate], thresholds: Thresholds, notes: List[str]
) -> Optional[Estimate]:
    """The 35 mm equivalent; under digital zoom whichever reading of it fits the sheet (without one: unzoomed)."""
    zoom = digital_zoom(frame)
    plain = equivalent_ratio(frame.focal_35mm, frame.width, frame.height, thresholds)
    if plain is None:
        return None
    ratio = plain * zoom
    if zoom > 1.0 and sheet_says is not None and sheet_says.ratio:
        # Some cameras write the equivalent of the zoomed picture, some that of the lens.
        known = sheet_says.ratio
        ratio = min((plain, ratio), key=lambda r: apart(r, known))
    if possible(ratio, thresholds) is None:
        notes.append(f"The 35 mm equivalent of {frame.focal_35mm:g} mm is no focal length of a real lens.")
        return None
    return Estimate("equivalent-35mm", ratio)


def from_focal_plane(
    frame: Frame,
    row: Optional[SheetRow],
    equivalent: Optional[Estimate],
    thresholds: Thresholds,
    notes: List[str],
) -> Optional[Estimate]:
    """Width by focal-plane tags, ``None`` where they belong to the frame before somebody resized it.

    They are checked against the exact sheet, else the 35 mm equivalent, else
    the size that Exif says the camera wrote. Where nothing else is known, that
    size gives the true width back.
    """
    width = focal_plane_width_mm(frame)
    if width is None:
        return None
    zoom, tag = digital_zoom(frame), positive(frame.focal_mm)
    exact = row.sensor_width_mm if row is not None and row.match == EXACT else None
    believed, why = _believed(frame, width, exact, equivalent, thresholds)
    if believed:
        return _at("focal-plane", tag, width, zoom, thresholds)
    original = _original_width(frame, thresholds)
    restored = focal_plane_width_mm(frame, original) if original else None
    if restored is not None and exact is None and equivalent is None and _sane(restored, thresholds):
        notes.append(f"{STALE}: {why}; for those the sensor is {restored:.2f} mm wide, which is used.")
        return _at("focal-plane", tag, restored, zoom, thresholds)
    notes.append(f"{STALE}: {why}; the focal-plane tags are passed over.")
    return None


def _believed(
    frame: Frame,
    width: float,
    exact: Optional[float],
    equivalent: Optional[Estimate],
    thresholds: Thresholds,
) -> Tuple[bool, str]:
    tag = positive(frame.focal_mm)
    said = f"the focal-plane tags give a sensor {width:.2f} mm wide"
    if not _sane(width, thresholds) or (tag and possible(tag / width, thresholds) is None):
        return False, f"{said}, which no camera of this kind has"
    if exact is not None:
        return apart(width, exact) <= thresholds.focal_plane_stale, f"{said}, the calibration sheet {exact:.2f} mm"
    if tag and equivalent is not None and equivalent.ratio:
        by_equivalent = tag * digital_zoom(frame) / equivalent.ratio
        agrees = apart(width, by_equivalent) <= thresholds.intrinsics_disagreement
        return agrees, f"{said}, the 35 mm equivalent {by_equivalent:.2f} mm"
    original = _original_width(frame, thresholds)
    return original is None, f"{said} for {frame.width} px, but were written for {original} px"


def _sane(width_mm: float, thresholds: Thresholds) -> bool:
    return thresholds.sensor_width_min_mm <= width_mm <= thresholds.sensor_width_max_mm


def _original_width(frame: Frame, thresholds: Thresholds) -> Optional[int]:
    """The width before somebody resized the frame: Exif still has it, in the same aspect."""
    if not frame.exif_width or not frame.exif_height or frame.exif_width == frame.width:
        return None
    aspect = frame.exif_width * frame.height / (frame.exif_height * frame.width)
    return frame.exif_width if abs(aspect - 1.0) <= thresholds.aspect_tolerance else None


def from_calibration(
    frame: Frame, width_mm: Optional[float], others: List[float], thresholds: Thresholds, notes: List[str]
) -> Optional[Estimate]:
    """The calibration in XMP, where any other source agrees with it or none speaks.

    ``width_mm`` turns a focal length in mm into a ratio, ``others`` are the
    ratios of the other sources.
    """
    calibration = frame.calibration
    if calibration is None:
        return None
    native = _calibration_ratio(frame.width, calibration, width_mm)
    if native is None:
        return None
    ratio = native * digital_zoom(frame)
    near = not others or any(apart(ratio, o) <= thresholds.intrinsics_disagreement for o in others)
    if possible(native, thresholds) is not None and near:
        return Estimate(calibration.source, ratio, calibration.focal_mm or positive(frame.focal_mm))
    notes.append(
        f"The calibration in XMP gives {native:.3f} for focal over width; every other source differs by more than "
        f"{thresholds.intrinsics_disagreement:.0%}, so it is passed over."
    )
    return None


def _calibration_ratio(width_px: int, calibration: FileCalibration, width_mm: Optional[float]) -> Optional[float]:
    if positive(calibration.focal_px) is not None:
        return float(calibration.focal_px or 0.0) / width_px
    if positive(calibration.focal_mm) is not None and width_mm:
        return float(calibration.focal_mm or 0.0) / width_mm
    return None
