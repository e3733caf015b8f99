"""What is said about orthophotos that are fused."""

from __future__ import annotations

from typing import Optional, Sequence

from .finding import ERROR, WARNING, Finding
from .raster_shift import Shift
from .thresholds import Thresholds


def unusable(name: str, code: str, message: str) -> Finding:
    """A source that has to stay out."""
    return Finding(
        code, ERROR, (name,), f"{name}: {message}", "Process this sub-project again; its orthophoto is left out."
    )


def reprojected(names: Sequence[str]) -> Finding:
    """Sources whose coordinate system is not that of most."""
    return Finding(
        "raster-crs-differs",
        WARNING,
        tuple(names),
        f"{', '.join(names)}: another coordinate system than the other orthophotos; reprojected.",
        "Nothing has to be done where both are right. If one lies elsewhere, process it with the right one.",
    )


def apart(name: str) -> Finding:
    """A source that overlaps no other."""
    return Finding(
        "raster-apart",
        WARNING,
        (name,),
        f"{name} lies beside the other orthophotos and was left out: nothing of it could be compared.",
        "Fuse it separately: give its file with others of the same place.",
    )


def of_shift(shift: Shift, limits: Thresholds) -> Optional[Finding]:
    """A distance that is too large, or one that could not be measured."""
    if shift.median is None or shift.median_px is None:
        return Finding(
            "raster-shift-unknown",
            WARNING,
            (shift.raster,),
            f"How well {shift.raster} lies on {shift.reference} could not be measured: they show too little alike.",
            "Compare a road or a building by eye before you compute anything across the two.",
        )
    if shift.median_px <= limits.fuse_shift_px:
        return None
    return Finding(
        "raster-shifted",
        WARNING,
        (shift.raster,),
        f"{shift.raster} lies {shift.median:.2f} map units from {shift.reference} "
        f"({shift.median_px:.1f} pixels of the coarser).",
        "Give both sub-projects ground control, or align one to the other (ODM's align option), and fuse again.",
        shift.median_px,
        limits.fuse_shift_px,
    )
