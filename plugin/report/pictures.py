"""Small pictures for the report: bounded in pixels and bytes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Optional, Tuple, Union

import numpy as np

MOST_BYTES = 160_000
CROP_WIDTH, CROP_HEIGHT = 360, 270
MOST_DECODED_PIXELS = 120_000_000
JPEG_QUALITIES = (82, 60, 35)
PathLike = Union[str, "Path"]


def preview_key(path: str, which: str) -> str:
    """The name under which ``html.render`` looks for a picture of the frame ``path``."""
    return f"{which}:{path}"


def picture_size(path: PathLike) -> Optional[Tuple[int, int]]:
    """Pixels from the header alone; ``None`` when unreadable or too large to decode here."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            width, height = image.size
    except Exception:  # Pillow's decoders raise almost anything on a damaged file; a picture is never worth a report
        return None
    return (width, height) if 0 < width * height <= MOST_DECODED_PIXELS else None


def to_jpeg(pixels: "np.ndarray[Any, Any]", stretch: Optional[Tuple[float, float]] = None) -> bytes:
    """Encode within ``MOST_BYTES``, at most ``CROP_WIDTH`` wide."""
    from PIL import Image

    if stretch is not None:
        low, high = stretch
        scaled = (np.nan_to_num(np.asarray(pixels, np.float64)) - low) / (high - low)
        pixels = (np.clip(scaled, 0.0, 1.0) * 255.0).round().astype(np.uint8)
    image = Image.fromarray(pixels).convert("RGB")
    image.thumbnail((CROP_WIDTH, CROP_HEIGHT))
    data = b""
    for quality in JPEG_QUALITIES:
        stream = io.BytesIO()
        image.save(stream, "JPEG", quality=quality, optimize=True)
        data = stream.getvalue()
        if len(data) <= MOST_BYTES:
            break
    return data
