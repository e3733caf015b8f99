"""What submitting costs beside pyodm's own upload: CPU and wall time for one project on a loopback node.

    python benchmarks/submit.py [--frames 60] [--size 4]

The node is the tests' double of NodeODM in a process of its own, so that its work is not counted. Ours negotiates the
options, uploads, holds what arrived against what was sent, waits and fetches; pyodm's ``create_task`` uploads. Frames
are small pictures filled up to ``--size`` megabytes.
"""

from __future__ import annotations

import argparse
import contextlib
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Callable, Iterator, List, Tuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sensorgate.plugin.submit import Settings, submit

from tests.plugin.submit.making import project, quick
from tests.plugin.submit.node_double import NodeDouble

OURS = "sensorgate submit, verified and fetched"
PYODM = "pyodm create_task, upload alone"


@contextlib.contextmanager
def node() -> Iterator[str]:
    """The address of a node in a process of its own."""
    process = subprocess.Popen([sys.executable, __file__, "--node"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait()


def measured(work: Callable[[], object]) -> Tuple[float, float]:
    """CPU and wall seconds."""
    before, began = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
    work()
    after = resource.getrusage(resource.RUSAGE_SELF)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, time.perf_counter() - began


def sending(frames: int, megabytes: float) -> List[Tuple[str, float, float]]:
    """Way of sending, CPU and wall seconds for a project of that many frames."""
    rows = []
    with tempfile.TemporaryDirectory() as place:
        names = tuple(f"IMG_{i:04d}.JPG" for i in range(frames))
        folder = project(Path(place), "rgb", names)
        for name in names:
            with open(folder / "images" / name, "ab") as stream:
                stream.truncate(int(megabytes * 1e6))
        files = [str(folder / "images" / name) for name in names]
        with node() as url:
            rows.append((OURS, *measured(lambda: submit(Path(place), url, Settings(thresholds=quick())))))
        with contextlib.suppress(ImportError):
            from pyodm import Node

            with node() as url:
                other = Node.from_url(url)
                rows.append((PYODM, *measured(lambda: other.create_task(files, {"dsm": True}))))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--size", type=float, default=4.0, help="megabytes of a frame")
    parser.add_argument("--node", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.node:
        with NodeDouble() as double:
            print(double.url, flush=True)
            while True:
                time.sleep(3600)
    print(f"{asked.frames} frames of {asked.size:g} MB\n{'':42}{'CPU s':>8}{'wall s':>8}")
    for name, cpu, wall in sending(asked.frames, asked.size):
        print(f"{name:42}{cpu:8.2f}{wall:8.2f}")


if __name__ == "__main__":
    main()
