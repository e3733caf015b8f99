"""The gate: what is wrong with this survey, and what follows from it.

``assess`` runs every rule over a survey. A rule (``rules/``) is a pure
generator of findings; it reads the survey and the thresholds and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence, Tuple, Union

from .finding import ERROR, Finding, sort_key
from .harmonize.model import HarmonizePlan
from .harmonize.plan import plan as plan_harmonizing
from .rules import Rule, cameras, files, flights, ground, positions, rigs
from .rules.files import cut_short
from .rules.positions import gps_outliers, is_rtk_fixed
from .rules.rigs import incomplete_captures, kept_bands, rig_kind
from .rules.text import listed, plural
from .survey import Survey
from .thresholds import Thresholds

__all__ = [
    "BLOCKED",
    "CONSISTENT",
    "INCONSISTENT",
    "RULES",
    "GateReport",
    "assess",
    "cut_short",
    "gps_outliers",
    "incomplete_captures",
    "is_rtk_fixed",
    "kept_bands",
    "listed",
    "plural",
    "rig_kind",
    "verdict_of",
]

CONSISTENT, INCONSISTENT, BLOCKED = "consistent", "inconsistent", "blocked"

RULES: Tuple[Rule, ...] = (
    files.broken,
    files.excluded,
    files.damaged,
    files.unusable,
    files.clock,
    rigs.mixed_spectra,
    rigs.mixed_rigs,
    rigs.captures_complete,
    rigs.misnumbered,
    cameras.focal,
    cameras.two_lenses,
    cameras.bodies,
    cameras.sizes,
    cameras.modes,
    cameras.projections,
    cameras.sensor_width,
    cameras.sources,
    positions.areas,
    positions.gps,
    positions.rtk,
    flights.few,
    flights.altitudes,
    flights.altitude_bias,
    flights.altitude_datum,
    flights.oblique,
    flights.hovering,
    ground.relief,
    ground.outside,
    ground.datum,
)


@dataclass(frozen=True)
class GateReport:
    """The verdict of the gate with its findings, worst first, and the harmonizing that would follow."""

    verdict: str
    findings: Tuple[Finding, ...]
    plan: HarmonizePlan


def verdict_of(findings: Sequence[Finding], usable: int) -> str:
    """Blocked without a usable frame, inconsistent with any error, else consistent."""
    if usable == 0:
        return BLOCKED
    return INCONSISTENT if any(f.severity == ERROR for f in findings) else CONSISTENT


def assess(survey: Survey, limits: Thresholds, *, gsd_target: Union[str, float] = "finest") -> GateReport:
    """Run every rule and plan the harmonizing; pure."""
    findings = [finding for rule in RULES for finding in rule(survey, limits)]
    plan, planned = plan_harmonizing(
        survey.usable, survey.file_of(), survey.profiles, survey.flights, limits, gsd_target=gsd_target
    )
    findings.extend(planned)
    return GateReport(
        verdict=verdict_of(findings, len(survey.usable)),
        findings=tuple(sorted(findings, key=sort_key)),
        plan=plan,
    )
