"""Check points: ground control that is held out of everything, so that its residual says something."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import Dict, Optional, Set

from ...stages.finding import INFO, Finding
from ...stages.gcp import Point, choose_check_points
from .gcp_place import PlacedGcps


def held_out(placed: PlacedGcps, wanted: Optional[str]) -> PlacedGcps:
    """The marks with those of check points flagged: named so, or asked for with ``--check-points``.

    They stand in no project's list, because ODM would hold every line of it.
    """
    images: Dict[Point, Set[str]] = defaultdict(set)
    for mark in placed.marks:
        images[mark.line.point].add(mark.path)
    names = {m.line.point: m.line.label for m in placed.marks}
    places = {m.line.point: (m.latitude, m.longitude) for m in placed.marks}
    checks = choose_check_points(names, places, {p: len(images[p]) for p in names}, wanted)
    if not checks:
        return placed
    labels = tuple(sorted(names[p] for p in checks))
    said = Finding(
        code="gcp-check-points",
        severity=INFO,
        subjects=labels,
        message=f"{len(labels)} ground control points are held out as check points; no project's list has them.",
        remedy="Nothing to do: how far the alignment misses them stands in the report.",
    )
    marks = tuple(replace(m, check=m.line.point in checks) for m in placed.marks)
    return replace(placed, marks=marks, findings=(*placed.findings, said))
