"""Worker processes for work on whole captures.

Subprocesses of the running interpreter that take one JSON line per job, like
those for single frames; see ``pool`` for why.
"""

from __future__ import annotations

import json
import queue
import signal
import subprocess
import sys
import threading
from dataclasses import asdict
from pathlib import Path
from typing import Any, Dict, Generator, List, Mapping, Optional, Sequence, Tuple

from ..progress import Cancel, check
from ..thresholds import Thresholds
from .bands_work import perform

_ALIAS = "_band_worker_package"
_BOOT = (
    "import importlib, json, sys, types; "
    "sys.path[:] = json.loads(sys.argv[1]); "
    f"house = types.ModuleType({_ALIAS!r}); house.__path__ = [sys.argv[2]]; sys.modules[{_ALIAS!r}] = house; "
    f"importlib.import_module({_ALIAS!r} + '.stages.harmonize.bands_pool').serve()"
)
_POLL_S = 0.2
Job = Mapping[str, Any]
Answer = Tuple[int, Dict[str, Any]]


def serve() -> None:
    """Answer jobs, one JSON line each, until standard input ends: the worker's whole life."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = sys.stdout
    sys.stdout = sys.stderr
    limits = Thresholds().replaced(json.loads(sys.stdin.readline()))
    for line in sys.stdin:
        answers.write(json.dumps(perform(json.loads(line), limits)) + "\n")
        answers.flush()


class _Worker:
    """One subprocess and the thread that feeds it; started anew when a job takes it down."""

    def __init__(
        self, limits: Thresholds, jobs: "queue.SimpleQueue[Any]", answers: "queue.SimpleQueue[Answer]"
    ) -> None:
        self._limits, self._jobs, self._answers = limits, jobs, answers
        self._process: Optional["subprocess.Popen[str]"] = None
        self._stopping = False
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _ask(self, job: Job) -> str:
        if self._process is None:
            house = str(Path(__file__).resolve().parents[2])
            self._process = subprocess.Popen(
                [sys.executable, "-c", _BOOT, json.dumps(sys.path), house],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                encoding="utf-8",
            )
            self._say(asdict(self._limits))
        self._say(job)
        stdout = self._process.stdout
        return stdout.readline() if stdout is not None else ""

    def _say(self, message: Any) -> None:
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.write(json.dumps(message) + "\n")
            self._process.stdin.flush()

    def _run(self) -> None:
        while True:
            item = self._jobs.get()
            if item is None or self._stopping:
                break
            number, job = item
            try:
                line = self._ask(job)
            except OSError:
                line = ""
            if line:
                self._answers.put((number, json.loads(line)))
            else:
                self._end()
                told = {"state": "broken", "code": "frame-fault", "message": "Working on this frame ended its process."}
                self._answers.put((number, told))
        self._end()

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        for stream in (process.stdin, process.stdout):
            try:
                if stream is not None:
                    stream.close()
            except OSError:
                continue
        process.wait()

    def stop(self) -> None:
        """End the worker now; what it is at is left unfinished."""
        self._stopping = True
        process = self._process
        if process is not None and process.poll() is None:
            process.terminate()


def run_jobs(
    jobs: Sequence[Job], limits: Thresholds, *, workers: int = 2, cancel: Optional[Cancel] = None
) -> Generator[Answer, None, None]:
    """Yield each job's index with its answer as it is done, in any order. Raises ``Cancelled``."""
    check(cancel)
    waiting: "queue.SimpleQueue[Any]" = queue.SimpleQueue()
    answers: "queue.SimpleQueue[Answer]" = queue.SimpleQueue()
    for item in enumerate(jobs):
        waiting.put(item)
    count = max(1, min(workers, len(jobs)))
    for _ in range(count):
        waiting.put(None)
    team: List[_Worker] = []
    try:
        team = [_Worker(limits, waiting, answers) for _ in range(count)]
        left = len(jobs)
        while left:
            check(cancel)
            try:
                answer = answers.get(timeout=_POLL_S)
            except queue.Empty:
                continue
            left -= 1
            yield answer
    except BaseException:
        for worker in team:
            worker.stop()
        raise
    finally:
        for worker in team:
            worker.thread.join()
