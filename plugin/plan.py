"""``plan.json``: all that decided and what was decided, with no place in it: equal wherever an equal run is made."""

from __future__ import annotations

import hashlib
import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ..stages.calibrations import key_of
from ..stages.progress import Cancel, Progress, check
from ..stages.record import to_plain
from ..stages.survey import Survey
from .inspection import Inspection, Settings

PLAN_VERSION = "2.0"
# Settings that name a file or folder; a plan knows a file by its name and content.
FILES = ("calibration", "control_points", "dem", "gcp", "geo")
_PLACES = (*FILES, "calibrations")
# Solver figures differ between runs within tolerances; everything else in a project is equal byte for byte.
_SOLVED = frozenset(("sensorgate/alignment.json", "sensorgate/calibration.json"))
_THREADS = 4
_BLOCK = 1 << 20


class Names:
    """Paths as a plan calls them: relative to the argument, with its number in front where there are several."""

    def __init__(self, paths: Sequence[str]) -> None:
        given = [_slashes(p) for p in dict.fromkeys(paths)]
        self._many = len(given) > 1
        # Nested arguments: a frame is shown below the first of them in order, as the scan does it.
        self._roots = sorted((root, number) for number, root in enumerate(given, start=1))

    def __call__(self, path: str) -> str:
        """The name of the file shown as ``path``."""
        shown = _slashes(path)
        for root, number in self._roots:
            folder = root if root.endswith("/") else f"{root}/"
            if shown == root or shown.startswith(folder):
                name = shown[len(folder) :] if shown != root else root.rsplit("/", 1)[-1]
                return f"{number}/{name}" if self._many else name
        return shown.rsplit("/", 1)[-1]


def _slashes(path: str) -> str:
    return path.replace(os.sep, "/")


class Digests:
    """SHA-256, hex, of files; a file that is linked to several places is read once."""

    def __init__(self, progress: Optional[Progress] = None, cancel: Optional[Cancel] = None) -> None:
        self._progress = progress
        self._cancel = cancel
        self._known: Dict[Tuple[int, int], Optional[str]] = {}

    def of(self, files: Mapping[str, Path]) -> Dict[str, Optional[str]]:
        """Name -> digest, ``None`` where the file cannot be read; sorted by name."""
        found: Dict[str, Optional[str]] = {}
        with ThreadPoolExecutor(max_workers=min(_THREADS, os.cpu_count() or 1)) as pool:
            names = sorted(files)
            for done, (name, digest) in enumerate(zip(names, pool.map(self._of, (files[n] for n in names))), start=1):
                found[name] = digest
                if self._progress is not None:
                    self._progress("hash", done, len(names))
        return found

    def _of(self, file: Path) -> Optional[str]:
        check(self._cancel)
        digest = hashlib.sha256()
        try:
            with open(file, "rb") as stream:
                told = os.fstat(stream.fileno())
                inode = (told.st_dev, told.st_ino)
                if told.st_ino and inode in self._known:
                    return self._known[inode]
                for block in iter(lambda: stream.read(_BLOCK), b""):
                    digest.update(block)
        except OSError:
            return None
        self._known[inode] = digest.hexdigest()
        return self._known[inode]


def input_files(inspection: Inspection) -> Dict[str, Path]:
    """Name -> file of every image found, broken ones and masks too."""
    names, survey = Names(inspection.paths), inspection.survey
    shown = [*(f.path for f in survey.files), *(b.path for b in survey.broken), *inspection.masks.values()]
    return {names(path): Path(path) for path in shown}


def output_files(projects: Path) -> Dict[str, Path]:
    """``project/file`` -> file, of all that is equal byte for byte between equal runs."""
    found: Dict[str, Path] = {}
    for file in projects.rglob("*"):
        name = file.relative_to(projects).as_posix()
        if file.is_file() and name.partition("/")[2] not in _SOLVED:
            found[name] = file
    return found


def _settings(settings: Settings, survey: Survey, options: Mapping[str, Any]) -> Dict[str, Any]:
    """What was asked for: plain options, and files by name and content."""
    files: Dict[str, Any] = {}
    for name in FILES:
        place = getattr(settings, name)
        if place is not None:
            elevation = survey.elevation.digest if name == "dem" and survey.elevation else None
            digest = elevation or options.get(f"{name}_sha256")
            files[name] = {"name": Path(place).name, "sha256": digest}
    plain = {k: v for k, v in options.items() if k not in _PLACES and not k.endswith("_sha256")}
    return {"options": plain, "files": files, "stored": _stored(settings, survey)}


def _stored(settings: Settings, survey: Survey) -> Optional[List[Any]]:
    """What the calibration store knew of this survey's bodies; ``None`` where there was no store."""
    known = settings.store()
    if known is None:
        return None
    keys = {key_of(p) for p in survey.profiles}
    return [to_plain(known[k]) for k in sorted(known, key=str) if k in keys]


def plan_record(
    report: Mapping[str, Any],
    inspection: Inspection,
    inputs: Mapping[str, Optional[str]],
    outputs: Mapping[str, Optional[str]],
) -> Dict[str, Any]:
    """All that decided and what was decided, without any solver figure: equal byte for byte between equal runs.

    ``inputs`` and ``outputs`` are name -> SHA-256 of ``input_files`` and ``output_files``.
    """
    names = Names(inspection.paths)
    told = json.dumps(dict(inputs), sort_keys=True)
    harmonize = to_plain(inspection.assessed.plan)
    for action in harmonize["actions"]:
        action["frames"] = [names(p) for p in action["frames"]]
    return {
        "schema_version": PLAN_VERSION,
        "versions": report["versions"],
        "settings": _settings(inspection.settings, inspection.survey, report["inputs"]["options"]),
        "thresholds": report["thresholds"],
        "inputs": {
            "paths": len(set(inspection.paths)),
            "digest": hashlib.sha256(told.encode("utf-8")).hexdigest(),
            "files": dict(inputs),
            "elevation": report["inputs"]["elevation"],
        },
        "harmonize": harmonize,
        "subprojects": [
            {
                "name": s["name"],
                "spectrum": s["spectrum"],
                "route": s["route"],
                "payloads": s["payloads"],
                "frames": [names(p) for p in s["frames"]],
                "options": [{"name": o["name"], "value": o["value"]} for o in s["options"]],
                "held": sorted(c["profile"] for c in s["calibration"] if c["held"]),
                "files": {n.partition("/")[2]: d for n, d in outputs.items() if n.partition("/")[0] == s["name"]},
            }
            for s in report["subprojects"]
        ],
        "excluded": {names(f["path"]): f["reason"] for f in report["frames"] if not f["subproject"]},
    }
