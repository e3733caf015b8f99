"""What is said about the bands of a rig."""

from __future__ import annotations

from typing import Dict, Iterator, List, Mapping, Sequence

from ..finding import INFO, WARNING, Finding
from ..frame import Frame
from ..thresholds import Thresholds
from .bands_model import ALIGNED, APPLIED, KEPT, REFUSED, VOIDED, WARP, BandFit, Residual, RigPlan


def unused_points(names: str) -> Finding:
    """Control points whose two names meet no capture or rig."""
    return Finding(
        code="control-points-unused",
        severity=WARNING,
        subjects=(names,),
        message=f"The control points for {names} were not used: these are no two bands of one capture.",
        remedy="Name two files of one capture or two bands of one rig; one of the two is the rig's primary band.",
    )


def rig_findings(
    plan: RigPlan, fits: Sequence[BandFit], files: Mapping[str, Frame], limits: Thresholds
) -> Iterator[Finding]:
    """Everything to say of one rig, in no order."""
    for profile in plan.refused:
        yield _refused(plan, [f for f in fits if f.profile == profile], limits)
    warped = [f for f in fits if f.state == WARP]
    if warped:
        yield _registered(plan, warped, limits)
    already = sorted({f.band for f in fits if f.state == ALIGNED})
    if already:
        yield Finding(
            code="bands-already-aligned",
            severity=INFO,
            subjects=(plan.payload,),
            message=f"{', '.join(already)} lie on {plan.primary_band} already and are left as they are.",
            remedy="Nothing has to be done.",
        )
    if plan.mismatched:
        yield Finding(
            code="band-capture-mismatch",
            severity=WARNING,
            subjects=plan.mismatched,
            message=f"{len(plan.mismatched)} band files show another place than the primary band of their capture.",
            remedy="They were probably renamed or renumbered. Copy this capture again from the card.",
        )
    if plan.radiometry == VOIDED:
        tags = sorted({t for f in warped for _, b in f.pairs for t in files[b].radiometry})
        yield Finding(
            code="not-reflectance",
            severity=WARNING,
            subjects=(plan.payload,),
            message=f"Aligning the bands voids {', '.join(tags)}: the values are no reflectance any more.",
            remedy="For reflectance, calibrate and align with the maker's own software first, and give those frames.",
        )


def _refused(plan: RigPlan, fits: Sequence[BandFit], limits: Thresholds) -> Finding:
    worst = next((f for f in fits if f.state == REFUSED and not f.reason.startswith("another height")), fits[0])
    measured = worst.held_out.median_px if worst.held_out is not None else None
    return Finding(
        code="band-refused",
        severity=WARNING,
        subjects=(worst.profile,),
        message=f"Band {worst.band} could not be laid on {plan.primary_band}: {worst.reason}. "
        "It is left out of the rig's project.",
        remedy="Give control points for it (--control-points FILE), or use it in a project of its own.",
        measured=measured,
        threshold=limits.band_median_px if measured is not None else None,
    )


def _registered(plan: RigPlan, warped: Sequence[BandFit], limits: Thresholds) -> Finding:
    worst: Dict[str, Residual] = {}
    for fitted in warped:
        held = fitted.held_out
        if held is not None and (fitted.band not in worst or held.median_px > worst[fitted.band].median_px):
            worst[fitted.band] = held
    told: List[str] = [f"{band} {r.median_px:.2f} px (95 %: {r.p95_px:.2f})" for band, r in sorted(worst.items())]
    applied = ""
    if plan.radiometry == APPLIED:
        applied = (
            " Black level, vignette and row gradient were applied first; run ODM with radiometric-calibration camera."
        )
    if plan.radiometry == KEPT:
        applied = " Black level and vignette tags stay true: the fall-off was moved along with the grid."
    return Finding(
        code="bands-registered",
        severity=INFO,
        subjects=(plan.payload,),
        message=f"Bands laid on {plan.primary_band}; residual on held-out points: {', '.join(told)}.{applied}",
        remedy="Nothing has to be done.",
        measured=max((r.median_px for r in worst.values()), default=None),
        threshold=limits.band_median_px,
    )
