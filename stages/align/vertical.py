"""The vertical scale of a solved block by what was measured: camera heights that differ, an elevation model (pure).

A point at X east of a camera and Z below it is seen at x = f X / Z. On views
straight down, heights and f may be multiplied by one number without x
changing, so a focal that is wrong by a share e leaves a block whose plan GPS
scales rightly and whose heights are all (1 + e) times too large. Measured over
solved differences of height are then 1 / (1 + e), and f times that is right.

Two things measure heights that neither the camera nor the plan had a hand in:

*Flying heights.* Altitudes of cameras, where these differ enough; per camera
``altitude = s z + a x + b y + c + flight + noise``.

*An elevation model.* Per cell of ground, and per camera,

    model    = s z + a x + b y + d r^2 + c + g . slope + patch + noise
    altitude = s z + a x + b y + d r^2 + c + zero + flight + noise

with ``z`` the solved height. A tilt (a, b) and a bow (d) of the network move
cameras and ground alike: the altitudes fix them as well as the receiver is
known, and only relief beyond them speaks for ``s``. ``g`` is a shift of the
model in plan, ``patch`` the error that neighbouring cells share. ``zero`` is
the difference of the two height systems: where it is unknown, only relief
counts and flat ground says nothing; where it was measured, each camera's
height above the ground does. All terms but s, a, b, c, d have a known spread,
so this is least squares with them as observed parameters (Koch 1999,
Parameter Estimation and Hypothesis Testing in Linear Models, 3.6.2).

The standard error takes in that of the horizontal scale.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np

from ..thresholds import Thresholds
from .fit import height_above_ground
from .flown import FREE_M, ROUNDS, FlownBlock
from .model import AlignFrame
from .solution import Array, Ints, Solution
from .terrain import Terrain
from .world import Ground, Rows, fit_rows

FLYING, MODEL = "flying heights", "the elevation model"
BOTH = f"{FLYING} and {MODEL}"
DISAGREE = f"{FLYING} and {MODEL}, which contradict each other,"
MODEL_DISAGREES = f"{MODEL}, whose relief and zero contradict each other,"

# Cells and patches that a block is cut into along its longer side at most: more do not sharpen the answer.
_CELLS, _PATCHES = 45, 12
# A part of the weight below which one of two measurements adds little to the other.
_ADDS = 0.1
# Cells this many spreads off their patch stand on something that the model does not show.
_FAR = 3.0


@dataclass(frozen=True)
class VerticalScale:
    """Measured over solved differences of height, with its standard error; ``by`` names what measured them."""

    ratio: float
    sigma: float
    by: str = FLYING


def vertical_scale(
    frames: Sequence[AlignFrame], solution: Solution, ground: Ground, rows: Rows, limits: Thresholds
) -> Optional[VerticalScale]:
    """Compare solved with measured differences of height among frames of one model and the ground below them.

    ``None`` where the flying heights spread by less than ``two_heights_ratio``
    and no elevation model covers the ground. A flight's altitudes share an
    error of their receiver's spread; two flights of one session, counted from
    one zero, that of a barometer.
    """
    rows = rows[ground.known[rows] & ground.vertical[rows]]
    fit = fit_rows(solution, ground, rows) if len(rows) >= limits.min_proof_frames else None
    if fit is None:
        return None
    points = fit.points(solution.point_xyz[solution.point_model == solution.model[rows[0]]])
    block = FlownBlock.of(frames, solution, ground, rows, fit, limits)
    height, _ = height_above_ground(fit.points(solution.center[rows]), points)
    if block is None or height is None or height <= 0:
        return None
    points = block.laid(points)
    flown = _by_flying(block, height, limits)
    told = _by_terrain(block, points, height, ground.terrain, flown is None, limits) if ground.terrain else None
    found = _together(flown, told, DISAGREE, limits)
    if found is None:
        return None
    sigma = math.hypot(found.sigma, block.plan_sigma)
    if not (math.isfinite(found.ratio) and math.isfinite(sigma)):
        return None
    return VerticalScale(round(found.ratio, 5), round(sigma, 5), found.by)


def _together(
    first: Optional[VerticalScale], second: Optional[VerticalScale], disagree: str, limits: Thresholds
) -> Optional[VerticalScale]:
    """The weighted mean of both; where they exclude each other, as uncertain as they are apart."""
    if first is None or second is None:
        return first or second
    a, b = 1.0 / first.sigma**2, 1.0 / second.sigma**2
    ratio = (a * first.ratio + b * second.ratio) / (a + b)
    apart = abs(first.ratio - second.ratio)
    if apart > limits.solved_focal_sigma * math.hypot(first.sigma, second.sigma):
        return VerticalScale(ratio, apart, disagree)
    # What adds little is not named: the word decides what else could find the same.
    share = a / (a + b)
    by = first.by if share > 1.0 - _ADDS or first.by == second.by else second.by if share < _ADDS else BOTH
    return VerticalScale(ratio, math.sqrt(1.0 / (a + b)), by)


def _by_flying(block: FlownBlock, height: float, limits: Thresholds) -> Optional[VerticalScale]:
    """The scale by the cameras' own altitudes, where they were flown at heights that differ."""
    low, high = np.percentile(block.solved[:, 2], [5, 95])
    if high - low < limits.two_heights_ratio * height:
        return None
    count = len(block.solved)
    design = np.column_stack(
        [block.solved[:, 2], block.solved[:, :2], np.ones(count), block.of_flights(), block.of_sessions()]
    )
    own = [block.own_m(f, limits) for f in range(len(block.flights))]
    spreads = np.asarray([FREE_M * 1e3] * 4 + own + block.session_m())
    noise = block.floor_m
    found, spread = np.zeros(design.shape[1]), np.zeros((design.shape[1],) * 2)
    for _ in range(ROUNDS):
        found, spread = _solve(design, block.altitude, np.full(count, 1.0 / noise**2), spreads)
        left = block.altitude - design[:, :4] @ found[:4]
        noise = max(block.floor_m, 1.4826 * float(np.median(np.abs(block.within(left)))))
    return VerticalScale(float(found[0]), math.sqrt(max(float(spread[0, 0]), 0.0)), FLYING)


@dataclass(frozen=True)
class _Cells:
    """Cells of ground: solved places (N, 3), the model's height, its slopes (N, 2) and the patch of each."""

    places: Array
    model: Array
    slope: Array
    patch: Ints


def _by_terrain(
    block: FlownBlock, points: Array, height: float, terrain: Terrain, absolute: bool, limits: Thresholds
) -> Optional[VerticalScale]:
    """The scale by the elevation model under the block: by its relief, and where asked by heights above it."""
    cells = _cells_of(block, points, height, terrain, limits)
    if cells is None:
        return None
    relief = _against(block, cells, terrain, None, limits)
    level = terrain.level_m if absolute else None
    above = _against(block, cells, terrain, level, limits) if level is not None else None
    return _together(relief, above, MODEL_DISAGREES, limits)


def _against(
    block: FlownBlock, cells: _Cells, terrain: Terrain, level: Optional[Tuple[float, float]], limits: Thresholds
) -> VerticalScale:
    """The scale by relief, or with the ``level`` of the two height systems by the cameras' heights above the model.

    Cameras level the ground only: their own ups and downs inside a flight are
    taken as solved, and speak in ``_by_flying`` where they are large. So is the
    relief where heights above the ground are asked for.
    """
    cameras, count = len(block.solved), len(cells.places)
    across = np.vstack([block.solved[:, :2], cells.places[:, :2]])
    radius = max(math.sqrt(float(np.percentile((across**2).sum(axis=1), 95))), 1e-6)
    shape = np.column_stack([across / radius, (across**2).sum(axis=1) / radius**2, np.ones(cameras + count)])
    solved = np.concatenate([block.solved[:, 2], cells.places[:, 2]])
    values = np.concatenate([block.altitude, cells.model])
    smooth = solved.copy()
    for members in block.flights:
        smooth[list(members)] = _fitted(shape[list(members)], solved[list(members)])
    ground = np.arange(cameras, cameras + count)
    rest = solved[ground] - _fitted(shape[ground], solved[ground])
    zero, zero_sigma = level or (0.0, FREE_M)
    if level is not None:
        smooth[ground] -= rest
    values = values - (solved - smooth)
    values[:cameras] -= zero
    flights, patches = block.of_flights(), np.eye(int(cells.patch.max()) + 1)[cells.patch]
    lean = [flights[:, [f]] * shape[:cameras, :3] for f in range(flights.shape[1])]
    up = np.column_stack([np.ones(cameras), flights, *lean, block.of_sessions()])
    design = np.zeros((cameras + count, 5 + up.shape[1] + 2 + patches.shape[1]))
    design[:, 0], design[:, 1:5] = smooth, shape
    design[:cameras, 5 : 5 + up.shape[1]] = up
    design[cameras:, 5 + up.shape[1] :] = np.column_stack([cells.slope, patches])
    shift = math.hypot(block.moved_m, terrain.spacing_m / 2.0)
    known = [FREE_M * 1e3] * 5 + [math.hypot(zero_sigma, terrain.sigma_m)]
    known += [block.own_m(f, limits) for f in range(flights.shape[1])]
    known += [min(m, limits.height_sigma_relative_m) for m in block.receiver_m for _ in range(3)]
    known += [*block.session_m(), shift, shift]
    last = len(known)
    # From the scale as it is solved: a first fit of it would follow the roofs.
    found = np.zeros(design.shape[1])
    found[0], noise_up = 1.0, block.floor_m
    found[1:5] = np.linalg.lstsq(shape[ground], values[ground] - smooth[ground], rcond=None)[0]
    for round_ in range(ROUNDS):
        left = values - design[:, :last] @ found[:last]
        common = _medians(left[ground], cells.patch)
        alone = left[ground] - common[cells.patch]
        noise = max(block.floor_m, 1.4826 * float(np.median(np.abs(alone))))
        shared = max(terrain.sigma_m, 1.4826 * float(np.median(np.abs(common - np.median(common)))))
        if round_:
            noise_up = max(block.floor_m, 1.4826 * float(np.median(np.abs(left[:cameras]))))
        # Roofs and trees stand above bare ground, and as heights they would pull the scale: they are left out.
        sure = np.concatenate([np.full(cameras, noise_up**-2), (np.abs(alone) <= _FAR * noise) / noise**2])
        spreads = np.asarray([*known, *[shared] * patches.shape[1]])
        found, spread = _solve(design, values, sure, spreads)
    # Cells of one patch err alike in more than its mean: they count as one group (Liang & Zeger 1986).
    scores = patches.T @ (((values - design @ found) * sure)[ground, None] * design[ground])
    many = patches.shape[1]
    inside = scores.T @ scores * (many / max(many - 1.0, 1.0)) + np.diag(spreads**-2.0)
    inside += design[:cameras].T @ (sure[:cameras, None] * design[:cameras])
    variance = max(float(spread[0, 0]), float((spread @ inside @ spread)[0, 0]))
    if level is None:
        # Errors of solved heights flatten the line by their share in the relief that tilt and bow leave.
        relief = max(1.4826 * float(np.median(np.abs(rest - np.median(rest)))), 1e-6)
        variance += ((noise**2 + shared**2) / relief**2) ** 2 + limits.dem_scale_floor**2
    return VerticalScale(float(found[0]), math.sqrt(max(variance, 0.0)), MODEL)


def _medians(values: Array, patch: Ints) -> Array:
    """Median of the values of each patch."""
    return np.asarray([np.median(values[patch == k]) for k in range(int(patch.max()) + 1)])


def _fitted(design: Array, values: Array) -> Array:
    """The values as least squares explain them."""
    result: Array = design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return result


def _solve(design: Array, values: Array, weight: Array, spreads: Array) -> Tuple[Array, Array]:
    """Least squares with every parameter observed as 0 with its spread; returns them and their covariance."""
    normal = design.T @ (weight[:, None] * design) + np.diag(spreads**-2.0)
    covariance = np.linalg.pinv(normal, hermitian=True)
    return covariance @ (design.T @ (weight * values)), covariance


def _cells_of(
    block: FlownBlock, points: Array, height: float, terrain: Terrain, limits: Thresholds
) -> Optional[_Cells]:
    """Cut the solved points into cells of ground; ``None`` where too few patches of it have some.

    A cell takes the points in the middle of its differences, so that single
    trees and false points do not count.
    """
    told = terrain.at(points / block.plan + block.middle if len(points) else points)
    good = np.isfinite(told).all(axis=1) if len(points) else np.zeros(0, dtype=bool)
    points, told = points[good], told[good]
    if not len(points):
        return None
    model = told[:, 0] - block.middle[2]
    extent = float(np.ptp(points[:, :2], axis=0).max())
    side = max(terrain.spacing_m, height / 20.0, extent / _CELLS, 1e-6)
    reach = max(limits.dem_error_cells * terrain.spacing_m, limits.dem_error_height * height, extent / _PATCHES)
    home = np.floor(points[:, :2] / side).astype(np.int64)
    _, number = np.unique(home, axis=0, return_inverse=True)
    number = number.reshape(-1)
    order = np.argsort(number, kind="stable")
    places, heights, slopes = [], [], []
    for members in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        away = points[members, 2] - model[members]
        away = np.abs(away - np.median(away))
        near = members[away <= max(1.5 * float(np.median(away)), 1e-9)]
        places.append(points[near].mean(axis=0))
        heights.append(float(model[near].mean()))
        slopes.append(told[near, 1:].mean(axis=0))
    at = np.asarray(places)
    _, patch = np.unique(np.floor(at[:, :2] / reach).astype(np.int64), axis=0, return_inverse=True)
    patch = patch.reshape(-1)
    if int(patch.max()) + 1 < limits.dem_min_patches:
        return None
    return _Cells(at, np.asarray(heights), np.asarray(slopes), patch.astype(np.int64))
