"""The inside of a worker process: jobs in, answers out, one JSON line each.

A worker ends with its parent, even a killed one: nothing is written that a
later run does not know of.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import logging
import os
import queue
import signal
import sys
import threading
from pathlib import Path
from typing import Any, Callable, Dict, Mapping, Optional, Sequence

from ..errors import FrameError, MissingDependency
from ..thresholds import Thresholds
from .files import OutputError, put_bytes

# How a job ended: done, a verdict on its frame, no OpenCV, an output folder that takes nothing.
OK, BROKEN, MISSING, OUTPUT = "ok", "broken", "missing", "output"
Answer = Dict[str, Any]
Perform = Callable[[Mapping[str, Any], Thresholds], Answer]


def serve(task: str) -> None:
    """Answer jobs by ``perform`` of the module ``task`` beside this one, until standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Libraries print to standard output now and then; answers keep a channel of their own.
    answers = sys.stdout
    sys.stdout = sys.stderr
    perform: Perform = importlib.import_module(f".{task}", __package__).perform
    limits = Thresholds().replaced(json.loads(sys.stdin.readline()))
    lines: "queue.SimpleQueue[str]" = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()
    while True:
        answers.write(json.dumps(answer(perform, json.loads(lines.get()), limits)) + "\n")
        answers.flush()


def _listen(lines: "queue.SimpleQueue[str]") -> None:
    """Pass lines on; input ends when no job is waited for, or when the parent is gone: the worker ends with it."""
    for line in sys.stdin:
        lines.put(line)
    os._exit(0)


def answer(perform: Perform, job: Mapping[str, Any], limits: Thresholds) -> Answer:
    """Do one job; whatever happens on one frame is told and does not take the others along."""
    try:
        return {"state": OK, **perform(job, limits)}
    except FrameError as error:
        return _broken(error.code, error.message)
    except MissingDependency:
        return {"state": MISSING}
    except OutputError as error:
        return {"state": OUTPUT, "message": str(error)}
    except FileNotFoundError:
        return _broken("frame-vanished", "The file was there when the folder was read and is gone now.")
    except OSError as error:
        return _broken("unreadable-file", f"The file cannot be read: {error.strerror or error}.")
    except MemoryError:
        return _broken("frame-too-large", "There is not enough memory for this frame.")
    except Exception as error:
        logging.getLogger(__name__).exception("%s", job.get("path", ""))
        return _broken("frame-fault", f"Working on this frame failed unexpectedly ({type(error).__name__}: {error}).")


def _broken(code: str, message: str) -> Answer:
    return {"state": BROKEN, "code": code, "message": message}


def read_source(source: str, size_bytes: Optional[int]) -> bytes:
    """Read a frame's file; ``FrameError`` ``frame-changed`` where it is not as long as when the folder was read."""
    data = Path(source).read_bytes()
    if size_bytes is not None and len(data) != size_bytes:
        raise FrameError("frame-changed", "The file has another size than when the folder was read.")
    return data


def put_once(target: str, key: str, known: Sequence[str], make: Callable[[], bytes]) -> Answer:
    """Write what ``make`` gives, unless an earlier run did.

    ``key`` is a digest of all that the output depends on, ``known`` the key
    and the output's digest of that run, empty for none.
    """
    place = Path(target)
    if known and known[0] == key and _digest(place) == known[1]:
        return {"key": key, "digest": known[1]}
    result = make()
    put_bytes(place, result)
    return {"key": key, "digest": hashlib.sha256(result).hexdigest()}


def _digest(target: Path) -> str:
    try:
        return hashlib.sha256(target.read_bytes()).hexdigest()
    except OSError:
        return ""
