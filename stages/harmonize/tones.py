"""Histograms of a frame's central disc, read at a fraction of its size."""

from __future__ import annotations

from pathlib import Path
from typing import Optional, Union

import numpy as np

from .tables import Histogram


def read_tones(file: Union[str, Path], share: float, sample_px: int) -> Optional[Histogram]:
    """Return (channels, 256) shares of the tones inside the central disc, each row summing to 1.

    ``share`` is the disc's radius over half the shorter side. JPEGs are decoded
    at the fraction of their size that keeps the shorter side at ``sample_px``
    or more; libjpeg's reduction keeps means. ``None`` for a frame that does not
    decode or is not 8 bits of grey or RGB.
    """
    from PIL import Image

    try:
        with Image.open(file) as image:
            if image.mode not in ("RGB", "L"):
                return None
            side = min(image.size)
            if side > sample_px:
                image.draft(image.mode, (image.width * sample_px // side, image.height * sample_px // side))
            pixels = np.asarray(image)
    except (OSError, ValueError, SyntaxError, MemoryError, Image.DecompressionBombError):
        return None
    step = max(1, min(pixels.shape[:2]) // sample_px)
    pixels = pixels[::step, ::step]
    height, width = pixels.shape[:2]
    rows = np.arange(height)[:, None] - (height - 1) / 2.0
    columns = np.arange(width)[None, :] - (width - 1) / 2.0
    inside = rows**2 + columns**2 <= (share * min(height, width) / 2.0) ** 2
    if not inside.any():
        return None
    chosen = pixels[inside].reshape(int(inside.sum()), -1)
    counts = [np.bincount(chosen[:, c], minlength=256) for c in range(chosen.shape[1])]
    return np.asarray(counts, np.float64) / len(chosen)
