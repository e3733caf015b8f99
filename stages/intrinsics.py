"""True intrinsics of a frame, each value with the source it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Tuple

from .fisheye import OpenCvFisheye, as_opencv
from .focals import (
    Estimate,
    apart,
    equivalent_ratio,
    focal_plane_width_mm,
    from_calibration,
    from_equivalent,
    from_focal_plane,
    from_sheet,
    positive,
)
from .frame import Frame
from .sensors import BUILT_IN, GENERIC, USER, Sheet, SheetRow
from .thresholds import DEFAULTS, Thresholds

__all__ = [
    "SOURCES",
    "STORED",
    "TRUSTED",
    "Intrinsics",
    "corrected_in_camera",
    "equivalent_ratio",
    "find_row",
    "focal_plane_width_mm",
    "gsd_cm",
    "gsd_cm_from_ratio",
    "resolve",
]

STORED = "stored-calibration"
# Sources, best first. What ranks above GUESSES may be locked; a guess never.
SOURCES = (
    "user-sheet",
    "xmp-camera",
    "xmp-dewarp",
    STORED,
    "xmp-calibrated",
    "focal-plane",
    "sheet",
    "equivalent-35mm",
    "generic-width",
    "unknown",
)
TRUSTED = ("user-sheet", "xmp-camera", "xmp-dewarp", STORED, "xmp-calibrated", "sheet")

CORRECTED = "corrected-in-camera"
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
_COMPRESSED = ("jpeg", "jpg", "mpo")


@dataclass(frozen=True)
class Intrinsics:
    """Focal length, sensor width and distortion with their sources.

    ``focal_ratio`` is focal length over sensor width of the frame as stored
    (= focal_px / width_px); it is what everything geometric uses and may be
    known (35 mm equivalent) where neither length is. Where a calibration has
    two focals, across and down, it is of their mean and ``aspect_ratio`` is
    down over across (fy / fx). ``focal_mm`` is the physical
    focal length. ``center_ratio`` is the principal point minus the image centre
    over max(width, height), OpenSfM's normalisation.
    ``distortion`` is k1, k2, p1, p2, k3 (Brown, OpenCV order);
    ``distortion_source`` is ``corrected-in-camera`` (known zero), ``xmp-*``,
    ``user-sheet``, ``sheet`` or ``unknown``. With ``projection`` ``fisheye``
    it is k1, k2, k3 of OpenCV's fisheye model where the frame's own
    calibration can be said so, else ``None``; ``converted_focal_ratio`` is then
    the focal that belongs to them. ``notes`` say in plain words which source
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
    converted_focal_ratio: Optional[float] = None
    notes: Tuple[str, ...] = ()
    aspect_ratio: float = 1.0

    @property
    def focal_trusted(self) -> bool:
        """The focal comes from a calibration or an exact sheet, so it may be held."""
        return self.focal_source in TRUSTED

    @property
    def complete(self) -> bool:
        """Focal and distortion are both known from a trusted source: fit to be locked."""
        return self.focal_trusted and self.distortion is not None and self.projection == "brown"


def gsd_cm(sensor_width_mm: float, height_m: float, focal_mm: float, width_px: int) -> float:
    """Ground size of a pixel in cm at ``height_m`` above ground (nadir view)."""
    return 100.0 * sensor_width_mm * height_m / (focal_mm * width_px)


def gsd_cm_from_ratio(focal_ratio: float, height_m: float, width_px: int) -> float:
    """``gsd_cm`` from focal length over sensor width."""
    return 100.0 * height_m / (focal_ratio * width_px)


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
    known = row.corrected_jpeg if frame.format.lower() in _COMPRESSED else row.corrected_raw
    return bool(known)


def find_row(frame: Frame, spectrum: str, sheet: Sheet, band: str = "") -> Optional[SheetRow]:
    """The sheet's row for a frame of this spectrum and band."""
    return sheet.find(
        frame.make or frame.xmp_make,
        frame.model or frame.xmp_model,
        *frame.camera_size,
        lens=frame.lens or frame.xmp_lens,
        spectrum=spectrum,
        image_source=frame.image_source,
        focal_mm=positive(frame.focal_mm),
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
    sheet_says = from_sheet(frame, row, thresholds, notes)
    equivalent = from_equivalent(frame, sheet_says, thresholds, notes)
    plane = from_focal_plane(frame, row, equivalent, thresholds, notes)
    sheet_says = _agreeing(sheet_says, plane, equivalent, thresholds, notes)
    width = next((e for e in (plane, sheet_says) if e is not None and e.width_mm), None)
    others = [e.ratio for e in (plane, sheet_says, equivalent) if e is not None and e.ratio]
    calibrated = from_calibration(frame, width.width_mm if width else None, others, thresholds, notes)
    found = [e for e in (calibrated, plane, sheet_says, equivalent) if e is not None]
    best = min((e for e in found if e.ratio), key=_rank, default=None)
    widest = min((e for e in found if e.width_mm), key=_rank, default=None)
    distortion, distortion_source, projection = _distortion(frame, row, calibrated)
    fisheye = _fisheye(frame, thresholds) if calibrated is not None and projection == "fisheye" else None
    if fisheye is not None and best is calibrated and best is not None:
        distortion, distortion_source = fisheye.coefficients, best.source
    return Intrinsics(
        focal_ratio=best.ratio if best else None,
        focal_source=best.source if best else "unknown",
        focal_mm=(best.focal_mm if best else None) or positive(frame.focal_mm),
        sensor_width_mm=widest.width_mm if widest else None,
        sensor_width_source=widest.source if widest else "unknown",
        center_ratio=_center(frame, row, calibrated),
        distortion=distortion,
        distortion_source=distortion_source,
        projection=projection,
        converted_focal_ratio=fisheye.focal_px / frame.width if distortion and fisheye is not None else None,
        notes=tuple(notes),
        aspect_ratio=_aspect(frame, best, calibrated),
    )


def _rank(estimate: Estimate) -> int:
    return SOURCES.index(estimate.source)


def _agreeing(
    sheet_says: Optional[Estimate],
    plane: Optional[Estimate],
    equivalent: Optional[Estimate],
    thresholds: Thresholds,
    notes: List[str],
) -> Optional[Estimate]:
    """A sheet row of another size is dropped where the frame's own tags contradict it: the frame is a crop."""
    if sheet_says is None or sheet_says.source != GENERIC or not sheet_says.ratio:
        return sheet_says
    for own in (plane, equivalent):
        if own is not None and own.ratio and apart(own.ratio, sheet_says.ratio) > thresholds.intrinsics_disagreement:
            notes.append(
                f"The known sensor width gives another field of view than the {own.source} tags; it is not used."
            )
            return None
    return sheet_says


def _offset(frame: Frame, center_px: Tuple[float, float], scale: float = 1.0) -> Tuple[float, float]:
    """Principal point (from the upper left corner) against the image centre, over the longer side."""
    longer = max(frame.width, frame.height)
    return (
        (center_px[0] * scale - frame.width / 2.0) / longer,
        (center_px[1] * scale - frame.height / 2.0) / longer,
    )


def _aspect(frame: Frame, best: Optional[Estimate], calibrated: Optional[Estimate]) -> float:
    """Focal down over across where the focal is the file's calibration; any other source knows square pixels alone."""
    if frame.calibration is None or best is None or best is not calibrated:
        return 1.0
    return frame.calibration.aspect_ratio


def _center(frame: Frame, row: Optional[SheetRow], calibrated: Optional[Estimate]) -> Optional[Tuple[float, float]]:
    if row is not None and row.center_px is not None and row.sizes:
        return _offset(frame, row.center_px, frame.width / row.sizes[0][0])
    if calibrated is None or frame.calibration is None or frame.calibration.center_px is None:
        return None
    return _offset(frame, frame.calibration.center_px)


def _fisheye(frame: Frame, thresholds: Thresholds) -> Optional[OpenCvFisheye]:
    """The frame's own fisheye calibration in OpenCV's model."""
    given = frame.calibration
    if given is None or given.projection != "fisheye" or given.distortion is None or given.fisheye_affine is None:
        return None
    return as_opencv(given.distortion, given.fisheye_affine, frame.width, frame.height, thresholds.conversion_error_px)


def _distortion(
    frame: Frame, row: Optional[SheetRow], calibrated: Optional[Estimate]
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
