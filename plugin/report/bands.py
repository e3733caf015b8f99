"""How the bands of each rig were laid on each other, in the report's shape (pure)."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional

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


_SOURCES = {
    "features": "features",
    "area": "edges, window by window",
    "control-points": "your control points",
    "neighbour": "taken from the next height",
}
_RADIOMETRY = {
    "applied": "Black level, vignette and row gradient are in the aligned bands; run ODM with radiometric-calibration "
    "camera, which applies them to the primary band.",
    "kept": "The fall-off of light was moved to the new grid with the pixels, so black level and vignette tags hold.",
    "none": "Aligning voids the black level and vignette tags of these frames: the values are no reflectance.",
}
_STATES = {"warp": "laid on it", "aligned": "lay on it already", "refused": "refused"}


def band_tables(report: Mapping[str, Any], most_rows: int) -> List[Dict[str, Any]]:
    """What the page shows of each rig: one row per band and height, the limits, what was left out of it."""
    limits = report["thresholds"]["all"]
    return [
        {
            "payload": rig["payload"],
            "primary": rig["primary_band"],
            "radiometry": _RADIOMETRY.get(rig["radiometry"] or ""),
            "mismatched": rig["mismatched"],
            "rows": [_row(fit, limits) for fit in rig["fits"][:most_rows]],
            "more": max(0, len(rig["fits"]) - most_rows),
            "heights": any(fit["height_low_m"] is not None for fit in rig["fits"]),
        }
        for rig in report.get("bands", [])
        if rig["fits"]
    ]


def _row(fit: Mapping[str, Any], limits: Mapping[str, float]) -> Dict[str, Any]:
    held = fit["held_out"] or {}
    heights = (fit["height_low_m"], fit["height_high_m"])
    return {
        "band": fit["band"],
        "profile": fit["profile"],
        "state": {"warp": "good", "aligned": "good"}.get(fit["state"], "bad"),
        "words": _STATES[fit["state"]] + (f": {fit['reason']}" if fit["reason"] else ""),
        "height": "–" if None in heights else f"{heights[0]:.0f}–{heights[1]:.0f}",
        "captures": fit["captures"],
        "source": _SOURCES.get(fit["source"] or "", "–"),
        "points": held.get("points"),
        "median_px": held.get("median_px"),
        "p95_px": held.get("p95_px"),
        "median_limit": limits.get("band_median_px"),
        "p95_limit": limits.get("band_p95_px"),
    }
