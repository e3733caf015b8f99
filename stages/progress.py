"""How long work tells its progress and hears that it should stop."""

from __future__ import annotations

from typing import Callable, Optional

from .errors import Cancelled

# stage name, done, total (0 = unknown)
Progress = Callable[[str, int, int], None]
Cancel = Callable[[], bool]


def check(cancel: Optional[Cancel]) -> None:
    """Raise ``Cancelled`` when the caller wants the work to end."""
    if cancel is not None and cancel():
        raise Cancelled("Stopped. What was finished is kept; run the same command with --resume to go on.")
