"""Each stage by its own call, from files to what is proven; nothing is written but scratch.

python docs/examples/stage_by_stage.py SURVEY
"""

from __future__ import annotations

import sys
import tempfile

from sensorgate.stages.document import requests_for
from sensorgate.stages.gate import assess
from sensorgate.stages.read import scan
from sensorgate.stages.route import prove
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import build
from sensorgate.stages.thresholds import DEFAULTS


def main(folder: str) -> int:
    """Print what every stage makes of the folder."""
    limits = DEFAULTS
    files = scan([folder], limits=limits)  # headers only, no pixel is decoded
    survey = build(files, load_sheet(thresholds=limits), limits)
    for profile in survey.profiles:
        camera = profile.intrinsics
        ratio = "unknown" if camera.focal_ratio is None else f"{camera.focal_ratio:.4f} of the width"
        print(f"profile {profile.id}: {len(profile.frames)} frames, focal {ratio} from {camera.focal_source}")

    gate = assess(survey, limits)
    print(f"verdict: {gate.verdict}")
    for finding in gate.findings:
        print(f"  {finding.severity} {finding.code}: {finding.message}")
    for action in gate.plan.actions:
        print(f"plan {action.flight}: scale {action.scale:.3f}, {action.width} -> {action.out_width} px wide")

    for request in requests_for(survey, limits):  # one per spectrum and place
        with tempfile.TemporaryDirectory() as scratch:
            proof = prove(request, scratch, thresholds=limits)
        for group in proof.groups:
            print(f"group {group.name}: {group.route}, {len(group.frames)} frames of {', '.join(group.payloads)}")
            for reason in group.reasons:
                print(f"  {reason}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
