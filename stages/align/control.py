"""Ground control marks in a solved model: intersected, laid on their coordinates, and what they say (pure).

Points with coordinates are the one thing in a survey that neither the camera
nor its GPS had a hand in. The free network's similarity to them proves or
contradicts a model; what proves it is then held in an adjustment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from ..geo import hull_area_m2
from ..thresholds import Thresholds
from .fit import Similarity, bowing, collinear, height_above_ground, residual_fit, robust_similarity, umeyama
from .model import AlignRequest, Bowing, ControlFit, ControlResidual, GcpMark
from .sights import MIN_RAYS, astray, intersect, working_pixel
from .solution import UNPLACED, Array, HeldPoint, Hold, Job, Solution
from .world import Ground, choose_anchor, fit_rows, rows_of, shifted

PASS, FAIL, UNPROVEN = "pass", "fail", "unproven"

_MIN_POINTS = 3
_CLOSE = 0.1


@dataclass(frozen=True)
class Lay:
    """One model on its ground points: the similarity to metres, and what it says. ``fit.points`` counts them.

    ``similarity`` is ``None`` where too few points are marked, or on one line.
    ``holds`` says that an adjustment may hold the points, but for those ``left_out``
    and the marks (point, path) that are ``astray``.
    """

    model: int
    similarity: Optional[Similarity]
    fit: ControlFit
    holds: bool = False
    left_out: Tuple[str, ...] = ()
    astray: Tuple[Tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Controlled:
    """What ground control says of a solution and of each payload, and the similarities of the models it carries."""

    laid: Mapping[int, Similarity]
    fit: Optional[ControlFit]
    payloads: Mapping[str, ControlFit]


NO_CONTROL = Controlled({}, None, {})


def sound(marks: Sequence[GcpMark], lay: Lay) -> Tuple[GcpMark, ...]:
    """The marks but for those that are astray in the model of ``lay``."""
    return tuple(m for m in marks if (m.point, m.path) not in lay.astray)


def _rms(rows: Array, fitted: int) -> Tuple[float, float]:
    """RMS horizontally and vertically; the seven freedoms of a fit to ``fitted`` points are given back."""
    factor = math.sqrt(3 * fitted / (3 * fitted - 7)) if fitted else 1.0
    flat = math.sqrt(float((rows[:, :2] ** 2).sum(axis=1).mean()))
    return round(factor * flat, 4), round(factor * math.sqrt(float((rows[:, 2] ** 2).mean())), 4)


def _names(marks: Sequence[GcpMark]) -> Dict[str, str]:
    return {m.point: m.name or m.point for m in marks}


def lay_by_control(
    request: AlignRequest, job: Job, solution: Solution, ground: Ground, model: int, limits: Thresholds
) -> Lay:
    """Lay one model on its ground points, check points left aside, and say what they prove.

    A point that the others contradict by more than the limit is an outlier and
    left out, as long as enough are left to say so.
    """
    wrong = astray(request, job, solution, model, limits)
    marks = [m for m in request.gcps if not m.check and (m.point, m.path) not in wrong]
    solved = intersect(request, job, solution, marks, model)
    names = sorted(n for n in solved if n in ground.control)
    called = _names(request.gcps)
    missed = tuple((called[point], path) for point, path in wrong)
    few = Lay(model, None, ControlFit(len(names), text=_few(len(names)), astray=missed), astray=wrong)
    if len(names) < _MIN_POINTS:
        return few
    target = np.asarray([ground.control[n] for n in names])
    if collinear(target, limits.collinear_ratio):
        return replace(few, fit=replace(few.fit, text="its control points lie on one line"))
    source = np.asarray([solved[n][0] for n in names])
    count = np.asarray([solved[n][1] for n in names])
    similarity = robust_similarity(source, target, limits.control_fit_m)
    if similarity is None:
        return few
    limit = _limit(solution, similarity, model, limits)
    kept = np.linalg.norm(similarity.points(source) - target, axis=1) <= limit
    if not kept.all() and kept.sum() > _MIN_POINTS and not collinear(target[kept], limits.collinear_ratio):
        similarity = umeyama(source[kept], target[kept], count[kept].astype(float)) or similarity
    else:
        kept = np.ones(len(names), dtype=bool)
        similarity = umeyama(source, target, count.astype(float)) or similarity
    miss = (similarity.points(source) - target)[kept]
    horizontal, vertical = _rms(miss, int(kept.sum()))
    said = f"{int(kept.sum())} control points fit to {horizontal:.2f} m horizontally, {vertical:.2f} m vertically"
    strong = int((count[kept] >= limits.gcp_min_images).sum())
    fit = ControlFit(
        points=int(kept.sum()),
        horizontal_m=horizontal,
        vertical_m=vertical,
        limit_m=round(limit, 3),
        bowing=_bow(similarity.points(source)[kept], target[kept], limits),
        outliers=tuple(_names(marks)[n] for n, good in zip(names, kept) if not good),
        astray=missed,
        text=said,
    )
    left_out = tuple(n for n, good in zip(names, kept) if not good)
    laid = Lay(model, similarity, fit, left_out=left_out, astray=wrong)
    if max(horizontal, vertical) > limit:
        return replace(laid, fit=replace(fit, verdict=FAIL, text=f"{said}, {limit:.2f} m is the limit"))
    if max(horizontal, vertical) > (1.0 - _CLOSE) * limit:
        said += f" (close: {limit:.2f} m is the limit)"
        laid = replace(laid, fit=replace(fit, text=said))
    share = _cover(solution, similarity, model, target[kept])
    if share < limits.gcp_hull_share:
        return replace(laid, fit=replace(laid.fit, text=f"{said}, but they span {share:.0%} of the block"))
    if strong < limits.gcp_min_points:
        free = not ground.known[rows_of(request.frames, solution, model)].any()
        text = f"{said}; {strong} of them are seen in {limits.gcp_min_images} frames, {limits.gcp_min_points} prove it"
        return replace(laid, fit=replace(laid.fit, text=text), holds=free)
    contradicted = _against_gps(request, solution, ground, similarity, model, limits)
    if contradicted:
        return replace(laid, fit=replace(laid.fit, verdict=FAIL, text=f"{said}, but {contradicted}"))
    return replace(laid, fit=replace(laid.fit, verdict=PASS), holds=True)


def _few(count: int) -> str:
    return f"{count} control points are marked in two or more of its frames; {_MIN_POINTS} off one line are needed"


def _limit(solution: Solution, similarity: Similarity, model: int, limits: Thresholds) -> float:
    """What a free network may miss its points by: a share of the height, where the bow of one shows."""
    centers = similarity.points(solution.center[solution.model == model])
    points = similarity.points(solution.point_xyz[solution.point_model == model])
    height, _ = height_above_ground(centers, points)
    return max(limits.control_fit_m, limits.control_fit_height * abs(height or 0.0))


def _cover(solution: Solution, similarity: Similarity, model: int, target: Array) -> float:
    """Area of the points' hull over that of the cameras'."""
    centers = similarity.points(solution.center[solution.model == model])
    block = hull_area_m2([(float(x), float(y)) for x, y, _ in centers])
    return hull_area_m2([(float(x), float(y)) for x, y, _ in target]) / block if block > 0 else 1.0


def _bow(solved: Array, target: Array, limits: Thresholds) -> Bowing:
    """The free network's bow by its ground points' heights, where they are enough to tell it from noise."""
    if len(solved) < limits.control_bow_points:
        return Bowing()
    return bowing(solved, target, ["control"] * len(solved))


def _against_gps(
    request: AlignRequest, solution: Solution, ground: Ground, similarity: Similarity, model: int, limits: Thresholds
) -> str:
    """Why GPS contradicts the scale and tilt that control gives a model, ``""`` where it does not.

    Only a payload whose own shape fits its GPS may speak; a constant offset is
    another datum, not a contradiction.
    """
    anchor = choose_anchor(request.frames, solution, ground, limits)
    rows = rows_of(request.frames, solution, model, anchor) if anchor else np.zeros(0, dtype=np.int64)
    rows = rows[ground.known[rows]]
    if len(rows) < limits.min_proof_frames:
        return ""
    own = fit_rows(solution, ground, rows)
    moved, _ = shifted(similarity, solution, ground, [anchor or ""], request.frames, model)
    sigma = (float(np.median(ground.sigma[rows, 0])), float(np.median(ground.sigma[rows, 1])))
    vertical = bool(ground.vertical[rows].all())

    def misfit(fit: Similarity, fitted: int) -> float:
        found = residual_fit(
            fit.points(solution.center[rows]) - ground.east_north_up[rows], sigma, fitted, False, vertical
        )
        flat = (found.horizontal_m or 0.0) / (limits.gps_sigma_factor * sigma[0])
        return max(flat, (found.vertical_m or 0.0) / (limits.gps_sigma_factor * sigma[1]))

    if own is None or misfit(own, len(rows)) > 1.0 or misfit(moved, 0) <= 1.0:
        return ""
    ratio = similarity.scale / own.scale
    return (
        f"GPS contradicts them: by GPS the block is {1.0 / ratio:.3f} times as large. "
        "Check the coordinates' unit and system"
    )


def lays_of(request: AlignRequest, job: Job, solution: Solution, ground: Ground, limits: Thresholds) -> Dict[int, Lay]:
    """Every model's lay on ground control; empty where the request has none."""
    if not any(not m.check for m in request.gcps):
        return {}
    return {m: lay_by_control(request, job, solution, ground, m, limits) for m in range(solution.models)}


def holds_of(
    request: AlignRequest, job: Job, solution: Solution, ground: Ground, lays: Mapping[int, Lay]
) -> Tuple[Hold, ...]:
    """What an adjustment is to hold: each proven model's points, outliers and check points left out."""
    index = {f.path: i for i, f in enumerate(request.frames)}
    found: List[Hold] = []
    for model in sorted(lays):
        lay = lays[model]
        if not lay.holds or lay.similarity is None:
            continue
        tracks: Dict[str, List[Tuple[int, float, float]]] = {}
        for mark in sound(request.gcps, lay):
            row = index.get(mark.path)
            if mark.check or mark.point in lay.left_out or row is None:
                continue
            if solution.model[row] == model:
                tracks.setdefault(mark.point, []).append((row, *working_pixel(request, job, row, mark)))
        fit = lay.similarity
        found.append(
            Hold(
                model=model,
                scale=fit.scale,
                rotation=tuple(float(v) for v in fit.rotation.ravel()),
                translation=(float(fit.translation[0]), float(fit.translation[1]), float(fit.translation[2])),
                points=tuple(
                    HeldPoint(_three(ground.control[name]), tuple(tracks[name]))
                    for name in sorted(tracks)
                    if len(tracks[name]) >= MIN_RAYS
                ),
            )
        )
    return tuple(found)


def _three(row: Array) -> Tuple[float, float, float]:
    return float(row[0]), float(row[1]), float(row[2])


def residuals(
    request: AlignRequest, job: Job, solution: Solution, ground: Ground, lay: Lay, similarity: Similarity
) -> ControlFit:
    """``lay.fit`` with every point's residual under ``similarity``, and the RMS over the check points."""
    solved = intersect(request, job, solution, sound(request.gcps, lay), lay.model)
    checks = {m.point for m in request.gcps if m.check}
    called = _names(request.gcps)
    rows = []
    for name in sorted(solved):
        miss = similarity.points(solved[name][0][None, :])[0] - ground.control[name]
        rows.append(
            ControlResidual(
                point=called[name],
                check=name in checks,
                images=solved[name][1],
                residual_m=(round(float(miss[0]), 4), round(float(miss[1]), 4), round(float(miss[2]), 4)),
            )
        )
    held_out = np.asarray([r.residual_m for r in rows if r.check], dtype=float).reshape(-1, 3)
    flat, up = _rms(held_out, 0) if len(held_out) else (None, None)
    return replace(
        lay.fit,
        points_m=tuple(rows),
        check_points=len(held_out),
        check_horizontal_m=flat,
        check_vertical_m=up,
    )


def checked(fit: ControlFit) -> Tuple[str, ...]:
    """How far check points came out from their coordinates, in words; empty without any."""
    if not fit.check_points:
        return ()
    how = "with the control points held" if fit.held else "laid on the control points"
    return (
        f"{fit.check_points} check points miss by {fit.check_horizontal_m:.3f} m horizontally and "
        f"{fit.check_vertical_m:.3f} m vertically, {how}",
    )


def of_payload(
    request: AlignRequest,
    job: Job,
    solution: Solution,
    ground: Ground,
    lays: Mapping[int, Lay],
    payload: str,
    limits: Thresholds,
) -> Optional[ControlFit]:
    """What ground control says of one payload: its own marks alone, under the lay of the model that holds most of it.

    ``None`` where its model has no lay or none of its frames a mark.
    """
    rows = np.asarray([i for i, f in enumerate(request.frames) if f.payload == payload], dtype=np.int64)
    placed = [int(m) for m in solution.model[rows] if m != UNPLACED]
    if not placed or not lays:
        return None
    model = min(set(placed), key=lambda m: (-placed.count(m), m))
    lay = lays[model]
    own = {request.frames[i].path for i in rows}
    mine = [m for m in request.gcps if m.path in own and not m.check]
    if lay.similarity is None or not mine:
        return lay.fit if lay.similarity is None else None
    if all(m.path in own for m in request.gcps):
        return lay.fit
    solved = intersect(request, job, solution, sound(mine, lay), model)
    names = [n for n in sorted(solved) if n not in lay.left_out]
    if len(names) < limits.gcp_min_points_without_gps:
        return ControlFit(len(names), text=_few(len(names)))
    miss = lay.similarity.points(np.asarray([solved[n][0] for n in names]))
    flat, up = _rms(miss - np.asarray([ground.control[n] for n in names]), 0)
    text = f"{len(names)} control points in its frames fit to {flat:.2f} m horizontally, {up:.2f} m vertically"
    found = ControlFit(len(names), flat, up, lay.fit.limit_m, text=text)
    if max(flat, up) > (lay.fit.limit_m or limits.control_fit_m):
        return replace(found, verdict=FAIL, text=f"{text}, {lay.fit.limit_m:.2f} m is the limit")
    return replace(found, verdict=lay.fit.verdict, text=text if lay.fit.verdict == PASS else lay.fit.text)
