"""One submission per ledger: two at once would send everything twice."""

from __future__ import annotations

import contextlib
import importlib
from pathlib import Path
from typing import Iterator

from ...stages.errors import UsageError


@contextlib.contextmanager
def only_one(ledger: Path) -> Iterator[None]:
    """Hold a lock that the system gives back when the process ends, however it ends. Raises ``UsageError``."""
    path = ledger.with_name(f".{ledger.name}.lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = path.open("a+b")
    except OSError as error:
        raise UsageError(f"Cannot write beside the ledger {ledger}: {error.strerror}.") from error
    with stream:
        try:
            _take(stream.fileno())
        except OSError as error:
            raise UsageError(f"Another submission is using {ledger}. Wait for it, or stop it.") from error
        yield
    with contextlib.suppress(OSError):
        path.unlink()


def _take(handle: int) -> None:
    try:
        system = importlib.import_module("fcntl")
    except ImportError:
        windows = importlib.import_module("msvcrt")
        windows.locking(handle, windows.LK_NBLCK, 1)
        return
    system.flock(handle, system.LOCK_EX | system.LOCK_NB)
