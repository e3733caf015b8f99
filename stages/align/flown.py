"""Cameras of one solved model in metres, with what was measured of them: plan, altitudes, flights, sessions (pure)."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..thresholds import Thresholds
from .fit import Similarity
from .model import AlignFrame
from .solution import Array, Solution
from .world import Ground, Rows

ROUNDS = 8
# Wider than any altitude: such a term is free.
FREE_M = 1e4


@dataclass(frozen=True)
class FlownBlock:
    """Cameras of one model in metres, about their middle and under the plan's scale, with what was measured of them.

    ``plan_sigma`` is the standard error of that scale as a ratio, ``moved_m``
    the spread of the positions' own place, ``flights`` the places of each
    flight's cameras, ``sessions`` the flights that count from one zero.
    """

    solved: Array
    altitude: Array
    plan: float
    middle: Array
    plan_sigma: float
    moved_m: float
    flights: Tuple[Tuple[int, ...], ...]
    sessions: Tuple[Tuple[int, ...], ...]
    receiver_m: Tuple[float, ...]
    free: Tuple[bool, ...]
    floor_m: float

    @classmethod
    def of(
        cls,
        frames: Sequence[AlignFrame],
        solution: Solution,
        ground: Ground,
        rows: Rows,
        fit: Similarity,
        limits: Thresholds,
    ) -> Optional["FlownBlock"]:
        """Cameras of ``rows`` laid by ``fit``; ``None`` where their positions give the plan no scale."""
        solved = fit.points(solution.center[rows])
        measured = ground.east_north_up[rows]
        flights = _by_flight(frames, rows)
        plain = [_receiver(frames[int(r)], limits) for r in rows]
        horizontal = float(np.median([h for h, _ in plain]))
        plan, sigma = _horizontal_scale(solved, measured, len(flights), min(horizontal, limits.gps_drift_m), limits)
        if plan <= 0:
            return None
        middle = np.median(solved, axis=0)
        return cls(
            solved=(solved - middle) * plan,
            altitude=measured[:, 2] - middle[2],
            plan=plan,
            middle=middle,
            plan_sigma=sigma,
            moved_m=horizontal,
            flights=tuple(tuple(members) for members in flights),
            sessions=tuple(tuple(s) for s in _sessions(frames, rows, flights, limits)),
            receiver_m=tuple(float(np.median([plain[i][1] for i in members])) for members in flights),
            free=tuple(any(frames[int(rows[i])].flight in ground.offsets for i in members) for members in flights),
            floor_m=limits.rtk_sigma_floor_m,
        )

    def laid(self, points: Array) -> Array:
        """Points of the similarity's frame in this one."""
        result: Array = (points - self.middle) * self.plan
        return result

    def own_m(self, flight: int, limits: Thresholds) -> float:
        """Spread of what a flight's altitudes have in common beyond its session."""
        return FREE_M if self.free[flight] else min(self.receiver_m[flight], limits.height_sigma_relative_m)

    def within(self, left: Array) -> Array:
        """Residuals without each flight's median."""
        return np.concatenate([left[list(members)] - np.median(left[list(members)]) for members in self.flights])

    def of_flights(self) -> Array:
        """One column per flight, 1 for its cameras, shape (N, flights)."""
        columns = np.zeros((len(self.solved), len(self.flights)))
        for number, members in enumerate(self.flights):
            columns[list(members), number] = 1.0
        return columns

    def of_sessions(self) -> Array:
        """One column per session, 1 for the cameras of its flights."""
        flights = self.of_flights()
        return np.stack([flights[:, list(s)].sum(axis=1) for s in self.sessions], axis=1)

    def session_m(self) -> List[float]:
        """Spread of each session's zero."""
        return [float(np.median([self.receiver_m[f] for f in s])) for s in self.sessions]


def _horizontal_scale(
    solved: Array, measured: Array, flights: int, drift_m: float, limits: Thresholds
) -> Tuple[float, float]:
    """Scale of the plan by its positions, and its standard error, both as ratios.

    Besides its noise a receiver drifts over a flight, which no number of
    frames averages away: along two axes, by ``drift_m`` at the block's radius.
    """
    source, target = solved[:, 0] + 1j * solved[:, 1], measured[:, 0] + 1j * measured[:, 1]
    weight = np.ones(len(source))
    turn, reach, miss = complex(1.0), 0.0, np.zeros(len(source))
    for _ in range(ROUNDS):
        a = source - np.average(source, weights=weight)
        b = target - np.average(target, weights=weight)
        reach = float((weight * np.abs(a) ** 2).sum())
        if reach <= 0:
            return 0.0, math.inf
        turn = complex((weight * b * np.conj(a)).sum() / reach)
        miss = np.abs(b - turn * a)
        scale = max(1.4826 * float(np.median(miss)), 1e-9)
        weight = np.minimum(1.0, 1.5 * scale / np.maximum(miss, 1e-12))
    # Per axis: a plane residual has two.
    noise = max(limits.rtk_sigma_floor_m, float(np.sqrt(np.average(miss**2, weights=weight) / 2.0)))
    radius = math.sqrt(float(np.percentile(np.abs(turn * source - turn * np.mean(source)) ** 2, 95)))
    slow = drift_m / (radius * math.sqrt(2.0 * flights)) if radius > 0 else math.inf
    return abs(turn), math.hypot(noise / (abs(turn) * math.sqrt(reach)), slow)


def _receiver(frame: AlignFrame, limits: Thresholds) -> Tuple[float, float]:
    """Spread of a frame's position, horizontal and vertical, m."""
    flat, up = frame.sigma_m or (limits.gps_sigma_horizontal_m, limits.gps_sigma_vertical_m)
    return max(limits.rtk_sigma_floor_m, flat), max(limits.rtk_sigma_floor_m, up)


def _by_flight(frames: Sequence[AlignFrame], rows: Rows) -> List[List[int]]:
    """Places in ``rows`` of each flight's frames."""
    found: Dict[str, List[int]] = defaultdict(list)
    for place, row in enumerate(rows.tolist()):
        found[frames[row].flight].append(place)
    return [found[name] for name in sorted(found)]


def _sessions(
    frames: Sequence[AlignFrame], rows: Rows, flights: Sequence[Sequence[int]], limits: Thresholds
) -> List[List[int]]:
    """Flights of one profile that follow each other without a pause: one start of the drone, one zero."""
    spans: List[Tuple[str, float, float, int]] = []
    result: List[List[int]] = []
    for number, members in enumerate(flights):
        times = [t for t in (frames[int(rows[i])].time_s for i in members) if t is not None]
        if times:
            spans.append((frames[int(rows[members[0]])].profile, min(times), max(times), number))
        else:
            result.append([number])
    last: Optional[Tuple[str, float]] = None
    for profile, begin, end, number in sorted(spans):
        if last is not None and last[0] == profile and begin - last[1] <= limits.flight_gap_s:
            result[-1].append(number)
            last = (profile, max(last[1], end))
        else:
            result.append([number])
            last = (profile, end)
    return result
