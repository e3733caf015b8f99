"""One homography per band and height bin from pooled control points, judged by points it never saw (pure).

Points are split by cells of the primary frame: a third of the cells, other
ones in each capture, is held out. RANSAC works on rays scaled to the coarser
band's pixels. Of the models that measure alike the one with the fewest
freedoms is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
import numpy.typing as npt

from ..thresholds import Thresholds
from .bands_lens import Lens, Points, project
from .bands_model import CALIBRATED, PLAIN, CaptureFit, Matrix, Residual
from .resample import opencv

Mask = npt.NDArray[np.bool_]
RIG, AFFINE, HOMOGRAPHY = "rig", "affine", "homography"
_CELLS = (8, 6)
_CONFIDENCE = 0.999
_FEWEST = {AFFINE: 3, HOMOGRAPHY: 4}
_GRID = 9


@dataclass(frozen=True)
class CapturePoints:
    """Control points (n, 4) of one capture: x, y in the primary, x, y in the band."""

    capture: str
    frame: str
    points: Points


@dataclass(frozen=True)
class Lenses:
    """The two lenses of a fit and how they are called."""

    primary: Lens
    band: Lens
    name: str

    @property
    def coarse_px(self) -> float:
        """Focal length of the coarser band: pixels per ray unit in which residuals are told."""
        return min(self.primary.focal_px, self.band.focal_px)


@dataclass(frozen=True)
class Fitted:
    """A chosen model with what it measured."""

    matrix: Matrix
    model: str
    lenses: Lenses
    control_points: int
    inliers: int
    share: float
    held_out: Optional[Residual]
    plain_homography: Optional[Residual]
    captures: Tuple[CaptureFit, ...]
    refine: bool = False
    identity: bool = False
    cover: float = 1.0
    cross_check: Optional[Residual] = None


def lens_choices(primary: Lens, band: Lens) -> Tuple[Lenses, ...]:
    """The calibrated pair, and the plain one where that is another."""
    plain = Lenses(replace(primary.plain(), focal_px=float(primary.width)), _plain_band(primary, band), PLAIN)
    if (primary, band) == (primary.plain(), band.plain()):
        return (Lenses(primary, band, PLAIN),)
    return (Lenses(primary, band, CALIBRATED), plain)


def _plain_band(primary: Lens, band: Lens) -> Lens:
    """Without distortion only the ratio of the two focal lengths counts."""
    return replace(band.plain(), focal_px=primary.width * band.focal_px / primary.focal_px)


def held_mask(points: Points, lens: Lens, turn: int) -> Mask:
    """Which points are held out: cells of the primary frame, shifted from capture to capture."""
    column, row = _cells(points, lens)
    return np.asarray((column + 2 * row + turn) % 3 == 0)


def _cells(points: Points, lens: Lens) -> Tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    column = np.clip(points[:, 0] / lens.width * _CELLS[0], 0, _CELLS[0] - 1).astype(np.int64)
    row = np.clip(points[:, 1] / lens.height * _CELLS[1], 0, _CELLS[1] - 1).astype(np.int64)
    return column, row


def _cover(points: Points, lens: Lens) -> float:
    """Share of the primary frame's cells that hold one of ``points``."""
    column, row = _cells(points, lens)
    return len(np.unique(column + _CELLS[0] * row)) / (_CELLS[0] * _CELLS[1])


def errors_px(matrix: Any, lenses: Lenses, points: Points) -> Points:
    """Distance in the band between where the primary's points come out and where they were seen."""
    there = project(matrix, lenses.primary.to_rays(points[:, :2]))
    away = (there - lenses.band.to_rays(points[:, 2:])) * lenses.coarse_px
    return np.asarray(np.nan_to_num(np.hypot(away[:, 0], away[:, 1]), nan=1e9))


def residual(errors: Points, limits: Thresholds) -> Optional[Residual]:
    """Median and 95th percentile of what is no plain mismatch; ``None`` without a point."""
    good = errors[errors <= limits.band_outlier_px]
    if not good.size:
        return None
    return Residual(int(good.size), round(float(np.median(good)), 4), round(float(np.percentile(good, 95)), 4))


def solve(points: Points, lenses: Lenses, model: str, limits: Thresholds) -> Optional[Matrix]:
    """RANSAC over control points; primary rays to band rays, or ``None`` where there is no solution."""
    if len(points) < _FEWEST[model]:
        return None
    cv2 = opencv()
    focal = lenses.coarse_px
    primary = lenses.primary.to_rays(points[:, :2]) * focal
    band = lenses.band.to_rays(points[:, 2:]) * focal
    if model == AFFINE:
        found, _ = cv2.estimateAffine2D(
            primary,
            band,
            method=cv2.RANSAC,
            ransacReprojThreshold=limits.band_ransac_px,
            maxIters=int(limits.affine_iterations),
            confidence=_CONFIDENCE,
        )
        found = None if found is None else np.vstack((found, [0.0, 0.0, 1.0]))
    else:
        found, _ = cv2.findHomography(
            primary,
            band,
            cv2.RANSAC,
            limits.band_ransac_px,
            maxIters=int(limits.affine_iterations),
            confidence=_CONFIDENCE,
        )
    if found is None or not np.isfinite(found).all():
        return None
    scale = np.diag([focal, focal, 1.0])
    rays = np.linalg.inv(scale) @ found @ scale
    if abs(rays[2, 2]) < 1e-9 or np.linalg.det(rays[:2, :2]) <= 0:
        return None
    return tuple(float(v) for v in (rays / rays[2, 2]).ravel())


@dataclass(frozen=True)
class _Pool:
    """The points of several captures with their held-out flags."""

    points: Points
    held: Mask
    owner: npt.NDArray[np.int64]

    @classmethod
    def of(cls, captures: Sequence[CapturePoints], lens: Lens) -> "_Pool":
        points = [c.points for c in captures]
        held = [held_mask(p, lens, turn) for turn, p in enumerate(points)]
        owner = [np.full(len(p), i, np.int64) for i, p in enumerate(points)]
        return cls(np.vstack(points), np.concatenate(held), np.concatenate(owner))


def fit(
    captures: Sequence[CapturePoints],
    primary: Lens,
    band: Lens,
    rigs: Sequence[Any],
    limits: Thresholds,
) -> Optional[Fitted]:
    """Choose the model that serves the pooled points best; captures that contradict it are named and left out.

    ``rigs`` are matrices that the rig's own tags give. ``None`` where no model
    could be found at all.
    """
    rest = [c for c in captures if len(c.points)]
    if not rest:
        return None
    first = _fit_once(rest, primary, band, rigs, limits)
    if first is None:
        return None
    strange = {c.frame for c in first.captures if _apart(c, limits)}
    if not strange or len(strange) == len(rest) or not passes(first, limits, residuals=False):
        return first
    again = _fit_once([c for c in rest if c.frame not in strange], primary, band, rigs, limits)
    if again is None:
        return first
    told = [_judge(c, again, index, limits) for index, c in enumerate(rest) if c.frame in strange]
    return replace(again, captures=tuple(sorted((*again.captures, *told), key=lambda c: c.frame)))


def passes(fitted: Fitted, limits: Thresholds, *, residuals: bool = True) -> bool:
    """Enough agreeing points, and (``residuals``) held-out residuals within the limits."""
    if fitted.inliers < limits.min_inliers or fitted.share < limits.band_min_share:
        return False
    if fitted.cover < limits.band_min_cover:
        return False
    held = fitted.held_out
    if held is None or held.points < limits.band_min_held:
        return False
    if not residuals:
        return True
    if fitted.cross_check is not None and fitted.cross_check.median_px > limits.band_median_px:
        return False
    return held.median_px <= limits.band_median_px and held.p95_px <= limits.band_p95_px


def _apart(capture: CaptureFit, limits: Thresholds) -> bool:
    """Most of a capture's points do not fit the bin: it may not steer the bin's model."""
    return capture.matches >= limits.band_min_held and capture.agreeing < limits.band_min_share * capture.matches


def contradicts(matches: int, agreeing: int, limits: Thresholds) -> bool:
    """A capture's points agree by chance only: they show another place."""
    return matches >= limits.band_min_held and agreeing <= limits.band_chance_share * matches


def cross_checked(fitted: Fitted, other: Sequence[CapturePoints], limits: Thresholds) -> Fitted:
    """Add the residual on control points of the other kind, none of which the fit has seen."""
    strange = {c.frame for c in fitted.captures if c.mismatch or _apart(c, limits)}
    points = [c.points for c in other if len(c.points) and c.frame not in strange]
    if not points:
        return fitted
    seen = residual(errors_px(fitted.matrix, fitted.lenses, np.vstack(points)), limits)
    return replace(fitted, cross_check=seen if seen is not None and seen.points >= limits.band_min_held else None)


def witnessed(fitted: Fitted, other: Sequence[CapturePoints], limits: Thresholds) -> Fitted:
    """Judge the captures by their points of the other kind too: a wrong capture may have hardly any of one kind."""
    told = {c.frame: c for c in fitted.captures}
    for item in other:
        if not len(item.points):
            continue
        known = told.get(item.frame, CaptureFit(item.capture, item.frame, 0, 0))
        errors = errors_px(fitted.matrix, fitted.lenses, item.points)
        matches = known.matches + len(item.points)
        agreeing = known.agreeing + int((errors <= limits.band_ransac_px).sum())
        mismatch = contradicts(matches, agreeing, limits)
        told[item.frame] = replace(known, matches=matches, agreeing=agreeing, mismatch=mismatch)
    return replace(fitted, captures=tuple(told[frame] for frame in sorted(told)))


def _fit_once(
    captures: Sequence[CapturePoints], primary: Lens, band: Lens, rigs: Sequence[Any], limits: Thresholds
) -> Optional[Fitted]:
    pool = _Pool.of(captures, primary)
    choices: List[Tuple[Residual, Fitted]] = []
    plain: Dict[str, Optional[Residual]] = {}
    identity = False
    for lenses in lens_choices(primary, band):
        candidates: List[Tuple[str, Optional[Matrix]]] = []
        if lenses.name == CALIBRATED:
            candidates = [(RIG, tuple(float(v) for v in np.asarray(r).ravel())) for r in rigs]
        candidates += [(m, solve(pool.points[~pool.held], lenses, m, limits)) for m in (AFFINE, HOMOGRAPHY)]
        for model, matrix in candidates:
            if matrix is None:
                continue
            errors = errors_px(matrix, lenses, pool.points)
            held = residual(errors[pool.held], limits)
            if lenses.name == PLAIN:
                plain[model] = held
                identity = identity or (held is not None and _is_identity(matrix, lenses, limits))
            inside = int((errors[~pool.held] <= limits.band_ransac_px).sum())
            share = inside / max(1, int((~pool.held).sum()))
            made = Fitted(matrix, model, lenses, len(pool.points), inside, share, held, None, ())
            made = replace(made, cover=_cover(pool.points[errors <= limits.band_ransac_px], lenses.primary))
            if held is not None:
                choices.append((held, made))
    chosen = _simplest(choices, limits)
    if chosen is None:
        return None
    told = tuple(sorted((_judge(c, chosen, i, limits) for i, c in enumerate(captures)), key=lambda c: c.frame))
    chosen = replace(chosen, plain_homography=plain.get(HOMOGRAPHY), captures=told, identity=identity)
    return _refined(chosen, limits)


def _simplest(choices: Sequence[Tuple[Residual, Fitted]], limits: Thresholds) -> Optional[Fitted]:
    """The first in order of freedoms that is about as good as the best and has about as many agreeing points."""
    if not choices:
        return None
    most = max(f.inliers for _, f in choices)
    able = [(h, f) for h, f in choices if f.inliers >= (1.0 - limits.band_simpler_cost) * most]
    median = min(h.median_px for h, _ in able)
    p95 = min(h.p95_px for h, _ in able)
    cost = 1.0 + limits.band_simpler_cost
    good = [f for h, f in able if h.median_px <= cost * median and h.p95_px <= cost * p95]
    return good[0] if good else min(able, key=lambda item: item[0].median_px)[1]


def _judge(capture: CapturePoints, fitted: Fitted, turn: int, limits: Thresholds) -> CaptureFit:
    """How one capture agrees with the bin's model, and whether one of its own would serve it better."""
    points, lenses = capture.points, fitted.lenses
    held = held_mask(points, lenses.primary, turn)
    errors = errors_px(fitted.matrix, lenses, points)
    agreeing = int((errors <= limits.band_ransac_px).sum())
    matrix = own_matrix(points[~held], fitted, limits)
    own = None if matrix is None else residual(errors_px(matrix, lenses, points[held]), limits)
    mismatch = contradicts(len(points), agreeing, limits)
    pooled = residual(errors[held], limits)
    return CaptureFit(capture.capture, capture.frame, len(points), agreeing, pooled, own, mismatch)


def own_matrix(points: Points, fitted: Fitted, limits: Thresholds) -> Optional[Matrix]:
    """One capture's own model, where it has the points for one."""
    model = AFFINE if fitted.model == RIG else fitted.model
    matrix = solve(points, fitted.lenses, model, limits)
    if matrix is None:
        return None
    inside = int((errors_px(matrix, fitted.lenses, points) <= limits.band_ransac_px).sum())
    return matrix if inside >= limits.min_inliers and inside >= limits.band_min_share * len(points) else None


def better(own: Optional[Residual], pooled: Optional[Residual], limits: Thresholds) -> bool:
    """A capture's own homography beats the bin's on points that neither saw."""
    if own is None or pooled is None or min(own.points, pooled.points) < limits.band_min_held:
        return False
    return own.median_px <= pooled.median_px - limits.band_refine_gain_px and own.p95_px <= pooled.p95_px


def _refined(fitted: Fitted, limits: Thresholds) -> Fitted:
    """Set ``refine`` where own homographies serve most captures better, and tell the residual that they give."""
    known = [c for c in fitted.captures if c.own is not None and c.pooled is not None and not _apart(c, limits)]
    winners = [c for c in known if better(c.own, c.pooled, limits)]
    if not known or 2 * len(winners) <= len(known):
        return fitted
    best = [c.own if better(c.own, c.pooled, limits) else c.pooled for c in known]
    held = [r for r in best if r is not None]
    count = sum(r.points for r in held)
    return replace(
        fitted,
        refine=True,
        held_out=Residual(
            count,
            round(sum(r.median_px * r.points for r in held) / count, 4),
            round(sum(r.p95_px * r.points for r in held) / count, 4),
        ),
    )


def _is_identity(matrix: Matrix, lenses: Lenses, limits: Thresholds) -> bool:
    primary, band = lenses.primary, lenses.band
    if (primary.width, primary.height) != (band.width, band.height):
        return False
    grid = np.stack(
        np.meshgrid(np.linspace(0, primary.width - 1, _GRID), np.linspace(0, primary.height - 1, _GRID)), axis=-1
    )
    there = band.to_pixels(project(matrix, primary.to_rays(grid)))
    return bool(np.nan_to_num(np.abs(there - grid), nan=1e9).max() <= limits.band_aligned_px)


def fit_user_points(points: Points, primary: Lens, band: Lens, limits: Thresholds) -> Optional[Fitted]:
    """Fit the user's points by least squares; each is judged by the fit to the others."""
    if len(points) < limits.band_user_points:
        return None
    spread = np.linalg.svd(points[:, :2] - points[:, :2].mean(axis=0), compute_uv=False)
    if spread[1] < limits.collinear_ratio * spread[0]:
        return None
    best: Optional[Fitted] = None
    for lenses in lens_choices(primary, band):
        for model in (AFFINE, HOMOGRAPHY):
            matrix = _least_squares(points, lenses, model)
            if matrix is None or (model == HOMOGRAPHY and len(points) < 2 * _FEWEST[HOMOGRAPHY]):
                continue
            errors = []
            for index in range(len(points)):
                others = _least_squares(np.delete(points, index, axis=0), lenses, model)
                one = points[index : index + 1]
                errors.append(1e9 if others is None else float(errors_px(others, lenses, one)[0]))
            told = np.asarray(errors)
            held = Residual(len(points), round(float(np.median(told)), 4), round(float(np.percentile(told, 95)), 4))
            inside = int((told <= limits.band_outlier_px).sum())
            made = Fitted(matrix, model, lenses, len(points), inside, inside / len(points), held, None, ())
            if best is None or best.held_out is None or held.median_px < best.held_out.median_px:
                best = made
    return best


def _least_squares(points: Points, lenses: Lenses, model: str) -> Optional[Matrix]:
    primary, band = lenses.primary.to_rays(points[:, :2]), lenses.band.to_rays(points[:, 2:])
    if model == AFFINE:
        design = np.hstack((primary, np.ones((len(primary), 1))))
        solved = np.linalg.lstsq(design, band, rcond=None)[0].T
        return tuple(float(v) for v in np.vstack((solved, [0.0, 0.0, 1.0])).ravel())
    found, _ = opencv().findHomography(primary * lenses.coarse_px, band * lenses.coarse_px, 0)
    if found is None:
        return None
    scale = np.diag([lenses.coarse_px, lenses.coarse_px, 1.0])
    rays = np.linalg.inv(scale) @ found @ scale
    return tuple(float(v) for v in (rays / rays[2, 2]).ravel()) if abs(rays[2, 2]) > 1e-9 else None
