"""Whether a sub-project gets ground control, and which lines.

With a ``gcp_list.txt`` ODM switches GPS off. So a project gets one only where
the points alone can hold the block; otherwise GPS stays and a finding says why.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Set, Tuple

from ...stages.align.model import ControlFit
from ...stages.finding import INFO, WARNING, Finding
from ...stages.geo import flatness, hull_area_m2, local_metres
from ...stages.rules.text import listed
from ...stages.thresholds import DEFAULTS, Thresholds
from .gcp import GcpFrame, write_gcp
from .gcp_place import PlacedGcps

_XY = Tuple[float, float]


@dataclass(frozen=True)
class GcpDecision:
    """The list's text or ``None``, how many points hold the project, and what to say."""

    text: Optional[str]
    points: int
    findings: Tuple[Finding, ...] = ()


def gcp_for_project(
    name: str,
    placed: PlacedGcps,
    frames: Sequence[GcpFrame],
    thresholds: Thresholds = DEFAULTS,
    fit: Optional[ControlFit] = None,
) -> GcpDecision:
    """Decide for one sub-project (``frames`` are its own, as they are written).

    Needed: enough points on enough primary-band frames, not on one line, over
    enough of the block. A project without any GPS has nothing to lose: there
    three points that are not on one line do. Check points are held out; so is
    what the alignment (``fit``) contradicts.
    """
    by_path = {f.path: f for f in frames}
    mine = [m for m in placed.marks if m.path in by_path and not m.check]
    if not mine:
        return GcpDecision(None, 0)
    free = not any(f.position is not None for f in frames)
    astray = set(fit.astray) if fit is not None else set()
    lost = [m for m in mine if (m.line.label, m.path) in astray]
    findings: List[Finding] = [_astray(name, [(m.line.label, m.path) for m in lost])] if lost else []
    if fit is not None and fit.verdict == "fail":
        return GcpDecision(None, 0, (*findings, _contradicted(name, free)))
    mine = [m for m in mine if m not in lost]
    usable = [m for m in mine if by_path[m.path].primary]
    if len(usable) < len(mine):
        findings.append(_secondary(name, [m.path for m in mine if not by_path[m.path].primary]))
    wrong = tuple(sorted({m.line.label for m in usable} & set(fit.outliers))) if fit is not None else ()
    if wrong:
        findings.append(_outliers(name, wrong))
        usable = [m for m in usable if m.line.label not in wrong]
    seen: Dict[Tuple[float, float, float], Set[str]] = defaultdict(set)
    places: Dict[Tuple[float, float, float], _XY] = {}
    for mark in usable:
        seen[mark.line.point].add(mark.path)
        places[mark.line.point] = (mark.latitude, mark.longitude)
    solid = [p for p in seen if len(seen[p]) >= thresholds.gcp_min_images]
    cameras = [f.position for f in frames if f.primary and f.position is not None]

    refusal = _refusal(name, [places[p] for p in solid], len(seen), cameras, thresholds)
    if refusal is not None:
        return GcpDecision(None, len(solid), (*findings, refusal))
    text = write_gcp(placed.srs, [(m.line, by_path[m.path]) for m in usable])
    return GcpDecision(text, len(solid), tuple(findings))


def _refusal(
    name: str, solid: Sequence[_XY], marked: int, cameras: Sequence[_XY], thresholds: Thresholds
) -> Optional[Finding]:
    wanted = thresholds.gcp_min_points if cameras else thresholds.gcp_min_points_without_gps
    if len(solid) < wanted:
        why = (
            f"{len(solid)} of its {marked} points are marked on {thresholds.gcp_min_images} frames or more, "
            f"and {wanted} are needed"
        )
        remedy = "Mark more points, or more frames of each."
        return _refused("gcp-few-points", name, why, float(len(solid)), float(wanted), remedy, not cameras)
    origin = solid[0]
    ground = local_metres(solid, origin)
    ratio = flatness(ground)
    if ratio < thresholds.collinear_ratio:
        return _refused(
            "gcp-collinear", name, "its points lie on one line, so the block could roll about it",
            round(ratio, 4), thresholds.collinear_ratio, "Add a point well off that line.", not cameras,
        )  # fmt: skip
    block = hull_area_m2(local_metres(cameras, origin))
    share = hull_area_m2(ground) / block if block > 0 else 1.0
    if share < thresholds.gcp_hull_share:
        return _refused(
            "gcp-hull-small", name, f"its points span {share:.0%} of the block, and the rest could tilt",
            round(share, 3), thresholds.gcp_hull_share, "Add points towards the corners of the block.", not cameras,
        )  # fmt: skip
    return None


def _refused(code: str, name: str, why: str, measured: float, threshold: float, remedy: str, free: bool) -> Finding:
    kept = "ODM would switch GPS off for it, so GPS stays."
    if free:
        kept = "It has no GPS either: its place and scale stay free."
    return Finding(
        code=code,
        severity=WARNING,
        subjects=(name,),
        message=f"{name} gets no ground control: {why}. {kept}",
        remedy=f"{remedy} Or run the project with --align on the surface model of the project that has ground control.",
        measured=measured,
        threshold=threshold,
    )


def _contradicted(name: str, free: bool) -> Finding:
    said = "" if free else ", or the scale that their GPS gives it"
    then = "With a wrong list ODM would bend the block." + ("" if free else " So GPS stays.")
    return Finding(
        code="gcp-contradicted",
        severity=WARNING,
        subjects=(name,),
        message=f"{name} gets no ground control: its points do not fit the model that its frames make{said}. {then}",
        remedy="Check the points' coordinate system, unit and heights, and that each mark has the right name; "
        "the project's reasons say by how much they miss.",
    )


def _astray(name: str, marks: Sequence[Tuple[str, str]]) -> Finding:
    shown = listed([f"{label} on {path.rsplit('/', 1)[-1]}" for label, path in sorted(marks)])
    return Finding(
        code="gcp-mark-astray",
        severity=WARNING,
        subjects=tuple(dict.fromkeys(w for mark in sorted(marks) for w in mark)),
        message=f"Ground control marks left out of {name}, because they miss where the point's other marks meet: "
        f"{shown}.",
        remedy="Look whether the mark stands on another target, or has another point's name.",
        measured=float(len(marks)),
    )


def _outliers(name: str, labels: Sequence[str]) -> Finding:
    return Finding(
        code="gcp-outlier",
        severity=WARNING,
        subjects=tuple(labels),
        message=f"{', '.join(labels)}: contradicted by all other ground control points of {name}, and left out.",
        remedy="Check the point's coordinates and its marks.",
    )


def _secondary(name: str, lost: Sequence[str]) -> Finding:
    return Finding(
        code="gcp-secondary-band",
        severity=INFO,
        subjects=(name, *sorted(set(lost))),
        message=f"{len(lost)} ground control marks of {name} stand on bands that do not enter ODM's solver; "
        "it would pass over them without a word.",
        remedy="Mark the points on frames of the primary band.",
    )
