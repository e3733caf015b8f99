"""Masks that lie beside their frames by ODM's convention: ``<stem>_mask.<ext>``."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import PurePosixPath
from typing import Dict, List, Sequence, Tuple

from ...stages.frame import Frame
from ...stages.read import Scan

_SUFFIX = "_mask"
_MASK_TYPES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")


def split_masks(scan: Scan) -> Tuple[Scan, Dict[str, str]]:
    """Take the masks out of a scan; returns the rest and frame path -> mask path.

    A mask is an image whose stem is that of a frame in the same folder with
    ``_mask`` behind it; an image of that name without such a frame is a frame.
    Masks count under ``ignored``, for they are no frames.
    """
    frame_of = {(_folder(f.path), _stem(f.path)): f.path for f in scan.frames}
    listed: Dict[str, List[str]] = {}
    for folder in sorted({_folder(f.path) for f in scan.frames}):
        try:
            listed[folder] = sorted(os.listdir(folder or "."))
        except OSError:
            listed[folder] = []
    masks: Dict[str, str] = {}
    for folder, names in listed.items():
        for name in names:
            stem, extension = PurePosixPath(name).stem, PurePosixPath(name).suffix
            if extension.lower() in _MASK_TYPES and stem.lower().endswith(_SUFFIX):
                frame = frame_of.get((folder, stem[: -len(_SUFFIX)]))
                if frame is not None:
                    masks.setdefault(frame, f"{folder}/{name}" if folder else name)
    taken = set(masks.values())
    frames: Sequence[Frame] = tuple(f for f in scan.frames if f.path not in taken)
    broken = tuple(b for b in scan.broken if b.path not in taken)
    ignored = dict(scan.ignored)
    if masks:
        ignored["masks"] = len(masks)
    return replace(scan, frames=tuple(frames), broken=broken, ignored=ignored), masks


def _folder(path: str) -> str:
    return path.rsplit("/", 1)[0] if "/" in path else ""


def _stem(path: str) -> str:
    return PurePosixPath(path).stem
