"""A rule of the gate written outside of it: too little forward overlap.

    python docs/examples/own_rule.py SURVEY

docs/adding-a-finding.md builds the same rule into the gate.
"""

from __future__ import annotations

import sys
from typing import Iterator

from own_stage import measure_overlap
from sensorgate.stages.finding import WARNING, Finding
from sensorgate.stages.read import scan
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import Survey, build
from sensorgate.stages.thresholds import DEFAULTS, Thresholds

# In the gate this number stands in stages/thresholds.py, with its unit and reason.
FORWARD_OVERLAP_MIN = 0.6


def low_overlap(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Flights whose frames overlap less along the strip than matching needs."""
    for flight in measure_overlap(survey, limits):
        if flight.forward < FORWARD_OVERLAP_MIN:
            yield Finding(
                code="overlap-low",
                severity=WARNING,
                subjects=(flight.flight,),
                message=f"The frames of {flight.flight} overlap by {max(0.0, flight.forward):.0%} along the strip; "
                f"below {FORWARD_OVERLAP_MIN:.0%} matches become few.",
                remedy="Fly slower, or let the camera release more often.",
                measured=flight.forward,
                threshold=FORWARD_OVERLAP_MIN,
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
