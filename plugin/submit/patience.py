"""How long a call is tried again, and how waiting hears that it should stop."""

from __future__ import annotations

import threading
import time
from typing import Callable, Optional, Tuple, Type, TypeVar

from ...stages.progress import Cancel, check
from ...stages.thresholds import Thresholds
from .errors import NodeError, NotSent, Unsure

T = TypeVar("T")
_LONGEST_WAIT_S = 60.0


class Patience:
    """Waits between tries; a set ``stop`` ends every wait at once."""

    def __init__(self, limits: Thresholds, stop: threading.Event, cancel: Optional[Cancel] = None) -> None:
        self.limits = limits
        self.stop = stop
        self._cancel = cancel

    def check(self) -> None:
        """Raise ``Cancelled`` when the work is to end."""
        check(lambda: self.stop.is_set() or (self._cancel is not None and self._cancel()))

    def wait(self, seconds: float) -> None:
        """Wait, unless the work is to end."""
        self.check()
        self.stop.wait(seconds)
        self.check()

    def keep_asking(self, call: Callable[[], T], *, repeat: Tuple[Type[NodeError], ...] = (NotSent, Unsure)) -> T:
        """Call until it answers; errors of ``repeat`` are outwaited up to the patience, others are raised at once.

        ``Unsure`` may stand in ``repeat`` only where the call may be carried out twice.
        """
        began = time.monotonic()
        wait = self.limits.submit_retry_s
        while True:
            self.check()
            try:
                return call()
            except repeat:
                left = self.limits.submit_patience_s - (time.monotonic() - began)
                if left <= 0:
                    raise
                self.wait(min(wait, left, _LONGEST_WAIT_S))
                wait *= 2
