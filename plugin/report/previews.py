"""Small before-and-after crops of changed frames, bounded in number, pixels and bytes."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from ...stages.harmonize.model import HarmonizedFrame
from .overlays import band_overlays
from .pictures import CROP_HEIGHT, CROP_WIDTH, PathLike, picture_size, preview_key, to_jpeg

BEFORE, AFTER = "before", "after"
MOST_PREVIEWS = 12


def chosen(report: Mapping[str, Any], most: int = MOST_PREVIEWS) -> List[str]:
    """Frames worth a picture: the middle one of each profile and flight whose pixels changed."""
    matched = {a["flight"] for a in report["actions"] if a["lut"] and a["lut"]["written"]}
    flights: Dict[str, List[str]] = {}
    for frame in report["frames"]:
        change = frame.get("change")
        if frame["output"] and change and (change["how"] == "resampled" or frame["flight"] in matched):
            flights.setdefault(frame["flight"], []).append(frame["path"])
    return [sorted(flights[f])[len(flights[f]) // 2] for f in sorted(flights)][:most]


def previews_of(report: Mapping[str, Any], copies: Mapping[str, HarmonizedFrame]) -> Dict[str, bytes]:
    """Crops of the same ground from originals and copies, and of bands over their primary, for ``html.render``.

    ``copies`` maps a frame's path, which names the original, to its copy. A
    frame that cannot be shown is left out without a word: a picture never
    stops a report.
    """
    found = band_overlays(report, copies)
    for path in chosen(report):
        if path not in copies:
            continue
        copy = copies[path]
        # New pixels show in a crop, a new brightness shows in the whole frame.
        resampled = copy.how == "resampled"
        pair = crop_pair(path, copy.file) if resampled else (thumbnail(path), thumbnail(copy.file))
        if pair is not None and pair[0] is not None and pair[1] is not None:
            found[preview_key(path, BEFORE)], found[preview_key(path, AFTER)] = pair[0], pair[1]
    return found


def crop_pair(before: PathLike, after: PathLike) -> Optional[Tuple[bytes, bytes]]:
    """The middle of both images over the same ground, at the finer one's pixels; ``None`` when unreadable."""
    sizes = [picture_size(before), picture_size(after)]
    if sizes[0] is None or sizes[1] is None:
        return None
    (width, height), (out_width, out_height) = sizes[0], sizes[1]
    finest = max(width, out_width)
    share = (min(1.0, CROP_WIDTH / finest), min(1.0, CROP_HEIGHT / max(height, out_height)))
    crops = [_middle(p, share) for p in (before, after)]
    if crops[0] is None or crops[1] is None:
        return None
    stretch = _stretch(crops) if any(c.dtype != np.uint8 for c in crops if c is not None) else None
    made = [to_jpeg(c, stretch) for c in crops if c is not None]
    return made[0], made[1]


def thumbnail(path: PathLike, longest_px: int = CROP_WIDTH) -> Optional[bytes]:
    """A whole frame, small, by reduced decoding; ``None`` when it cannot be read."""
    from PIL import Image

    if picture_size(path) is None:
        return None
    try:
        with Image.open(path) as image:
            image.draft("RGB", (longest_px, longest_px))
            image.thumbnail((longest_px, longest_px))
            pixels = np.asarray(image)
    except Exception:  # Pillow's decoders raise almost anything on a damaged file; a picture is never worth a report
        return None
    return to_jpeg(pixels, None if pixels.dtype == np.uint8 else _stretch([pixels]))


def _middle(path: PathLike, share: Tuple[float, float]) -> Optional["np.ndarray[Any, Any]"]:
    from PIL import Image

    try:
        with Image.open(path) as image:
            width, height = image.size
            half = (max(1, round(width * share[0] / 2)), max(1, round(height * share[1] / 2)))
            box = (width // 2 - half[0], height // 2 - half[1], width // 2 + half[0], height // 2 + half[1])
            part = image.crop((max(0, box[0]), max(0, box[1]), min(width, box[2]), min(height, box[3])))
            if part.mode in ("P", "CMYK", "YCbCr", "LAB", "RGBA", "LA", "1"):
                part = part.convert("RGB")
            return np.asarray(part)
    except Exception:  # Pillow's decoders raise almost anything on a damaged file; a picture is never worth a report
        return None


def _stretch(crops: Sequence[Optional["np.ndarray[Any, Any]"]]) -> Tuple[float, float]:
    """One range for both pictures of a pair, so that their brightness stays comparable."""
    values = np.concatenate([np.asarray(c, np.float64).ravel() for c in crops if c is not None])
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    low, high = np.percentile(values, (1, 99))
    return float(low), float(max(high, low + 1e-6))
