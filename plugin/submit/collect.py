"""What a task made, brought home: asked for, bounded, and never outside its folder."""

from __future__ import annotations

import os
import re
import shutil
import stat
import zipfile
from pathlib import Path, PurePosixPath
from typing import List, Optional, Sequence, Tuple

from ...stages.errors import UsageError
from ...stages.thresholds import DEFAULTS, Thresholds
from ..odm.layout import EVIDENCE, GCP_FILE, GEO_FILE, IMAGE_GROUPS, IMAGES
from ..odm.project import OURS
from .errors import Refused

ALL = "all.zip"
NONE = "none"
# What stands in a project folder before ODM runs; no archive may replace it.
KEPT = frozenset((IMAGES, OURS, GCP_FILE, GEO_FILE, IMAGE_GROUPS))
_NAME = re.compile(r"^[A-Za-z0-9_.][A-Za-z0-9_. /*-]*$")
_PART = 1 << 20


def outputs_for(assets: Sequence[str]) -> Tuple[str, ...]:
    """What the node is told to pack; empty means its own list. ``UsageError`` for a name that leaves the task."""
    if ALL in assets:
        return ()
    for name in assets:
        if name != NONE and (not _NAME.match(name) or name.startswith("/") or ".." in name.split("/")):
            raise UsageError(
                f"--assets takes {ALL}, {NONE} or paths inside a project like odm_orthophoto, not {name!r}."
            )
    return tuple(dict.fromkeys((*(a for a in assets if a != NONE), *EVIDENCE)))


def room(folder: Path, limits: Thresholds = DEFAULTS) -> int:
    """Bytes that may be written into ``folder``."""
    free = shutil.disk_usage(folder).free - limits.submit_disk_reserve_bytes
    return max(0, min(limits.submit_asset_bytes, free))


def unpack(
    archive: Path, folder: Path, limits: Thresholds = DEFAULTS, max_bytes: Optional[int] = None
) -> Tuple[str, ...]:
    """Unpack a node's archive into the project ``folder``; returns the names that were put at its root.

    Everything is unpacked beside and moved in at the end. Raises ``Refused``
    for an archive that is damaged, too large, leaves its folder, holds links,
    or would replace the project's own input.
    """
    beside = folder / ".part-assets"
    shutil.rmtree(beside, ignore_errors=True)
    beside.mkdir(parents=True)
    try:
        try:
            with zipfile.ZipFile(archive) as opened:
                _extract(opened, beside, room(folder, limits) if max_bytes is None else max_bytes, limits)
        except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError) as error:
            raise Refused(f"all.zip is damaged: {error}.", "damaged") from error
        return _install(beside, folder)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _extract(archive: zipfile.ZipFile, folder: Path, left: int, limits: Thresholds) -> None:
    entries = archive.infolist()
    if len(entries) > limits.submit_asset_files:
        raise Refused(f"all.zip holds {len(entries)} files.", "too many files")
    root = folder.resolve()
    for entry in entries:
        target = _target(entry, root)
        if entry.is_dir():
            target.mkdir(parents=True, exist_ok=True)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        # What the header says of the size is not believed: bytes are counted as they come.
        with archive.open(entry) as source, target.open("wb") as sink:
            while True:
                part = source.read(_PART)
                if not part:
                    break
                left -= len(part)
                if left < 0:
                    raise Refused("all.zip unpacks to more than this disk has room for.", "too large")
                sink.write(part)


def _target(entry: zipfile.ZipInfo, root: Path) -> Path:
    name = entry.filename
    parts = PurePosixPath(name).parts
    mode = entry.external_attr >> 16
    if (
        not parts
        or "\\" in name
        or "\0" in name
        or name.startswith("/")
        or ".." in parts
        or ":" in parts[0]
        or (mode and not (stat.S_ISREG(mode) or stat.S_ISDIR(mode) or stat.S_IFMT(mode) == 0))
    ):
        raise Refused(f"all.zip holds an entry that must not be unpacked: {name!r}.", "unsafe name")
    if parts[0].lower() in KEPT:
        raise Refused(f"all.zip would replace the project's own {parts[0]}.", "own input")
    target = root.joinpath(*parts)
    if root not in target.resolve().parents:
        raise Refused(f"all.zip holds an entry that leaves its folder: {name!r}.", "unsafe name")
    return target


def _install(beside: Path, folder: Path) -> Tuple[str, ...]:
    names: List[str] = []
    for entry in sorted(beside.iterdir()):
        target = folder / entry.name
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target)
        os.replace(entry, target)
        names.append(entry.name)
    return tuple(names)


def set_aside(folder: Path, number: int) -> None:
    """Move a rejected result out of the way, so that nothing later takes it for the project's product."""
    shelf = folder / OURS / f"rejected-{number}"
    for entry in sorted(folder.iterdir()):
        if entry.name in KEPT or entry.name.startswith("."):
            continue
        shelf.mkdir(parents=True, exist_ok=True)
        target = shelf / entry.name
        if target.is_dir():
            shutil.rmtree(target)
        os.replace(entry, target)
