"""Plan how the bands of every rig come onto their primary's grid, from a bounded sample of captures."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from ..errors import FrameError
from ..finding import Finding, sort_key
from ..frame import Frame
from ..profile import Payload, SurveyFrame
from ..progress import Cancel, Progress
from ..thresholds import Thresholds
from .bands_findings import rig_findings, unused_points
from .bands_fit import (
    CapturePoints,
    Fitted,
    Lenses,
    contradicts,
    cross_checked,
    errors_px,
    fit,
    fit_user_points,
    passes,
    witnessed,
)
from .bands_group import (
    HeightBin,
    Rig,
    RigCapture,
    find_rig,
)
from .bands_lens import Points
from .bands_measure import Measured, measure, user_points
from .bands_model import (
    ALIGNED,
    APPLIED,
    KEPT,
    NOTHING,
    REFUSED,
    VOIDED,
    WARP,
    BandFit,
    BandPlan,
    CaptureFit,
    RigPlan,
)
from .bands_radiometry import correction_of, treatment
from .control_points import ControlPair

FEATURES, AREA, USER, NEIGHBOUR = "features", "area", "control-points", "neighbour"
PathLike = Union[str, Path]


def plan_bands(
    frames: Sequence[SurveyFrame],
    files: Mapping[str, Frame],
    payloads: Sequence[Payload],
    sources: Mapping[str, PathLike],
    thresholds: Thresholds,
    *,
    control: Sequence[ControlPair] = (),
    workers: int = 2,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Tuple[BandPlan, Tuple[Finding, ...]]:
    """Measure, per rig, band and height bin, the way onto the primary's grid; judge it on held-out points.

    ``frames`` are the survey's, ``sources`` path -> file. Of each bin at most
    ``band_captures`` captures are read. ``control`` are the user's points:
    where a band has them, they decide. Payloads of one profile have nothing to
    align. Raises ``MissingDependency`` without OpenCV, ``Cancelled``.
    """
    rigs = [r for r in (find_rig(p, frames, files, thresholds) for p in payloads) if r is not None]
    user, unused = user_points(rigs, control)
    measured = measure(rigs, sources, user, thresholds, workers, progress, cancel)
    plans: List[RigPlan] = []
    fits: List[BandFit] = []
    findings: List[Finding] = [unused_points(name) for name in unused]
    for rig in rigs:
        own = _fit_rig(rig, measured, user, thresholds)
        plan = _rig_plan(rig, own, sources, thresholds)
        own = _settled(own, plan)
        plans.append(plan)
        fits.extend(own)
        findings.extend(rig_findings(plan, own, files, thresholds))
    return BandPlan(tuple(plans), tuple(fits)), tuple(sorted(findings, key=sort_key))


def _fit_rig(rig: Rig, measured: Measured, user: Mapping[Tuple[str, str], Points], limits: Thresholds) -> List[BandFit]:
    """Every band and bin of a rig, unproven bins helped by their neighbours."""
    fits: List[BandFit] = []
    for profile in sorted(rig.optics):
        own = []
        for height_bin in rig.bins:
            captures = [c for c in height_bin.captures if profile in dict(c.bands)]
            if not captures:
                continue
            points = user.get((rig.payload.id, profile))
            if points is not None:
                own.append(_by_user(rig, profile, height_bin, captures, points, limits))
            else:
                own.append(_by_points(rig, profile, height_bin, captures, measured, limits))
        fits.extend(_borrowed(fitted, own, rig, measured, limits) for fitted in own)
    return fits


def _empty(rig: Rig, profile: str, height_bin: HeightBin, captures: Sequence[RigCapture], reason: str) -> BandFit:
    return BandFit(
        payload=rig.payload.id,
        primary=rig.payload.primary,
        profile=profile,
        band=rig.band_of[profile],
        low_m=height_bin.low_m,
        high_m=height_bin.high_m,
        pairs=tuple((c.primary.path, dict(c.bands)[profile].path) for c in captures),
        state=REFUSED,
        reason=reason,
    )


def _filled(empty: BandFit, fitted: Fitted, source: str, state: str, reason: str) -> BandFit:
    return replace(
        empty,
        state=state,
        reason=reason,
        matrix=fitted.matrix,
        model=fitted.model,
        lenses=fitted.lenses.name,
        source=source,
        primary_lens=fitted.lenses.primary,
        band_lens=fitted.lenses.band,
        control_points=fitted.control_points,
        inliers=fitted.inliers,
        held_out=fitted.held_out,
        cross_check=fitted.cross_check,
        plain_homography=fitted.plain_homography,
        refine=fitted.refine,
        sampled=fitted.captures,
    )


def _by_user(
    rig: Rig,
    profile: str,
    height_bin: HeightBin,
    captures: Sequence[RigCapture],
    points: Points,
    limits: Thresholds,
) -> BandFit:
    need = int(limits.band_user_points)
    empty = _empty(
        rig,
        profile,
        height_bin,
        captures,
        f"{len(points)} control points were given; {need} are needed, not on one line",
    )
    fitted = fit_user_points(points, rig.primary_lens, rig.optics[profile].lens, limits)
    if fitted is None or fitted.held_out is None:
        return empty
    held = fitted.held_out
    good = held.median_px <= limits.band_median_px and held.p95_px <= limits.band_p95_px
    reason = "" if good else f"the given control points disagree: {_told(held.median_px, held.p95_px)}"
    return _filled(empty, fitted, USER, WARP if good else REFUSED, reason)


def _told(median_px: float, p95_px: float) -> str:
    return f"{median_px:.2f} px in the median and {p95_px:.2f} px at the 95th percentile"


def _by_points(
    rig: Rig,
    profile: str,
    height_bin: HeightBin,
    captures: Sequence[RigCapture],
    measured: Measured,
    limits: Thresholds,
) -> BandFit:
    """The better of the two kinds of control points, if one of them proves the band."""
    empty = _empty(rig, profile, height_bin, captures, "too few control points were found")
    optics = rig.optics[profile]
    tried: List[Tuple[str, Fitted]] = []
    points = {source: _capture_points(captures, profile, measured, source) for source in (AREA, FEATURES)}
    for source, found in points.items():
        fitted = fit(found, rig.primary_lens, optics.lens, optics.rigs, limits)
        if fitted is not None:
            tried.append((source, fitted))
    if len(tried) == 2 and all(passes(f, limits, residuals=False) for _, f in tried):
        others = (points[FEATURES], points[AREA])
        tried = [(s, cross_checked(f, other, limits)) for (s, f), other in zip(tried, others)]
    proven = [(s, f) for s, f in tried if passes(f, limits)]
    if proven:
        source, best = min(proven, key=lambda item: item[1].held_out.p95_px if item[1].held_out else math.inf)
        best = witnessed(best, points[AREA if source == FEATURES else FEATURES], limits)
        return _filled(empty, best, source, ALIGNED if best.identity else WARP, "")
    dense = [(s, f) for s, f in tried if passes(f, limits, residuals=False)]
    if dense:
        source, best = max(dense, key=lambda item: item[1].inliers)
        assert best.held_out is not None
        off = _told(best.held_out.median_px, best.held_out.p95_px)
        return _filled(empty, best, source, REFUSED, f"points that were held out lie off by {off}")
    if tried:
        source, best = max(tried, key=lambda item: item[1].inliers)
        few = f"only {best.inliers} of {best.control_points} control points agree"
        if best.inliers >= limits.min_inliers and best.share >= limits.band_min_share:
            few = "control points were found in a small part of the frame only"
        return replace(empty, reason=few, source=source, sampled=best.captures)
    return empty


def _capture_points(
    captures: Sequence[RigCapture], profile: str, measured: Measured, source: str
) -> List[CapturePoints]:
    found = []
    for capture in captures:
        path = dict(capture.bands)[profile].path
        if path in measured:
            found.append(CapturePoints(capture.capture, path, measured[path][source]))
    return found


def _borrowed(fitted: BandFit, others: Sequence[BandFit], rig: Rig, measured: Measured, limits: Thresholds) -> BandFit:
    """A bin that could not be measured takes its neighbour's homography where parallax between them is below the limit.

    Captures that have points and contradict it are named, not warped blindly.
    """
    if fitted.state != REFUSED or fitted.matrix or fitted.low_m is None or fitted.high_m is None:
        return fitted
    height = math.sqrt(fitted.low_m * fitted.high_m)
    near = [o for o in others if o.state == WARP and o.low_m is not None and o.high_m is not None]
    best: Optional[Tuple[float, BandFit]] = None
    for other in near:
        if other.low_m is None or other.high_m is None or other.primary_lens is None or other.band_lens is None:
            continue
        away = abs(1.0 / height - 1.0 / math.sqrt(other.low_m * other.high_m))
        focal = min(rig.primary_lens.focal_px, rig.optics[fitted.profile].lens.focal_px)
        shift = focal * limits.lever_arm_m * away
        if shift <= limits.band_median_px and (best is None or shift < best[0]):
            best = (shift, other)
    if best is None:
        return fitted
    other = best[1]
    judged = _against(fitted, other, measured, limits)
    if judged and all(c.mismatch for c in judged):
        return fitted
    return replace(
        fitted,
        state=WARP,
        reason="",
        source=NEIGHBOUR,
        matrix=other.matrix,
        model=other.model,
        lenses=other.lenses,
        primary_lens=other.primary_lens,
        band_lens=other.band_lens,
        held_out=other.held_out,
        plain_homography=other.plain_homography,
        sampled=judged,
    )


def _against(fitted: BandFit, other: BandFit, measured: Measured, limits: Thresholds) -> Tuple[CaptureFit, ...]:
    assert other.primary_lens is not None and other.band_lens is not None
    lenses = Lenses(other.primary_lens, other.band_lens, other.lenses)
    judged = []
    for primary, path in fitted.pairs:
        points = max((measured.get(path) or {}).values(), key=len, default=np.empty((0, 4)))
        if len(points) < limits.band_min_held:
            continue
        agreeing = int((errors_px(other.matrix, lenses, points) <= limits.band_ransac_px).sum())
        mismatch = contradicts(len(points), agreeing, limits)
        judged.append(CaptureFit(primary, path, len(points), agreeing, mismatch=mismatch))
    return tuple(judged)


def _rig_plan(rig: Rig, fits: Sequence[BandFit], sources: Mapping[str, PathLike], limits: Thresholds) -> RigPlan:
    refused = sorted({f.profile for f in fits if f.state == REFUSED})
    stay = [f for f in fits if f.profile not in refused]
    warped = sorted({f.profile for f in stay if f.state == WARP})
    return RigPlan(
        payload=rig.payload.id,
        primary=rig.payload.primary,
        primary_band=rig.primary_band,
        aligned=tuple(sorted({f.profile for f in stay})),
        refused=tuple(refused),
        skip_band_alignment=bool(stay),
        radiometry=_radiometry(warped, stay, rig, sources, limits),
        mismatched=tuple(sorted({c.frame for f in stay for c in f.sampled if c.mismatch})),
    )


def _radiometry(
    warped: Sequence[str], fits: Sequence[BandFit], rig: Rig, sources: Mapping[str, PathLike], limits: Thresholds
) -> str:
    """How the sensor-bound radiometry of all bands that are warped is dealt with: one way for the whole rig."""
    first = {p: next(pair for f in fits if f.profile == p for pair in f.pairs) for p in {f.profile for f in fits}}
    try:
        ways = {treatment(Path(sources[first[p][1]]).read_bytes(), limits) for p in warped if p in rig.tagged}
        if not ways and not warped:
            return _as_found([pair for p, pair in sorted(first.items()) if p in rig.tagged], sources, limits)
    except (OSError, FrameError):
        return VOIDED
    return next((way for way in (VOIDED, KEPT, APPLIED) if way in ways), NOTHING)


def _as_found(pairs: Sequence[Tuple[str, str]], sources: Mapping[str, PathLike], limits: Thresholds) -> str:
    """``applied`` where bands that lie aligned are levelled already and their primary is not: an earlier run's work."""
    for primary, band in pairs:
        own, other = (correction_of(Path(sources[path]).read_bytes(), limits) for path in (primary, band))
        if own is None or other is None or own.neutral or not other.neutral:
            return NOTHING
    return APPLIED if pairs else NOTHING


def _settled(fits: Sequence[BandFit], plan: RigPlan) -> List[BandFit]:
    """A band that one bin refuses is refused as a whole: a project needs all bands of all captures."""
    result = []
    for fitted in fits:
        if fitted.profile in plan.refused and fitted.state != REFUSED:
            fitted = replace(fitted, state=REFUSED, reason="another height of this band could not be aligned")
        result.append(fitted)
    return result
