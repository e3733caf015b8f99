"""Looks at every folder of a queue before a node spends hours on it.

    python docs/examples/gate_queue.py QUEUE

Prints one line per folder and ends with 0 where all may be queued, 1 where one needs ``sensorgate run`` first,
3 where one holds no usable frame. Reads headers only: about a second for a thousand frames.
"""

from __future__ import annotations

import sys
from pathlib import Path

from sensorgate.plugin import pipeline


def main(queue: Path) -> int:
    """Gate the folders below ``queue`` and return the worst exit code."""
    worst = 0
    for folder in sorted(p for p in queue.iterdir() if p.is_dir()):
        result = pipeline.gate([str(folder)])
        codes = [f["code"] for f in result.report["findings"] if f["severity"] == "error"]
        print(f"{folder.name:24} {result.report['verdict']:14} {', '.join(dict.fromkeys(codes))}")
        worst = max(worst, result.exit_code)
    return worst


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
