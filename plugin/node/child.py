"""One process at a time below the task: its output passed on line by line, a stop passed down to all it started."""

from __future__ import annotations

import contextlib
import os
import select
import selectors
import signal
import subprocess
import time
from pathlib import Path
from typing import Any, Callable, Dict, Optional, Sequence

from ...stages.thresholds import DEFAULTS

Heard = Callable[[str], None]
_PIECE = 4096  # a pipe takes so much in one piece
_POLL_S = 0.25


class Stopped(Exception):
    """The task was told to end."""


class Children:
    """Runs children in sessions of their own, so that a signal to the group reaches what they started as well."""

    def __init__(self, grace_s: float = DEFAULTS.node_grace_s) -> None:
        self._grace_s = grace_s
        self._process: Optional["subprocess.Popen[bytes]"] = None
        self._stopping = False

    def listen(self) -> None:
        """Take over the signals that end a task."""
        signal.signal(signal.SIGTERM, self._stop)
        for number in (signal.SIGINT, signal.SIGHUP):
            if signal.getsignal(number) != signal.SIG_IGN:  # nohup, or the background of a shell
                signal.signal(number, self._stop)

    def _stop(self, number: int, frame: Any) -> None:
        self._stopping = True
        self._signal(signal.SIGTERM)

    def _signal(self, number: int) -> None:
        if self._process is not None:
            with contextlib.suppress(OSError):
                os.killpg(self._process.pid, number)

    def run(
        self,
        command: Sequence[str],
        *,
        cwd: Optional[Path] = None,
        env: Optional[Dict[str, str]] = None,
        heard: Optional[Heard] = None,
    ) -> int:
        """Run ``command`` to its end and return its exit code as a shell would (128 + signal). Raises ``Stopped``."""
        if self._stopping:
            raise Stopped
        process = subprocess.Popen(
            list(command),
            cwd=None if cwd is None else str(cwd),
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        self._process = process
        try:
            self._relay(process, heard)
            code = process.wait()
        finally:
            if process.stdout is not None:
                process.stdout.close()
            # What it started and left behind goes with it.
            self._signal(signal.SIGKILL if process.poll() is None else signal.SIGTERM)
            if process.poll() is None:
                process.wait()
            self._process = None
        if self._stopping:
            raise Stopped
        return code if code >= 0 else 128 - code

    def _relay(self, process: "subprocess.Popen[bytes]", heard: Optional[Heard]) -> None:
        """Pass the output on until it ends, or until the grace after a stop is over."""
        assert process.stdout is not None
        source = process.stdout.fileno()
        held = b""
        told_at: Optional[float] = None
        with selectors.DefaultSelector() as selector:
            selector.register(source, selectors.EVENT_READ)
            while True:
                if self._stopping:
                    if told_at is None:
                        told_at = time.monotonic()
                        self._signal(signal.SIGTERM)
                    elif time.monotonic() - told_at > self._grace_s:
                        break
                elif _nobody_listens():
                    self._stopping = True
                    continue
                if not selector.select(_POLL_S):
                    self._pass_on(held, None)
                    held = b""
                    if process.poll() is not None:
                        break  # what it left behind holds the pipe open
                    continue
                data = os.read(source, 1 << 16)
                if not data:
                    break
                lines, newline, rest = (held + data).rpartition(b"\n")
                self._pass_on(lines + newline, heard)
                held = rest
        self._pass_on(held, None)

    @staticmethod
    def _pass_on(data: bytes, heard: Optional[Heard]) -> None:
        """Write whole lines in pieces that arrive as they are."""
        if not data:
            return
        piece = b""
        for line in data.splitlines(keepends=True):
            if heard is not None:
                heard(line.decode("utf-8", "replace").rstrip())
            if piece and len(piece) + len(line) > _PIECE:
                _write(piece)
                piece = b""
            piece += line
        _write(piece)


def _nobody_listens() -> bool:
    """Whether the reader of our output is gone: a node that died starts the task anew, and two must not run at once."""
    watch = select.poll()
    watch.register(1, 0)
    # A pipe says error, a socket (such as NodeODM gives) or a terminal says hung up.
    return any(happened & (select.POLLERR | select.POLLHUP) for _, happened in watch.poll(0))


def _write(data: bytes) -> None:
    """Write all of it; that nobody reads any more is noticed elsewhere."""
    with contextlib.suppress(BrokenPipeError):
        while data:
            data = data[os.write(1, data) :]
