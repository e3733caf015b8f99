"""How findings name and count things."""

from __future__ import annotations

from typing import Dict, Iterable, Sequence

SPECTRUM_WORD: Dict[str, str] = {"rgb": "colour", "multispectral": "multispectral", "thermal": "thermal"}


def listed(items: Iterable[str], most: int = 3) -> str:
    """``a, b, c and 5 more``."""
    names = list(items)
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"


def plural(count: int, noun: str = "frame") -> str:
    """``1 frame``, ``2 frames``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def named(paths: Sequence[str], most: int = 3) -> str:
    """File names without their folders, the first few."""
    return listed([p.rsplit("/", 1)[-1] for p in paths], most)
