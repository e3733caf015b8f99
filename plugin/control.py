"""Ground control and positions that the user gave: read once, handed to the solver and to each project."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from ..stages.align.model import ControlFit, GcpMark
from ..stages.assemble import gps_sigma_of
from ..stages.errors import UsageError
from ..stages.finding import Finding
from ..stages.frame import Frame
from ..stages.gate import is_rtk_fixed
from ..stages.gcp import read_text
from ..stages.harmonize.model import HarmonizedFrame, untouched
from ..stages.rules.flights import other_zero
from ..stages.srs import to_lonlat
from ..stages.survey import Survey
from ..stages.thresholds import Thresholds
from .odm.gcp import GcpFile, GcpFrame, align_marks, read_gcp
from .odm.gcp_check import held_out
from .odm.gcp_place import PlacedGcps, place
from .odm.gcp_project import gcp_for_project
from .odm.geo import GeoFile, GeoFrame, check_geo, geo_for, read_geo, rewrite_geo, uniform_accuracy_m


@dataclass(frozen=True)
class ProjectControl:
    """What one project gets: texts for ODM, or ``None``, with what is to be said about it."""

    gcp_text: Optional[str] = None
    gcp_points: int = 0
    gcp_images: int = 0
    geo_text: Optional[str] = None
    accuracy_m: Optional[float] = None
    findings: Tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Control:
    """Ground control and positions, bound to the frames. ``frames`` carry the positions of ``--geo``.

    ``accuracies`` are path -> standard deviation in metres, horizontal and
    vertical; ``points`` the ground control in the report's shape.
    """

    frames: Tuple[Frame, ...]
    placed: Optional[PlacedGcps] = None
    geo: Optional[GeoFile] = None
    accuracies: Mapping[str, Tuple[float, float]] = field(default_factory=dict)
    points: Tuple[Mapping[str, Any], ...] = ()
    findings: Tuple[Finding, ...] = ()

    def marks(self, copies: Mapping[str, HarmonizedFrame]) -> Tuple[GcpMark, ...]:
        """Every mark in pixels of the harmonized frames."""
        if self.placed is None:
            return ()
        return align_marks(self.placed.marks, _gcp_frames(self.frames, copies))

    def for_project(
        self,
        name: str,
        paths: Sequence[str],
        copies: Mapping[str, HarmonizedFrame],
        survey: Survey,
        limits: Thresholds,
        primary: Set[str],
        fit: Optional[ControlFit] = None,
    ) -> ProjectControl:
        """Ground control and positions for one project, rewritten for its frames' names and sizes.

        ``fit`` is what the alignment found of the points: those that it
        contradicts stay out.
        """
        own = set(paths)
        frames = [f for f in survey.files if f.path in own]
        result = ProjectControl()
        if self.placed is not None:
            decision = gcp_for_project(name, self.placed, _gcp_frames(frames, copies, primary), limits, fit)
            marked = {m.path for m in self.placed.marks if m.path in own and m.path in primary and not m.check}
            result = replace(
                result,
                gcp_text=decision.text,
                gcp_points=decision.points if decision.text else 0,
                gcp_images=len(marked) if decision.text else 0,
                findings=decision.findings,
            )
        if self.geo is not None:
            outputs: Dict[str, List[str]] = defaultdict(list)
            for frame in frames:
                outputs[frame.name].append(copies[frame.path].name)
            return replace(result, geo_text=rewrite_geo(self.geo, outputs))
        standing = _standing([f for f in frames if f.path in primary], copies, limits)
        return replace(result, geo_text=geo_for(standing, limits), accuracy_m=uniform_accuracy_m(standing, limits))


def _standing(
    frames: Sequence[Frame], copies: Mapping[str, HarmonizedFrame], limits: Thresholds
) -> Tuple[GeoFrame, ...]:
    """Where the frames stand; heights that count from another zero than most are hardly believed."""
    other = set(other_zero(frames))
    found = [(f, _geo_frame(f, copies, limits)) for f in frames]
    return tuple(
        replace(g, sigma_vertical_m=max(g.sigma_vertical_m, limits.altitude_zero_sigma_m)) if f.path in other else g
        for f, g in found
        if g is not None
    )


def _geo_frame(frame: Frame, copies: Mapping[str, HarmonizedFrame], limits: Thresholds) -> Optional[GeoFrame]:
    if not frame.has_gps or frame.latitude is None or frame.longitude is None:
        return None
    horizontal, vertical = gps_sigma_of(frame, limits)
    odm = None
    if frame.rtk_std_m is not None:
        odm = (max(frame.rtk_std_m[:2]), frame.rtk_std_m[2])
    return GeoFrame(
        name=copies[frame.path].name,
        latitude=frame.latitude,
        longitude=frame.longitude,
        altitude_m=frame.altitude_m,
        sigma_horizontal_m=horizontal,
        sigma_vertical_m=vertical,
        fixed=is_rtk_fixed(frame.rtk_flag),
        odm_sigma_m=odm,
    )


def _gcp_frames(
    frames: Sequence[Frame], copies: Mapping[str, HarmonizedFrame], primary: Optional[Set[str]] = None
) -> Tuple[GcpFrame, ...]:
    return tuple(
        GcpFrame(
            path=f.path,
            output=copies[f.path].name,
            width=f.width,
            height=f.height,
            out_width=copies[f.path].width,
            out_height=copies[f.path].height,
            position=_position(f),
            primary=primary is None or f.path in primary,
        )
        for f in frames
        if f.path in copies
    )


def _position(frame: Frame) -> Optional[Tuple[float, float]]:
    if not frame.has_gps or frame.latitude is None or frame.longitude is None:
        return None
    return (frame.latitude, frame.longitude)


def read_control(
    gcp: Optional[str],
    geo: Optional[str],
    frames: Sequence[Frame],
    limits: Thresholds,
    check_points: Optional[str] = None,
) -> Control:
    """Read the files that were given and bind them to the frames. ``UsageError`` where one cannot be read.

    ``check_points`` are names or a number of points to hold out, beside those whose name says so.
    """
    control = Control(tuple(frames))
    if geo is not None:
        control = _with_geo(control, read_geo(read_text(_file(geo, "--geo"))), limits)
    if gcp is not None:
        control = _with_gcp(control, read_gcp(read_text(_file(gcp, "--gcp"))), limits, check_points)
    elif check_points:
        raise UsageError("--check-points needs the ground control file that they stand in (--gcp FILE).")
    return control


def _file(path: str, option: str) -> Path:
    file = Path(path)
    if not file.is_file():
        raise UsageError(f"{option}: there is no file {path}.")
    return file


def _with_gcp(control: Control, gcp: GcpFile, limits: Thresholds, check_points: Optional[str]) -> Control:
    found = place(gcp, _gcp_frames(control.frames, untouched(control.frames)), limits)
    placed = held_out(found, check_points)
    images: Dict[Tuple[float, float, float], Set[str]] = defaultdict(set)
    first = {}
    for mark in placed.marks:
        images[mark.line.point].add(mark.path)
        first.setdefault(mark.line.point, mark)
    points = tuple(
        {
            "name": mark.line.name or f"gcp-{number:02d}",
            "latitude": round(mark.latitude, 9),
            "longitude": round(mark.longitude, 9),
            "altitude_m": point[2] if math.isfinite(point[2]) else None,
            "images": len(images[point]),
            "check": mark.check,
        }
        for number, (point, mark) in enumerate(first.items(), start=1)
    )
    return replace(control, placed=placed, points=points, findings=(*control.findings, *gcp.findings, *placed.findings))


def _with_geo(control: Control, geo: GeoFile, limits: Thresholds) -> Control:
    """Positions and accuracies of the file replace those of the tags, as they will in ODM."""
    lines = {line.image: line for line in geo.lines}
    places = dict(zip(lines, to_lonlat(geo.srs, [(float(g.x), float(g.y)) for g in lines.values()])))
    frames: List[Frame] = []
    accuracies: Dict[str, Tuple[float, float]] = {}
    for frame in control.frames:
        line = lines.get(frame.name)
        if line is None:
            frames.append(frame)
            continue
        longitude, latitude = places[frame.name]
        height = float(line.z) if line.z is not None else frame.altitude_m
        frames.append(replace(frame, latitude=latitude, longitude=longitude, altitude_m=height))
        if line.accuracies is not None:
            accuracies[frame.path] = (float(line.accuracies[0]), float(line.accuracies[1]))
        else:
            accuracies[frame.path] = gps_sigma_of(frame, limits)
    findings = check_geo(geo, [f.name for f in control.frames])
    return replace(control, frames=tuple(frames), geo=geo, accuracies=accuracies, findings=tuple(findings))
