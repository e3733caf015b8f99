"""Whether payloads are tied to the others at all: their pairs matched, nothing mapped.

A payload without enough verified pairs is refused whatever a model of it
looks like. Its pairs alone are a fraction of a rung's cost.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Collection, Dict, Optional, Sequence

from ..progress import Cancel, Progress
from ..record import dumps
from ..thresholds import Thresholds
from . import worker
from .model import AlignRequest
from .pairs import plan_pairs
from .prepare import build_job, rung_max_dim, sorted_request
from .run import thread_count
from .solution import Retrieval


@dataclass(frozen=True)
class Ties:
    """Pairs of a payload with others: how many were tried, how many verified, how many hold the required inliers."""

    tried: int
    verified: int
    strong: int


def ties_of(
    request: AlignRequest,
    payloads: Collection[str],
    workspace: Path,
    extra: Sequence[Retrieval],
    *,
    rung: str,
    thresholds: Thresholds,
    engine: str,
    max_dim: Optional[int] = None,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Optional[Dict[str, Ties]]:
    """Match the pairs that the rung would try between ``payloads`` and others; the inliers are the rung's own.

    ``None`` where frames without a position are paired by likeness among all
    frames: those pairs depend on which others are tried.
    """
    request = sorted_request(request)
    side = max_dim or rung_max_dim(rung, thresholds)
    plan = plan_pairs(request.frames, request.cameras, thresholds)
    if plan.blind:
        return None
    owner = [f.payload for f in request.frames]
    job = build_job(request, plan, rung, side, thread_count(), thresholds, extra)
    pairs = tuple((a, b) for a, b in job.pairs if owner[a] != owner[b] and {owner[a], owner[b]} & set(payloads))
    said = dumps([[f.path for f in request.frames], sorted(payloads), rung, side, engine, extra])
    folder = workspace / f"ties-{hashlib.sha256(said.encode('utf-8')).hexdigest()[:12]}"
    solution = worker.solve(replace(job, pairs=pairs, only_pairs=True), engine, folder, workspace, progress, cancel)
    result = {}
    for payload in sorted(payloads):
        found = [n for a, b, n in solution.pairs.tolist() if (owner[a] == payload) != (owner[b] == payload)]
        result[payload] = Ties(len(found), sum(n > 0 for n in found), sum(n >= thresholds.min_inliers for n in found))
    return result
