"""Ground control marks as rays of a solved model: where they meet, and which of them miss (pure)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..thresholds import Thresholds
from .model import AlignRequest, GcpMark
from .solution import Array, CameraSetting, Job, Solution

MIN_RAYS = 2
_PARALLEL = 1e8


def rays(camera: CameraSetting, pixels: Array) -> Array:
    """Return directions (N, 3), z = 1, of pixels (N, 2) of the working size, with the distortion taken off."""
    cx, cy = camera.center_px
    seen = (pixels - np.array([cx, cy])) / np.array(camera.focals_px)
    k1, k2, p1, p2, k3 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    xy = seen.copy()
    for _ in range(25):
        x, y = xy[:, 0], xy[:, 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        shift = np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=1)
        xy = (seen - shift) / radial[:, None]
    return np.concatenate([xy, np.ones((len(xy), 1))], axis=1)


def working_pixel(request: AlignRequest, job: Job, row: int, mark: GcpMark) -> Tuple[float, float]:
    """The mark in pixels of the working size, counted from the corner of the first pixel as the engines do."""
    frame, camera = request.frames[row], job.cameras[job.frames[row].camera]
    return (mark.x_px + 0.5) * camera.width / frame.width, (mark.y_px + 0.5) * camera.height / frame.height


def intersect(
    request: AlignRequest, job: Job, solution: Solution, marks: Sequence[GcpMark], model: int
) -> Dict[str, Tuple[Array, int]]:
    """Return point -> (place in the model's gauge, number of rays), from marks of frames in ``model``.

    Least squares on the distance to the rays; points with fewer than two rays,
    or whose rays run parallel, are left out.
    """
    found: Dict[str, Tuple[Array, int]] = {}
    for point, sights in sorted(_sights(request, job, solution, marks, model).items()):
        place = _meet(sights)
        if place is not None:
            found[point] = (place, len(sights))
    return found


@dataclass(frozen=True)
class _Sight:
    """One mark as a ray in the model's gauge: from ``center`` along the unit vector ``direction``."""

    mark: GcpMark
    center: Array
    direction: Array
    focal_px: float

    def miss_px(self, place: Array) -> float:
        """How far from the mark the camera sees ``place``; infinite behind it."""
        away = place - self.center
        along = float(away @ self.direction)
        if along <= 0:
            return math.inf
        return self.focal_px * float(np.linalg.norm(away - along * self.direction)) / along


def _sights(
    request: AlignRequest, job: Job, solution: Solution, marks: Sequence[GcpMark], model: int
) -> Dict[str, List[_Sight]]:
    """Point -> its rays from frames in ``model``."""
    index = {f.path: i for i, f in enumerate(request.frames)}
    found: Dict[str, List[_Sight]] = {}
    for mark in marks:
        row = index.get(mark.path)
        if row is None or solution.model[row] != model:
            continue
        camera = solution.cameras[job.frames[row].camera]
        ray = rays(camera, np.array([working_pixel(request, job, row, mark)]))[0]
        direction = solution.rotation[row].T @ ray
        sight = _Sight(mark, solution.center[row], direction / np.linalg.norm(direction), camera.focal_px)
        found.setdefault(mark.point, []).append(sight)
    return found


def _meet(sights: Sequence[_Sight]) -> Optional[Array]:
    """Where rays meet best; ``None`` with fewer than two, or where they run parallel."""
    if len(sights) < MIN_RAYS:
        return None
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for sight in sights:
        across = np.eye(3) - np.outer(sight.direction, sight.direction)
        normal += across
        right += across @ sight.center
    if not np.linalg.cond(normal) < _PARALLEL:
        return None
    return np.asarray(np.linalg.solve(normal, right), dtype=np.float64)


def _worst_px(sights: Sequence[_Sight]) -> float:
    place = _meet(sights)
    return math.inf if place is None else max(s.miss_px(place) for s in sights)


def astray(
    request: AlignRequest, job: Job, solution: Solution, model: int, limits: Thresholds
) -> Tuple[Tuple[str, str], ...]:
    """Return the marks (point, path) that stand on another target than the point's other ones.

    The one without which the others meet best goes first, until the rest meet
    within ``gcp_mark_px``; two that do not meet go both. Where more than
    ``gcp_astray_share`` of the marks miss, it is the model that is wrong: none
    is called then.
    """
    wrong: List[Tuple[str, str]] = []
    total = 0
    for _, sights in sorted(_sights(request, job, solution, request.gcps, model).items()):
        total += len(sights)
        left = list(sights)
        while len(left) >= MIN_RAYS and _worst_px(left) > limits.gcp_mark_px:
            out = min(range(len(left)), key=lambda k: (_worst_px(left[:k] + left[k + 1 :]), k))
            left = left[:out] + left[out + 1 :] if len(left) > MIN_RAYS else []
        if len(sights) >= MIN_RAYS:
            wrong += [(s.mark.point, s.mark.path) for s in sights if s not in left]
    return tuple(sorted(wrong)) if len(wrong) <= max(1.0, limits.gcp_astray_share * total) else ()
