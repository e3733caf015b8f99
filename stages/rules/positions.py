"""Rules about positions: place, GPS, RTK."""

from __future__ import annotations

from collections import Counter
from typing import Iterator, List, Optional, Tuple

from ..finding import ERROR, WARNING, Finding
from ..geo import distance_m
from ..survey import Survey
from ..thresholds import Thresholds
from .text import SPECTRUM_WORD, named, plural


def areas(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Frames of one spectrum over places that cannot overlap."""
    area = survey.area_of()
    for spectrum in sorted({p.spectrum for p in survey.payloads}):
        members = [f for f in survey.usable if f.spectrum == spectrum and f.flight in area]
        counts = Counter(area[f.flight] for f in members)
        if len(counts) > 1:
            shown = ", ".join(f"area {a}: {plural(n)}" for a, n in sorted(counts.items()))
            yield Finding(
                code="separate-areas",
                severity=ERROR,
                subjects=tuple(sorted({f.flight for f in members})),
                message=f"The {SPECTRUM_WORD[spectrum]} frames were taken over {len(counts)} places that cannot "
                f"overlap ({shown}). ODM would merge the pieces without a word.",
                remedy="One project per place: sensorgate run writes them.",
                measured=float(len(counts)),
                threshold=1.0,
            )


def gps(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Positions that are missing, zero, or far from their flight."""
    files = survey.file_of()
    paths = [f.path for f in survey.usable]
    missing = [p for p in paths if not files[p].has_gps]
    zero = [p for p in missing if files[p].latitude is not None and files[p].longitude is not None]
    if zero:
        yield Finding(
            code="gps-zero",
            severity=WARNING,
            subjects=tuple(zero),
            message=f"{plural(len(zero))} came with the position 0,0 that cameras write before a fix: {named(zero)}.",
            remedy="Give positions with --geo FILE, or go on: they are treated as without GPS.",
            measured=float(len(zero)),
        )
    if missing and len(missing) == len(paths):
        yield Finding(
            code="gps-none",
            severity=WARNING,
            subjects=(),
            message="No frame has a GPS position. Nothing can be proven by position, and the map will have no place.",
            remedy="Give positions with --geo FILE or ground control with --gcp FILE.",
            measured=float(len(missing)),
        )
    elif missing:
        yield Finding(
            code="gps-missing",
            severity=WARNING,
            subjects=tuple(missing),
            message=f"{len(missing)} of {plural(len(paths))} have no GPS position: {named(missing)}. "
            "One such frame makes ODM match every frame with every other.",
            remedy="Give positions with --geo FILE, or keep these frames apart.",
            measured=float(len(missing)),
            threshold=0.0,
        )
    outliers = gps_outliers(survey, limits)
    if outliers:
        yield Finding(
            code="gps-outlier",
            severity=WARNING,
            subjects=outliers,
            message=f"{plural(len(outliers))} stand more than {limits.gps_outlier_m / 1000:g} km from the middle of "
            f"their flight: {named(outliers)}.",
            remedy="Set their position right with --geo FILE; it is not used for the proof.",
            measured=float(len(outliers)),
            threshold=limits.gps_outlier_m,
        )


def gps_outliers(survey: Survey, limits: Thresholds) -> Tuple[str, ...]:
    """Frames farther than ``gps_outlier_m`` from the median position of their flight."""
    files = survey.file_of()
    out: List[str] = []
    for flight in survey.flights:
        fixes = {p: files[p] for p in flight.frames if files[p].has_gps}
        if len(fixes) < 3:
            continue
        lats = sorted(f.latitude or 0.0 for f in fixes.values())
        lons = sorted(f.longitude or 0.0 for f in fixes.values())
        middle = (lats[len(lats) // 2], lons[len(lons) // 2])
        corners = [(lat, lon) for lat in (lats[0], lats[-1]) for lon in (lons[0], lons[-1])]
        # Where even the corners are near, no frame is far.
        if all(distance_m(middle, corner) <= limits.gps_outlier_m for corner in corners):
            continue
        out.extend(
            p
            for p, f in fixes.items()
            if distance_m(middle, (f.latitude or 0.0, f.longitude or 0.0)) > limits.gps_outlier_m
        )
    return tuple(sorted(out))


def rtk(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Fixed RTK positions beside others."""
    files = survey.file_of()
    total = len(survey.usable)
    plain = [f.path for f in survey.usable if not is_rtk_fixed(files[f.path].rtk_flag)]
    fixed = total - len(plain)
    if fixed and plain:
        yield Finding(
            code="rtk-mixed",
            severity=WARNING,
            subjects=tuple(plain),
            message=f"{fixed} of {plural(total)} have a fixed RTK position, the others do not. "
            "One accuracy for all would trust the wrong ones.",
            remedy="sensorgate run writes geo.txt with an accuracy per frame.",
            measured=float(fixed),
            threshold=float(total),
        )


def is_rtk_fixed(flag: Optional[int]) -> bool:
    """DJI's RtkFlag 50 is a fixed solution; 16 single, 34 float."""
    return flag == 50
