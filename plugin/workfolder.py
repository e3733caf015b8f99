"""The output folder and its scratch: refused when in use, kept for ``--resume``, removed on success."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Iterator, Optional

from ..stages.errors import SensorgateError, UsageError
from ..stages.record import dumps, write_text

_STATE = "state.json"
# What submitting leaves beside the results.
_SUBMITTED = ("submit.json", "submit-uploads")
RESULTS = ("report.json", "report.html", "plan.json", "projects")


class NoSpace(SensorgateError):
    """The disk is full."""

    exit_code = 2


@dataclass(frozen=True)
class WorkFolder:
    """``out`` receives the result, ``scratch`` everything before it is whole."""

    out: Path
    scratch: Path
    made_out: bool

    def folder(self, name: str) -> Path:
        """A folder of that name in the scratch, made when missing."""
        path = self.scratch / name
        path.mkdir(parents=True, exist_ok=True)
        return path

    def load(self, name: str) -> Any:
        """A JSON value kept by an interrupted run, or ``None``; a damaged one counts as not there."""
        try:
            return json.loads((self.scratch / name).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None

    def keep(self, name: str, value: Any) -> None:
        """Keep a JSON value for a later ``--resume``."""
        write_text(self.scratch / name, dumps(value))

    def begin(self, digest: str, resume: bool) -> None:
        """Bind the scratch to these inputs and options; what belongs to others is cleared."""
        state = self.load(_STATE)
        if not (resume and isinstance(state, dict) and state.get("digest") == digest):
            self.clear()
        self.scratch.mkdir(parents=True, exist_ok=True)
        self.keep(_STATE, {"digest": digest})

    def clear(self) -> None:
        """Remove the scratch."""
        shutil.rmtree(self.scratch, ignore_errors=True)

    def abandon(self) -> None:
        """Nothing came of it: leave the output folder as it was found."""
        self.clear()
        if self.made_out:
            with contextlib.suppress(OSError):
                self.out.rmdir()

    def publish(self) -> None:
        """Move the finished result from the scratch into the output folder, the report last, and clear the scratch."""
        staged = self.scratch / "result"
        for name in ("projects", "plan.json", "report.html", "report.json"):
            source, target = staged / name, self.out / name
            if not source.exists():
                continue
            if target.is_dir():
                shutil.rmtree(target)
            try:
                os.replace(source, target)
            except OSError as error:
                if error.errno != errno.EXDEV:
                    raise
                beside = self.out / f".part-{name}"
                if source.is_dir():
                    shutil.rmtree(beside, ignore_errors=True)
                    shutil.copytree(source, beside)
                else:
                    shutil.copy2(source, beside)
                os.replace(beside, target)
        self.clear()


def open_folder(out: Path, work: Optional[Path], inputs: "list[Path]", resume: bool) -> WorkFolder:
    """Check the output folder and make it. Raises ``UsageError`` where it cannot be used.

    It must be new, empty, or (with ``resume``) the folder of an interrupted or
    finished run. It may not lie inside the input, nor the input inside it.
    """
    resolved = out.resolve()
    for source in inputs:
        folder = source.resolve()
        if folder == resolved or folder in resolved.parents:
            raise UsageError(f"The output folder {out} lies inside the input {source}. Choose a folder beside it.")
        if resolved in folder.parents:
            raise UsageError(f"The input {source} lies inside the output folder {out}. Choose another output folder.")
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out} is a file. Choose a folder for --out.")
    scratch = work / f"sensorgate-{resolved.name}" if work is not None else out / ".work"
    made = not out.exists()
    if not made:
        try:
            there = {p.name for p in out.iterdir()}
        except OSError as error:
            raise UsageError(f"Cannot read the output folder {out}: {error.strerror}.") from error
        ours = {*RESULTS, *_SUBMITTED, ".work"}
        if there and not (resume and there <= ours):
            way_out = (
                "It holds an interrupted or finished run: add --resume to go on, or choose another folder."
                if there <= ours
                else "Choose a new or empty folder."
            )
            raise UsageError(f"The output folder {out} is not empty. {way_out}")
    try:
        out.mkdir(parents=True, exist_ok=True)
        scratch.mkdir(parents=True, exist_ok=True)
        probe = scratch / ".probe"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise UsageError(
            f"Cannot write to the output folder {out}: {error.strerror}. Choose another folder."
        ) from error
    return WorkFolder(out=out, scratch=scratch, made_out=made)


@contextlib.contextmanager
def disk_errors(folder: Path) -> Iterator[None]:
    """Turn a full disk into a sentence with the way out."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise NoSpace(
                f"The disk of {folder} is full. Free some space and run the same command with --resume, "
                "or choose another disk with --out."
            ) from error
        raise
