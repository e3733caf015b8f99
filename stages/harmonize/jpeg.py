"""The segments of a JPEG in memory: header edited or put around other picture data, nothing decoded.

References: ITU-T T.81 annex B (markers), CIPA DC-008 (Exif in APP1),
CIPA DC-007 (multi-picture format in APP2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Tuple

from ..errors import FrameError
from .exif import TagEdit, TiffBlock, damaged, drop_thumbnail, edit_tags

EXIF_MARK = b"Exif\x00\x00"
_XMP_MARK = b"http://ns.adobe.com/xap/1.0/\x00"
_APP0, _APP1, _APP2, _APP14, _APP15, _COM = 0xE0, 0xE1, 0xE2, 0xEE, 0xEF, 0xFE
_EMPTY_EXIF = b"II*\x00\x08\x00\x00\x00" + b"\x00" * 6
_MAX_SEGMENTS = 4096
_LARGEST = 0xFFFF - 2


@dataclass(frozen=True)
class Segment:
    """A marker and where its payload stands in the file."""

    marker: int
    start: int
    end: int


def segments(data: bytes) -> Tuple[List[Segment], int]:
    """Return the segments up to the first scan, and where that scan's marker stands.

    ``FrameError`` ``tags-not-rewritable`` where the header is broken.
    """
    if data[:2] != b"\xff\xd8":
        raise damaged("this is not a JPEG")
    found: List[Segment] = []
    at = 2
    while len(found) < _MAX_SEGMENTS:
        while data[at : at + 2] == b"\xff\xff":
            at += 1
        if at + 4 > len(data) or data[at] != 0xFF:
            raise damaged("the JPEG header is broken")
        marker = data[at + 1]
        if marker == 0x01 or 0xD0 <= marker <= 0xD7:
            at += 2
            continue
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        if length < 2 or at + 2 + length > len(data) or marker in (0xD8, 0xD9):
            raise damaged("the JPEG header is broken")
        if marker == 0xDA:
            return found, at
        found.append(Segment(marker, at + 4, at + 2 + length))
        at += 2 + length
    raise damaged("the JPEG header has too many segments")


def sampling(data: bytes) -> Optional[Tuple[int, int]]:
    """Chroma subsampling of the picture, horizontal and vertical: (2, 1) is 4:2:2; ``None`` without chroma."""
    for segment in segments(data)[0]:
        if 0xC0 <= segment.marker <= 0xCF and segment.marker not in (0xC4, 0xC8, 0xCC):
            body = data[segment.start : segment.end]
            if len(body) < 6 or body[5] != 3 or len(body) < 15:
                return None
            luma, chroma = body[7], body[10]
            if not chroma >> 4 or not chroma & 15:
                return None
            return (luma >> 4) // (chroma >> 4), (luma & 15) // (chroma & 15)
    return None


def retag_jpeg(data: bytes, edit: TagEdit) -> bytes:
    """Return the file with its Exif edited. Every other byte stays: scan data, XMP, appended pictures."""
    found, _ = segments(data)
    exif = _exif_segment(data, found)
    if exif is None:
        block = TiffBlock(bytearray(_EMPTY_EXIF))
        edit_tags(block, edit)
        return data[:2] + _segment(_APP1, EXIF_MARK + bytes(block.data)) + data[2:]
    mark = data[exif.start : exif.start + len(EXIF_MARK)]
    block = TiffBlock(bytearray(data[exif.start + len(EXIF_MARK) : exif.end]))
    edit_tags(block, edit, _LARGEST - len(EXIF_MARK))
    return data[: exif.start - 4] + _segment(_APP1, mark + bytes(block.data)) + data[exif.end :]


def with_header_of(original: bytes, encoded: bytes, edit: TagEdit) -> bytes:
    """Put the header of ``original`` around the picture of ``encoded`` (a JPEG of the same scene, resampled).

    Application segments and comments are taken over byte for byte, Exif with
    ``edit``; a resampled file that has none but an XMP packet is given one for
    its original size. Left behind is what describes the old picture data:
    thumbnails, the multi-picture index and the Adobe colour marker.
    """
    parts = [b"\xff\xd8"]
    found, _ = segments(original)
    exif = _exif_segment(original, found)
    for segment in found:
        body = original[segment.start : segment.end]
        if segment is exif:
            block = TiffBlock(bytearray(body[len(EXIF_MARK) :]))
            drop_thumbnail(block)
            edit_tags(block, edit, _LARGEST - len(EXIF_MARK))
            body = body[: len(EXIF_MARK)] + bytes(block.data)
        elif not _describes_metadata(segment.marker, body):
            continue
        elif segment.marker == _APP0 and len(body) > 14:
            body = body[:12] + b"\x00\x00"
        parts.append(_segment(segment.marker, body))
    counts_pixels = edit.size is not None and any(original.startswith(_XMP_MARK, s.start) for s in found)
    if exif is None and (edit.focal_mm is not None or edit.focal_35mm is not None or counts_pixels):
        block = TiffBlock(bytearray(_EMPTY_EXIF))
        edit_tags(block, edit)
        parts.insert(1, _segment(_APP1, EXIF_MARK + bytes(block.data)))
    inner, scan = segments(encoded)
    parts.extend(encoded[s.start - 4 : s.end] for s in inner if not (_APP0 <= s.marker <= _APP15 or s.marker == _COM))
    parts.append(encoded[scan:])
    return b"".join(parts)


def complete(data: bytes) -> bool:
    """Whether the picture data has an end: a decoder would fill what is missing with grey."""
    return data.find(b"\xff\xd9", segments(data)[1]) >= 0


def _describes_metadata(marker: int, body: bytes) -> bool:
    if marker == _APP0:
        return body.startswith(b"JFIF\x00")
    if marker == _APP2:
        return not body.startswith(b"MPF\x00")
    return (_APP1 <= marker <= _APP15 and marker != _APP14) or marker == _COM


def _exif_segment(data: bytes, found: List[Segment]) -> Optional[Segment]:
    for segment in found:
        if segment.marker == _APP1 and data[segment.start : segment.start + 5] == EXIF_MARK[:5]:
            return segment
    return None


def _segment(marker: int, body: bytes) -> bytes:
    if len(body) > _LARGEST:
        raise FrameError("tags-not-rewritable", "The Exif block of this file is full; no focal length can be added.")
    return bytes((0xFF, marker)) + (len(body) + 2).to_bytes(2, "big") + body
