"""What a task says while it runs: lines as ODM writes them, progress as ODM broadcasts it, entries of ``log.json``."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import socket
import textwrap
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Optional

from ...stages.record import write_text

INFO, WARNING, ERROR = "INFO", "WARNING", "ERROR"
# Where every NodeODM of a machine listens to ODM. Of several only one hears what goes to the first address, as ODM
# sends it; what goes to the second reaches them all.
PROGRESS_PORT = 6367
_LISTENERS = ("127.0.0.1", "127.255.255.255")
_WIDTH = 160
_PLAIN = str.maketrans({"…": "...", "→": "->", "–": "-", "—": "-", "·": "|", "×": "x", "≤": "<=", "≥": ">=", "σ": "s"})


def plain(text: str) -> str:
    """``text`` in printable ASCII: a node cuts the output into pieces, which breaks longer characters."""
    spelled = text.translate(_PLAIN).encode("ascii", "replace").decode("ascii")
    return "".join(c if c.isprintable() else " " for c in spelled)


def say(level: str, text: str) -> None:
    """Write lines as ODM's log does, each at once and short, so that a node shows it whole."""
    head = f"[{level}]".ljust(9)
    parts = textwrap.wrap(plain(text), _WIDTH, subsequent_indent="  ", drop_whitespace=False) or [""]
    for part in parts:
        # Nobody reads any more where the pipe is closed; the work itself decides when to end.
        with contextlib.suppress(OSError):
            os.write(1, f"{head} {part.rstrip()}\n".encode("ascii"))


class Broadcast:
    """Progress in percent to whoever listens, in ODM's words."""

    def __init__(self, name: str, port: int = PROGRESS_PORT) -> None:
        self._name = name
        self._port = port
        self._last = -1.0

    def __call__(self, percent: float) -> None:
        """Send ``percent`` of the whole task; less than a tenth more is not sent."""
        value = round(min(100.0, max(0.0, percent)), 2)
        if value < self._last + 0.1 and value < 100.0:
            return
        self._last = value
        message = f"PGUP/{os.getpid()}/{self._name}/{value}".encode("utf-8", "replace")
        with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            out.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            for listener in _LISTENERS:
                out.sendto(message, (listener, self._port))


def _now() -> datetime.datetime:
    return datetime.datetime.now()


@dataclass
class Stage:
    """One stage as ODM shows and logs it."""

    name: str
    started: datetime.datetime = field(default_factory=_now)
    messages: List[Dict[str, str]] = field(default_factory=list)
    ended: Optional[datetime.datetime] = None

    def begin(self) -> "Stage":
        """Say that the stage runs."""
        self.say(INFO, f"Running {self.name} stage")
        return self

    def say(self, level: str, text: str) -> None:
        """Say a line and keep it for ``log.json``."""
        say(level, text)
        self.messages.append({"message": plain(text), "type": level.lower()})

    def end(self) -> None:
        """Say that the stage is finished."""
        self.say(INFO, f"Finished {self.name} stage")
        self.ended = _now()

    def entry(self) -> Dict[str, Any]:
        """The stage's entry in ``log.json``."""
        ended = self.ended or _now()
        return {
            "name": self.name,
            "startTime": self.started.isoformat(),
            "messages": self.messages,
            "endTime": ended.isoformat(),
            "totalTime": round((ended - self.started).total_seconds(), 2),
        }


def prepend_stages(log: Path, entries: Iterable[Mapping[str, Any]]) -> None:
    """Put our stages before ODM's in the ``log.json`` that ODM wrote; one that cannot be read stays as it is."""
    ahead = list(entries)
    try:
        record = json.loads(log.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return
    if not isinstance(record, dict) or not isinstance(record.get("stages"), list) or not ahead:
        return
    names = {e["name"] for e in ahead}
    record["stages"] = [*ahead, *(s for s in record["stages"] if not (isinstance(s, dict) and s.get("name") in names))]
    record["startTime"] = ahead[0]["startTime"]
    with contextlib.suppress(KeyError, TypeError, ValueError):
        whole = datetime.datetime.fromisoformat(record["endTime"]) - datetime.datetime.fromisoformat(
            record["startTime"]
        )
        record["totalTime"] = round(whole.total_seconds(), 2)
    write_text(log, json.dumps(record, indent=4))


def write_refusal_log(
    log: Path, entries: Iterable[Mapping[str, Any]], *, version: str, images: int, code: int, message: str
) -> None:
    """``log.json`` of a task that ODM never saw, in ODM's format."""
    ahead = list(entries)
    started = ahead[0]["startTime"] if ahead else _now().isoformat()
    ended = _now()
    record = {
        "odmVersion": version,
        "images": images,
        "options": {},
        "startTime": started,
        "stages": ahead,
        "processes": [],
        "success": False,
        "error": {"code": code, "message": plain(message)},
        "stackTrace": [],
        "endTime": ended.isoformat(),
        "totalTime": round((ended - datetime.datetime.fromisoformat(started)).total_seconds(), 2),
    }
    write_text(log, json.dumps(record, indent=4))
