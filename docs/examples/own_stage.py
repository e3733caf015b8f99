"""A stage written outside of the package: the forward overlap of every flight.

    python docs/examples/own_stage.py SURVEY

A stage is a pure function from frozen dataclasses to frozen dataclasses, with the thresholds as an argument. What it
returns goes to JSON and back unchanged. docs/writing-a-stage.md takes this one apart.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Tuple

from sensorgate.stages.geo import distance_m, median
from sensorgate.stages.read import scan
from sensorgate.stages.record import dumps, to_plain
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import Survey, build
from sensorgate.stages.thresholds import DEFAULTS, Thresholds


@dataclass(frozen=True)
class Overlap:
    """How much a flight's frames share with the next one: ``forward`` as a ratio, ``step_m`` between their centres."""

    flight: str
    frames: int
    step_m: float
    forward: float


def measure_overlap(survey: Survey, limits: Thresholds) -> Tuple[Overlap, ...]:
    """Overlap along the strip of every flight with enough positions and a known ground resolution, by flight id.

    Straight down, 1 - step / reach; reach is the short side on the ground, along which cameras are flown.
    """
    files = survey.file_of()
    usable = {f.path for f in survey.usable}
    found = []
    for flight in survey.flights:
        frames = [files[p] for p in flight.frames if p in usable and files[p].has_gps]
        if len(frames) < limits.min_proof_frames or not flight.gsd_cm:
            continue
        places = [(f.latitude or 0.0, f.longitude or 0.0) for f in frames]
        step_m = median([distance_m(a, b) for a, b in zip(places, places[1:])])
        reach_m = min(frames[0].width, frames[0].height) * flight.gsd_cm / 100.0
        found.append(Overlap(flight.id, len(frames), round(step_m, 3), round(1.0 - step_m / reach_m, 4)))
    return tuple(sorted(found, key=lambda o: o.flight))


def main(folder: str) -> int:
    """Print the stage's result as JSON."""
    survey = build(scan([folder]), load_sheet(), DEFAULTS)
    print(dumps(to_plain(measure_overlap(survey, DEFAULTS))))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
