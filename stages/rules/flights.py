"""Rules about flights: heights, views, hovering, and how many frames there are."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Dict, Iterator, List, Sequence, Set, Tuple

from ..finding import INFO, WARNING, Finding
from ..frame import ELLIPSOID, SEA_LEVEL, Frame
from ..geo import local_metres, median
from ..profile import Flight
from ..survey import Survey
from ..thresholds import Thresholds
from .positions import is_rtk_fixed
from .text import listed, named, plural

_ZERO = {SEA_LEVEL: "mean sea level (GPS and barometer)", ELLIPSOID: "the ellipsoid (RTK)"}


def few(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Payloads with too few views to prove anything."""
    for payload in survey.payloads:
        views = len({f.capture for f in survey.usable_of(payload.id)})
        if 0 < views < limits.min_proof_frames:
            yield Finding(
                code="too-few-frames",
                severity=WARNING,
                subjects=(payload.id,),
                message=f"{payload.id} has {plural(views, 'capture')}. Fewer than {limits.min_proof_frames} cannot "
                "prove that a reconstruction is right.",
                remedy="Fly more frames, or take the result as unproven.",
                measured=float(views),
                threshold=float(limits.min_proof_frames),
            )


def _usable_flights(survey: Survey) -> Iterator[Tuple[Flight, List[Frame]]]:
    """Each flight with the files of its usable frames, in time order."""
    files = survey.file_of()
    usable = {f.path for f in survey.usable}
    for flight in survey.flights:
        frames = [files[p] for p in flight.frames if p in usable]
        if frames:
            yield flight, frames


def altitudes(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """GPS altitudes that are missing, or zero at a height that says otherwise, beside others."""
    files = survey.file_of()
    placed = [f.path for f in survey.usable if files[f.path].has_gps]
    missing = [p for p in placed if _no_altitude(files[p], limits)]
    if missing and len(missing) < len(placed):
        yield Finding(
            code="altitude-missing",
            severity=INFO,
            subjects=tuple(missing),
            message=f"{len(missing)} of {plural(len(placed))} with a position have no GPS altitude: {named(missing)}.",
            remedy="Give altitudes with --geo FILE if the heights of the result matter.",
            measured=float(len(missing)),
            threshold=0.0,
        )


def _no_altitude(frame: Frame, limits: Thresholds) -> bool:
    flying = frame.relative_altitude_m is None or frame.relative_altitude_m > limits.panel_height_m
    return frame.altitude_m is None or (frame.altitude_m == 0.0 and flying)


def altitude_bias(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Flights over one place whose GPS altitudes disagree with their heights above take-off by different amounts."""
    area = survey.area_of()
    offsets: Dict[int, List[Tuple[float, Flight]]] = defaultdict(list)
    for flight, frames in _usable_flights(survey):
        known = [
            f.altitude_m - f.relative_altitude_m
            for f in frames
            if f.altitude_m is not None and f.relative_altitude_m is not None and not _no_altitude(f, limits)
        ]
        fixed = all(is_rtk_fixed(f.rtk_flag) for f in frames)
        # A fixed altitude is right: a different take-off is then all that an offset can mean.
        if len(known) >= limits.min_level_frames and not fixed:
            offsets[area[flight.id]].append((median(known), flight))
    for place, found in sorted(offsets.items()):
        found.sort(key=lambda o: (o[0], o[1].id))
        gap = found[-1][0] - found[0][0]
        if gap <= limits.altitude_bias_m:
            continue
        low, high = found[0][1], found[-1][1]
        yield Finding(
            code="altitude-bias",
            severity=WARNING,
            subjects=tuple(sorted(f.id for _, f in found)),
            message=f"Over one place (area {place}) the GPS altitudes of {high.id} lie {gap:.0f} m higher against the "
            f"height above take-off than those of {low.id}. Either the take-offs were {gap:.0f} m apart in height, or "
            "one flight's altitudes are shifted (a bad fix, or ellipsoidal against sea-level heights).",
            remedy="If both took off from the same ground, give right altitudes with --geo FILE or ground control with "
            "--gcp FILE. sensorgate run shifts nothing by itself.",
            measured=gap,
            threshold=limits.altitude_bias_m,
        )


def other_zero(frames: Sequence[Frame]) -> Tuple[str, ...]:
    """Paths of the fewer frames whose altitudes count from another zero than the others say theirs do."""
    said: Dict[str, List[str]] = {k: [f.path for f in frames if f.altitude_zero == k] for k in _ZERO}
    fewer, more = sorted(said.values(), key=len)
    return tuple(fewer) if more else ()


def altitude_datum(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Frames that say their altitude counts from different zeros."""
    files = survey.file_of()
    usable = [files[f.path] for f in survey.usable]
    fewer = other_zero(usable)
    if fewer:
        said = {k: sum(f.altitude_zero == k for f in usable) for k in _ZERO}
        shown = " and ".join(f"{plural(said[k])} from {_ZERO[k]}" for k in said)
        yield Finding(
            code="altitude-datum-mixed",
            severity=WARNING,
            subjects=fewer,
            message=f"Altitudes count from different zeros: {shown}. The two may lie tens of metres apart.",
            remedy="Give all altitudes in one height system with --geo FILE, or use ground control. In a project that "
            "has both, sensorgate run gives the fewer almost no weight in height (geo.txt).",
            measured=float(len(fewer)),
            threshold=0.0,
        )


def oblique(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Frames that look aside: good for facades and for the focal length, so only noted."""
    files = survey.file_of()
    paths = [
        f.path
        for f in survey.usable
        if (pitch := files[f.path].pitch_deg) is not None and 90.0 + pitch > limits.oblique_pitch_deg
    ]
    if paths:
        yield Finding(
            code="oblique-frames",
            severity=INFO,
            subjects=tuple(paths),
            message=f"{plural(len(paths))} of {len(survey.usable)} look more than {limits.oblique_pitch_deg:g} degrees "
            f"away from straight down: {named(paths)}.",
            remedy="Nothing to do: they help to fix the focal length. Their ground resolution is coarser than stated.",
            measured=float(len(paths)),
            threshold=limits.oblique_pitch_deg,
        )


def hover_runs(frames: Sequence[Frame], radius_m: float, least: int) -> List[List[Frame]]:
    """Runs of at least ``least`` frames in time order that all stand within ``radius_m`` of the run's first."""
    placed = [f for f in frames if f.has_gps]
    if len(placed) < least:
        return []
    points = local_metres([(f.latitude or 0.0, f.longitude or 0.0) for f in placed], _place(placed[0]))
    runs: List[List[Frame]] = []
    begin = 0
    for index in range(1, len(placed) + 1):
        if index < len(placed) and _apart_m(placed, points, begin, index) <= radius_m:
            continue
        if index - begin >= least:
            runs.append(list(placed[begin:index]))
        begin = index
    return runs


def _place(frame: Frame) -> Tuple[float, float]:
    return (frame.latitude or 0.0, frame.longitude or 0.0)


def _apart_m(frames: Sequence[Frame], points: Sequence[Tuple[float, float]], i: int, j: int) -> float:
    up = 0.0
    for a, b in (
        (frames[i].altitude_m, frames[j].altitude_m),
        (frames[i].relative_altitude_m, frames[j].relative_altitude_m),
    ):
        if a is not None and b is not None:
            up = max(up, abs(a - b))
    return math.hypot(points[i][0] - points[j][0], points[i][1] - points[j][1], up)


def hovering(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Many frames at one place: no base line between them, so nothing can be measured from them."""
    primaries: Set[str] = {p.primary for p in survey.payloads}
    paths: List[str] = []
    places = 0
    for flight, frames in _usable_flights(survey):
        if flight.profile not in primaries:
            continue
        radius = limits.hover_radius_m
        if flight.height_m is not None and flight.height_m > 0:
            radius = min(radius, limits.hover_radius_ratio * flight.height_m)
        runs = hover_runs(frames, radius, limits.hover_min_frames)
        places += len(runs)
        paths.extend(f.path for run in runs for f in run)
    if paths:
        where = "one place" if places == 1 else f"{places} places"
        yield Finding(
            code="hover-frames",
            severity=WARNING,
            subjects=tuple(sorted(paths)),
            message=f"{plural(len(paths))} were taken while hovering over {where}: {listed(_short(paths))}. "
            "Frames from one place have no base line and can bend a model.",
            remedy="Keep one or two frames per place and delete the others. sensorgate run keeps them all.",
            measured=float(len(paths)),
            threshold=float(limits.hover_min_frames),
        )


def _short(paths: Sequence[str]) -> List[str]:
    return [p.rsplit("/", 1)[-1] for p in sorted(paths)]
