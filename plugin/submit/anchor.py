"""Which project the others are laid on: ODM's ``align`` takes the anchor's points as the reference. Pure."""

from __future__ import annotations

from pathlib import Path
from typing import Optional, Sequence, Tuple

from ...stages.errors import UsageError
from ...stages.route import ROUTES
from .parcel import Parcel

ISOLATED, ALL, NONE = "isolated", "all", "none"
CHOICES = (ISOLATED, ALL, NONE)


def _has_control(parcel: Parcel) -> bool:
    return any(i.name == "gcp_list.txt" for i in parcel.items)


def choose(parcels: Sequence[Parcel], which: str) -> Tuple[Optional[str], Tuple[str, ...]]:
    """The anchor's name and the names of those that wait for it.

    The anchor is the project with ground control, else the best proven, else
    the one with most frames. ``isolated`` lays the projects on it that the
    router set apart, ``all`` all others; one with ground control of its own
    needs no anchor. Nobody waits where there is one project only.
    """
    if which not in CHOICES:
        raise UsageError(f"--align takes {', '.join(CHOICES)}, not {which!r}.")
    roots = [p for p in parcels if not p.parent]
    if which == NONE or len(roots) < 2:
        return None, ()

    def rank(p: Parcel) -> Tuple[bool, int, int, str]:
        place = ROUTES.index(p.route) if p.route in ROUTES else len(ROUTES)
        return (not _has_control(p), place, -p.images, p.name)

    anchor = min(roots, key=rank)
    waiting = tuple(
        sorted(
            p.name
            for p in parcels
            if p.name != anchor.name
            and p.parent != anchor.name
            and not _has_control(p)
            and (which == ALL or p.route == "isolate")
        )
    )
    return (anchor.name, waiting) if waiting else (None, ())


def product(folder: Path, parts: Sequence[str]) -> Optional[Path]:
    """The anchor's points where they were brought home."""
    path = folder.joinpath(*parts)
    return path if path.is_file() else None
