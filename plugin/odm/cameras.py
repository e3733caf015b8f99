"""The cameras file of a project: what ODM is told of each camera, and whether it may be locked.

ODM finds an entry by the id that it computes itself (``camera_id``); a key
that matches nothing changes nothing and says nothing, so every key that is
written is checked (``cameras_file``). Its lock is for all cameras at once and holds at zero distortion what
the file does not give.

OpenSfM divides by max(width, height), both focals alike; ``Intrinsics.focal_ratio`` is focal over
width. On portrait frames the two differ, and ODM's own focal (a tag over the
width) is then wrong by the aspect.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.finding import INFO, WARNING, Finding, sort_key
from ...stages.focals import both_focals
from ...stages.frame import Frame
from ...stages.intrinsics import SOURCES, TRUSTED, Intrinsics
from ...stages.thresholds import DEFAULTS, Thresholds
from .camera_id import OdmFocal, camera_id, file_key, odm_focal_ratio

# Where ODM's own focal stands among our sources.
_ODM_RANK = {
    "focal-plane": SOURCES.index("focal-plane"),
    "equivalent-35mm": SOURCES.index("equivalent-35mm"),
    "sensor-table": SOURCES.index("generic-width"),
    "default": SOURCES.index("unknown"),
    "crash": SOURCES.index("unknown"),
}
# A focal that our own alignment found is better than a rounded equivalent, not better than a calibration.
_SOLVED_RANK = SOURCES.index("equivalent-35mm")
_LOCKABLE = frozenset((*TRUSTED, "solved"))
_DIGITS = 8
# Coefficients of OpenSfM's fisheye_opencv that ODM lets through.
_FISHEYE = 3


@dataclass(frozen=True)
class CameraDecision:
    """What was decided for a profile's camera.

    ``focal_ratio`` is focal over width of the frame as stored,
    ``center_ratio`` principal point minus centre over max(width, height),
    ``distortion`` k1, k2, p1, p2, k3 or ``None`` (not known), ``aspect_ratio``
    focal down over focal across (fy / fx), whose mean ``focal_ratio`` is of.
    ``focal_source`` is one of ``intrinsics.SOURCES`` or ``solved``. ``lock``
    asks to hold the camera; ``reason`` says why.
    """

    profile: str
    focal_ratio: Optional[float]
    focal_source: str
    center_ratio: Tuple[float, float] = (0.0, 0.0)
    distortion: Optional[Tuple[float, ...]] = None
    projection: str = "brown"
    lock: bool = False
    reason: str = ""
    aspect_ratio: float = 1.0


@dataclass(frozen=True)
class ProjectFrame:
    """A frame as ODM will find it in the project.

    ``frame`` is the header of the written file; where it is not written yet,
    the header of the original with ``width``, ``height`` and the tags that
    harmonizing will set (see ``camera_id``). ``primary`` is false for the
    bands that ODM keeps out of its solver.
    """

    frame: Frame
    profile: str
    primary: bool = True
    width: Optional[int] = None
    height: Optional[int] = None
    focal_mm: Optional[float] = None
    focal_35mm: Optional[float] = None
    focal_plane_scale: float = 1.0

    @property
    def size(self) -> Tuple[int, int]:
        """Width and height in pixels as ODM will decode them."""
        return self.width or self.frame.width, self.height or self.frame.height

    @property
    def camera_id(self) -> str:
        """The id that ODM will compute, ``""`` where it would die."""
        return camera_id(self.frame, *self.size, self.focal_mm, self.focal_35mm, self.focal_plane_scale)

    @property
    def odm_focal(self) -> OdmFocal:
        """The focal ratio that ODM will compute."""
        return odm_focal_ratio(self.frame, *self.size, self.focal_mm, self.focal_35mm, self.focal_plane_scale)


@dataclass(frozen=True)
class CameraUse:
    """One id of the project: its size, who uses it, and what ODM would take for its focal."""

    id: str
    width: int
    height: int
    profiles: Tuple[str, ...]
    frames: int
    primary: bool
    odm_focal: OdmFocal


@dataclass(frozen=True)
class CalibrationPlan:
    """The cameras file of a project (``cameras`` is empty where none is needed) and the lock.

    ``covers_all`` is set where every camera that enters ODM's solver has an
    entry made from a camera that may be held.
    """

    cameras: Mapping[str, Mapping[str, Any]]
    lock: bool
    covers_all: bool
    reason: str
    uses: Tuple[CameraUse, ...]
    findings: Tuple[Finding, ...] = ()


def decision_from_intrinsics(
    profile: str, intrinsics: Intrinsics, lock: bool = False, reason: str = ""
) -> CameraDecision:
    """A decision that takes the profile's intrinsics as they are."""
    return CameraDecision(
        profile=profile,
        focal_ratio=intrinsics.converted_focal_ratio or intrinsics.focal_ratio,
        focal_source=intrinsics.focal_source,
        center_ratio=intrinsics.center_ratio or (0.0, 0.0),
        distortion=intrinsics.distortion,
        projection=intrinsics.projection,
        lock=lock,
        reason=reason,
        aspect_ratio=intrinsics.aspect_ratio,
    )


def camera_uses(frames: Sequence[ProjectFrame]) -> Tuple[CameraUse, ...]:
    """The distinct ids of a project, sorted; frames on which ODM would die are left out."""
    grouped: Dict[str, List[ProjectFrame]] = defaultdict(list)
    for item in frames:
        if item.camera_id:
            grouped[item.camera_id].append(item)
    return tuple(
        CameraUse(
            id=identity,
            width=members[0].size[0],
            height=members[0].size[1],
            profiles=tuple(sorted({m.profile for m in members})),
            frames=len(members),
            primary=any(m.primary for m in members),
            odm_focal=members[0].odm_focal,
        )
        for identity, members in sorted(grouped.items())
    )


def entry(decision: CameraDecision, width: int, height: int) -> Optional[Dict[str, Any]]:
    """One camera in ODM's format, ``None`` where its model cannot be said in it.

    ODM drops a fourth fisheye coefficient: a fisheye lens has an entry where
    three say it.
    """
    if decision.focal_ratio is None:
        return None
    across, down = both_focals(decision.focal_ratio * width / max(width, height), decision.aspect_ratio)
    common = {
        "width": width,
        "height": height,
        "focal_x": round(across, _DIGITS),
        "focal_y": round(down, _DIGITS),
        "c_x": round(decision.center_ratio[0], _DIGITS),
        "c_y": round(decision.center_ratio[1], _DIGITS),
    }
    bend = decision.distortion
    names: Tuple[str, ...]
    if decision.projection == "fisheye" and bend is not None and len(bend) == _FISHEYE:
        kind, names = "fisheye_opencv", ("k1", "k2", "k3")
    elif decision.projection in ("brown", "perspective"):
        kind, names = "brown", ("k1", "k2", "p1", "p2", "k3")
        bend = (*(bend or ()), 0.0, 0.0, 0.0, 0.0, 0.0)
    else:
        return None
    return {"projection_type": kind, **common, **{name: round(value, _DIGITS) for name, value in zip(names, bend)}}


def own_focal_gap(
    own: OdmFocal, focal_ratio: Optional[float], focal_source: str, size: Tuple[int, int]
) -> Optional[float]:
    """How far ODM's own focal lies from one of a source at least as good, as a ratio; ``None`` without such a source.

    ``focal_ratio`` is to the width; ``size`` is width and height, for OpenSfM means the longer side.
    """
    rank = _SOLVED_RANK if focal_source == "solved" else SOURCES.index(focal_source)
    if focal_ratio is None or own.ratio is None or own.how == "default" or rank > _ODM_RANK[own.how]:
        return None
    better = focal_ratio * size[0] / max(size)
    return abs(own.ratio - better) / better


def why_entry(use: CameraUse, decision: CameraDecision, thresholds: Thresholds = DEFAULTS) -> str:
    """Why ODM must be told this camera's focal even without a lock; ``""`` where its own will do."""
    own = use.odm_focal
    if decision.focal_ratio is None or decision.focal_source == "unknown":
        return ""
    if own.how == "default":
        return "ODM would silently take 0.85 for its focal"
    gap = own_focal_gap(own, decision.focal_ratio, decision.focal_source, (use.width, use.height))
    if gap is not None and gap > thresholds.focal_source_gap:
        better = decision.focal_ratio * use.width / max(use.width, use.height)
        return f"ODM's own focal ({own.ratio:.4f}) lies {gap:.1%} from the better one ({better:.4f})"
    return ""


def _choose(
    use: CameraUse,
    decisions: Mapping[str, CameraDecision],
    counts: Mapping[Tuple[str, str], int],
    thresholds: Thresholds,
) -> Tuple[Optional[CameraDecision], bool, Optional[Finding]]:
    """The decision for one id, whether all its profiles can live with it, and what to say if not."""
    known = [decisions[p] for p in use.profiles if p in decisions and decisions[p].focal_ratio is not None]
    if not known:
        return None, False, None
    chosen = max(known, key=lambda d: (counts[use.id, d.profile], d.profile))
    ratios = [d.focal_ratio for d in known if d.focal_ratio is not None]
    spread = (max(ratios) - min(ratios)) / min(ratios)
    if spread <= thresholds.solved_focal_gap:
        return chosen, len(known) == len(use.profiles), None
    return (
        chosen,
        False,
        Finding(
            code="odm-cameras-merged",
            severity=WARNING,
            subjects=use.profiles,
            message=f"ODM sees one camera ({file_key(use.id)}) in {len(use.profiles)} profiles whose focals lie "
            f"{spread:.1%} apart.",
            remedy="Give each of these profiles its own project; within one, ODM can only average them.",
            measured=round(spread, 4),
            threshold=thresholds.solved_focal_gap,
        ),
    )


def calibration_for(
    frames: Sequence[ProjectFrame], decisions: Mapping[str, CameraDecision], thresholds: Thresholds = DEFAULTS
) -> CalibrationPlan:
    """The cameras file and the lock of one project.

    Without a lock an entry is written where ODM's own focal would be its
    default or lies beyond ``focal_source_gap`` from a source at least as good.
    The lock is set only if every profile in the solver asks for it and every
    id has an entry; otherwise the profiles that asked are named in a finding.
    """
    uses = camera_uses(frames)
    counts: Dict[Tuple[str, str], int] = defaultdict(int)
    for item in frames:
        counts[item.camera_id, item.profile] += 1
    findings: List[Finding] = []
    chosen: Dict[str, CameraDecision] = {}
    coverable = bool(uses) and all(item.camera_id for item in frames)
    for use in uses:
        decision, agreed, finding = _choose(use, decisions, counts, thresholds)
        if finding is not None:
            findings.append(finding)
        if decision is not None and use.odm_focal.sure and entry(decision, use.width, use.height) is not None:
            chosen[use.id] = decision
            fit = agreed and decision.distortion is not None and decision.focal_source in _LOCKABLE
        else:
            fit = False
            if decision is not None:
                findings.append(_not_said(use, decision))
        coverable = coverable and (fit or not use.primary)

    solver_profiles = sorted({p for use in uses if use.primary for p in use.profiles})
    asking = [p for p in solver_profiles if p in decisions and decisions[p].lock]
    lock = coverable and bool(asking) and asking == solver_profiles
    if asking and not lock:
        findings.append(_lock_refused(asking, [p for p in solver_profiles if p not in asking]))

    cameras: Dict[str, Mapping[str, Any]] = {}
    reasons: List[str] = []
    for use in uses:
        decision = chosen.get(use.id)
        why = "" if decision is None else why_entry(use, decision, thresholds)
        made = None if decision is None or not (lock or why) else entry(decision, use.width, use.height)
        if made is not None:
            cameras[file_key(use.id)] = made
            reasons += [f"{file_key(use.id)}: {why}"] if why else []
    if lock:
        reasons.insert(0, "; ".join(sorted({decisions[p].reason or "to be held" for p in asking})))
    return CalibrationPlan(cameras, lock, coverable, "; ".join(reasons), uses, tuple(sorted(findings, key=sort_key)))


def _not_said(use: CameraUse, decision: CameraDecision) -> Finding:
    if not use.odm_focal.sure:
        return Finding(
            code="odm-camera-id-unsure",
            severity=WARNING,
            subjects=use.profiles,
            message=f"ODM's id of this camera hangs on its own sensor table ({use.odm_focal.why}), "
            "so no calibration can be addressed to it.",
            remedy="Let sensorgate write the 35 mm focal into the project's copies; then the id is certain.",
        )
    return Finding(
        code="odm-camera-model-not-expressible",
        severity=INFO,
        subjects=use.profiles,
        message=f"The calibration of {decision.profile} is a {decision.projection} model, which ODM's cameras file "
        "cannot carry whole.",
        remedy="Nothing to do: ODM solves this lens itself.",
    )


def _lock_refused(asking: Sequence[str], others: Sequence[str]) -> Finding:
    reason = f"{', '.join(others)} cannot be held" if others else "a camera of the project has no full calibration"
    return Finding(
        code="odm-lock-refused",
        severity=WARNING,
        subjects=tuple(asking),
        message=f"The intrinsics should be locked, but ODM locks all cameras of a project at once and {reason}.",
        remedy="Give the profiles that must be locked their own project, or a calibration to all of them.",
    )
