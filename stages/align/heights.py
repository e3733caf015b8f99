"""Flights of a solved block whose altitudes count from another zero than its other ones (pure)."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import Dict, List, Mapping, Sequence

import numpy as np

from ..thresholds import Thresholds
from .fit import Similarity, collinear, residual_fit, robust_similarity
from .model import AlignFrame
from .solution import UNPLACED, Array, Solution
from .world import Ground, Rows, fit_rows, rows_of

_ROUNDS = 10


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
