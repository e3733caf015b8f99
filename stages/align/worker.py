"""The worker process of the solvers.

A native abort (glog's CHECK, an illegal instruction in a wheel) ends the
process that it happens in, so solvers run in one of their own. The job and
its answer are files in the workspace; progress is one JSON line each on
stdout. The package is found by its folder, not by its name, because it is
installed under several.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Tuple

from ..errors import Cancelled, SensorgateError
from ..record import dumps, from_plain, write_text
from .solution import AdjustJob, Job, Solution, load_solution, save_solution

Progress = Callable[[str, int, int], None]
Cancel = Callable[[], bool]

_BOOT = (
    "import importlib, sys, types\n"
    "root = types.ModuleType('sensorgate'); root.__path__ = [sys.argv[1]]\n"
    "sys.modules['sensorgate'] = root\n"
    "raise SystemExit(importlib.import_module('sensorgate.stages.align.worker').main(sys.argv[2]))\n"
)
_POLL_S = 0.2


class SolverFailed(SensorgateError):
    """The solver's process ended without an answer."""


def solve(
    job: Job,
    engine: str,
    folder: Path,
    cache: Path,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Solution:
    """Run one solve in a worker; raises ``SolverFailed``, ``MissingDependency`` or ``Cancelled``."""
    said = {"do": "solve", "engine": engine, "job": job, "folder": str(folder), "cache": str(cache)}
    return _run(said, folder, 1, progress, cancel)[0]


def adjust(
    task: AdjustJob,
    engine: str,
    folder: Path,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Tuple[Solution, ...]:
    """Run the bundle adjustments of ``task`` in a worker, one solution per variant."""
    said = {"do": "adjust", "engine": engine, "task": task, "folder": str(folder)}
    return _run(said, folder, len(task.variants), progress, cancel)


def _run(
    said: Dict[str, Any], folder: Path, answers: int, progress: Optional[Progress], cancel: Optional[Cancel]
) -> Tuple[Solution, ...]:
    folder.mkdir(parents=True, exist_ok=True)
    request = folder / f"{said['do']}.json"
    write_text(request, dumps(said))
    outputs = [folder / f"{said['do']}-{n:02d}.npz" for n in range(answers)]
    for path in outputs:
        if path.exists():
            path.unlink()
    errors = folder / f"{said['do']}.log"
    root = str(Path(__file__).resolve().parents[2])
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(str(Path(p).resolve()) for p in sys.path if p)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        environment[name] = "1"
    with open(errors, "wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", _BOOT, root, str(request)],
            stdout=subprocess.PIPE,
            stderr=log,
            stdin=subprocess.PIPE,
            env=environment,
        )
        reader = threading.Thread(target=_relay, args=(process, progress), daemon=True)
        reader.start()
        try:
            while True:
                try:
                    code = process.wait(timeout=_POLL_S)
                    break
                except subprocess.TimeoutExpired:
                    if cancel is not None and cancel():
                        raise Cancelled("The alignment was interrupted.") from None
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            reader.join(timeout=5.0)
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()
    failure = folder / f"{said['do']}.failed.json"
    if failure.exists():
        told = json.loads(failure.read_text(encoding="utf-8"))
        failure.unlink()
        _raise(told)
    if code != 0 or not all(path.exists() for path in outputs):
        raise SolverFailed(f"The solver ended with code {code}: {_tail(errors)}")
    return tuple(load_solution(path) for path in outputs)


def _relay(process: "subprocess.Popen[bytes]", progress: Optional[Progress]) -> None:
    if process.stdout is None:
        return
    for line in process.stdout:
        if progress is None:
            continue
        try:
            what, done, total = json.loads(line)
        except ValueError:
            continue
        progress(str(what), int(done), int(total))


def _raise(told: Dict[str, str]) -> None:
    from ..errors import MissingDependency

    if told.get("kind") == "missing":
        raise MissingDependency(told["what"], told["needed_for"], told["command"])
    raise SolverFailed(told.get("message", "The solver failed."))


def _tail(path: Path) -> str:
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    except OSError:
        return ""
    telling = [line for line in lines if any(word in line for word in ("Check failed", "Fatal", "Error"))]
    return " | ".join(telling[-2:] or lines[-2:])[-400:]


def main(request: str) -> int:
    """Answer the job in the file ``request``; 0 when every answer was written."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    path = Path(request)
    said = json.loads(path.read_text(encoding="utf-8"))
    folder = Path(said["folder"])
    try:
        for number, solution in enumerate(_answer(said, folder)):
            save_solution(solution, folder / f"{said['do']}-{number:02d}.npz")
    except ImportError as error:
        what = error.name or "pycolmap"
        told = {
            "kind": "missing",
            "what": what,
            "needed_for": "the alignment",
            "command": "pip install 'sensorgate[sfm]'",
        }
        write_text(folder / f"{said['do']}.failed.json", dumps(told))
        return 1
    except SensorgateError as error:
        from ..errors import MissingDependency

        told = {"kind": "failed", "message": str(error)}
        if isinstance(error, MissingDependency):
            told = {"kind": "missing", "what": error.what, "needed_for": "the alignment", "command": error.command}
        write_text(folder / f"{said['do']}.failed.json", dumps(told))
        return 1
    return 0


def _end_with_parent() -> None:
    """The parent holds the other end of stdin: when it is gone, nobody waits for an answer."""
    # Not sys.stdin: its lock, held by this thread, would abort the interpreter at its regular end.
    while os.read(0, 4096):
        pass
    os._exit(1)


def _answer(said: Dict[str, Any], folder: Path) -> List[Solution]:
    last: List[Any] = [None]

    def step(what: str, done: int, total: int) -> None:
        if (what, done) != last[0]:
            last[0] = (what, done)
            print(json.dumps([what, done, total]), flush=True)

    engine = importlib.import_module(f".engine_{said['engine']}", __package__)
    if said["do"] == "solve":
        return [engine.solve(from_plain(Job, said["job"]), folder, Path(said["cache"]), step)]
    return list(engine.adjust(from_plain(AdjustJob, said["task"]), step))
