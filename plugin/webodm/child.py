"""The main job in a process of its own, started by WebODM's worker. Imports neither Django nor WebODM."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import time
from pathlib import Path
from typing import Any, Dict

from ...stages.errors import SensorgateError
from ...stages.record import dumps, write_text
from ...stages.thresholds import Thresholds
from .. import pipeline

_TELL_S = 1.0
# Which part of the whole a stage is: (start, size). What has no entry is alignment.
_SHARES = {
    "read": (0.0, 0.05),
    "tones": (0.05, 0.05),
    "bands": (0.1, 0.1),
    "harmonize": (0.2, 0.2),
    "calibration": (0.7, 0.29),
}
_ALIGN = (0.4, 0.3)


class Teller:
    """Writes how far the job is, at most once a second."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._told = 0.0
        self._share = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Hear of a stage."""
        start, size = _SHARES.get(stage, _ALIGN)
        self._share = max(self._share, start + size * min(1.0, done / total if total else 0.0))
        if time.monotonic() - self._told > _TELL_S:
            self._told = time.monotonic()
            write_text(self._file, dumps({"stage": stage, "share": round(self._share, 4)}))


def main(work: str) -> int:
    """Take ``request.json`` of the work folder, leave ``out/`` and ``result.json`` in it."""
    folder = Path(work)
    logging.basicConfig(level=logging.INFO)
    result: Dict[str, Any]
    lock = open(folder / "lock", "a")  # noqa: SIM115
    # The child of a worker that was killed may still be at it: its work is taken up when it ends.
    fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        request = json.loads((folder / "request.json").read_text(encoding="utf-8"))
        os.chdir(request["images"])  # frames are called by their names alone
        settings = pipeline.Settings(
            thresholds=Thresholds(**request["thresholds"]),
            calibration=request["calibration"],
            gcp=request["gcp"],
            geo=request["geo"],
        )
        told = pipeline.run(
            list(request["names"]),
            folder / "out",
            settings,
            work=folder / "scratch",
            resume=True,
            progress=Teller(folder / "progress.json"),
        )
        result = {"exit": told.exit_code}
    except SensorgateError as error:
        result = {"exit": error.exit_code if error.exit_code > 1 else 2, "message": str(error)}
    except Exception as error:
        logging.getLogger("sensorgate").exception("the main job")
        result = {"exit": 70, "message": f"a fault of sensorgate ({type(error).__name__}: {error})"}
    write_text(folder / "result.json", dumps(result))
    return int(result["exit"])
