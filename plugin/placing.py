"""From what was proven to ODM projects on disk: names, frames, calibration, ground control, options."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ..stages.align.judge import FAIL
from ..stages.align.model import AlignmentReport, LockDecision
from ..stages.assemble import Group
from ..stages.errors import SensorgateError
from ..stages.finding import Finding
from ..stages.flights import PANEL
from ..stages.gate import is_rtk_fixed
from ..stages.grouping import slug
from ..stages.harmonize.bands_model import APPLIED, VOIDED
from ..stages.harmonize.model import HarmonizedFrame
from ..stages.intrinsics import SOURCES, Intrinsics
from ..stages.profile import CameraProfile
from ..stages.read import read_frame
from ..stages.record import to_plain
from ..stages.route import ProvenGroup
from ..stages.survey import Survey
from ..stages.thresholds import Thresholds
from .advice import advice
from .harmonizing import Harmonized
from .inspection import Inspection
from .odm.bands import band_name
from .odm.camera_id import camera_id, file_key
from .odm.cameras import CalibrationPlan, CameraDecision, ProjectFrame, calibration_for, decision_from_intrinsics
from .odm.cameras_file import check_cameras_file
from .odm.names import mask_name
from .odm.options import OptionNeeds, as_node_options, options_for
from .odm.project import OURS, write_project
from .report.build import SubProject, Written, pair_medians


@dataclass(frozen=True)
class Placed:
    """One proven group inside the group of frames that it came from."""

    group: Group
    proven: ProvenGroup


@dataclass(frozen=True)
class Placing:
    """The written projects in the report's terms, and what is to be said about them."""

    record: Written
    findings: Tuple[Finding, ...]


def without_alignment(group: Group, survey: Survey) -> List[Placed]:
    """A group that no alignment looked at: one unproven project per group."""
    proven = ProvenGroup(
        name=group.name,
        payloads=group.payloads,
        frames=group.solver_frames,
        route="unproven",
        reasons=("No alignment was run: these frames are grouped by their metadata alone.",),
    )
    return [Placed(group, proven)]


def project_names(placed: Sequence[Placed], survey: Survey) -> Tuple[str, ...]:
    """One folder name per project: the spectrum where it has one project only, else with its largest payload."""
    payload_of = {f.path: f.payload for f in survey.frames}
    count: Dict[str, int] = {}
    for item in placed:
        count[item.group.spectrum] = count.get(item.group.spectrum, 0) + 1
    names: List[str] = []
    for item in placed:
        spectrum = item.group.spectrum
        name = spectrum
        if count[spectrum] > 1:
            size = Counter(payload_of[p] for p in item.proven.frames)
            largest = min(size, key=lambda p: (-size[p], p))
            first = slug(largest.replace("/rig", "").replace(f"/{spectrum}", ""))
            band = f"-{slug(item.group.lone_band)}" if item.group.lone_band else ""
            name = f"{spectrum}-{first}"[: 60 - len(band)].rstrip("-.") + band
        unique, number = name, 1
        while unique in names:
            number += 1
            unique = f"{name}-{number}"
        names.append(unique)
    return tuple(names)


def frames_of(item: Placed, survey: Survey) -> Tuple[str, ...]:
    """All frames of a proven group: those that the solver saw and the other bands of their captures."""
    at = {f.path: f for f in survey.frames}
    seen = set(item.proven.frames)
    captures = {(at[p].payload, at[p].capture) for p in seen}
    rigs = {p.id for p in survey.payloads if len(p.profiles) > 1}
    return tuple(
        p
        for p in item.group.frames
        if p in seen or (at[p].payload in rigs and (at[p].payload, at[p].capture) in captures)
    )


def believed(proven: ProvenGroup, profiles: Sequence[CameraProfile]) -> Tuple[LockDecision, ...]:
    """The alignment's decisions that a project may be built on.

    A focal that a contradicted alignment solved shows nothing of the lens:
    where any source says a focal, that one stands.
    """
    if proven.alignment is None or proven.alignment.verdict != FAIL:
        return proven.locked
    said = {p.id for p in profiles if p.intrinsics.focal_ratio is not None}
    return tuple(d for d in proven.locked if d.profile not in said or _focal_source(d.source) != "solved")


def _decisions(proven: ProvenGroup, profiles: Sequence[CameraProfile]) -> Dict[str, CameraDecision]:
    """What is known of each profile's camera: what the alignment decided, else its own best source."""
    decided: Dict[str, CameraDecision] = {}
    holds = {h.profile: h for h in believed(proven, profiles)}
    doubted = {h.profile for h in proven.locked} - set(holds)
    for profile in profiles:
        hold = holds.get(profile.id)
        # The solver works with Brown's model: of a fisheye lens its own calibration says more.
        if hold is not None and profile.intrinsics.projection != "fisheye":
            decided[profile.id] = CameraDecision(
                profile=profile.id,
                focal_ratio=hold.focal_ratio * max(profile.width, profile.height) / profile.width,
                focal_source=_focal_source(hold.source),
                center_ratio=hold.center_ratio,
                distortion=hold.distortion,
                projection=profile.intrinsics.projection,
                lock=hold.hold,
                reason=hold.reason,
                aspect_ratio=hold.aspect_ratio,
            )
        else:
            focal: Intrinsics = profile.intrinsics
            hold_it = focal.complete and profile.id not in doubted
            why = f"{profile.id}: focal and distortion from {focal.focal_source}" if hold_it else ""
            decided[profile.id] = decision_from_intrinsics(profile.id, focal, lock=hold_it, reason=why)
    return decided


def _focal_source(text: str) -> str:
    """The focal's source out of a decision's words; what the alignment found by itself is ``solved``."""
    return next((word for word in text.replace(",", " ").split() if word in SOURCES), "solved")


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:
        beside = target.with_name(f".part-{target.name}")
        shutil.copy2(source, beside)
        os.replace(beside, target)


def place(placed: Sequence[Placed], inspection: Inspection, ready: Harmonized, result: Path) -> Placing:
    """Write every project into ``result/projects``; what an earlier try left there is replaced."""
    copies = ready.copies
    root = result / "projects"
    if root.exists():
        shutil.rmtree(root)
    ordered = sorted(placed, key=lambda i: (i.group.name, i.proven.payloads, i.proven.frames))
    projects: List[SubProject] = []
    findings: List[Finding] = []
    outputs: Dict[str, str] = {}
    locks: Dict[str, Tuple[bool, str]] = {}
    for name, item in zip(project_names(ordered, inspection.survey), ordered):
        paths = frames_of(item, inspection.survey)
        if not paths:
            raise SensorgateError(f"The project {name} would have no frame. Please report this.")
        _fill_images(root / name / "images", paths, copies, inspection.masks)
        outputs.update({p: f"projects/{name}/images/{copies[p].name}" for p in paths})
        project, said, held = _decide(name, item, paths, inspection, ready, root / name)
        _keep_panels(root / name, project.payloads, inspection.survey)
        projects.append(project)
        findings.extend(said)
        locks.update(held)
    known = zip((p.name for p in projects), ordered)
    findings.extend(
        advice(
            [(name, i.group.spectrum, i.group.area, i.proven) for name, i in known],
            inspection.settings.gcp is not None,
            inspection.settings.thresholds,
        )
    )
    record = Written(tuple(projects), outputs, {p: copies[p] for p in outputs}, locks, ready.bands)
    return Placing(record, tuple(findings))


def _fill_images(
    images: Path, paths: Sequence[str], copies: Mapping[str, HarmonizedFrame], masks: Mapping[str, str]
) -> None:
    """Link the harmonized frames and their masks into the project."""
    images.mkdir(parents=True)
    for path in paths:
        copy = copies[path]
        _link(Path(copy.file), images / copy.name)
        if path in masks and copy.how != "warped":  # ODM reads the masks of the primary band only
            name = mask_name(copy.name, Path(masks[path]).name)
            mask = Path(copy.file).with_name(name)
            if mask.is_file():  # one that could not be written has its finding
                _link(mask, images / name)


def _keep_panels(folder: Path, payloads: Sequence[str], survey: Survey) -> None:
    """Put the calibration panel captures of a project's payloads beside it, for who wants reflectance."""
    for frame in survey.frames:
        if frame.role == PANEL and frame.payload in payloads:
            shelf = folder / OURS / "panels"
            shelf.mkdir(parents=True, exist_ok=True)
            target = shelf / f"{slug(frame.flight)}_{Path(frame.path).name}"
            if not target.exists():
                _link(Path(frame.path), target)


def _decide(
    name: str,
    item: Placed,
    paths: Sequence[str],
    inspection: Inspection,
    ready: Harmonized,
    folder: Path,
) -> Tuple[SubProject, List[Finding], Dict[str, Tuple[bool, str]]]:
    """Decide calibration, ground control and options of one project and write them."""
    survey, settings = inspection.survey, inspection.settings
    at = {f.path: f for f in survey.frames}
    copies, seen = ready.copies, set(item.proven.frames)
    headers = [ProjectFrame(read_frame(folder / "images" / copies[p].name, p), at[p].profile, p in seen) for p in paths]
    used = {at[p].profile for p in paths}
    profiles = [p for p in survey.profiles if p.id in used]
    decisions = _decisions(item.proven, profiles)
    # Bands beside the primary take its pose and camera over in ODM; only the primary's camera is solved.
    solver = [h for h in headers if h.primary]
    solved = {h.profile for h in solver}
    calibration = calibration_for(solver, decisions, settings.thresholds)
    ground = inspection.control.for_project(
        name,
        paths,
        copies,
        survey,
        settings.thresholds,
        primary={h.frame.path for h in solver},
        fit=item.proven.alignment.control if item.proven.alignment else None,
    )
    own = set(paths)
    fixed = all(is_rtk_fixed(h.frame.rtk_flag) for h in headers)
    bands = _bands_of(headers, item, survey, ready)
    needs = OptionNeeds(
        lock=calibration.lock,
        cameras_cover_all=calibration.covers_all,
        # No solver figure may stand in odm.sh: it is equal byte for byte between runs.
        lock_reason="; ".join(sorted({d.reason for p, d in decisions.items() if d.lock and p in solved})),
        bands_aligned=bands.aligned,
        primary_band=bands.primary,
        radiometry_applied=bands.radiometry == APPLIED,
        radiometry_changed=bands.radiometry == VOIDED
        or any(a.radiometric_none and own & set(a.frames) for a in inspection.assessed.plan.actions),
        has_gcp=ground.gcp_text is not None,
        force_gcp=settings.force_gcp,
        keep_gps=ground.gcp_text is not None and not settings.force_gcp and fixed,
        gps_accuracy_m=ground.accuracy_m,
        geo_has_accuracies=ground.geo_text is not None,
    )
    options = options_for(needs)
    alignment = _alignment(item.proven, survey, settings.thresholds)
    write_project(
        folder,
        options=options,
        gcp_text=ground.gcp_text,
        geo_text=ground.geo_text,
        calibration=dict(calibration.cameras) or None,
        alignment=alignment,
        notes=(f"route: {item.proven.route}",),
    )
    unheld = "no trusted calibration to hold" if not calibration.lock else ""
    record = SubProject(
        name=name,
        spectrum=item.group.spectrum,
        frames=tuple(paths),
        payloads=tuple(sorted({at[p].payload for p in paths})),
        route=item.proven.route,
        reasons=item.proven.reasons,
        options=tuple({**o, "reason": r.reason} for o, r in zip(as_node_options(options), options)),
        alignment=alignment,
        gcp={"points": ground.gcp_points, "images": ground.gcp_images} if ground.gcp_text else None,
        calibration=_calibration_rows(solver, decisions, calibration),
    )
    locks = {p.id: (calibration.lock and p.id in solved, decisions[p.id].reason or unheld) for p in profiles}
    checked = check_cameras_file(dict(calibration.cameras), [camera_id(h.frame) for h in headers])
    return record, [*calibration.findings, *checked, *ground.findings], locks


@dataclass(frozen=True)
class _Bands:
    """What laying the bands on each other means for one project."""

    aligned: bool = False
    primary: Optional[str] = None
    radiometry: str = ""


def _bands_of(headers: Sequence[ProjectFrame], item: Placed, survey: Survey, ready: Harmonized) -> _Bands:
    """Aligned where every band beside the primary was laid on it or lay there already."""
    payload_of = {f.path: f.payload for f in survey.frames}
    rigs = {r.payload: r for r in ready.bands.rigs}
    beside = [h for h in headers if not h.primary]
    plans = [rigs.get(payload_of[h.frame.path]) for h in beside]
    if not beside or not all(plan and h.profile in plan.aligned for h, plan in zip(beside, plans)):
        return _Bands()
    first = next(h for h in headers if h.primary)
    radiometry = {plan.radiometry for plan in plans if plan}
    return _Bands(
        aligned=True,
        primary=band_name(first.frame),
        radiometry=VOIDED if VOIDED in radiometry else APPLIED if APPLIED in radiometry else "",
    )


def _calibration_rows(
    headers: Sequence[ProjectFrame], decisions: Mapping[str, CameraDecision], plan: CalibrationPlan
) -> Tuple[Mapping[str, Any], ...]:
    rows: Dict[Tuple[str, str], Mapping[str, Any]] = {}
    for header in headers:
        identity = file_key(camera_id(header.frame))
        decision = decisions.get(header.profile)
        if decision is None:
            continue
        ratio = decision.focal_ratio
        scale = header.frame.width / max(header.frame.width, header.frame.height)
        rows[(header.profile, identity)] = {
            "profile": header.profile,
            "camera_id": identity,
            "focal_ratio": round(ratio * scale, 8) if ratio is not None else None,
            "aspect_ratio": round(decision.aspect_ratio, 8),
            "source": decision.focal_source,
            "held": plan.lock and identity in plan.cameras,
            "reason": decision.reason,
        }
    return tuple(rows[k] for k in sorted(rows))


def _rounded(value: Optional[float], digits: int = 4) -> Optional[float]:
    return None if value is None else round(value, digits)


def _alignment(proven: ProvenGroup, survey: Survey, limits: Thresholds) -> Optional[Dict[str, Any]]:
    """The figures of the alignment in the report's shape, rounded to what repeats."""
    found: Optional[AlignmentReport] = proven.alignment
    if found is None:
        return None
    payload_of = {f.path: f.payload for f in survey.frames}
    horizontal, vertical = found.gps.horizontal_m, found.gps.vertical_m
    total = None if horizontal is None or vertical is None else (horizontal**2 + vertical**2) ** 0.5
    sigma_h, sigma_v = found.gps.sigma_horizontal_m, found.gps.sigma_vertical_m
    return {
        "registered": found.registered,
        "frames": len(found.frames),
        "components": found.components,
        "mean_reproj_error_px": _rounded(found.mean_reproj_error_px),
        "gps_rmse_m": _rounded(total),
        "height_m": _rounded(found.height_m, 3),
        "bowing_m": _rounded(found.bowing.bowing_m),
        "bowing_se_m": _rounded(found.bowing.se_m),
        "engine": found.engine,
        "rung": found.rung,
        "anchor": found.anchor,
        "gps_horizontal_m": _rounded(horizontal),
        "gps_vertical_m": _rounded(vertical),
        "gps_limit_horizontal_m": None if sigma_h is None else _rounded(limits.gps_sigma_factor * sigma_h),
        "gps_limit_vertical_m": None if sigma_v is None else _rounded(limits.gps_sigma_factor * sigma_v),
        "bowing_radius_m": _rounded(found.bowing.radius_m, 2),
        "median_inliers": found.median_inliers,
        "payloads": to_plain(found.payloads),
        "pairs": pair_medians([(payload_of[p.a], payload_of[p.b], p.inliers) for p in found.pairs]),
        "candidates": to_plain(found.candidates),
        "residuals": [
            {
                "path": f.path,
                "east_m": _rounded(f.gps_residual_m[0], 3),
                "north_m": _rounded(f.gps_residual_m[1], 3),
                "up_m": _rounded(f.gps_residual_m[2], 3),
            }
            for f in found.frames
            if f.gps_residual_m is not None
        ],
        "unregistered": [f.path for f in found.frames if not f.registered],
        "notes": list(found.notes),
        "control": None if found.control is None else to_plain(found.control),
    }
