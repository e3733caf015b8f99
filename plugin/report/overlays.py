"""Bands over their primary in red and cyan, before and after they were laid on it."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from ...stages.harmonize.model import HarmonizedFrame
from .pictures import CROP_HEIGHT, CROP_WIDTH, PathLike, picture_size, preview_key, to_jpeg

BAND_BEFORE, BAND_AFTER = "band-before", "band-after"
MOST_OVERLAYS = 12
# Pixels of the primary that a crop shows: a shift of one pixel is still to be seen in it.
VIEW_WIDTH, VIEW_HEIGHT = 240, 180
_PLACES = (0.2, 0.5, 0.8)
_RANGE = (1, 99)
_MOST_EMPTY = 0.02
Box = Tuple[float, float, float, float]


def chosen_bands(report: Mapping[str, Any], most: int = MOST_OVERLAYS) -> List[Tuple[str, str]]:
    """(Primary, band) frames worth a picture: the middle warped capture of each band of each rig."""
    captures: Dict[Tuple[str, str], List[Mapping[str, Any]]] = {}
    for frame in report["frames"]:
        captures.setdefault((frame["payload"], frame["capture"]), []).append(frame)
    found = []
    for rig in report.get("bands", []):
        laid = {fit["profile"] for fit in rig["fits"]}
        for profile in sorted({fit["profile"] for fit in rig["fits"] if fit["state"] == "warp"}):
            pairs = [
                (primary["path"], band["path"])
                for (payload, _), frames in captures.items()
                if payload == rig["payload"]
                for band in frames
                if band["profile"] == profile and band["output"] and (band.get("change") or {}).get("how") == "warped"
                for primary in frames
                if primary["profile"] not in laid and primary["output"]
            ]
            if pairs:
                found.append(sorted(pairs)[len(pairs) // 2])
    return found[:most]


def band_overlays(report: Mapping[str, Any], copies: Mapping[str, HarmonizedFrame]) -> Dict[str, bytes]:
    """JPEG bytes by ``preview_key(band's path, BAND_BEFORE | BAND_AFTER)``; what cannot be shown is left out."""
    found: Dict[str, bytes] = {}
    for primary, band in chosen_bands(report):
        if primary not in copies or band not in copies:
            continue
        made = overlay_pair((primary, band), (copies[primary].file, copies[band].file))
        if made is not None:
            found[preview_key(band, BAND_BEFORE)], found[preview_key(band, BAND_AFTER)] = made
    return found


def overlay_pair(before: Tuple[PathLike, PathLike], after: Tuple[PathLike, PathLike]) -> Optional[Tuple[bytes, bytes]]:
    """The same part of the frame from (primary, band) before and after; ``None`` when one is unreadable."""
    size = picture_size(after[0])
    if size is None:
        return None
    box = _most_telling(after, (min(1.0, VIEW_WIDTH / size[0]), min(1.0, VIEW_HEIGHT / size[1])))
    if box is None:
        return None
    made = [_overlay(pair, box) for pair in (before, after)]
    return (made[0], made[1]) if made[0] is not None and made[1] is not None else None


def _most_telling(pair: Sequence[PathLike], share: Tuple[float, float]) -> Optional[Box]:
    """The place where both frames show most of the same edges."""
    best: Optional[Tuple[float, Box]] = None
    for down in _PLACES:
        for across in _PLACES:
            left, top = across * (1.0 - share[0]), down * (1.0 - share[1])
            box = (left, top, left + share[0], top + share[1])
            parts = [_part(path, box) for path in pair]
            if parts[0] is None or parts[1] is None:
                return None
            told = _common_detail(parts[0], parts[1])
            if best is None or told > best[0]:
                best = (told, box)
    return None if best is None else best[1]


def _common_detail(one: "np.ndarray[Any, Any]", other: "np.ndarray[Any, Any]") -> float:
    """How much detail both have, times how well it agrees; nothing where one of them has no picture."""
    if max((part <= 0).mean() for part in (one, other)) > _MOST_EMPTY:
        return -1.0
    edges = [np.hypot(*np.gradient(_even(part).astype(np.float64))) for part in (one, other)]
    spread = float(np.std(edges[0]) * np.std(edges[1]))
    if spread <= 0.0:
        return 0.0
    likeness = float(np.mean((edges[0] - edges[0].mean()) * (edges[1] - edges[1].mean())) / spread)
    return likeness * min(float(e.mean()) for e in edges)


def _overlay(pair: Sequence[PathLike], box: Box) -> Optional[bytes]:
    parts = [_part(path, box) for path in pair]
    if parts[0] is None or parts[1] is None:
        return None
    red, cyan = (_even(p) for p in parts if p is not None)
    return to_jpeg(np.stack((red, cyan, cyan), axis=2))


def _even(part: "np.ndarray[Any, Any]") -> "np.ndarray[Any, Any]":
    """Each band over its own range: their brightness says nothing about their place."""
    low, high = (float(v) for v in np.percentile(part, _RANGE))
    return np.asarray((np.clip((part - low) / max(high - low, 1e-6), 0.0, 1.0) * 255.0).round(), np.uint8)


def _part(path: PathLike, box: Box) -> Optional["np.ndarray[Any, Any]"]:
    """The part of a frame that ``box`` names in shares of its sides, at the size of a picture, in one channel."""
    from PIL import Image

    if picture_size(path) is None:
        return None
    try:
        with Image.open(path) as image:
            width, height = image.size
            edges = (round(box[0] * width), round(box[1] * height), round(box[2] * width), round(box[3] * height))
            pixels = np.asarray(image.crop(edges), np.float32)
        grey = np.nan_to_num(pixels if pixels.ndim == 2 else pixels.mean(axis=2))
        shown = Image.fromarray(grey).resize((CROP_WIDTH, CROP_HEIGHT), Image.Resampling.BICUBIC)
        return np.asarray(shown, np.float64)
    except Exception:  # Pillow's decoders raise almost anything on a damaged file; a picture is never worth a report
        return None
