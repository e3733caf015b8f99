"""Where matches cannot tie a payload to the others, ground control seen by both can."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, Tuple

import numpy as np

from ..thresholds import Thresholds
from .control import Lay, lay_by_control
from .fit import Similarity
from .judge import FAIL
from .model import AlignRequest, GcpMark
from .run import Aligned, judged_again
from .solution import UNPLACED, Ints, Solution


@dataclass(frozen=True)
class ControlTie:
    """Whether control points tie a payload to the others, and in words why or what is missing."""

    holds: bool
    text: str


def tie_by_control(aligned: Aligned, payload: str, limits: Thresholds) -> ControlTie:
    """Say whether control points tie ``payload`` to the rest of an alignment, model by model.

    The payload's own model and the others' each need three points off one line
    in two frames each; both must fit them within the limit of a free network.
    """
    request = aligned.request
    if not request.gcps:
        return ControlTie(False, "no ground control points are given: a GCP file with points seen by both would tie it")
    lays, missing = _lays(aligned, payload, limits)
    if missing:
        return ControlTie(False, missing)
    for lay in lays:
        if lay.fit.verdict == FAIL:
            return ControlTie(False, lay.fit.text)
    worst = max(max(lay.fit.horizontal_m or 0.0, lay.fit.vertical_m or 0.0) for lay in lays)
    count = min(lay.fit.points for lay in lays)
    return ControlTie(True, f"tied by {count} ground control points, fitting to {worst:.2f} m")


def _lays(aligned: Aligned, payload: str, limits: Thresholds) -> Tuple[Tuple[Lay, ...], str]:
    request, found = aligned.request, []
    for marks, own, whose in (
        (_marks(request, payload, True), True, "its own frames"),
        (_marks(request, payload, False), False, "the other payloads' frames"),
    ):
        model = _main_model(aligned, payload, own)
        if model == UNPLACED:
            return (), "its frames form no model that ground control could be laid on"
        only = replace(request, gcps=marks)
        lay = lay_by_control(only, aligned.job, aligned.solution, aligned.ground, model, limits)
        if lay.similarity is None:
            text = f"{lay.fit.points} control points are marked in two or more of {whose}; 3 off one line are needed"
            return (), text
        found.append(lay)
    return tuple(found), ""


def joined_by_control(aligned: Aligned, payload: str, limits: Thresholds) -> Aligned:
    """The alignment judged again, the payload's model and the others' laid on the same points and counted as one."""
    lays, missing = _lays(aligned, payload, limits)
    if missing or len({lay.model for lay in lays}) == 1:
        return judged_again(aligned, aligned.solution, {}, (payload,), limits)
    mine, others = lays
    solution = aligned.solution
    for lay in lays:
        if lay.similarity is not None:
            solution = moved(solution, lay.model, lay.similarity)
    into = min(mine.model, others.model)
    gone = max(mine.model, others.model)

    solution = replace(
        solution, model=_merged(solution.model, gone, into), point_model=_merged(solution.point_model, gone, into)
    )
    still = Similarity(1.0, np.eye(3), np.zeros(3))
    return judged_again(aligned, solution, {into: still}, (payload,), limits)


def _merged(models: Ints, gone: int, into: int) -> Ints:
    """Model numbers with one counted as another, and no number left out."""
    result: Ints = np.where(models == gone, into, models)
    return np.where(result > gone, result - 1, result)


def moved(solution: Solution, model: int, fit: Similarity) -> Solution:
    """The solution with one model laid in metres."""
    rows, points = solution.model == model, solution.point_model == model
    center, rotation, xyz = solution.center.copy(), solution.rotation.copy(), solution.point_xyz.copy()
    center[rows] = fit.points(center[rows])
    rotation[rows] = rotation[rows] @ fit.rotation.T
    xyz[points] = fit.points(xyz[points])
    return replace(solution, center=center, rotation=rotation, point_xyz=xyz)


def _marks(request: AlignRequest, payload: str, own: bool) -> Tuple[GcpMark, ...]:
    owner = {f.path: f.payload for f in request.frames}
    return tuple(m for m in request.gcps if m.path in owner and (owner[m.path] == payload) == own)


def _main_model(aligned: Aligned, payload: str, own: bool) -> int:
    counts: Dict[int, int] = {}
    for index, frame in enumerate(aligned.request.frames):
        model = int(aligned.solution.model[index])
        if (frame.payload == payload) == own and model != UNPLACED:
            counts[model] = counts.get(model, 0) + 1
    return min(counts, key=lambda m: (-counts[m], m)) if counts else UNPLACED
