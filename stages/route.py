"""From frames that may share a project to groups that provably do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import List, Optional, Union

from .align.blocks import blocks
from .align.judge import UNPROVEN
from .align.model import AlignRequest
from .align.prepare import sorted_request
from .ladder import Ladder
from .large import climb_sampled
from .progress import Cancel, Progress
from .proven import ISOLATE, PAIRWISE, PROCEED, ROUTES, Proof, ProvenGroup, apart, named
from .router import FALLBACK_STRATEGY, PROCEED_STRATEGY, PipelineRouter
from .thresholds import DEFAULTS, Thresholds

__all__ = [
    "FALLBACK_STRATEGY",
    "ISOLATE",
    "PAIRWISE",
    "PROCEED",
    "PROCEED_STRATEGY",
    "ROUTES",
    "UNPROVEN",
    "PipelineRouter",
    "Proof",
    "ProvenGroup",
    "apart",
    "prove",
]


def prove(
    request: AlignRequest,
    workspace: Union[str, Path],
    *,
    thresholds: Thresholds = DEFAULTS,
    engine: str = "pycolmap",
    max_dim: Optional[int] = None,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Proof:
    """Climb the ladder for one request of one spectrum.

    Raises ``MissingDependency``, ``Cancelled`` and ``UsageError`` as ``align``
    does. A solver that dies on a group makes the group unproven, with its
    last words as the reason. A block of more than ``sample_above`` frames is
    judged by samples.
    """
    ladder = Ladder(Path(workspace), thresholds, engine, max_dim, progress, cancel)
    request = sorted_request(request)
    found: List[ProvenGroup] = []
    for number, block in enumerate(blocks(request, thresholds)):
        groups = climb_sampled(ladder, block, thresholds)
        if number:
            groups = [
                replace(g, reasons=("it lies over other ground than the rest of its request", *g.reasons))
                for g in groups
            ]
        found.extend(groups)
    return Proof(tuple(named(request.name, found)), tuple(ladder.attempts))
