"""The main job and the submission as two calls.

    python docs/examples/run_and_submit.py SURVEY RESULT [NODE_URL]

Writes the projects of SURVEY into RESULT. With a node they are processed there; the token is taken from the variable
SENSORGATE_NODE_TOKEN. Called again with the same folders, the submission goes on where it stopped.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Optional

from sensorgate.plugin import pipeline
from sensorgate.plugin.submit import Settings as SubmitSettings
from sensorgate.plugin.submit import submit
from sensorgate.stages.errors import SensorgateError


def main(survey: str, out: Path, node: Optional[str] = None) -> int:
    """Run once, submit where a node is given, and return the exit code of the last step."""
    code = 0
    if not (out / "plan.json").exists():
        done = pipeline.run([survey], out, pipeline.Settings(gsd_target="finest"))
        code = done.exit_code
        for project in done.report["subprojects"]:
            options = " ".join(f"{o['name']}={o['value']}" for o in project["options"])
            print(f"{project['name']:20} {project['route']:10} {len(project['frames'])} frames  {options}")
    if node is None:
        return code
    sent = submit(out, node, SubmitSettings(include_unproven=False))
    for entry in sent.entries:
        print(f"{entry.name:20} {entry.state}: {'; '.join(entry.reasons)}")
    for name in sent.left_out:
        print(f"{name:20} left out: nothing proves it")
    return sent.exit_code


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1], Path(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else None))
    except SensorgateError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
