"""True intrinsics of a frame, each value with the source it came from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional, Tuple

from .frame import FileCalibration, Frame
from .sensors import BUILT_IN, GENERIC, USER, Sheet, SheetRow
from .thresholds import DEFAULTS, Thresholds

# Sources, best first. What ranks above GUESSES may be locked; a guess never.
SOURCES = (
    "user-sheet",
    "xmp-camera",
    "xmp-dewarp",
    "xmp-calibrated",
    "focal-plane",
    "sheet",
    "equivalent-35mm",
    "generic-width",
    "unknown",
)
TRUSTED = ("user-sheet", "xmp-camera", "xmp-dewarp", "xmp-calibrated", "sheet")

CORRECTED = "corrected-in-camera"
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)

# TIFF ResolutionUnit as cameras write it in tag 41488, in mm (4 and 5 are outside the
# Exif standard and written by MicaSense, Parrot and others).
UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}

# Diagonal of the 36 x 24 mm frame that 35 mm equivalents refer to.
FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)


@dataclass(frozen=True)
class Intrinsics:
    """Focal length, sensor width and distortion with their sources.

    ``focal_ratio`` is focal length over sensor width of the frame as stored
    (= focal_px / width_px); it is what everything geometric uses and may be
    known (35 mm equivalent) where neither length is. ``focal_mm`` is the
    physical focal length. ``center_ratio`` is the principal point minus the
    image centre over max(width, height), OpenSfM's normalisation.
    ``distortion`` is k1, k2, p1, p2, k3 (Brown, OpenCV order);
    ``distortion_source`` is ``corrected-in-camera`` (known zero), ``xmp-*``,
    ``user-sheet``, ``sheet`` or ``unknown``. With ``projection`` ``fisheye``
    no Brown distortion is given. ``notes`` say in plain words which source
    was passed over, and why.
    """

    focal_ratio: Optional[float] = None
    focal_source: str = "unknown"
    focal_mm: Optional[float] = None
    sensor_width_mm: Optional[float] = None
    sensor_width_source: str = "unknown"
    center_ratio: Optional[Tuple[float, float]] = None
    distortion: Optional[Tuple[float, ...]] = None
    distortion_source: str = "unknown"
    projection: str = "brown"
    notes: Tuple[str, ...] = ()

    @property
    def focal_trusted(self) -> bool:
        """The focal comes from a calibration or an exact sheet, so it may be held."""
        return self.focal_source in TRUSTED

    @property
    def complete(self) -> bool:
        """Focal and distortion are both known from a trusted source: fit to be locked."""
        return self.focal_trusted and self.distortion is not None and self.projection == "brown"


@dataclass(frozen=True)
class _Estimate:
    """What one source says of a frame; ``ratio`` already has the digital zoom in it."""

    source: str
    ratio: Optional[float] = None
    focal_mm: Optional[float] = None
    width_mm: Optional[float] = None
    center_ratio: Optional[Tuple[float, float]] = None


def gsd_cm(sensor_width_mm: float, height_m: float, focal_mm: float, width_px: int) -> float:
    """Ground size of a pixel in cm at ``height_m`` above ground (nadir view)."""
    return 100.0 * sensor_width_mm * height_m / (focal_mm * width_px)


def gsd_cm_from_ratio(focal_ratio: float, height_m: float, width_px: int) -> float:
    """``gsd_cm`` from focal length over sensor width."""
    return 100.0 * height_m / (focal_ratio * width_px)


def focal_plane_width_mm(frame: Frame, width_px: Optional[int] = None) -> Optional[float]:
    """Sensor width by tags 41486-41488 for ``width_px`` (default: the frame's own).

    Without an X resolution the Y resolution stands in (square pixels).
    """
    unit = UNIT_MM.get(frame.focal_plane_unit if frame.focal_plane_unit is not None else 2)
    for resolution in (frame.focal_plane_x_res, frame.focal_plane_y_res):
        if unit is not None and _positive(resolution) is not None:
            return (width_px or frame.width) * unit / float(resolution or 1.0)
    return None


def equivalent_ratio(
    focal_35mm: Optional[float], width: int, height: int, thresholds: Thresholds = DEFAULTS
) -> Optional[float]:
    """Focal over sensor width from a 35 mm equivalent, by the diagonal.

    CIPA DCG-001 defines the equivalent by the diagonal of the image, and DJI,
    Sony, Canon and Autel write it so: a 24 mm equivalent on a 4:3 sensor is
    0.693 by the diagonal, calibrated 0.703 (DJI M3E), while dividing by 36 mm
    gives 0.667. Stills wider than ``equivalent_crop_aspect`` are cut from a
    4:3 sensor at full width and keep the tag of the whole sensor (DJI FC300S,
    4000x2250: tag 20 -> 0.578, sheet 0.58; by the crop's own diagonal 0.530).
    """
    value = _positive(focal_35mm)
    if value is None or width <= 0 or height <= 0:
        return None
    long_side, short_side = max(width, height), min(width, height)
    if long_side / short_side > thresholds.equivalent_crop_aspect:
        short_side = round(long_side * 0.75)
    return value * math.hypot(long_side, short_side) / FULL_FRAME_DIAGONAL_MM / width


def corrected_in_camera(frame: Frame, row: Optional[SheetRow]) -> bool:
    """The frame's lens distortion was already removed by the camera.

    DJI's ``DewarpFlag`` decides where it stands; else what the sheet knows of
    the frame's format.
    """
    if frame.dewarp_flag is not None:
        if frame.dewarp_flag == 1:
            return True
        if frame.calibration is not None and frame.calibration.source == "xmp-dewarp":
            return False
    if row is None:
        return False
    known = row.corrected_jpeg if frame.format.upper() in ("JPEG", "JPG", "MPO") else row.corrected_raw
    return bool(known)


def find_row(frame: Frame, spectrum: str, sheet: Sheet, band: str = "") -> Optional[SheetRow]:
    """The sheet's row for a frame of this spectrum and band."""
    return sheet.find(
        frame.make or frame.xmp_make,
        frame.model or frame.xmp_model,
        frame.width,
        frame.height,
        lens=frame.lens or frame.xmp_lens,
        spectrum=spectrum,
        image_source=frame.image_source,
        focal_mm=_positive(frame.focal_mm),
        band=band,
        serial=frame.serial,
    )


def resolve(frame: Frame, spectrum: str, sheet: Sheet, thresholds: Thresholds = DEFAULTS, band: str = "") -> Intrinsics:
    """The frame's intrinsics from its best believable source, in the order of ``SOURCES``.

    ``spectrum`` (and ``band``) keep the sheet's cameras of one name apart.
    Every source is checked against the others; what is passed over is said in
    ``notes``. Nothing known gives ``Intrinsics()`` with source ``unknown``.
    """
    notes: List[str] = []
    row = find_row(frame, spectrum, sheet, band)
    zoom = _digital_zoom(frame)
    sheet_says = _from_sheet(frame, row, zoom, thresholds, notes)
    equivalent = _from_equivalent(frame, sheet_says, zoom, thresholds, notes)
    plane = _from_focal_plane(frame, row, sheet_says, equivalent, zoom, thresholds, notes)
    others = [e.ratio for e in (plane, sheet_says, equivalent) if e is not None and e.ratio]
    calibrated = _from_calibration(frame, plane or sheet_says, others, zoom, thresholds, notes)
    found = [e for e in (calibrated, plane, sheet_says, equivalent) if e is not None]
    best = min((e for e in found if e.ratio), key=lambda e: SOURCES.index(e.source), default=None)
    width = min((e for e in found if e.width_mm), key=lambda e: SOURCES.index(e.source), default=None)
    distortion, distortion_source, projection = _distortion(frame, row, calibrated)
    return Intrinsics(
        focal_ratio=best.ratio if best else None,
        focal_source=best.source if best else "unknown",
        focal_mm=(best.focal_mm if best else None) or _positive(frame.focal_mm),
        sensor_width_mm=width.width_mm if width else None,
        sensor_width_source=width.source if width else "unknown",
        center_ratio=_center(frame, row, calibrated),
        distortion=distortion,
        distortion_source=distortion_source,
        projection=projection,
        notes=tuple(notes),
    )


def _positive(value: Optional[float]) -> Optional[float]:
    return value if value is not None and math.isfinite(value) and value > 0 else None


def _digital_zoom(frame: Frame) -> float:
    zoom = _positive(frame.digital_zoom)
    return zoom if zoom is not None and zoom > 1.0 else 1.0


def _apart(a: float, b: float) -> float:
    """How far apart two positive numbers are, as a share of the smaller."""
    return max(a, b) / min(a, b) - 1.0


def _possible(ratio: Optional[float], thresholds: Thresholds) -> Optional[float]:
    if ratio is None or not thresholds.focal_ratio_min <= ratio <= thresholds.focal_ratio_max:
        return None
    return ratio


def _from_sheet(
    frame: Frame, row: Optional[SheetRow], zoom: float, thresholds: Thresholds, notes: List[str]
) -> Optional[_Estimate]:
    if row is None:
        return None
    source, width = row.width_source, row.sensor_width_mm
    if row.origin == USER and row.focal_px is not None:
        ratio = row.focal_px / row.sizes[0][0]
        return _Estimate(source, ratio * zoom, row.focal_mm or (ratio * width if width else None), width)
    if width is None:
        return None
    tag = _positive(frame.focal_mm)
    if row.origin == USER and row.focal_mm is not None:
        return _Estimate(source, row.focal_mm / width * zoom, row.focal_mm, width)
    fixed = None if row.zoom else row.focal_mm
    if tag is None:
        return _Estimate(source, fixed / width * zoom if fixed else None, fixed, width)
    if fixed is None or _apart(tag, fixed) <= thresholds.intrinsics_disagreement:
        return _Estimate(source, _possible(tag / width * zoom, thresholds), tag, width)
    return _contradicted(frame, tag, fixed, width, source, zoom, thresholds, notes)


def _contradicted(
    frame: Frame,
    tag: float,
    fixed: float,
    width: float,
    source: str,
    zoom: float,
    thresholds: Thresholds,
    notes: List[str],
) -> _Estimate:
    """The tag names another focal length than the sheet's fixed lens: the 35 mm equivalent is the judge."""
    equivalent = equivalent_ratio(frame.focal_35mm, frame.width, frame.height, thresholds)
    said = f"The focal length tag says {tag:g} mm, the calibration sheet {fixed:g} mm"
    if equivalent is not None and _apart(equivalent, fixed / width) <= thresholds.intrinsics_disagreement:
        notes.append(f"{said}; the 35 mm equivalent agrees with the sheet, so the tag is passed over.")
        return _Estimate(source, fixed / width * zoom, fixed, width)
    if equivalent is not None and _apart(equivalent, tag / width) <= thresholds.intrinsics_disagreement:
        notes.append(f"{said}; the 35 mm equivalent agrees with the tag, so this is another lens than the sheet's.")
        return _Estimate(GENERIC, tag / width * zoom, tag, width)
    notes.append(f"{said} and nothing else decides; the sheet's is used, as a guess.")
    return _Estimate(GENERIC, fixed / width * zoom, fixed, width)


def _from_equivalent(
    frame: Frame, sheet_says: Optional[_Estimate], zoom: float, thresholds: Thresholds, notes: List[str]
) -> Optional[_Estimate]:
    plain = equivalent_ratio(frame.focal_35mm, frame.width, frame.height, thresholds)
    if plain is None:
        return None
    ratio = plain * zoom
    if zoom > 1.0 and sheet_says is not None and sheet_says.ratio:
        # Some cameras write the equivalent of the zoomed picture, some that of the lens.
        ratio = min((plain, ratio), key=lambda r: _apart(r, sheet_says.ratio or r))
    possible = _possible(ratio, thresholds)
    if possible is None:
        notes.append(f"The 35 mm equivalent of {frame.focal_35mm:g} mm is no focal length of a real lens.")
        return None
    return _Estimate("equivalent-35mm", possible)


def _from_focal_plane(
    frame: Frame,
    row: Optional[SheetRow],
    sheet_says: Optional[_Estimate],
    equivalent: Optional[_Estimate],
    zoom: float,
    thresholds: Thresholds,
    notes: List[str],
) -> Optional[_Estimate]:
    """The width by focal-plane tags, or ``None`` where they belong to a frame before it was resized."""
    width = focal_plane_width_mm(frame)
    if width is None:
        return None
    tag = _positive(frame.focal_mm)
    exact = row.sensor_width_mm if row is not None and row.match == "exact" and row.origin == BUILT_IN else None
    believed, why = _plane_believed(frame, width, tag, exact, equivalent, zoom, thresholds)
    if believed:
        return _Estimate("focal-plane", _possible(tag / width * zoom, thresholds) if tag else None, tag, width)
    original = _original_width(frame, thresholds)
    restored = focal_plane_width_mm(frame, original) if original else None
    if restored is not None and sheet_says is None and equivalent is None and _sane(restored, thresholds):
        notes.append(f"{why}; the frame was resized from {original} px, which gives {restored:.2f} mm.")
        return _Estimate("focal-plane", _possible(tag / restored * zoom, thresholds) if tag else None, tag, restored)
    notes.append(f"{why}; the focal-plane tags are passed over.")
    return None


def _plane_believed(
    frame: Frame,
    width: float,
    tag: Optional[float],
    exact: Optional[float],
    equivalent: Optional[_Estimate],
    zoom: float,
    thresholds: Thresholds,
) -> Tuple[bool, str]:
    said = f"The focal-plane tags give a sensor {width:.2f} mm wide"
    if not _sane(width, thresholds) or (tag and _possible(tag / width, thresholds) is None):
        return False, f"{said}, which no camera of this kind has"
    if exact is not None:
        return _apart(width, exact) <= thresholds.focal_plane_stale, f"{said}, the calibration sheet {exact:.2f} mm"
    if tag and equivalent is not None and equivalent.ratio:
        by_equivalent = tag * zoom / equivalent.ratio
        agrees = _apart(width, by_equivalent) <= thresholds.intrinsics_disagreement
        return agrees, f"{said}, the 35 mm equivalent {by_equivalent:.2f} mm"
    original = _original_width(frame, thresholds)
    return original is None, f"{said} for {frame.width} px, but they were written for {original} px"


def _sane(width_mm: float, thresholds: Thresholds) -> bool:
    return thresholds.sensor_width_min_mm <= width_mm <= thresholds.sensor_width_max_mm


def _original_width(frame: Frame, thresholds: Thresholds) -> Optional[int]:
    """The width before somebody resized the frame: Exif still has it, in the same aspect."""
    if not frame.exif_width or not frame.exif_height or frame.exif_width == frame.width:
        return None
    aspect = frame.exif_width * frame.height / (frame.exif_height * frame.width)
    return frame.exif_width if abs(aspect - 1.0) <= thresholds.aspect_tolerance else None


def _from_calibration(
    frame: Frame,
    width_from: Optional[_Estimate],
    others: List[float],
    zoom: float,
    thresholds: Thresholds,
    notes: List[str],
) -> Optional[_Estimate]:
    """The calibration in XMP, where any other source agrees with it or none speaks."""
    calibration = frame.calibration
    if calibration is None:
        return None
    native = _calibration_ratio(frame.width, calibration, width_from)
    original = _original_width(frame, thresholds)
    if native is None:
        return None
    choices = [(native, frame.width)]
    if original is not None and calibration.focal_px is not None:
        choices.append((native * frame.width / original, original))
    for ratio, counted in choices:
        near = not others or any(_apart(ratio * zoom, o) <= thresholds.intrinsics_disagreement for o in others)
        if _possible(ratio, thresholds) is not None and near:
            if counted != frame.width:
                notes.append(f"The calibration in XMP is for {counted} px; it was scaled to {frame.width} px.")
            focal = calibration.focal_mm or _positive(frame.focal_mm)
            return _Estimate(
                calibration.source, ratio * zoom, focal, center_ratio=_offset(frame, calibration.center_px, counted)
            )
    notes.append(
        f"The calibration in XMP gives {native:.3f} for focal over width, every other source differs by more than "
        f"{thresholds.intrinsics_disagreement:.0%}; it is passed over."
    )
    return None


def _calibration_ratio(width_px: int, calibration: FileCalibration, width_from: Optional[_Estimate]) -> Optional[float]:
    if calibration.projection == "fisheye" and calibration.fisheye_affine:
        # Parrot: radius_px = C * polynomial(theta * 2 / pi), so C * 2 / pi pixels per radian at the centre.
        return calibration.fisheye_affine[0] * 2.0 / math.pi / width_px
    if calibration.focal_px is not None:
        return calibration.focal_px / width_px
    if calibration.focal_mm is not None and width_from is not None and width_from.width_mm:
        return calibration.focal_mm / width_from.width_mm
    return None


def _offset(
    frame: Frame, center_px: Optional[Tuple[float, float]], counted_width: int
) -> Optional[Tuple[float, float]]:
    """Principal point against the image centre over the longer side, for a calibration of ``counted_width`` px."""
    if center_px is None:
        return None
    scale = frame.width / counted_width
    longer = max(frame.width, frame.height)
    return (
        (center_px[0] * scale - frame.width / 2.0) / longer,
        (center_px[1] * scale - frame.height / 2.0) / longer,
    )


def _center(frame: Frame, row: Optional[SheetRow], calibrated: Optional[_Estimate]) -> Optional[Tuple[float, float]]:
    if row is not None and row.center_px is not None and row.sizes:
        return _offset(frame, row.center_px, row.sizes[0][0])
    return calibrated.center_ratio if calibrated else None


def _distortion(
    frame: Frame, row: Optional[SheetRow], calibrated: Optional[_Estimate]
) -> Tuple[Optional[Tuple[float, ...]], str, str]:
    """Distortion, its source and the projection that it belongs to."""
    calibration = frame.calibration if calibrated is not None else None
    if row is not None and row.origin == USER and row.distortion is not None:
        return row.distortion, USER, row.projection
    projection = calibration.projection if calibration else frame.projection.lower()
    if "fisheye" in projection or (row is not None and row.projection == "fisheye" and not projection):
        return None, "unknown", "fisheye"
    if corrected_in_camera(frame, row):
        return NO_DISTORTION, CORRECTED, "brown"
    if calibration is not None and calibration.distortion is not None:
        return calibration.distortion, calibration.source, "brown"
    if row is not None and row.distortion is not None:
        return row.distortion, BUILT_IN, "brown"
    return None, "unknown", "brown"
