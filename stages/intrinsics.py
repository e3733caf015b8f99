"""True intrinsics of a frame, each value with the source it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

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
    ``sheet`` or ``unknown``.
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

    @property
    def focal_trusted(self) -> bool:
        """The focal comes from a calibration or an exact sheet, so it may be held."""
        return self.focal_source in TRUSTED

    @property
    def complete(self) -> bool:
        """Focal and distortion are both known from a trusted source: fit to be locked."""
        return self.focal_trusted and self.distortion is not None and self.projection == "brown"
