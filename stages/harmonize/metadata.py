"""A frame's tags kept while its pixels or its focal length change: one door for JPEG and TIFF.

Decoding a pixel is never needed here, nor OpenCV.
"""

from __future__ import annotations

from ..errors import FrameError
from .exif import TagEdit
from .jpeg import retag_jpeg
from .tiff import retag_tiff


def is_jpeg(data: bytes) -> bool:
    """Whether the bytes begin like a JPEG (or an MPO, which is one)."""
    return data[:3] == b"\xff\xd8\xff"


def is_tiff(data: bytes) -> bool:
    """Whether the bytes begin like a TIFF of 32-bit offsets."""
    return data[:4] in (b"II*\x00", b"MM\x00*")


def retag(data: bytes, edit: TagEdit) -> bytes:
    """Rewrite focal tags in a file's bytes without touching its picture data.

    Raises ``FrameError`` ``tags-not-rewritable`` for other formats and broken
    headers.
    """
    if edit.size is not None:
        raise ValueError("a new size needs new pixels: use jpeg.with_header_of or tiff.encode")
    if is_jpeg(data):
        return retag_jpeg(data, edit)
    if is_tiff(data):
        return retag_tiff(data, edit)
    raise FrameError("tags-not-rewritable", "Tags are rewritten in JPEG and TIFF files only.")
