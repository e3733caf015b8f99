"""Harmonizing and alignment in WebODM's worker, as a process of its own: its result becomes tasks.

A Celery worker may have no children of its own kind, and what goes wrong in a
solver must not take it along; so the main job runs as a subprocess that says
in a file how far it is, and goes on where it was when it is started again.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, Dict, List, Mapping, Tuple

from ...stages.errors import SensorgateError
from ...stages.record import dumps, write_text
from ..submit.parcel import read_parcels, subprojects
from . import home, preferences, records, tasks
from .checking import alone
from .gathering import task_files
from .proposal import GCP_FILE, GEO_FILE, Proposed

_STEP_S = 2.0
# The package is loaded by its folder under a name of its own: inside WebODM it has another.
_CHILD = (
    "import importlib, sys, types\n"
    "package = types.ModuleType('sensorgate'); package.__path__ = [sys.argv[1]]\n"
    "sys.modules['sensorgate'] = package\n"
    "sys.path.append(sys.argv[2])\n"
    "sys.exit(importlib.import_module('sensorgate.plugin.webodm.child').main(sys.argv[3]))\n"
)
_WORDS = {
    "read": "reading the images",
    "tones": "comparing brightness",
    "bands": "laying the bands on each other",
    "harmonize": "writing frames that can be matched",
    "calibration": "trying which calibration holds",
}


def prepare_task(task_id: str, user_id: int) -> Dict[str, Any]:
    """Run the main job on a task's images and create its projects as tasks."""
    from django.contrib.auth.models import User

    task = home.find_task(task_id)
    user = User.objects.filter(pk=user_id).first()
    if task is None or user is None:
        return {"output": "gone"}
    with alone(task_id) as mine:
        if not mine:
            return {"output": "somebody is at it"}
        before = records.load(task_id) or {}
        try:
            _prepare(task, user)
        except (SensorgateError, OSError) as error:
            records.change(
                task_id,
                state=before.get("before", records.NONE),
                progress=None,
                message=f"Harmonizing on this server did not work: {_without_paths(str(error), task)}",
            )
    return {"output": (records.load(task_id) or {}).get("state", records.NONE)}


def _without_paths(text: str, task: Any) -> str:
    """No path of this server is for its users."""
    return text.replace(str(task.task_path()).rstrip("/"), "its folder")


def _prepare(task: Any, user: Any) -> None:
    work = home.task_folder(task) / "work"
    work.mkdir(parents=True, exist_ok=True)
    with preferences.settings_for(user) as settings:
        files = task_files(Path(task.task_path()))
        request = {
            "images": str(files.folder),
            "names": [n for n in files.names if not n.lower().endswith(".txt")],
            "gcp": os.path.basename(files.control) if files.control else None,
            "geo": os.path.basename(files.geo) if files.geo else None,
            "calibration": settings.calibration,
            "thresholds": asdict(settings.thresholds),
        }
        write_text(work / "request.json", dumps(request))
        _run(task, work)
    report = home.task_folder(task)
    for name in ("report.json", "report.html"):
        if (work / "out" / name).is_file():
            shutil.copy2(work / "out" / name, report / name)
    parts = projects_as_tasks(work / "out")
    tasks.split(task, parts)
    shutil.rmtree(work, ignore_errors=True)


def _run(task: Any, work: Path) -> None:
    """Start the main job and pass on how far it is. Raises ``SensorgateError`` with its last words."""
    from django.core.cache import cache

    for name in ("result.json", "progress.json"):
        with contextlib.suppress(FileNotFoundError):
            (work / name).unlink()
    command = [sys.executable, "-c", _CHILD, home.ROOT, home.packages_folder(), str(work)]
    with open(work / "log.txt", "w", encoding="utf-8") as log:
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=str(work))
        try:
            while child.poll() is None:
                time.sleep(_STEP_S)
                told = _json(work / "progress.json")
                share = float(told.get("share", 0.0))
                step = _WORDS.get(str(told.get("stage", "")), "proving which frames belong together")
                cache.touch(f"{home.NAME}-at-{task.pk}", records.CLAIM_S)
                records.change(
                    task.pk, state=records.WORKING, progress=share, message=f"Harmonizing on this server: {step}."
                )
        finally:
            if child.poll() is None:
                child.terminate()
                child.wait()
    told = _json(work / "result.json")
    if "exit" not in told or told["exit"] not in (0, 1):
        said = told.get("message") or f"the main job ended with code {child.returncode} before it was done"
        raise SensorgateError(str(said))


def _json(file: Path) -> Dict[str, Any]:
    try:
        value = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def projects_as_tasks(out: Path) -> Tuple[Tuple[Path, Proposed], ...]:
    """The projects that the main job wrote, as tasks: (folder of their images, task)."""
    said: Mapping[str, Mapping[str, Any]] = {str(s["name"]): s for s in subprojects(out)}
    found: List[Tuple[Path, Proposed]] = []
    for parcel in read_parcels(out):
        folder = Path(parcel.folder)
        names = {i.name: i.name for i in parcel.items if i.name not in (GCP_FILE, GEO_FILE)}
        texts = {n: (folder / n).read_text(encoding="utf-8") for n in (GCP_FILE, GEO_FILE) if (folder / n).is_file()}
        about = said.get(parcel.name, {})
        found.append(
            (
                folder / "images",
                Proposed(
                    key=parcel.name,
                    name=parcel.name,
                    spectrum=str(about.get("spectrum", "")),
                    payloads=parcel.payloads,
                    frames=tuple(sorted(names)),
                    names=names,
                    options=parcel.options,
                    reasons={},
                    texts=texts,
                    calibration=dict(parcel.calibration or {}),
                ),
            )
        )
    return tuple(found)


def available() -> bool:
    """Whether the extras are there."""
    return not preferences.missing() and bool(sys.executable) and os.access(sys.executable, os.X_OK)
