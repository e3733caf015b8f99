"""What happens to the imagery: cameras and pixels, nothing of ODM.

The calls that scripts use are here by name; each is imported when first used,
so that the gate needs numpy and Pillow alone.
"""

from __future__ import annotations

import importlib
from typing import Any

_CALLS = {
    "profile_images": "document",
    "assert_profiles_consistent": "document",
    "run_locked_sfm": "document",
    "PipelineRouter": "route",
    "read_frame": "read",
    "scan": "read",
    "assess": "gate",
}

__all__ = sorted(_CALLS)


def __getattr__(name: str) -> Any:
    if name not in _CALLS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_CALLS[name]}", __name__), name)
