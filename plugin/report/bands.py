"""How the bands of each rig were laid on each other, in the report's shape (pure)."""

from __future__ import annotations

from typing import Any, Dict, List, Optional

from ...stages.harmonize.bands_model import BandFit, BandPlan, CaptureFit, Residual


def bands_record(plan: BandPlan) -> List[Dict[str, Any]]:
    """One entry per rig: its primary, what became of the radiometry, and per band and height what was measured."""
    return [
        {
            "payload": rig.payload,
            "primary_band": rig.primary_band,
            "skip_band_alignment": rig.skip_band_alignment,
            "radiometry": rig.radiometry or None,
            "refused": list(rig.refused),
            "mismatched": list(rig.mismatched),
            "fits": [_fit(f) for f in plan.fits if f.payload == rig.payload],
        }
        for rig in plan.rigs
    ]


def _fit(fit: BandFit) -> Dict[str, Any]:
    return {
        "profile": fit.profile,
        "band": fit.band,
        "state": fit.state,
        "reason": fit.reason or None,
        "source": fit.source or None,
        "model": fit.model or None,
        "height_low_m": fit.low_m,
        "height_high_m": fit.high_m,
        "captures": len(fit.pairs),
        "control_points": fit.control_points,
        "inliers": fit.inliers,
        "held_out": _residual(fit.held_out),
        "cross_check": _residual(fit.cross_check),
        "sampled": [_capture(c) for c in fit.sampled],
    }


def _capture(found: CaptureFit) -> Dict[str, Any]:
    return {
        "frame": found.frame,
        "matches": found.matches,
        "agreeing": found.agreeing,
        "residual": _residual(found.pooled),
        "mismatch": found.mismatch,
    }


def _residual(found: Optional[Residual]) -> Optional[Dict[str, Any]]:
    if found is None:
        return None
    return {"points": found.points, "median_px": round(found.median_px, 3), "p95_px": round(found.p95_px, 3)}
