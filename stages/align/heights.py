"""What measured altitudes say of a solved block's vertical: its scale, and flights that count from another zero (pure).

On views straight down, heights and the focal may be scaled together without
any image changing: heights alone fix no focal, measured differences of
height do. Only differences count, because a receiver's altitudes are off as
a whole from flight to flight.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from ..thresholds import Thresholds
from .fit import Similarity, collinear, height_above_ground, residual_fit, robust_similarity
from .model import AlignFrame
from .solution import UNPLACED, Array, Solution
from .world import Ground, Rows, fit_rows, rows_of

_ROUNDS = 10
# Wider than any altitude: such an offset is free.
_FREE_M = 1e4


@dataclass(frozen=True)
class VerticalScale:
    """Measured over solved differences of height, under the horizontal scale of GPS, with its standard error."""

    ratio: float
    sigma: float


def vertical_scale(
    frames: Sequence[AlignFrame], solution: Solution, ground: Ground, rows: Rows, limits: Thresholds
) -> Optional[VerticalScale]:
    """Compare solved with measured differences of height among frames of one model.

    ``None`` where the heights spread by less than ``two_heights_ratio``. A
    flight's altitudes share an error of their receiver's spread; two flights
    of one session, counted from one zero, that of a barometer.
    """
    rows = rows[ground.known[rows] & ground.vertical[rows]]
    fit = fit_rows(solution, ground, rows) if len(rows) >= limits.min_proof_frames else None
    if fit is None:
        return None
    solved = fit.points(solution.center[rows])
    measured = ground.east_north_up[rows]
    points = fit.points(solution.point_xyz[solution.point_model == solution.model[rows[0]]])
    height, _ = height_above_ground(solved, points)
    low, high = np.percentile(solved[:, 2], [5, 95])
    if height is None or height <= 0 or high - low < limits.two_heights_ratio * height:
        return None
    flat, flat_sigma = _horizontal_scale(solved, measured, limits)
    if flat <= 0:
        return None
    shared = _shared(frames, ground, rows, limits)
    away = (solved - np.median(solved, axis=0)) * flat
    design = np.stack([away[:, 2], away[:, 0], away[:, 1], np.ones(len(rows))], axis=1)
    noise = limits.rtk_sigma_floor_m
    values = measured[:, 2] - float(np.median(measured[:, 2]))
    found, spread = np.zeros(4), np.zeros((4, 4))
    for _ in range(_ROUNDS):
        weight = np.linalg.inv(shared + noise**2 * np.eye(len(rows)))
        spread = np.linalg.pinv(design.T @ weight @ design)
        found = spread @ design.T @ weight @ values
        left = values - design @ found
        within = np.concatenate([left[members] - np.median(left[members]) for members in _by_flight(frames, rows)])
        noise = max(limits.rtk_sigma_floor_m, 1.4826 * float(np.median(np.abs(within))))
    ratio, sigma = float(found[0]), math.sqrt(max(float(spread[0, 0]), 0.0))
    if not (math.isfinite(ratio) and math.isfinite(sigma)):
        return None
    return VerticalScale(round(ratio, 5), round(math.hypot(sigma, flat_sigma), 5))


def _horizontal_scale(solved: Array, measured: Array, limits: Thresholds) -> Tuple[float, float]:
    """Scale of the plan by its positions, and its standard error, both as ratios."""
    source, target = solved[:, 0] + 1j * solved[:, 1], measured[:, 0] + 1j * measured[:, 1]
    weight = np.ones(len(source))
    turn, reach, miss = complex(1.0), 0.0, np.zeros(len(source))
    for _ in range(_ROUNDS):
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
    return abs(turn), noise / (abs(turn) * math.sqrt(reach))


def _by_flight(frames: Sequence[AlignFrame], rows: Rows) -> List[List[int]]:
    """Places in ``rows`` of each flight's frames."""
    found: Dict[str, List[int]] = defaultdict(list)
    for place, row in enumerate(rows.tolist()):
        found[frames[row].flight].append(place)
    return [found[name] for name in sorted(found)]


def _shared(frames: Sequence[AlignFrame], ground: Ground, rows: Rows, limits: Thresholds) -> Array:
    """Covariance of the altitude errors that frames have in common, m^2, shape (N, N)."""
    count = len(rows)
    result = np.zeros((count, count))
    flights = _by_flight(frames, rows)
    for members in flights:
        receiver = float(np.median([_receiver_m(frames[int(rows[i])], limits) for i in members]))
        free = any(frames[int(rows[i])].flight in ground.offsets for i in members)
        own = _FREE_M if free else min(receiver, limits.height_sigma_relative_m)
        result[np.ix_(members, members)] += own**2
    for session in _sessions(frames, rows, flights, limits):
        members = [i for flight in session for i in flights[flight]]
        receiver = float(np.median([_receiver_m(frames[int(rows[i])], limits) for i in members]))
        result[np.ix_(members, members)] += receiver**2
    return result


def _receiver_m(frame: AlignFrame, limits: Thresholds) -> float:
    return max(limits.rtk_sigma_floor_m, frame.sigma_m[1] if frame.sigma_m else limits.gps_sigma_vertical_m)


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


def levelled(frames: Sequence[AlignFrame], solution: Solution, ground: Ground, limits: Thresholds) -> Ground:
    """Take off the altitude by which whole flights of a payload lie above or below its largest one.

    Called only where the flight has frames enough, fits once it is shifted,
    and the shift is more than the receivers, a wrong focal or a take-off
    from other ground explain. ``Ground.offsets`` has what was taken off.
    """
    places, offsets = ground.east_north_up.copy(), dict(ground.offsets)
    for payload in sorted({f.payload for f in frames}):
        for model in range(solution.models):
            rows = rows_of(frames, solution, model, payload)
            rows = rows[ground.known[rows] & ground.vertical[rows]] if len(rows) else rows
            for flight, shift in _shifts(frames, solution, ground, rows, limits).items():
                members = [r for r in rows.tolist() if frames[r].flight == flight]
                places[members, 2] -= shift
                offsets[flight] = round(shift, 2)
    return replace(ground, east_north_up=places, offsets=offsets) if offsets != dict(ground.offsets) else ground


def _shifts(
    frames: Sequence[AlignFrame], solution: Solution, ground: Ground, rows: Rows, limits: Thresholds
) -> Mapping[str, float]:
    """Flight -> metres that its altitudes lie above those of the largest flight among ``rows``."""
    found: Dict[str, List[int]] = defaultdict(list)
    for row in rows.tolist():
        found[frames[row].flight].append(row)
    flights = {name: np.asarray(r, dtype=np.int64) for name, r in found.items() if len(r) >= limits.min_proof_frames}
    order = sorted(flights, key=lambda f: (-len(flights[f]), f))
    base = next((f for f in order if not collinear(solution.center[flights[f]], limits.collinear_ratio)), None)
    if base is None or len(order) < 2:
        return {}
    inside = np.concatenate([flights[f] for f in order])
    fit = fit_rows(solution, ground, flights[base])
    shift = dict.fromkeys(order, 0.0)
    for _ in range(_ROUNDS):
        if fit is None:
            return {}
        up = {f: _above(fit, solution, ground, flights[f])[:, 2] for f in order}
        zero = float(np.median(up[base]))
        shift = {f: float(np.median(up[f])) - zero for f in order}
        target = ground.east_north_up[inside].copy()
        target[:, 2] -= np.concatenate([np.full(len(flights[f]), shift[f]) for f in order])
        spread = float(np.median(np.hypot(ground.sigma[inside, 0], ground.sigma[inside, 1])))
        fit = robust_similarity(solution.center[inside], target, spread)
    return {
        f: shift[f]
        for f in order
        if f != base and fit is not None and _rigid(fit, solution, ground, flights[base], flights[f], shift[f], limits)
    }


def _above(fit: Similarity, solution: Solution, ground: Ground, rows: Rows) -> Array:
    """Measured minus solved places."""
    result: Array = ground.east_north_up[rows] - fit.points(solution.center[rows])
    return result


def _rigid(
    fit: Similarity, solution: Solution, ground: Ground, base: Rows, rows: Rows, shift: float, limits: Thresholds
) -> bool:
    """Whether a flight fits its positions once it is shifted, and not before, and nothing else explains the shift."""
    sigma = (
        float(np.median(ground.sigma[rows, 0])),
        max(float(np.median(ground.sigma[rows, 1])), float(np.median(ground.sigma[base, 1]))),
    )
    climb = float(
        np.median(fit.points(solution.center[rows])[:, 2]) - np.median(fit.points(solution.center[base])[:, 2])
    )
    least = max(limits.gps_sigma_factor * sigma[1], limits.altitude_bias_m, limits.flight_offset_share * abs(climb))
    if abs(shift) <= least:
        return False
    miss = _above(fit, solution, ground, rows)
    miss[:, 2] -= np.median(miss[:, 2])
    left = residual_fit(miss, sigma, 0, False)
    return (
        left.horizontal_m is not None
        and left.vertical_m is not None
        and left.horizontal_m <= limits.gps_sigma_factor * sigma[0]
        and left.vertical_m <= limits.gps_sigma_factor * sigma[1]
    )


def offsets_of(frames: Sequence[AlignFrame], solution: Solution, ground: Ground, payload: str) -> Mapping[str, float]:
    """The offsets that were taken off flights of one payload, by flight."""
    flights = {f.flight for i, f in enumerate(frames) if f.payload == payload and solution.model[i] != UNPLACED}
    return {f: ground.offsets[f] for f in sorted(flights & set(ground.offsets))}
