"""What was proven to belong together: groups, routes, and the relabelling of what stands apart (pure)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence, Tuple

from .align.judge import UNPROVEN
from .align.model import AlignmentReport, AlignRequest, LockDecision
from .partition import held_together

PROCEED = "proceed"
PAIRWISE = "pairwise"
ISOLATE = "isolate"
ROUTES = (PROCEED, PAIRWISE, ISOLATE, UNPROVEN)


@dataclass(frozen=True)
class ProvenGroup:
    """Payloads that share one project, with the alignment that says so.

    ``frames`` are the paths of the request's frames, sorted. ``alignment`` is
    ``None`` where no solver could be run on them. ``locked`` has one decision
    per profile that was solved.
    """

    name: str
    payloads: Tuple[str, ...]
    frames: Tuple[str, ...]
    route: str
    reasons: Tuple[str, ...]
    alignment: Optional[AlignmentReport] = None
    locked: Tuple[LockDecision, ...] = ()


@dataclass(frozen=True)
class Proof:
    """Where every payload of a request ended, and every alignment that was tried on the way."""

    groups: Tuple[ProvenGroup, ...]
    attempts: Tuple[AlignmentReport, ...]


def named(name: str, groups: Sequence[ProvenGroup]) -> List[ProvenGroup]:
    """Order groups, the proven and large first, and number them."""
    order = sorted(groups, key=lambda g: (ROUTES.index(g.route), -len(g.frames), g.payloads))
    return [replace(g, name=name if i == 0 else f"{name}-{i + 1}") for i, g in enumerate(order)]


def group_of(
    request: AlignRequest, route: str, reasons: Sequence[str], report: Optional[AlignmentReport]
) -> ProvenGroup:
    """All frames of a request as one group; reasons said twice stand once."""
    return ProvenGroup(
        name=request.name,
        payloads=tuple(sorted({f.payload for f in request.frames})),
        frames=tuple(sorted(f.path for f in request.frames)),
        route=route,
        reasons=tuple(dict.fromkeys(reasons)),
        alignment=report,
        locked=held_together(report.decisions) if report else (),
    )


def apart(groups: Sequence[Tuple[str, int, ProvenGroup]]) -> Tuple[ProvenGroup, ...]:
    """Isolate what stands over other ground than most frames of its spectrum; order is kept.

    Each entry is a spectrum, the number of its piece of ground, and a group.
    A block elsewhere was slipped in: it may align well, but shares nothing with
    the rest.
    """
    frames: Dict[Tuple[str, int], int] = {}
    for spectrum, area, group in groups:
        frames[(spectrum, area)] = frames.get((spectrum, area), 0) + len(group.frames)
    main = {
        spectrum: min((k[1] for k in frames if k[0] == spectrum), key=lambda a: (-frames[(spectrum, a)], a))
        for spectrum in {k[0] for k in frames}
    }
    result: List[ProvenGroup] = []
    for spectrum, area, group in groups:
        if area != main[spectrum] and group.route in (PROCEED, PAIRWISE):
            why = "It stands over another place than most frames of its spectrum, and aligns alone."
            group = replace(group, route=ISOLATE, reasons=(why, *group.reasons))
        result.append(group)
    return tuple(result)
