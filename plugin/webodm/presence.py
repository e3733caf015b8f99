"""Whether every process of WebODM runs this plugin as it lies on the disk.

WebODM loads a plugin that is uploaded to a running server into the one process
that took the upload; the others, and the worker, go on without it, or with what
they had, until they are started again. Nothing of ours runs in a process that
never loaded it, so what is found here is said to the administrator, and hold
mode is not switched on before.
"""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path
from typing import List, Optional

from . import home

LOG = logging.getLogger("app.logger")
_KEY = f"{home.NAME}-worker-has"
_FILE = Path(home.ROOT) / "__init__.py"
RESTART = "./webodm.sh restart"


def installed_at() -> float:
    """When the plugin's files were unpacked, in seconds since 1970."""
    try:
        return _FILE.stat().st_mtime
    except OSError:
        return 0.0


_LOADED = installed_at()


def note() -> None:
    """Called when the plugin is loaded: the worker says what it has."""
    if "celery" not in sys.argv[0]:
        return
    from django.core.cache import cache

    try:
        cache.set(_KEY, _LOADED, None)
    except Exception as error:  # the worker runs without; the page then asks for a restart
        LOG.warning("sensorgate: the worker could not say what it has loaded: %s", error)


def restart_needed() -> str:
    """What an administrator has to do before all processes run this plugin; empty where they do."""
    from django.core.cache import cache

    if installed_at() != _LOADED:
        why = "The files of sensorgate were replaced while WebODM ran, and this process still runs the old ones."
    elif web_is_older():
        why = "sensorgate was added while WebODM ran: some of its processes do not have it yet."
    elif cache.get(_KEY) != _LOADED:
        why = "WebODM's worker has not loaded this version of sensorgate."
    else:
        return ""
    return f"Restart WebODM now ({RESTART}). {why} Until then tasks can slip past the hold."


def web_is_older() -> bool:
    """Whether this process, or another of the same server, ran before the plugin was there."""
    starts = [_started(pid) for pid in _siblings()]
    return any(start is not None and start < _LOADED for start in starts)


def _siblings() -> List[int]:
    """This process and the others of the same server: gunicorn's workers have one parent."""
    own, parent = os.getpid(), os.getppid()
    try:
        if "gunicorn" not in Path(f"/proc/{parent}/cmdline").read_text(encoding="utf-8", errors="replace"):
            return [own]
        pids = [int(name) for name in os.listdir("/proc") if name.isdigit()]
    except OSError:
        return [own]
    return [own, *(p for p in pids if p != own and _stat(p, 1) == parent)]


def _stat(pid: int, index: int) -> Optional[int]:
    """A value of ``/proc/<pid>/stat`` behind the name of the program, which may hold blanks."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        return int(text.rpartition(")")[2].split()[index])
    except (OSError, ValueError, IndexError):
        return None


def _started(pid: int) -> Optional[float]:
    ticks = _stat(pid, 19)
    try:
        lines = Path("/proc/stat").read_text(encoding="utf-8").splitlines()
        boot = next(int(line.split()[1]) for line in lines if line.startswith("btime "))
        return None if ticks is None else boot + ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, StopIteration, IndexError):
        return None
