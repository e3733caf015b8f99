"""``report.json`` from what the stages decided (pure). Its shape is ``report.schema.json``."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import platform
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.finding import Finding
from ...stages.frame import Frame
from ...stages.gate import is_rtk_fixed
from ...stages.harmonize.bands_model import BandPlan
from ...stages.harmonize.model import FlightAction, HarmonizedFrame, HarmonizePlan, Lut, Outcome
from ...stages.profile import CameraProfile, SurveyFrame
from ...stages.record import to_plain
from ...stages.survey import Survey
from ...stages.thresholds import DEFAULTS, Thresholds
from ..odm.sizes import OdmLoad, loads
from ..version import VERSION
from .bands import bands_record

SCHEMA_VERSION = "1.0"

_FRAME_FACTS = (
    *("subproject", "output", "profile", "flight", "payload", "spectrum", "band", "capture", "make", "model", "serial"),
    *("width", "height", "focal_mm", "focal_source", "sensor_width_mm", "sensor_width_source", "altitude_m"),
    *("height_m", "height_source", "gsd_cm", "latitude", "longitude", "odm_camera_id"),
)


@dataclass(frozen=True)
class SubProject:
    """One ODM project as written: its frames, options and why.

    ``frames`` are paths as in ``report.json``; ``alignment`` the figures of
    the alignment in the report's shape, or ``None``.
    """

    name: str
    spectrum: str
    frames: Tuple[str, ...]
    payloads: Tuple[str, ...]
    route: str
    reasons: Tuple[str, ...]
    options: Tuple[Mapping[str, Any], ...] = ()
    alignment: Optional[Mapping[str, Any]] = None
    gcp: Optional[Mapping[str, int]] = None
    calibration: Tuple[Mapping[str, Any], ...] = ()


@dataclass(frozen=True)
class Written:
    """What ``run`` made of each frame; empty for ``gate``."""

    subprojects: Tuple[SubProject, ...] = ()
    outputs: Mapping[str, str] = field(default_factory=dict)
    copies: Mapping[str, HarmonizedFrame] = field(default_factory=dict)
    locks: Mapping[str, Tuple[bool, str]] = field(default_factory=dict)
    bands: BandPlan = field(default_factory=BandPlan)


def digest_of(survey: Survey, options: Mapping[str, Any]) -> str:
    """SHA-256 over names, sizes and metadata of all frames and over the deciding options."""
    material = {
        "files": to_plain(survey.files),
        "broken": to_plain(survey.broken),
        "options": to_plain(dict(sorted(options.items()))),
    }
    if survey.elevation is not None:
        # Large models are hashed in parts, so the heights that were read belong to the identity as well.
        heights = [(f.path, f.ground_m, f.height_m, f.height_sigma_m) for f in survey.frames]
        material["elevation"] = [survey.elevation.digest, heights]
    return hashlib.sha256(json.dumps(material, sort_keys=True).encode("utf-8")).hexdigest()


def versions() -> Dict[str, Optional[str]]:
    """Name to version of what decides something; ``None`` where it is not installed."""
    from importlib import metadata

    found: Dict[str, Optional[str]] = {"sensorgate": VERSION, "python": ".".join(platform.python_version_tuple()[:2])}
    for name in ("numpy", "Pillow", "opencv-python-headless", "pycolmap", "GDAL"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found


def build(
    survey: Survey,
    verdict: str,
    findings: Sequence[Finding],
    plan: HarmonizePlan,
    thresholds: Thresholds,
    *,
    paths: Sequence[str],
    options: Mapping[str, Any],
    odm_ids: Mapping[str, str],
    odm_notes: Sequence[str] = (),
    gcp_points: Sequence[Mapping[str, Any]] = (),
    gps_sigma: Mapping[str, Tuple[float, float]] = {},
    written: Optional[Written] = None,
) -> Dict[str, Any]:
    """Assemble the report; every value in it is plain JSON and every list is in a fixed order."""
    done = written or Written()
    home = {path: s.name for s in done.subprojects for path in s.frames}
    action_of = {path: a for a in plan.actions for path in a.frames}
    files = survey.file_of()
    frames = [_frame(f, files[f.path], odm_ids, gps_sigma, home, action_of, done) for f in survey.frames]
    frames += [_broken_frame(b.path, b.code) for b in survey.broken]
    gain_of = _gains(plan, thresholds)
    report = {
        "schema_version": SCHEMA_VERSION,
        "verdict": verdict,
        "ignored": dict(survey.ignored),
        "frames": sorted(frames, key=lambda f: f["path"]),
        "flights": survey.flights,
        "payloads": survey.payloads,
        "profiles": [_profile(p, odm_ids, done) for p in survey.profiles],
        "findings": tuple(findings),
        "actions": [_action(a, plan.luts, gain_of.get((a.profile, a.flight))) for a in plan.actions],
        "bands": bands_record(done.bands),
        "subprojects": done.subprojects,
        "odm": {"projects": 1, "notes": list(odm_notes)} if odm_ids else None,
        "thresholds": {
            "changed": {
                f.name: getattr(thresholds, f.name)
                for f in dataclasses.fields(thresholds)
                if getattr(thresholds, f.name) != getattr(DEFAULTS, f.name)
            },
            "all": thresholds,
        },
        "versions": versions(),
        "inputs": {
            "paths": list(paths),
            "digest": digest_of(survey, options),
            "options": dict(options),
            "gcp": list(gcp_points),
            "elevation": survey.elevation,
        },
    }
    plain: Dict[str, Any] = to_plain(report)
    return plain


def _round(value: Optional[float], digits: int) -> Optional[float]:
    return None if value is None or not math.isfinite(value) else round(value, digits)


def _frame(
    placed: SurveyFrame,
    file: Frame,
    odm_ids: Mapping[str, str],
    gps_sigma: Mapping[str, Tuple[float, float]],
    home: Mapping[str, str],
    action_of: Mapping[str, FlightAction],
    done: Written,
) -> Dict[str, Any]:
    copy = done.copies.get(placed.path) if placed.path in done.outputs else None
    retagged = copy is not None and copy.how not in ("linked", "copied")
    scale = copy.scale if copy is not None else None
    sigma = gps_sigma.get(placed.path)
    focal = placed.intrinsics
    return {
        "path": placed.path,
        "subproject": home.get(placed.path),
        "output": done.outputs.get(placed.path),
        "reason": None if placed.path in home else placed.excluded,
        "profile": placed.profile,
        "flight": placed.flight,
        "payload": placed.payload,
        "role": placed.role,
        "spectrum": placed.spectrum,
        "band": placed.band,
        "capture": placed.capture,
        "make": file.make,
        "model": file.model,
        "serial": file.serial,
        "width": file.width,
        "height": file.height,
        "focal_mm": focal.focal_mm,
        "focal_source": focal.focal_source,
        "sensor_width_mm": _round(focal.sensor_width_mm, 6),
        "sensor_width_source": focal.sensor_width_source,
        "altitude_m": file.altitude_m,
        "height_m": placed.height_m,
        "height_source": placed.height_source,
        "gsd_cm": _round(placed.gsd_cm, 6),
        "gsd_after_cm": _round(placed.gsd_cm / scale, 6) if placed.gsd_cm and scale else None,
        "latitude": file.latitude,
        "longitude": file.longitude,
        "gps": {
            "rtk_fixed": is_rtk_fixed(file.rtk_flag),
            "rtk_flag": file.rtk_flag,
            "sigma_horizontal_m": sigma[0] if sigma else None,
            "sigma_vertical_m": sigma[1] if sigma else None,
            "relative_altitude_m": file.relative_altitude_m,
            "yaw_deg": file.yaw_deg,
            "pitch_deg": file.pitch_deg,
            "time": file.time,
        }
        if file.has_gps
        else None,
        "odm_camera_id": odm_ids.get(placed.path),
        "intrinsics_notes": list(focal.notes),
        "original_tags": {
            "focal_mm": file.focal_mm,
            "focal_35mm": file.focal_35mm,
            "focal_plane_x_res": file.focal_plane_x_res,
            "focal_plane_y_res": file.focal_plane_y_res,
            "focal_plane_unit": file.focal_plane_unit,
        }
        if retagged
        else None,
        "change": {"how": copy.how, "scale": copy.scale, "width": copy.width, "height": copy.height} if copy else None,
    }


def _broken_frame(path: str, code: str) -> Dict[str, Any]:
    nothing = dict.fromkeys(_FRAME_FACTS)
    return {"path": path, **nothing, "role": "broken", "reason": code}


def _profile(profile: CameraProfile, odm_ids: Mapping[str, str], done: Written) -> Dict[str, Any]:
    plain: Dict[str, Any] = to_plain(profile)
    plain["odm_camera_ids"] = sorted({odm_ids[p] for p in profile.frames if p in odm_ids})
    if profile.id in done.locks:
        plain["lock"], plain["lock_reason"] = done.locks[profile.id]
    return plain


def _gains(plan: HarmonizePlan, thresholds: Thresholds) -> Dict[Tuple[str, str], Dict[str, Any]]:
    """(profile, flight) -> what resampling brings and costs, ODM's part with it."""
    odm = loads(plan.gains, thresholds)
    told: Dict[Tuple[str, str], Dict[str, Any]] = {}
    for gain in plan.gains:
        key = (gain.profile, gain.flight)
        native, resampled = odm[key]
        told[key] = {
            "ratio": round(gain.ratio, 4),
            "trigger": round(gain.trigger, 4),
            "chosen": gain.chosen,
            "native": _outcome(gain.native, native),
            "resampled": _outcome(gain.resampled, resampled),
        }
    return told


def _outcome(outcome: Outcome, odm: OdmLoad) -> Dict[str, Any]:
    return {
        "scale": outcome.scale,
        "width": outcome.width,
        "height": outcome.height,
        "inliers": round(outcome.inliers, 3),
        "megapixels": round(outcome.megapixels, 1),
        "size_bytes": outcome.size_bytes,
        "odm_inliers": round(odm.inliers, 3),
        "odm_feature_px": odm.feature_px,
        "odm_undistorted_px": odm.undistorted_px,
    }


def _action(action: FlightAction, luts: Sequence[Lut], gain: Optional[Mapping[str, Any]]) -> Dict[str, Any]:
    table = next((t for t in luts if t.id == action.lut), None)
    return {
        "profile": action.profile,
        "flight": action.flight,
        "frames": len(action.frames),
        "gsd_before_cm": _round(action.gsd_cm, 6),
        "gsd_after_cm": _round(action.gsd_cm / action.scale, 6) if action.gsd_cm else None,
        "scale": action.scale,
        "width": action.width,
        "height": action.height,
        "out_width": action.out_width,
        "out_height": action.out_height,
        "focal_mm": action.focal_mm,
        "lut": {
            "id": table.id,
            "offset_dn": table.offset_dn,
            "reference": table.reference,
            "written": action.write_lut,
            "frames_sampled": table.frames_sampled,
        }
        if table
        else None,
        "reasons": list(action.reasons),
        "gain": gain,
    }


def pair_medians(pairs: Sequence[Tuple[str, str, int]]) -> List[Dict[str, Any]]:
    """(payload a, payload b, inliers) per frame pair -> medians per payload pair, in order."""
    by_pair: Dict[Tuple[str, str], List[int]] = defaultdict(list)
    for a, b, inliers in pairs:
        by_pair[(min(a, b), max(a, b))].append(inliers)
    return [
        {"a": a, "b": b, "pairs": len(values), "inliers_median": sorted(values)[(len(values) - 1) // 2]}
        for (a, b), values in sorted(by_pair.items())
    ]
