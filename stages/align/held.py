"""Ground control as a constraint: a proven model is laid on its points and adjusted with them held."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Optional, Tuple

import numpy as np

from ..progress import Cancel, Progress
from ..thresholds import Thresholds
from . import worker
from .control import NO_CONTROL, Controlled, Lay, holds_of, lays_of, of_payload, residuals
from .fit import Similarity
from .model import AlignRequest
from .solution import AdjustJob, CameraSetting, Job, Solution
from .world import Ground

# COLMAP's own program adjusts without constant points: there control lays a model, and cannot hold it.
HOLDING = ("pycolmap",)


def hold_control(
    request: AlignRequest,
    job: Job,
    solution: Solution,
    cameras: Tuple[CameraSetting, ...],
    ground: Ground,
    engine: str,
    folder: Path,
    limits: Thresholds,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Tuple[Solution, Controlled]:
    """Prove the models by ground control, then adjust those that it may hold; ``cameras`` say what may move.

    The proof is the free network's: an adjusted one fits its points by force.
    The solution's models that are held come back in metres.
    """
    lays = lays_of(request, job, solution, ground, limits)
    if not lays:
        return solution, NO_CONTROL
    payloads = {}
    for name in sorted({f.payload for f in request.frames}):
        found = of_payload(request, job, solution, ground, lays, name, limits)
        if found is not None:
            payloads[name] = found
    laid = {m: lay.similarity for m, lay in lays.items() if lay.holds and lay.similarity is not None}
    held = solution
    holds = holds_of(request, job, solution, ground, lays)
    if holds and engine in HOLDING:
        task = AdjustJob(solution.stored, job, (cameras,), holds)
        held = worker.adjust(task, engine, folder / "control", progress, cancel)[0]
        held = replace(
            held,
            cameras=tuple(
                replace(c, solve_focal=s.solve_focal, solve_distortion=s.solve_distortion)
                for c, s in zip(held.cameras, solution.cameras)
            ),
            pairs=solution.pairs,
            notes=solution.notes,
            features=solution.features,
        )
        still = Similarity(1.0, np.eye(3), np.zeros(3))
        laid = {h.model: still for h in holds}
    best = min(lays.values(), key=_rank)
    if best.similarity is None:
        return held, Controlled(laid, best.fit, payloads)
    at = laid.get(best.model, best.similarity)
    fit = residuals(request, job, held, ground, best, at)
    return held, Controlled(laid, replace(fit, held=bool(holds) and engine in HOLDING and best.holds), payloads)


def _rank(lay: Lay) -> Tuple[bool, int, int]:
    return (not lay.holds, -lay.fit.points, lay.model)
