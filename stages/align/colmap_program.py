"""COLMAP's program: found, and run with the options that its version knows."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple, Sequence, Tuple

from ..errors import MissingDependency
from .worker import SolverFailed

_TIMEOUT_S = 24 * 3600


class Flag(NamedTuple):
    """An option under its names, newest first, and its value."""

    names: Tuple[str, ...]
    value: str


class ProgramFailed(SolverFailed):
    """The program ended with an error; ``crashed`` where a signal ended it."""

    def __init__(self, message: str, crashed: bool) -> None:
        super().__init__(message)
        self.crashed = crashed


def program() -> str:
    """The program's path; ``MissingDependency`` where it is not installed."""
    found = shutil.which("colmap")
    if found is None:
        raise MissingDependency("COLMAP", "the alignment with --engine colmap", "sudo apt install colmap")
    return found


def run(program: str, verb: str, flags: Sequence[Flag], folder: Path) -> None:
    """Run one verb with the options that this version knows; raises ``ProgramFailed`` with its last words."""
    known = subprocess.run(
        [program, verb, "--help"], capture_output=True, text=True, errors="replace", timeout=60, check=False
    )
    words = known.stdout + known.stderr
    command = [program, verb]
    for flag in flags:
        name = next((n for n in flag.names if f"--{n} " in words or f"--{n}\n" in words), None)
        if name is not None:
            command += [f"--{name}", flag.value]
    done = subprocess.run(
        command, capture_output=True, text=True, errors="replace", timeout=_TIMEOUT_S, check=False, cwd=str(folder)
    )
    if done.returncode != 0:
        tail = " | ".join((done.stdout + done.stderr).strip().splitlines()[-3:])
        raise ProgramFailed(f"colmap {verb} ended with code {done.returncode}: {tail[-500:]}", done.returncode < 0)
