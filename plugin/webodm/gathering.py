"""From what was sent, or from a task's folder, to an inspection. The only disk that is touched is the task's own."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Optional

from ...stages.progress import Progress
from ...stages.read import Scan, scan
from ..inspection import Inspection, Settings, inspect_scan
from . import calibrating
from .headers import is_mask, mask_of
from .sessions import Gathered

_NOWHERE = Path(os.devnull) / "not-here"
# What a node lays the reconstruction on; no image, whatever its kind.
ALIGN = re.compile(r"^align\.(las|laz|tif)$", re.IGNORECASE)
_NOT_CONTROL = frozenset(("geo.txt", "image_groups.txt"))


@dataclass(frozen=True)
class TaskFiles:
    """The files in a task's folder by what they are. ``control`` is its ground control, ``geo`` its positions."""

    folder: Path
    names: List[str]
    control: Optional[str]
    geo: Optional[str]


def of_session(gathered: Gathered, settings: Settings, gcp: Optional[str], geo: Optional[str]) -> Inspection:
    """The inspection of headers that a browser sent. Raises ``UsageError`` where the control texts cannot be read."""
    taken = set(gathered.masks.values())
    seen = replace(gathered.scan, frames=tuple(f for f in gathered.scan.frames if f.path not in taken))
    # Paths come from the browser: they never name a file here.
    return inspect_scan(
        seen,
        ("the chosen files",),
        replace(settings, gcp=gcp, geo=geo),
        open_path=lambda path: _NOWHERE,
        masks=gathered.masks,
    )


def task_files(folder: Path) -> TaskFiles:
    """What lies in the folder, without what the plugin or WebODM keep below it."""
    names = sorted(
        e.name
        for e in os.scandir(folder)
        if e.is_file() and not (e.name.startswith(".") or e.name in calibrating.FILES or ALIGN.match(e.name))
    )
    texts = [n for n in names if n.lower().endswith(".txt")]
    geo = next((n for n in texts if n.lower() == "geo.txt"), None)
    control = next((n for n in texts if n.lower() == "gcp_list.txt"), None) or next(
        (n for n in texts if n.lower() not in _NOT_CONTROL), None
    )
    return TaskFiles(folder, names, str(folder / control) if control else None, str(folder / geo) if geo else None)


def of_task(folder: Path, settings: Settings, progress: Optional[Progress] = None) -> Inspection:
    """The inspection of a task's images; paths in it are file names alone."""
    files = task_files(folder)
    found = scan([str(folder)], progress=progress, limits=settings.thresholds)
    prefix = str(folder).rstrip("/") + "/"
    # Products and what we keep lie in folders below; a task's images lie flat.
    frames = tuple(replace(f, path=f.path[len(prefix) :]) for f in found.frames if "/" not in f.path[len(prefix) :])
    broken = tuple(replace(b, path=b.path[len(prefix) :]) for b in found.broken if "/" not in b.path[len(prefix) :])
    masks: Dict[str, str] = mask_of([f.path for f in frames], [n for n in files.names if is_mask(n)])
    taken = set(masks.values())
    seen = Scan(
        tuple(f for f in frames if f.path not in taken and not ALIGN.match(f.path)),
        tuple(b for b in broken if b.path not in taken and not ALIGN.match(b.path)),
        {},
    )
    return inspect_scan(
        seen,
        ("images",),
        replace(settings, gcp=files.control, geo=files.geo),
        open_path=lambda path: folder / path,
        masks=masks,
    )
