"""Rules about the ground under the flights: what an elevation model says, and what it cannot."""

from __future__ import annotations

from collections import defaultdict
from typing import Dict, Iterator, List

from ..finding import INFO, WARNING, Finding
from ..frame import ELLIPSOID
from ..profile import SurveyFrame
from ..relief import CORRECTED
from ..survey import Survey
from ..thresholds import Thresholds
from .text import listed, named, plural


def _by_flight(survey: Survey) -> Dict[str, List[SurveyFrame]]:
    members: Dict[str, List[SurveyFrame]] = defaultdict(list)
    for frame in survey.usable:
        members[frame.flight].append(frame)
    return members


def relief(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Flights over ground that varies by more than their ground resolution may."""
    members = _by_flight(survey)
    for flight in survey.flights:
        if flight.relief_m is None or flight.height_m is None or flight.height_m <= 0 or not members[flight.id]:
            continue
        share = flight.relief_m / flight.height_m
        sources = {f.height_source for f in members[flight.id]}
        if share <= limits.gsd_trigger or not sources & {CORRECTED, "relative-altitude"}:
            continue
        varies = f"The ground under {flight.id} varies by {flight.relief_m:.0f} m"
        if CORRECTED in sources:
            yield Finding(
                code="ground-relief",
                severity=INFO,
                subjects=(flight.id,),
                message=f"{varies}. Its heights above take-off were turned into heights above ground by the elevation "
                f"model: {flight.height_m:.0f} m in the middle.",
                remedy="Nothing to do.",
                measured=share,
                threshold=limits.gsd_trigger,
            )
        elif (flight.height_sigma_m or 0.0) > limits.height_sigma_relative_m:
            yield Finding(
                code="ground-relief",
                severity=WARNING,
                subjects=(flight.id,),
                message=f"{varies}, and no frame shows where the drone took off: {flight.height_m:.0f} m are above "
                f"take-off and may be {2.0 * (flight.height_sigma_m or 0.0):.0f} m off above ground. It is resampled "
                "only where its ground resolution is farther off than that.",
                remedy="Put a frame from the take-off (below 5 m) back into the folder if there is one.",
                measured=share,
                threshold=limits.gsd_trigger,
            )


def outside(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Frames whose height rests on the elevation model, which has no ground under them."""
    if survey.elevation is None:
        return
    files = survey.file_of()
    lost = [
        f.path
        for f in survey.usable
        if f.height_m is None and files[f.path].has_gps and files[f.path].altitude_m is not None
    ]
    if lost:
        yield Finding(
            code="ground-outside",
            severity=WARNING,
            subjects=tuple(sorted(lost)),
            message=f"{survey.elevation.name} has no ground under {plural(len(lost))} of {len(survey.usable)}: "
            f"{named(sorted(lost))}. Their height above ground is unknown.",
            remedy="Give an elevation model that covers the whole site without voids.",
            measured=float(len(lost)),
            threshold=0.0,
        )


def datum(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Heights that are GPS altitude minus the model's ground: right only if both count from one zero."""
    if survey.elevation is None:
        return
    files = survey.file_of()
    resting = [f for f in survey.usable if f.height_source == "dem"]
    if not resting:
        return
    below = [f.path for f in resting if f.height_m is not None and f.height_m <= 0]
    above_ellipsoid = [f for f in resting if files[f.path].altitude_zero == ELLIPSOID]
    said = survey.elevation.vertical
    zero = f"counts heights from {said}" if said else "does not say from which zero its heights count"
    doubt = ""
    if below:
        doubt = f" {plural(len(below))} would stand below the ground: the zeros differ."
    elif above_ellipsoid and "ellipsoid" not in said.lower():
        doubt = f" {plural(len(above_ellipsoid))} say altitudes above the ellipsoid: the zeros may differ by tens of m."
    flights = sorted({f.flight for f in resting})
    yield Finding(
        code="ground-datum",
        severity=WARNING if doubt else INFO,
        subjects=tuple(flights),
        message=f"Heights of {listed(flights)} are GPS altitude minus ground. {survey.elevation.name} {zero}; GPS "
        f"altitudes are taken to count from the same.{doubt}",
        remedy="Give an elevation model in the height system of the GPS altitudes, or altitudes in that of the model "
        "with --geo FILE.",
        measured=float(len(below) or len(above_ellipsoid) if doubt else len(resting)),
        threshold=0.0,
    )
