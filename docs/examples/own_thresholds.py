"""The gate with thresholds of your own, and which findings they change.

    python docs/examples/own_thresholds.py SURVEY [NAME=VALUE ...]

Without NAME=VALUE the ground resolution may differ by 30 % before frames are resampled.
"""

from __future__ import annotations

import sys
from typing import Mapping

from sensorgate.plugin import pipeline
from sensorgate.stages.errors import UsageError
from sensorgate.stages.thresholds import DEFAULTS


def main(survey: str, changes: Mapping[str, float]) -> int:
    """Gate with the defaults and with ``changes``, and print the difference; an unknown name is a ``UsageError``."""
    own = DEFAULTS.replaced(changes)
    before = {f["code"] for f in pipeline.gate([survey]).report["findings"]}
    result = pipeline.gate([survey], pipeline.Settings(thresholds=own))
    after = {f["code"] for f in result.report["findings"]}
    for name in sorted(changes):
        print(f"{name}: {getattr(DEFAULTS, name)} -> {getattr(own, name)}")
    print(f"verdict: {result.report['verdict']}")
    print(f"no more: {', '.join(sorted(before - after)) or 'nothing'}")
    print(f"new: {', '.join(sorted(after - before)) or 'nothing'}")
    return result.exit_code


if __name__ == "__main__":
    given = dict(word.split("=", 1) for word in sys.argv[2:]) or {"gsd_trigger": "0.3"}
    try:
        sys.exit(main(sys.argv[1], {name: float(value) for name, value in given.items()}))
    except UsageError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
