"""Solved camera centres against measured positions: similarity, residuals, bowing, height (pure numpy).

Robust and deterministic: consensus over fixed samples, then least squares
(Umeyama 1991, doi:10.1109/34.88573) reweighted by Huber's rule.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np
import numpy.typing as npt

from .model import Bowing, GpsFit

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_SAMPLES = 400
_ROUNDS = 20
# Share of centres that the RMS may leave out as wild positions: more of them are no accident.
_WILD_SHARE = 0.1


@dataclass(frozen=True)
class Similarity:
    """world = scale * rotation @ model + translation."""

    scale: float
    rotation: Array
    translation: Array

    def points(self, rows: Array) -> Array:
        """Model points (N, 3) in world metres."""
        result: Array = self.scale * (rows @ self.rotation.T) + self.translation
        return result

    def directions(self, rows: Array) -> Array:
        """Model directions (N, 3) in the world."""
        result: Array = rows @ self.rotation.T
        return result


def umeyama(source: Array, target: Array, weight: Optional[Array] = None) -> Optional[Similarity]:
    """Weighted least-squares similarity from ``source`` to ``target`` (N, 3); ``None`` where it is undefined."""
    w = np.ones(len(source)) if weight is None else weight
    total = float(w.sum())
    if len(source) < 3 or total <= 0:
        return None
    mean_s = (w[:, None] * source).sum(axis=0) / total
    mean_t = (w[:, None] * target).sum(axis=0) / total
    a, b = source - mean_s, target - mean_t
    variance = float((w * (a**2).sum(axis=1)).sum()) / total
    if variance <= 1e-18:
        return None
    u, d, vt = np.linalg.svd((w[:, None] * b).T @ a / total)
    sign = np.array([1.0, 1.0, 1.0 if np.linalg.det(u) * np.linalg.det(vt) > 0 else -1.0])
    rotation = (u * sign) @ vt
    scale = float((d * sign).sum() / variance)
    if not math.isfinite(scale) or scale <= 0:
        return None
    return Similarity(scale, rotation, mean_t - scale * rotation @ mean_s)


def robust_similarity(source: Array, target: Array, sigma_m: float) -> Optional[Similarity]:
    """Similarity that wild positions do not move; ``sigma_m`` is the spread of a good one.

    Samples of three centres are drawn by a fixed generator; the one with the
    least truncated cost starts the reweighting. Fewer than three, or three in
    one place, give ``None``.
    """
    count = len(source)
    if count < 3:
        return None
    limit = 3.0 * sigma_m
    best, best_cost = umeyama(source, target), math.inf
    if best is not None:
        best_cost = _cost(best, source, target, limit)
    if count >= 5:
        draw = np.random.default_rng(0)
        for _ in range(_SAMPLES):
            rows = np.sort(draw.choice(count, 3, replace=False))
            trial = umeyama(source[rows], target[rows])
            if trial is None:
                continue
            cost = _cost(trial, source, target, limit)
            if cost < best_cost * (1.0 - 1e-9):
                best, best_cost = trial, cost
    if best is None:
        return None
    for _ in range(_ROUNDS):
        miss = np.linalg.norm(best.points(source) - target, axis=1)
        scale = max(1.4826 * float(np.median(miss)), 1e-9)
        weight = np.minimum(1.0, 1.5 * scale / np.maximum(miss, 1e-12))
        weight[miss > max(limit, 6.0 * scale)] = 0.0
        again = umeyama(source, target, weight)
        if again is None:
            break
        best = again
    return best


def _cost(fit: Similarity, source: Array, target: Array, limit: float) -> float:
    miss = ((fit.points(source) - target) ** 2).sum(axis=1)
    return float(np.minimum(miss, limit * limit).sum())


def collinear(points: Array, ratio: float) -> bool:
    """Whether the centres (N, 3) lie on one line: second singular value below ``ratio`` of the first."""
    if len(points) < 3:
        return True
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(values[0] <= 1e-12 or values[1] < ratio * values[0])


def wild(residual: Array, sigma_h: float, sigma_v: float) -> Mask:
    """Mark at most a tenth of the rows as wild positions: far outside both GPS's spread and that of the rest."""
    size = np.hypot(np.hypot(residual[:, 0], residual[:, 1]) / sigma_h, residual[:, 2] / sigma_v)
    limit = max(5.0, 6.0 * float(np.median(size))) if len(size) else math.inf
    far = size > limit
    if far.sum() > _WILD_SHARE * len(far):
        return np.zeros(len(far), dtype=bool)
    return np.asarray(far)


def residual_fit(
    residual: Array, sigma: Tuple[float, float], fitted: int, line: bool, vertical_known: bool = True
) -> GpsFit:
    """RMS of residual rows (N, 3), horizontal and vertical apart.

    ``fitted`` is the number of centres that the similarity was fitted to among
    these rows: its seven freedoms are given back by sqrt(3n/(3n-7)). 0 means
    the similarity came from others, and nothing is to be given back.
    """
    count = len(residual)
    if count == 0:
        return GpsFit(0, None, None, sigma[0], sigma[1], line)
    kept = residual[~wild(residual, *sigma)]
    if fitted and 3 * fitted <= 7:
        return GpsFit(count, None, None, sigma[0], sigma[1], line)
    factor = math.sqrt(3.0 * fitted / (3.0 * fitted - 7.0)) if fitted else 1.0
    horizontal = factor * math.sqrt(float((kept[:, :2] ** 2).sum(axis=1).mean()))
    vertical = factor * math.sqrt(float((kept[:, 2] ** 2).mean()))
    return GpsFit(
        frames=count,
        horizontal_m=round(horizontal, 4),
        vertical_m=round(vertical, 4) if vertical_known else None,
        sigma_horizontal_m=sigma[0],
        sigma_vertical_m=sigma[1],
        collinear=line,
    )


def bowing(solved: Array, measured: Array, groups: Sequence[str]) -> Bowing:
    """d*r^2 of z = a_group + b x + c y + d (x^2 + y^2) through solved minus measured heights.

    Rows are metres (N, 3). Each group (flight) keeps its own offset, so that a
    barometer's bias between flights is no bow. ``r`` is the block's radius, the
    95th percentile of the distances from its middle. ``Bowing()`` where the
    fit has fewer than two freedoms left.
    """
    names = sorted(set(groups))
    freedom = len(solved) - len(names) - 3
    if freedom < 2:
        return Bowing()
    middle = np.median(measured[:, :2], axis=0)
    x, y = (measured[:, :2] - middle).T
    squared = x * x + y * y
    radius = math.sqrt(float(np.percentile(squared, 95)))
    if radius <= 0:
        return Bowing()
    unit = radius
    columns = [np.asarray([1.0 if g == name else 0.0 for g in groups]) for name in names]
    design = np.stack([*columns, x / unit, y / unit, squared / unit**2], axis=1)
    return _last_term(design, solved[:, 2] - measured[:, 2], radius)


def surface_bow(first: Array, second: Array, per_camera: int) -> Bowing:
    """Bow of ``first`` minus ``second``, two surfaces of the same points (N, 3) in metres: terrain cancels.

    Points of one block are not independent; the standard error is that of
    ``per_camera`` independent ones (one per frame).
    """
    if len(first) < 12:
        return Bowing()
    x, y = (second[:, :2] - np.median(second[:, :2], axis=0)).T
    squared = x * x + y * y
    radius = math.sqrt(float(np.percentile(squared, 95)))
    if radius <= 0:
        return Bowing()
    design = np.stack([np.ones(len(x)), x / radius, y / radius, squared / radius**2], axis=1)
    found = _last_term(design, first[:, 2] - second[:, 2], radius)
    if found.se_m is None:
        return found
    inflate = math.sqrt(max(1.0, len(first) / max(per_camera, 1)))
    return Bowing(found.bowing_m, round(found.se_m * inflate, 5), found.radius_m)


def _last_term(design: Array, values: Array, radius: float) -> Bowing:
    weight: Array = np.ones(len(values))
    solution: Array = np.zeros(design.shape[1])
    for _ in range(10):
        root = np.sqrt(weight)[:, None]
        solution[:] = np.linalg.lstsq(design * root, values * root[:, 0], rcond=None)[0]
        miss = np.abs(values - design @ solution)
        scale = max(1.4826 * float(np.median(miss)), 1e-9)
        weight = np.asarray(np.minimum(1.0, 2.0 * scale / np.maximum(miss, 1e-12)), dtype=np.float64)
    left = values - design @ solution
    freedom = len(values) - design.shape[1]
    variance = float((weight * left**2).sum()) / max(freedom, 1)
    inverse = np.linalg.pinv((design * weight[:, None]).T @ design)
    error = math.sqrt(max(variance * float(inverse[-1, -1]), 0.0))
    if not (math.isfinite(error) and math.isfinite(float(solution[-1]))):
        return Bowing()
    return Bowing(round(float(solution[-1]), 4), round(error, 5), round(radius, 2))


def called(bow: Bowing, sigmas: float) -> bool:
    """Whether a bow is certain: beyond ``sigmas`` of its standard errors."""
    return bow.bowing_m is not None and bow.se_m is not None and abs(bow.bowing_m) > sigmas * bow.se_m


def height_above_ground(centers: Array, points: Array) -> Tuple[Optional[float], Optional[float]]:
    """Return the median camera height above the points below it, and the ground's relief (5 to 95 %), m.

    Rows are world metres. A camera takes the points within half the typical
    height; with fewer than eight there, the sixteen nearest.
    """
    if len(points) < 8 or len(centers) == 0:
        return None, None
    rough = float(np.median(centers[:, 2]) - np.median(points[:, 2]))
    reach = max(abs(rough) * 0.5, 1.0)
    heights = []
    for center in centers:
        away = np.hypot(points[:, 0] - center[0], points[:, 1] - center[1])
        near = away <= reach
        if near.sum() < 8:
            near = np.zeros(len(points), dtype=bool)
            near[np.argsort(away, kind="stable")[:16]] = True
        heights.append(float(center[2] - np.median(points[near, 2])))
    low, high = np.percentile(points[:, 2], [5, 95])
    return round(float(np.median(heights)), 3), round(float(high - low), 3)
