"""What a browser sent before the upload: one folder per session, one file per batch, gone after a day.

WebODM runs several web processes, so nothing is kept in memory; its own worker
clears the folder of temporary files.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
import secrets
import shutil
import time
import uuid
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple, Union

from ...stages.errors import UsageError
from ...stages.frame import BrokenFrame, Frame
from ...stages.read import Scan
from ...stages.record import dumps, from_plain, to_plain, write_text
from . import bounds
from .headers import Read, mask_of

_ID = re.compile(r"^[0-9a-f]{32}$")
_PREFIX = "sensorgate-session-"
KINDS = ("gcp", "geo")


class TooMuch(UsageError):
    """More than one session may hold."""


@dataclass(frozen=True)
class Gathered:
    """All of a session: what was read, with the id of each path, and the masks by image."""

    scan: Scan
    ids: Dict[str, int]
    masks: Dict[str, str]


@dataclass(frozen=True)
class Session:
    """A session that exists, with its owner's id and its project's."""

    id: str
    folder: Path
    user: int
    project: int

    def add(self, read: Read) -> int:
        """Keep a batch; returns how many files the session holds now. Raises ``TooMuch``."""
        held, size = self._held()
        # A file that was sent again counts again here; the verdict counts it once.
        if held + len(read.frames) > 2 * bounds.SESSION_FILES or size > bounds.SESSION_BYTES:
            raise TooMuch(f"A verdict takes at most {bounds.SESSION_FILES} files.")
        if read.frames or read.masks:
            value = {
                "frames": [
                    [number, isinstance(f, BrokenFrame), to_plain(f)] for number, f in sorted(read.frames.items())
                ],
                "masks": sorted(read.masks.items()),
            }
            # Batches come in parallel and in any order: each has a name of its own, with its time and count.
            name = f"batch-{time.time_ns():020d}-{len(read.frames)}-{uuid.uuid4().hex[:12]}.json"
            text = json.dumps(value, ensure_ascii=True, separators=(",", ":"))
            write_text(self.folder / name, text)
        return held + len(read.frames)

    def _held(self) -> Tuple[int, int]:
        files = size = 0
        for entry in os.scandir(self.folder):
            if entry.name.startswith("batch-"):
                files += int(entry.name.split("-")[2])
                size += entry.stat().st_size
        return files, size

    def keep_control(self, kind: str, text: str) -> None:
        """Keep ground control or positions; an empty text takes them back."""
        if kind not in KINDS:
            raise UsageError(f"kind must be one of {', '.join(KINDS)}.")
        if len(text.encode("utf-8", "replace")) > bounds.CONTROL_BYTES:
            raise TooMuch("The file is too large for ground control or positions.")
        file = self.folder / f"{kind}.txt"
        if text.strip():
            write_text(file, text)
        else:
            with contextlib.suppress(FileNotFoundError):
                file.unlink()

    def control(self, kind: str) -> Optional[str]:
        """Where the text of this kind lies, or ``None``."""
        file = self.folder / f"{kind}.txt"
        return str(file) if file.is_file() else None

    def keep(self, name: str, value: Any) -> None:
        """Keep a JSON value beside the batches."""
        write_text(self.folder / f"{name}.json", dumps(value))

    def load(self, name: str) -> Any:
        """A JSON value that was kept, or ``None``."""
        try:
            return json.loads((self.folder / f"{name}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None

    def gather(self) -> Gathered:
        """Everything that was sent so far; of a file that was sent twice, what came later."""
        found: Dict[int, Union[Frame, BrokenFrame]] = {}
        masks: Dict[int, str] = {}
        for file in sorted(self.folder.glob("batch-*.json"), key=lambda f: f.name):
            value = json.loads(file.read_text(encoding="utf-8"))
            for number, broken, plain in value["frames"]:
                found[number] = from_plain(BrokenFrame if broken else Frame, plain)
            masks.update(dict(value["masks"]))
        return _placed(found, masks)


def _placed(found: Dict[int, Union[Frame, BrokenFrame]], masks: Dict[int, str]) -> Gathered:
    """Give every file a path of its own: browsers that know no folders send equal names."""
    count = Counter(f.path for f in found.values())
    seen: Counter = Counter()
    ids: Dict[str, int] = {}
    frames: List[Frame] = []
    broken: List[BrokenFrame] = []
    for number in sorted(found):
        item = found[number]
        path = item.path
        seen[path] += 1
        if count[path] > 1 and seen[path] > 1:
            path = f"again-{seen[path]}/{path}"
        ids[path] = number
        placed = dataclasses.replace(item, path=path)
        (broken if isinstance(placed, BrokenFrame) else frames).append(placed)  # type: ignore[arg-type]
    frames.sort(key=lambda f: f.path)
    broken.sort(key=lambda f: f.path)
    by_path = {path: number for number, path in masks.items()}
    ids.update(by_path)
    return Gathered(Scan(tuple(frames), tuple(broken)), ids, mask_of([f.path for f in frames], list(by_path)))


def create(root: Path, user: int, project: int) -> Session:
    """A new session below ``root``, bound to its user."""
    name = secrets.token_hex(16)
    folder = root / f"{_PREFIX}{name}"
    folder.mkdir(mode=0o700, parents=True)
    write_text(folder / "session.json", dumps({"user": user, "project": project}))
    return Session(name, folder, user, project)


def find(root: Path, name: str, user: int) -> Optional[Session]:
    """The session of that name, or ``None`` where it is gone or somebody else's."""
    if not _ID.match(name):
        return None
    folder = root / f"{_PREFIX}{name}"
    try:
        told = json.loads((folder / "session.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return Session(name, folder, user, int(told["project"])) if told.get("user") == user else None


def forget(session: Session) -> None:
    """Remove a session."""
    shutil.rmtree(session.folder, ignore_errors=True)
