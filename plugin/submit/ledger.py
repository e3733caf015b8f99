"""What was sent, where, under which uuid, and what became of it: on disk before and after every act on the node.

Beside the ledger stands a journal for each upload: one line when a file is
begun, one when the node has it. After a crash a file that was begun and not
finished may lie on the node in part, and is never sent under its name again.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Dict, List, Optional, Set, Tuple

from ...stages.errors import UsageError
from ...stages.record import dumps, from_plain, to_plain, write_text
from .parcel import read_json

SCHEMA_VERSION = 1

# States of one task, in the order in which it runs through them.
OPENING = "opening"  # the node is asked for an upload
UPLOADING = "uploading"  # files are being sent
COMMITTING = "committing"  # the node is asked to make a task of them
VERIFYING = "verifying"  # the task is known to the node, and is compared with what was sent
RUNNING = "running"  # the node has all of it
COMPLETED = "completed"  # done there; the products are not here yet
FETCHED = "fetched"  # the products are here
FAILED = "failed"  # the node said that it failed
CANCELED = "canceled"  # stopped there, by us or by somebody
DISCARDING = "discarding"  # an upload that came to nothing is being removed
DISCARDED = "discarded"  # nothing of it is on the node any more
LOST = "lost"  # the node does not know it any more

OPEN = frozenset((OPENING, UPLOADING, COMMITTING, VERIFYING, RUNNING, COMPLETED, DISCARDING))

# What became of a project.
DONE = "done"
REROUTED = "rerouted"
GIVEN_UP = "failed"
REFUSED = "refused"
WAITING = "waiting"


@dataclass(frozen=True)
class Attempt:
    """One task of a project on a node. ``opened`` says that the node took the upload under this uuid."""

    number: int
    uuid: str
    node: str
    state: str
    reason: str
    options: Tuple[Dict[str, Any], ...] = ()
    files: int = 0
    images: int = 0
    opened: bool = False
    seed: bool = False
    calibration_file: bool = False
    repaired: Tuple[str, ...] = ()
    notes: Tuple[str, ...] = ()
    message: str = ""


@dataclass(frozen=True)
class Entry:
    """One project: its tasks, and what became of it. ``children`` are the projects it was split into."""

    name: str
    digest: str
    folder: str
    images: int
    payloads: Tuple[str, ...]
    attempts: Tuple[Attempt, ...] = ()
    state: str = WAITING
    route: str = ""
    reasons: Tuple[str, ...] = ()
    parent: str = ""
    children: Tuple[str, ...] = ()
    seeds: bool = True
    leave_out: Dict[str, str] = field(default_factory=dict)

    @property
    def last(self) -> Optional[Attempt]:
        """The latest task."""
        return self.attempts[-1] if self.attempts else None


class Ledger:
    """The entries of one submission; every change is on disk before the call returns. Safe between threads."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.RLock()
        self._entries: Dict[str, Entry] = {}
        self._superseded: List[Any] = []

    @classmethod
    def open(cls, path: Path) -> Ledger:
        """Read the ledger, or begin one. Raises ``UsageError`` where the file is something else."""
        ledger = cls(path)
        if path.exists():
            told = read_json(path, "submission ledger")
            if not isinstance(told, dict) or told.get("schema_version") != SCHEMA_VERSION:
                raise UsageError(f"{path} is no submission ledger of this version. Name another file with --ledger.")
            try:
                for plain in told.get("projects", []):
                    entry = from_plain(Entry, plain)
                    ledger._entries[entry.name] = entry
            except (TypeError, ValueError, KeyError, AttributeError) as error:
                raise UsageError(f"{path} is damaged ({error}). Name another file with --ledger.") from error
            ledger._superseded = list(told.get("superseded", []))
        else:
            ledger._write()
        return ledger

    @property
    def entries(self) -> Tuple[Entry, ...]:
        """All projects, by name."""
        with self._lock:
            return tuple(self._entries[k] for k in sorted(self._entries))

    def get(self, name: str) -> Optional[Entry]:
        """The entry of a project."""
        with self._lock:
            return self._entries.get(name)

    def put(self, entry: Entry) -> Entry:
        """Write an entry; one of the same name with other content is kept among the superseded."""
        with self._lock:
            before = self._entries.get(entry.name)
            if before is not None and before.digest != entry.digest:
                self._superseded.append(to_plain(before))
            self._entries[entry.name] = entry
            self._write()
            return entry

    def change(self, name: str, **values: Any) -> Entry:
        """Replace fields of an entry."""
        with self._lock:
            return self.put(replace(self._entries[name], **values))

    def attempt(self, name: str, **values: Any) -> Attempt:
        """Replace fields of the latest attempt of a project."""
        with self._lock:
            entry = self._entries[name]
            last = replace(entry.attempts[-1], **values)
            self.put(replace(entry, attempts=(*entry.attempts[:-1], last)))
            return last

    def begin(self, name: str, attempt: Attempt) -> Attempt:
        """Add an attempt."""
        with self._lock:
            entry = self._entries[name]
            self.put(replace(entry, attempts=(*entry.attempts, attempt)))
            return attempt

    def plain(self) -> Dict[str, Any]:
        """The ledger as JSON values."""
        with self._lock:
            return {
                "schema_version": SCHEMA_VERSION,
                "projects": [to_plain(e) for e in self.entries],
                "superseded": list(self._superseded),
            }

    def _write(self) -> None:
        try:
            write_text(self.path, dumps(self.plain()))
        except OSError as error:
            raise UsageError(f"Cannot write the ledger {self.path}: {error.strerror}.") from error

    @property
    def _journals(self) -> Path:
        return self.path.with_name(f"{self.path.stem}-uploads")

    def journal(self, uuid: str) -> Journal:
        """The journal of one upload."""
        return Journal(self._journals / f"{uuid}.txt")

    def tidy(self) -> None:
        """Remove the folder of journals when all uploads are over; nobody else may be writing one."""
        if self._journals.is_dir() and not any(self._journals.iterdir()):
            self._journals.rmdir()


class Journal:
    """Which files of one upload were begun, and which the node has."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self.begun: Set[str] = set()
        self.done: Set[str] = set()
        if path.is_file():
            for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
                mark, _, name = line.partition(" ")
                if mark == "+":
                    self.begun.add(name)
                elif mark == "=":
                    self.done.add(name)
                elif mark == "-":
                    self.begun.discard(name)

    @property
    def torn(self) -> Set[str]:
        """Files of which a part may lie on the node."""
        with self._lock:
            return self.begun - self.done

    def _say(self, mark: str, name: str) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(f"{mark} {name}\n")

    def begin(self, name: str) -> None:
        """The file is about to be sent."""
        with self._lock:
            self._say("+", name)
            self.begun.add(name)

    def never_sent(self, name: str) -> None:
        """The connection was never made: the file may be sent again."""
        with self._lock:
            self._say("-", name)
            self.begun.discard(name)

    def finish(self, name: str) -> None:
        """The node has the file."""
        with self._lock:
            self._say("=", name)
            self.done.add(name)

    def remove(self) -> None:
        """The upload is over."""
        with self._lock:
            if self._path.exists():
                self._path.unlink()
