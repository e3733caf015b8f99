"""An elevation model's ground around a block, on a square grid in the frame of the positions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np

from ..elevation import open_elevation
from ..geo import metres_per_degree
from ..thresholds import Thresholds
from .enu import enu
from .model import AlignFrame, AlignRequest
from .solution import Array


@dataclass(frozen=True)
class Terrain:
    """Ground heights ``up_m`` (rows, columns), NaN over voids; the first node lies at ``west_m``, ``south_m``.

    ``spacing_m`` is the distance of the model's own cells, ``sigma_m`` the
    spread of its heights. ``level_m`` is how far the positions' zero lies
    above the model's, and its spread: ``None`` where nothing measured it.
    """

    west_m: float
    south_m: float
    step_m: float
    up_m: Array
    spacing_m: float
    sigma_m: float
    level_m: Optional[Tuple[float, float]] = None

    def at(self, places: Array) -> Array:
        """Return height, and slope to the east and to the north, at rows of east, north; NaN where unknown."""
        rows, columns = self.up_m.shape
        x = (places[:, 0] - self.west_m) / self.step_m
        y = (places[:, 1] - self.south_m) / self.step_m
        inside = (x >= 0) & (x <= columns - 1) & (y >= 0) & (y <= rows - 1)
        left = np.clip(np.floor(np.where(inside, x, 0.0)).astype(int), 0, columns - 2)
        low = np.clip(np.floor(np.where(inside, y, 0.0)).astype(int), 0, rows - 2)
        fx, fy = x - left, y - low
        a, b = self.up_m[low, left], self.up_m[low, left + 1]
        c, d = self.up_m[low + 1, left], self.up_m[low + 1, left + 1]
        height = (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
        east = ((b - a) * (1 - fy) + (d - c) * fy) / self.step_m
        north = ((c - a) * (1 - fx) + (d - b) * fx) / self.step_m
        result: Array = np.where(inside[:, None], np.stack([height, east, north], axis=1), np.nan)
        return result


def terrain_of(request: AlignRequest, origin: Optional[Sequence[float]], limits: Thresholds) -> Optional[Terrain]:
    """Read the request's elevation model around its positions; ``origin`` is the zero of their local frame.

    ``None`` without a model, without positions, or where it has no ground
    under them. Raises what ``open_elevation`` does.
    """
    placed = [f for f in request.frames if f.position is not None]
    if not request.elevation or not placed or origin is None:
        return None
    zero = np.asarray(origin, dtype=float)
    places = enu(np.asarray([f.position for f in placed], dtype=float), zero)
    reach = _reach_m(placed, limits)
    low, high = places[:, :2].min(axis=0) - reach, places[:, :2].max(axis=0) + reach
    model = open_elevation(request.elevation, limits)
    spacing = model.spacing_m((float(zero[0]), float(zero[1])))
    if spacing is None:
        return None
    step = max(spacing, float((high - low).max()) / limits.dem_grid_nodes)
    columns, rows = (math.ceil(v) + 2 for v in ((high - low) / step).tolist())
    east, north = np.meshgrid(low[0] + step * np.arange(columns), low[1] + step * np.arange(rows))
    degrees = _degrees(east.ravel(), north.ravel(), zero)
    told = model.sample([(float(a), float(b)) for a, b in degrees])
    height = np.asarray([math.nan if h is None else h for h in told], dtype=float)
    if not np.isfinite(height).any():
        return None
    up = enu(np.column_stack([degrees, np.nan_to_num(height)]), zero)[:, 2]
    return Terrain(
        west_m=float(low[0]),
        south_m=float(low[1]),
        step_m=step,
        up_m=np.where(np.isfinite(height), up, np.nan).reshape(rows, columns),
        spacing_m=spacing,
        sigma_m=max(limits.dem_sigma_floor_m, limits.dem_sigma_share * spacing),
        level_m=request.elevation_level_m,
    )


def _reach_m(frames: Sequence[AlignFrame], limits: Thresholds) -> float:
    """How far from their positions the frames see ground: the height, as wide angles reach half of it to a side."""
    heights = [f.height_m for f in frames if f.height_m is not None and f.height_m > 0]
    return float(np.median(heights)) if heights else limits.unknown_footprint_m


def _degrees(east: Array, north: Array, origin: Array) -> Array:
    """Latitude and longitude of places on the level plane through ``origin``, by Newton steps on ``enu``."""
    per_north, per_east = metres_per_degree(float(origin[0]))
    wanted = np.stack([east, north], axis=1)
    found = np.stack([origin[0] + north / per_north, origin[1] + east / per_east], axis=1)
    for _ in range(3):
        miss = wanted - enu(np.column_stack([found, np.full(len(found), origin[2])]), origin)[:, :2]
        found += np.stack([miss[:, 1] / per_north, miss[:, 0] / per_east], axis=1)
    result: Array = found
    return result
