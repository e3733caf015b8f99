"""Ground control marks in a solved model: intersected, laid on their coordinates, and what they say.

Where matches cannot tie a payload to the others, control points seen by both
can: each model is laid on the same ground by them, and has to fit its GPS too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..thresholds import Thresholds
from .enu import enu
from .fit import Similarity, collinear, umeyama
from .model import AlignRequest, GcpMark
from .run import Aligned
from .solution import UNPLACED, Array, CameraSetting, Job, Solution

_MIN_POINTS = 3
_MIN_RAYS = 2


@dataclass(frozen=True)
class ControlTie:
    """Whether control points tie a payload to the others, and in words why or what is missing."""

    holds: bool
    text: str


def rays(camera: CameraSetting, pixels: Array) -> Array:
    """Return directions (N, 3), z = 1, of pixels (N, 2) of the working size, with the distortion taken off."""
    cx, cy = camera.center_px
    seen = (pixels - np.array([cx, cy])) / camera.focal_px
    k1, k2, p1, p2, k3 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    xy = seen.copy()
    for _ in range(25):
        x, y = xy[:, 0], xy[:, 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        shift = np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=1)
        xy = (seen - shift) / radial[:, None]
    return np.concatenate([xy, np.ones((len(xy), 1))], axis=1)


def intersect(
    request: AlignRequest, job: Job, solution: Solution, marks: Sequence[GcpMark], model: int
) -> Dict[str, Tuple[Array, int]]:
    """Return point -> (place in the model's gauge, number of rays), from marks of frames in ``model``.

    Least squares on the distance to the rays; points with fewer than two rays,
    or whose rays run parallel, are left out.
    """
    index = {f.path: i for i, f in enumerate(request.frames)}
    lines: Dict[str, List[Tuple[Array, Array]]] = {}
    for mark in marks:
        row = index.get(mark.path)
        if row is None or solution.model[row] != model:
            continue
        frame = request.frames[row]
        camera = solution.cameras[job.frames[row].camera]
        scale = np.array([camera.width / frame.width, camera.height / frame.height])
        ray = rays(camera, np.array([[mark.x_px, mark.y_px]]) * scale)[0]
        direction = solution.rotation[row].T @ ray
        lines.setdefault(mark.point, []).append((solution.center[row], direction / np.linalg.norm(direction)))
    found: Dict[str, Tuple[Array, int]] = {}
    for point in sorted(lines):
        if len(lines[point]) < _MIN_RAYS:
            continue
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for center, direction in lines[point]:
            across = np.eye(3) - np.outer(direction, direction)
            normal += across
            right += across @ center
        if np.linalg.cond(normal) < 1e8:
            found[point] = (np.asarray(np.linalg.solve(normal, right), dtype=np.float64), len(lines[point]))
    return found


def control_places(marks: Sequence[GcpMark]) -> Dict[str, Array]:
    """Return point -> east, north, up in metres about the first point by name."""
    first: Dict[str, Tuple[float, float, float]] = {}
    for mark in sorted(marks, key=lambda m: (m.point, m.path)):
        first.setdefault(mark.point, (mark.latitude, mark.longitude, mark.altitude_m))
    if not first:
        return {}
    names = sorted(first)
    rows = np.asarray([first[n] for n in names], dtype=float)
    return dict(zip(names, enu(rows, np.median(rows, axis=0))))


def lay_by_control(
    request: AlignRequest, job: Job, solution: Solution, marks: Sequence[GcpMark], model: int, limits: Thresholds
) -> Tuple[Optional[Similarity], int, Optional[float]]:
    """Return the similarity of a model to the control points, how many carried it, and its RMS in metres.

    The RMS is given back its freedoms by sqrt(3n/(3n-7)).
    """
    places = control_places(marks)
    solved = intersect(request, job, solution, marks, model)
    names = sorted(solved)
    if len(names) < _MIN_POINTS:
        return None, len(names), None
    source = np.asarray([solved[n][0] for n in names])
    target = np.asarray([places[n] for n in names])
    if collinear(target, limits.collinear_ratio):
        return None, len(names), None
    fit = umeyama(source, target, np.asarray([float(solved[n][1]) for n in names]))
    if fit is None:
        return None, len(names), None
    count = len(names)
    miss = math.sqrt(float(((fit.points(source) - target) ** 2).sum(axis=1).mean()))
    return fit, count, round(miss * math.sqrt(3 * count / (3 * count - 7)), 4)


def tie_by_control(aligned: Aligned, payload: str, limits: Thresholds) -> ControlTie:
    """Say whether control points tie ``payload`` to the rest of an alignment, model by model.

    The payload's own model and the others' each need three points off one line
    in two frames each; both must fit them within ``control_fit_m``.
    """
    request = aligned.request
    if not request.gcps:
        return ControlTie(False, "no ground control points are given: a GCP file with points seen by both would tie it")
    mine, others = _marks(request, payload)
    model_mine, model_others = _main_model(aligned, payload, True), _main_model(aligned, payload, False)
    if model_mine == UNPLACED or model_others == UNPLACED:
        return ControlTie(False, "its frames form no model that ground control could be laid on")
    results = []
    for marks, model in ((mine, model_mine), (others, model_others)):
        results.append(lay_by_control(request, aligned.job, aligned.solution, marks, model, limits))
    for (fit, count, _), whose in zip(results, ("its own frames", "the other payloads' frames")):
        if fit is None:
            return ControlTie(
                False,
                f"{count} control points are marked in two or more of {whose}; {_MIN_POINTS} off one line are needed",
            )
    worst = max(r[2] or 0.0 for r in results)
    if worst > limits.control_fit_m:
        return ControlTie(False, f"control points fit only to {worst:.2f} m, {limits.control_fit_m:g} m is the limit")
    return ControlTie(True, f"tied by {min(r[1] for r in results)} ground control points, fitting to {worst:.2f} m")


def _marks(request: AlignRequest, payload: str) -> Tuple[Tuple[GcpMark, ...], Tuple[GcpMark, ...]]:
    owner = {f.path: f.payload for f in request.frames}
    mine = tuple(m for m in request.gcps if owner.get(m.path) == payload)
    others = tuple(m for m in request.gcps if owner.get(m.path) not in (payload, None))
    return mine, others


def _main_model(aligned: Aligned, payload: str, own: bool) -> int:
    counts: Dict[int, int] = {}
    for index, frame in enumerate(aligned.request.frames):
        model = int(aligned.solution.model[index])
        if (frame.payload == payload) == own and model != UNPLACED:
            counts[model] = counts.get(model, 0) + 1
    return min(counts, key=lambda m: (-counts[m], m)) if counts else UNPLACED
