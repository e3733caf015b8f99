"""Worker processes that take jobs one by one.

Subprocesses of the running interpreter, because a daemonic worker may have no
multiprocessing children. The package is found by its folder, not by its name:
it is imported under different names by its hosts.
"""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generator, List, Mapping, Optional, Sequence, Tuple

from ..errors import SensorgateError
from ..progress import Cancel, check
from ..thresholds import Thresholds
from .files import OutputError
from .resample import missing_opencv
from .worker import BROKEN, MISSING, OK, OUTPUT, Answer

# The module beside this one whose ``perform`` does a job.
FRAMES, BANDS = "work", "bands_work"

_ALIAS = "_harmonize_worker_package"
_BOOT = (
    "import importlib, json, sys, types; "
    "sys.path[:] = json.loads(sys.argv[1]); "
    f"house = types.ModuleType({_ALIAS!r}); house.__path__ = [sys.argv[2]]; sys.modules[{_ALIAS!r}] = house; "
    f"importlib.import_module({_ALIAS!r} + '.stages.harmonize.worker').serve(sys.argv[3])"
)
_POLL_S = 0.2
_DIED = {"state": BROKEN, "code": "frame-fault", "message": "Working on this frame ended its process."}
Job = Mapping[str, Any]
Numbered = Tuple[int, Answer]


class _Worker:
    """One subprocess and the thread that feeds it; it is started anew when a decoder takes it down."""

    def __init__(
        self, task: str, limits: Thresholds, jobs: "queue.SimpleQueue[Any]", answers: "queue.SimpleQueue[Numbered]"
    ) -> None:
        self._task, self._limits, self._jobs, self._answers = task, limits, jobs, answers
        self._process: Optional["subprocess.Popen[str]"] = None
        self._stopping = False
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _start(self) -> None:
        house = str(Path(__file__).resolve().parents[2])
        self._process = subprocess.Popen(
            [sys.executable, "-c", _BOOT, json.dumps(sys.path), house, self._task],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
        )
        self._say(asdict(self._limits))

    def _say(self, message: Any) -> None:
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.write(json.dumps(message) + "\n")
            self._process.stdin.flush()

    def _ask(self, job: Job) -> Answer:
        try:
            if self._process is None:
                self._start()
            self._say(job)
            stdout = self._process.stdout if self._process is not None else None
            line = stdout.readline() if stdout is not None else ""
        except OSError:
            line = ""
        if line.endswith("\n"):
            found: Answer = json.loads(line)
            return found
        self._end()
        return _DIED

    def _run(self) -> None:
        while True:
            item = self._jobs.get()
            if item is None or self._stopping:
                break
            number, job = item
            self._answers.put((number, self._ask(job)))
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
    jobs: Sequence[Job], limits: Thresholds, *, task: str, workers: int = 2, cancel: Optional[Cancel] = None
) -> Generator[Numbered, None, None]:
    """Yield each job's index with its answer as it is done, in any order; an answer's state is ``ok`` or ``broken``.

    Raises ``Cancelled`` when asked to stop, ``OutputError`` where nothing can
    be written, ``MissingDependency`` without OpenCV. Close the generator to end
    the workers before all is done.
    """
    check(cancel)
    waiting: "queue.SimpleQueue[Any]" = queue.SimpleQueue()
    answers: "queue.SimpleQueue[Numbered]" = queue.SimpleQueue()
    for item in enumerate(jobs):
        waiting.put(item)
    count = max(1, min(workers, len(jobs)))
    for _ in range(count):
        waiting.put(None)
    team: List[_Worker] = []
    try:
        team = [_Worker(task, limits, waiting, answers) for _ in range(count)]
        left = len(jobs)
        while left:
            check(cancel)
            try:
                number, answer = answers.get(timeout=_POLL_S)
            except queue.Empty:
                continue
            left -= 1
            _raise_if_over(answer)
            yield number, answer
    except BaseException:
        for worker in team:
            worker.stop()
        raise
    finally:
        for worker in team:
            worker.thread.join()


def _raise_if_over(answer: Answer) -> None:
    """Raise what ends the command."""
    if answer["state"] == MISSING:
        raise missing_opencv()
    if answer["state"] == OUTPUT:
        raise OutputError(answer["message"])
    if answer["state"] not in (OK, BROKEN):
        raise SensorgateError(f"A worker gave an answer that is not understood: {answer['state']!r}.")
