"""Calibrations that the survey itself speaks against (pure)."""

from __future__ import annotations

from typing import Iterable, List, Mapping, Sequence, Set, Tuple

from .align.model import LockDecision
from .finding import WARNING, Finding
from .intrinsics import STORED
from .profile import CameraProfile
from .thresholds import Thresholds

_WORDS = {
    "user-sheet": "the calibration file",
    "sheet": "the kept calibration sheet",
    STORED: "the stored calibration",
}
# Findings that compare with the profile's best source, and say nothing once it is refuted.
_BUILT_ON_IT = "odm-focal-off"


def overruled(
    decisions: Iterable[LockDecision], profiles: Sequence[CameraProfile], limits: Thresholds
) -> Tuple[Finding, ...]:
    """Return a finding per profile whose chosen focal lies off that of a trusted source it has."""
    at = {p.id: p for p in profiles}
    found: List[Finding] = []
    for decision in sorted(decisions, key=lambda d: d.profile):
        profile = at.get(decision.profile)
        given = profile.intrinsics if profile else None
        if profile is None or given is None or not given.focal_trusted or given.focal_ratio is None:
            continue
        known = given.focal_ratio * profile.width / max(profile.width, profile.height)
        gap = known / decision.focal_ratio - 1.0
        if round(abs(gap), 6) <= limits.focal_source_gap:
            continue
        whose = _WORDS.get(given.focal_source, f"the calibration in its metadata ({given.focal_source})")
        found.append(
            Finding(
                code="sheet-contradicted",
                severity=WARNING,
                subjects=(profile.id,),
                message=f"For {profile.id} {whose} says a focal of {known:.4f} of the longer side, {gap:+.1%} off the "
                f"{decision.focal_ratio:.4f} that the survey shows ({decision.reason}).",
                remedy="Check focal, sensor width and picture size of this camera there. The project takes what the "
                "survey shows.",
                measured=round(abs(gap), 4),
                threshold=limits.focal_source_gap,
            )
        )
    return tuple(found)


def still_true(findings: Sequence[Finding], refuted: Sequence[Finding], profile_of: Mapping[str, str]) -> List[Finding]:
    """Leave out what was said on the strength of a refuted source; ``profile_of`` is path -> profile."""
    wrong: Set[str] = {s for f in refuted for s in f.subjects}
    return [f for f in findings if f.code != _BUILT_ON_IT or not {profile_of.get(s, "") for s in f.subjects} <= wrong]
