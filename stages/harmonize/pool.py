"""Worker processes that take frame jobs one by one.

Subprocesses of the running interpreter, because a daemonic worker may have no
multiprocessing children. The package is found by its folder, not by its name:
it is imported under different names by its hosts.
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
from typing import Any, Dict, Generator, List, Optional, Sequence, Tuple

from ..progress import Cancel, check
from ..thresholds import Thresholds
from .work import FrameJob, job_from_plain, perform

_ALIAS = "_frame_worker_package"
_BOOT = (
    "import importlib, json, sys, types; "
    "sys.path[:] = json.loads(sys.argv[1]); "
    f"house = types.ModuleType({_ALIAS!r}); house.__path__ = [sys.argv[2]]; sys.modules[{_ALIAS!r}] = house; "
    f"importlib.import_module({_ALIAS!r} + '.stages.harmonize.pool').serve()"
)
_POLL_S = 0.2
Answer = Tuple[FrameJob, Dict[str, Any]]


def serve() -> None:
    """Answer jobs, one JSON line each, until standard input ends: the worker's whole life."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Libraries print to standard output now and then; answers keep a channel of their own.
    answers = sys.stdout
    sys.stdout = sys.stderr
    limits = Thresholds().replaced(json.loads(sys.stdin.readline()))
    for line in sys.stdin:
        answer = perform(job_from_plain(json.loads(line)), limits)
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


class _Worker:
    """One subprocess and the thread that feeds it; it is started anew when a decoder takes it down."""

    def __init__(self, limits: Thresholds, jobs: "queue.SimpleQueue[Optional[FrameJob]]", answers: Any) -> None:
        self._limits = limits
        self._jobs = jobs
        self._answers = answers
        self._process: Optional[subprocess.Popen[str]] = None
        self._stopping = False
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _start(self) -> "subprocess.Popen[str]":
        house = str(Path(__file__).resolve().parents[2])
        process = subprocess.Popen(
            [sys.executable, "-c", _BOOT, json.dumps(sys.path), house],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
        )
        self._process = process
        self._say(process, asdict(self._limits))
        return process

    @staticmethod
    def _say(process: "subprocess.Popen[str]", message: Any) -> None:
        if process.stdin is not None:
            process.stdin.write(json.dumps(message) + "\n")
            process.stdin.flush()

    def _run(self) -> None:
        process: Optional[subprocess.Popen[str]] = None
        while True:
            job = self._jobs.get()
            if job is None or self._stopping:
                break
            line = ""
            try:
                process = process or self._start()
                self._say(process, asdict(job))
                line = process.stdout.readline() if process.stdout is not None else ""
            except OSError:
                line = ""
            if line:
                self._answers.put((job, json.loads(line)))
            else:
                self._end(process)
                process = None
                told = {"state": "broken", "code": "frame-fault", "message": "Decoding this frame ended its process."}
                self._answers.put((job, told))
        self._end(process)

    @staticmethod
    def _end(process: Optional["subprocess.Popen[str]"]) -> None:
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
        """End the worker now; the frame it is at is left unfinished."""
        self._stopping = True
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()


def run_jobs(
    jobs: Sequence[FrameJob], limits: Thresholds, *, workers: int = 2, cancel: Optional[Cancel] = None
) -> Generator[Answer, None, None]:
    """Yield every job with its answer as it is done, in any order.

    Raises ``Cancelled`` when asked to stop. Close the generator to end the
    workers before all is done.
    """
    waiting: "queue.SimpleQueue[Optional[FrameJob]]" = queue.SimpleQueue()
    answers: "queue.SimpleQueue[Answer]" = queue.SimpleQueue()
    for job in jobs:
        waiting.put(job)
    team: List[_Worker] = []
    count = max(1, min(workers, len(jobs)))
    for _ in range(count):
        waiting.put(None)
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
