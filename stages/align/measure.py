"""What a laid solution shows of each payload: the figures that the verdict is made of (pure)."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..thresholds import Thresholds
from .control import NO_CONTROL, Controlled
from .fit import Similarity, bowing, collinear, height_above_ground, residual_fit
from .heights import offsets_of
from .model import AlignFrame, Bowing, ControlFit, GpsFit
from .solution import UNPLACED, Array, Solution
from .world import Ground, Rows, choose_anchor, fit_rows, laid_centers, laid_points, lay_models, looks_down, rows_of

Laid = Tuple[Tuple[Optional[Similarity], str], ...]


@dataclass(frozen=True)
class PayloadFigures:
    """Everything measured of one payload; ``None`` where it could not be.

    ``offset_m`` is the median of its residual together, measured minus solved, ``scatter`` what is
    left of the residual once that is taken off: a GPS offset leaves little.
    ``flight_offsets_m`` are flights whose altitudes were shifted to the others'.
    ``strong_cross`` counts pairs with other payloads of at least the required
    inliers.
    """

    payload: str
    frames: int
    registered: int
    in_main: int
    mean_reproj_error_px: Optional[float]
    worst_profile_px: Optional[float]
    together: GpsFit
    alone: GpsFit
    offset_m: Optional[Tuple[float, float, float]]
    scatter: GpsFit
    height_m: Optional[float]
    flown_height_m: Optional[float]
    relief_m: Optional[float]
    bowing: Bowing
    own_inliers: Optional[int]
    cross_pairs: int
    cross_inliers: Optional[int]
    strong_cross: int
    shares_model: bool
    capture_gap_m: Optional[Tuple[float, float]]
    capture_gap_limit_m: Optional[Tuple[float, float]]
    looks_down: Optional[float]
    positions: int
    self_fitted: bool
    control: Optional[ControlFit] = None
    flight_offsets_m: Tuple[Tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Measured:
    """All figures of a solution."""

    anchor: Optional[str]
    laid: Laid
    centers: Array
    components: int
    areas: int
    payloads: Tuple[PayloadFigures, ...]
    control: Optional[ControlFit] = None


def main_models(solution: Solution, areas: Sequence[int]) -> Dict[int, int]:
    """Return area -> the model that holds most of its frames (ties to the lower number)."""
    counts: Dict[int, Dict[int, int]] = defaultdict(lambda: defaultdict(int))
    for index, area in enumerate(areas):
        if solution.model[index] != UNPLACED:
            counts[max(area, 0)][int(solution.model[index])] += 1
    return {area: min(found, key=lambda m: (-found[m], m)) for area, found in counts.items()}


def measure(
    frames: Sequence[AlignFrame],
    solution: Solution,
    ground: Ground,
    areas: Sequence[int],
    limits: Thresholds,
    control: Controlled = NO_CONTROL,
) -> Measured:
    """Measure every payload of ``frames`` in ``solution``; ``areas`` is each frame's piece of ground."""
    anchor = choose_anchor(frames, solution, ground, limits)
    laid = lay_models(frames, solution, ground, anchor, limits, control.laid)
    centers = laid_centers(solution, laid)
    main = main_models(solution, areas)
    gaps = _capture_gaps(frames, solution, centers, limits)
    names = sorted({f.payload for f in frames})
    return Measured(
        anchor=anchor,
        laid=laid,
        centers=centers,
        components=solution.models,
        areas=len({max(a, 0) for a in areas}) or 1,
        payloads=tuple(
            _payload(name, frames, solution, ground, areas, limits, laid, centers, main, gaps, len(names), control)
            for name in names
        ),
        control=_with_offset(control, laid, ground, main),
    )


def _with_offset(control: Controlled, laid: Laid, ground: Ground, main: Dict[int, int]) -> Optional[ControlFit]:
    """The control's figures with how far GPS puts the cameras from where control does."""
    fit = control.fit
    for model in sorted(set(main.values())):
        there = laid[model][0]
        if fit is not None and model in control.laid and there is not None and ground.known.any():
            gap = there.translation - control.laid[model].translation
            return replace(
                fit, gps_offset_m=(round(float(gap[0]), 3), round(float(gap[1]), 3), round(float(gap[2]), 3))
            )
    return fit


def _payload(
    name: str,
    frames: Sequence[AlignFrame],
    solution: Solution,
    ground: Ground,
    areas: Sequence[int],
    limits: Thresholds,
    laid: Laid,
    centers: Array,
    main: Dict[int, int],
    gaps: Dict[str, Tuple[Tuple[float, float], Tuple[float, float]]],
    payloads: int,
    control: Controlled,
) -> PayloadFigures:
    mine = np.asarray([i for i, f in enumerate(frames) if f.payload == name], dtype=np.int64)
    placed = mine[solution.model[mine] != UNPLACED]
    inside = np.asarray([i for i in placed if main.get(max(areas[i], 0)) == solution.model[i]], dtype=np.int64)
    sigma = _sigma(ground, mine, limits)
    carriers = {laid[int(m)][1] for m in set(solution.model[inside].tolist())}
    together_sigma = sigma
    for carrier in sorted(carriers - {"", name}):
        rows = np.asarray([i for i, f in enumerate(frames) if f.payload == carrier], dtype=np.int64)
        other = _sigma(ground, rows, limits)
        together_sigma = (max(together_sigma[0], other[0]), max(together_sigma[1], other[1]))
    residual, alone_residual, alone_rows, line = _residuals(name, frames, solution, ground, inside, centers, limits)
    vertical = bool(len(inside)) and bool(ground.vertical[inside].all())
    self_fitted = carriers <= {"", name}
    together = residual_fit(residual, together_sigma, len(residual) if self_fitted else 0, line, vertical)
    alone = residual_fit(alone_residual, sigma, alone_rows, line, vertical)
    offset = None
    scatter = GpsFit(0)
    if len(residual):
        middle = np.median(residual, axis=0)
        offset = (round(-float(middle[0]), 3), round(-float(middle[1]), 3), round(-float(middle[2]), 3))
        scatter = residual_fit(residual - middle, together_sigma, 0, line, vertical)
    cross, strong, own, tied = _inliers(name, frames, solution, limits)
    height, relief = _height(solution, laid, centers, inside)
    flown = [f for f in (frames[i].height_m for i in mine) if f is not None]
    known = inside[ground.known[inside] & np.isfinite(centers[inside, 0])] if len(inside) else inside
    bow = Bowing()
    if len(known) and vertical:
        bow = bowing(centers[known], ground.east_north_up[known], [frames[i].flight for i in known])
    proof = control.payloads.get(name)
    if bow.bowing_m is None and proof is not None:
        bow = proof.bowing
    profiles = sorted({frames[i].profile for i in placed})
    errors = [_mean_error(solution, placed[[frames[i].profile == p for i in placed]]) for p in profiles]
    gap = gaps.get(name)
    return PayloadFigures(
        payload=name,
        frames=len(mine),
        registered=len(placed),
        in_main=len(inside),
        mean_reproj_error_px=_mean_error(solution, placed),
        worst_profile_px=max((math.inf if e is None else e for e in errors), default=None),
        together=together,
        alone=alone,
        offset_m=offset,
        scatter=scatter,
        height_m=height,
        flown_height_m=round(float(np.median(flown)), 3) if flown else None,
        relief_m=relief,
        bowing=bow,
        own_inliers=own,
        cross_pairs=len(cross),
        cross_inliers=int(np.median(cross)) if cross else None,
        strong_cross=strong,
        shares_model=payloads == 1 or tied,
        capture_gap_m=gap[0] if gap else None,
        capture_gap_limit_m=gap[1] if gap else None,
        looks_down=looks_down(solution, laid, placed),
        positions=int(ground.known[mine].sum()),
        self_fitted=self_fitted,
        control=proof,
        flight_offsets_m=tuple(offsets_of(frames, solution, ground, name).items()),
    )


def _sigma(ground: Ground, rows: Rows, limits: Thresholds) -> Tuple[float, float]:
    if not len(rows):
        return limits.gps_sigma_horizontal_m, limits.gps_sigma_vertical_m
    floor = limits.rtk_sigma_floor_m
    # As residuals are taken: with RTK on some of the frames only, the others' share of the misfit stays theirs.
    spread = np.sqrt(np.mean(ground.sigma[rows] ** 2, axis=0))
    return max(floor, float(spread[0])), max(floor, float(spread[1]))


def _residuals(
    name: str,
    frames: Sequence[AlignFrame],
    solution: Solution,
    ground: Ground,
    inside: Rows,
    centers: Array,
    limits: Thresholds,
) -> Tuple[Array, Array, int, bool]:
    """Residual rows together and alone, the number of centres fitted alone, and whether all of it is one line.

    A payload in several models is fitted alone in each and the rows pooled.
    """
    together: List[Array] = []
    alone: List[Array] = []
    fitted = 0
    straight = True
    for model in sorted({int(m) for m in solution.model[inside]}):
        rows = rows_of(frames, solution, model, name)
        rows = rows[np.isin(rows, inside)]
        rows = rows[ground.known[rows]]
        if not len(rows):
            continue
        shown = rows[np.isfinite(centers[rows, 0])]
        together.append(centers[shown] - ground.east_north_up[shown])
        if len(rows) >= limits.min_proof_frames:
            fit = fit_rows(solution, ground, rows)
            if fit is not None:
                alone.append(fit.points(solution.center[rows]) - ground.east_north_up[rows])
                fitted += len(rows)
                straight = straight and collinear(solution.center[rows], limits.collinear_ratio)
    empty = np.zeros((0, 3))
    line = straight if fitted else False
    return (
        np.concatenate(together) if together else empty,
        np.concatenate(alone) if alone else empty,
        fitted,
        line,
    )


def _inliers(
    name: str, frames: Sequence[AlignFrame], solution: Solution, limits: Thresholds
) -> Tuple[List[int], int, Optional[int], bool]:
    cross: List[int] = []
    own: List[int] = []
    tied = False
    for a, b, inliers in solution.pairs.tolist():
        first, second = frames[a].payload, frames[b].payload
        if name not in (first, second) or inliers <= 0:
            continue
        if first == second:
            own.append(inliers)
        else:
            cross.append(inliers)
            same = solution.model[a] != UNPLACED and solution.model[a] == solution.model[b]
            tied = tied or (same and inliers >= limits.min_inliers)
    strong = sum(1 for n in cross if n >= limits.min_inliers)
    return cross, strong, int(np.median(own)) if own else None, tied


def _height(solution: Solution, laid: Laid, centers: Array, inside: Rows) -> Tuple[Optional[float], Optional[float]]:
    found = []
    for model in sorted({int(m) for m in solution.model[inside]}):
        rows = inside[solution.model[inside] == model]
        height, relief = height_above_ground(centers[rows], laid_points(solution, laid, model))
        if height is not None and relief is not None:
            found.append((len(rows), height, relief))
    if not found:
        return None, None
    best = max(found)
    return best[1], best[2]


def _mean_error(solution: Solution, rows: Rows) -> Optional[float]:
    """Mean over observations, ``None`` without any."""
    if not len(rows):
        return None
    weight = solution.observations[rows].astype(float)
    good = np.isfinite(solution.error_px[rows]) & (weight > 0)
    if not good.any():
        return None
    return round(float(np.average(solution.error_px[rows][good], weights=weight[good])), 4)


def _capture_gaps(
    frames: Sequence[AlignFrame], solution: Solution, centers: Array, limits: Thresholds
) -> Dict[str, Tuple[Tuple[float, float], Tuple[float, float]]]:
    """Payload -> median gap between its centres and those of the same captures' other payloads, and its limit.

    The limit is lever arm + speed * (time difference + readout) + 1 m
    horizontally, and 3 % of the height vertically (never below 1 m).
    """
    groups: Dict[str, List[int]] = defaultdict(list)
    for index, frame in enumerate(frames):
        if frame.capture and np.isfinite(centers[index, 0]):
            groups[frame.capture].append(index)
    speed = _speeds(frames, centers)
    found: Dict[str, List[Tuple[float, float, float, float]]] = defaultdict(list)
    for capture in sorted(groups):
        members = groups[capture]
        for a in members:
            for b in members:
                if frames[a].payload == frames[b].payload or solution.model[a] != solution.model[b]:
                    continue
                gap = centers[a] - centers[b]
                first, second = frames[a].time_s, frames[b].time_s
                late = abs(first - second) if first is not None and second is not None else 0.0
                # Clocks of two cameras may disagree by hours; one trigger does not take longer than this.
                late = min(late, limits.capture_time_s)
                motion = speed.get(frames[a].flight, 0.0) * (late + limits.capture_readout_s)
                height = frames[a].height_m or 0.0
                found[frames[a].payload].append(
                    (
                        float(np.hypot(gap[0], gap[1])),
                        abs(float(gap[2])),
                        limits.lever_arm_m + motion + limits.capture_gap_base_m,
                        max(limits.capture_gap_base_m, limits.capture_gap_vertical * height),
                    )
                )
    result = {}
    for payload, rows in found.items():
        middle = np.median(np.asarray(rows), axis=0)
        result[payload] = (
            (round(float(middle[0]), 3), round(float(middle[1]), 3)),
            (round(float(middle[2]), 3), round(float(middle[3]), 3)),
        )
    return result


def _speeds(frames: Sequence[AlignFrame], centers: Array) -> Dict[str, float]:
    """Flight -> median speed over ground of its laid centres, m/s."""
    by_flight: Dict[str, List[Tuple[float, int]]] = defaultdict(list)
    for index, frame in enumerate(frames):
        if frame.time_s is not None and np.isfinite(centers[index, 0]):
            by_flight[frame.flight].append((frame.time_s, index))
    result = {}
    for flight, rows in by_flight.items():
        rows.sort()
        found = [
            float(np.hypot(*(centers[j] - centers[i])[:2])) / (t2 - t1)
            for (t1, i), (t2, j) in zip(rows, rows[1:])
            if 0.05 < t2 - t1 < 60.0
        ]
        if found:
            result[flight] = float(np.median(found))
    return result
