"""A rule of the gate written outside of it: too little forward overlap.

    python docs/examples/own_rule.py SURVEY

The same function becomes part of the gate when it moves into ``stages/rules``; docs/writing-a-stage.md says how.
"""

from __future__ import annotations

import sys
from typing import Iterator

from sensorgate.stages.finding import WARNING, Finding
from sensorgate.stages.geo import distance_m, median
from sensorgate.stages.read import scan
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import Survey, build
from sensorgate.stages.thresholds import DEFAULTS, Thresholds

# In the gate this number stands in stages/thresholds.py, with its unit and reason.
MIN_FORWARD_OVERLAP = 0.6


def low_overlap(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Flights whose frames overlap less along the strip than matching needs."""
    files = survey.file_of()
    usable = {f.path for f in survey.usable}
    for flight in survey.flights:
        frames = [files[p] for p in flight.frames if p in usable and files[p].has_gps]
        if len(frames) < limits.min_proof_frames or not flight.gsd_cm:
            continue
        places = [(f.latitude or 0.0, f.longitude or 0.0) for f in frames]
        step_m = median([distance_m(a, b) for a, b in zip(places, places[1:])])
        # Cameras are mounted with the short side along the strip.
        reach_m = min(frames[0].width, frames[0].height) * flight.gsd_cm / 100.0
        overlap = 1.0 - step_m / reach_m
        if overlap < MIN_FORWARD_OVERLAP:
            yield Finding(
                code="overlap-low",
                severity=WARNING,
                subjects=(flight.id,),
                message=f"The frames of {flight.id} overlap by {max(0.0, overlap):.0%} along the strip; "
                f"below {MIN_FORWARD_OVERLAP:.0%} matches become few.",
                remedy="Fly slower, or let the camera release more often.",
                measured=round(overlap, 3),
                threshold=MIN_FORWARD_OVERLAP,
            )


def main(folder: str) -> int:
    """Print what the rule has to say of a folder; 1 where it says anything."""
    survey = build(scan([folder]), load_sheet(), DEFAULTS)
    findings = list(low_overlap(survey, DEFAULTS))
    for finding in findings:
        print(f"{finding.severity} {finding.code}: {finding.message} {finding.remedy}")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
