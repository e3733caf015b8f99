"""The segments of a JPEG or MPO file, up to its picture data.

Only the marker and length of a segment are read, and the first bytes of those
that name themselves; thumbnails and thermal raw data are skipped by seeking.
References: ITU-T T.81 annex B (markers), CIPA DC-008 (Exif in APP1), Adobe XMP
part 3 (XMP and extended XMP in APP1).
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field
from typing import Dict, List, Optional, Tuple

from ..errors import FrameError
from .source import BeyondEnd, ByteSource

EXIF_MARK = b"Exif\x00"
XMP_MARK = b"http://ns.adobe.com/xap/1.0/\x00"
EXTENDED_MARK = b"http://ns.adobe.com/xmp/extension/\x00"
FLIR_MARK = b"FLIR\x00"
_MAX_SEGMENTS = 4096
_MAX_STRAY_BYTES = 64 * 1024
_SEARCH_BYTES = 1024 * 1024
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_BARE_MARKERS = frozenset(range(0xD0, 0xD8)) | {0x01}
_RAW_MARKERS = range(0xE3, 0xEA)
_RESTART = re.compile(rb"\xff[\xd0-\xd7]")


@dataclass
class JpegLayout:
    """Where things are in a JPEG. Ranges are (offset, length) of the payload after its name."""

    width: int = 0
    height: int = 0
    bits: int = 8
    channels: int = 0
    mcu: Tuple[int, int] = (8, 8)
    restart_interval: int = 0
    exif: Optional[Tuple[int, int]] = None
    xmp: List[Tuple[int, int]] = field(default_factory=list)
    extended: List[Tuple[int, int]] = field(default_factory=list)
    flir_segments: int = 0
    flir_expected: int = 0
    raw_segments: Dict[int, int] = field(default_factory=dict)
    raw_bytes: Dict[int, int] = field(default_factory=dict)
    data_offset: int = 0
    problems: List[str] = field(default_factory=list)


def walk(source: ByteSource) -> JpegLayout:
    """Follow the segments up to the first scan.

    ``FrameError`` ``truncated-image`` when the file ends before its picture
    data, ``damaged-header`` when the segments make no sense or give no size.
    """
    layout = JpegLayout()
    size = source.size
    at = 2
    for _ in range(_MAX_SEGMENTS):
        if at + 4 > size:
            raise FrameError("truncated-image", "The file ends inside its header, before any picture data.")
        head = source.peek(at, min(46, size - at))
        if head[0] != 0xFF or head[1] == 0xFF or head[1] == 0x00:
            at = _next_marker(source, at)
            continue
        marker = head[1]
        if marker in _BARE_MARKERS:
            at += 2
            continue
        if marker == 0xD8:
            raise FrameError("damaged-header", "A second picture starts before the first has any data.")
        if marker == 0xD9:
            raise FrameError("truncated-image", "The file ends its picture before any picture data.")
        length = head[2] << 8 | head[3]
        if length < 2:
            raise FrameError("damaged-header", "A segment of the JPEG header has an impossible length.")
        if marker == 0xDA:
            layout.data_offset = at
            if not (layout.width and layout.height and layout.channels):
                raise FrameError("damaged-header", "The JPEG header gives no picture size.")
            return layout
        if at + 2 + length > size:
            raise FrameError("truncated-image", "The file ends inside its header, before any picture data.")
        if marker == 0xE1:
            _application_one(layout, head, at, length)
        elif marker in _RAW_MARKERS:
            layout.raw_segments[marker] = layout.raw_segments.get(marker, 0) + 1
            layout.raw_bytes[marker] = layout.raw_bytes.get(marker, 0) + length - 2
        elif marker in _FRAME_MARKERS:
            if layout.width == 0 and length >= 8:
                layout.bits, layout.height, layout.width, layout.channels = struct.unpack(">BHHB", head[4:10])
                factors = [head[i] for i in range(11, min(10 + 3 * layout.channels, len(head)), 3)]
                layout.mcu = (
                    8 * max([f >> 4 for f in factors] or [1]) if len(factors) > 1 else 8,
                    8 * max([f & 15 for f in factors] or [1]) if len(factors) > 1 else 8,
                )
        elif marker == 0xDD and length >= 4:
            layout.restart_interval = head[4] << 8 | head[5]
        at += 2 + length
    raise FrameError("damaged-header", f"The JPEG header has more than {_MAX_SEGMENTS} segments.")


def _application_one(layout: JpegLayout, head: bytes, at: int, length: int) -> None:
    body = head[4:]
    if body.startswith(EXIF_MARK):
        if layout.exif is None and length > 8:
            layout.exif = (at + 10, length - 8)
    elif body.startswith(XMP_MARK):
        layout.xmp.append((at + 4 + len(XMP_MARK), length - 2 - len(XMP_MARK)))
    elif body.startswith(EXTENDED_MARK):
        layout.extended.append((at + 4 + len(EXTENDED_MARK), length - 2 - len(EXTENDED_MARK)))
    elif body.startswith(FLIR_MARK) and len(body) >= 8:
        layout.flir_segments += 1
        layout.flir_expected = max(layout.flir_expected, body[7] + 1)


def _next_marker(source: ByteSource, at: int) -> int:
    """Skip fill bytes and stray bytes between segments, within bounds."""
    chunk = source.read(at, min(_MAX_STRAY_BYTES, source.size - at))
    position = 0
    while True:
        position = chunk.find(b"\xff", position)
        if position < 0 or position + 1 >= len(chunk):
            raise FrameError("damaged-header", "The JPEG header is overwritten: no further segment is found.")
        if chunk[position + 1] not in (0x00, 0xFF):
            return at + position
        position += 1


def check_end(source: ByteSource, layout: JpegLayout) -> None:
    """See that the picture data has an end, without decoding it.

    Picture data cannot hold the end marker (T.81 stuffs its 0xFF bytes), so one
    anywhere behind the first scan is its end, whatever cameras append. A
    missing marker alone is no loss when every restart interval has begun: then
    ``jpeg-end-missing`` is noted, else ``FrameError`` ``truncated-image``. Of
    header bytes only what was sent is looked at.
    """
    start, size = layout.data_offset, source.size
    for span in (2, 4096, 65536):
        offset = max(start, size - span)
        if not source.holds(offset, size - offset):
            break
        if b"\xff\xd9" in source.read(offset, size - offset):
            return
    if not source.complete:
        layout.problems.append("jpeg-end-missing:not among the header bytes")
    elif not _whole(source, layout, start, size):
        raise FrameError("truncated-image", "The picture data breaks off: the file was not copied whole.")


def _whole(source: ByteSource, layout: JpegLayout, start: int, size: int) -> bool:
    restarts = 0
    last = b""
    for offset in range(start, size, _SEARCH_BYTES):
        chunk = last + source.scan(offset, min(_SEARCH_BYTES, size - offset))
        if b"\xff\xd9" in chunk:
            return True
        restarts += len(_RESTART.findall(chunk))
        last = chunk[-1:]
    if layout.restart_interval:
        across = -(-layout.width // layout.mcu[0])
        down = -(-layout.height // layout.mcu[1])
        if restarts >= -(-across * down // layout.restart_interval) - 1:
            layout.problems.append("jpeg-end-missing:the last rows are cut")
            return True
    return False


def extended_xmp(source: ByteSource, layout: JpegLayout, guid: bytes, limit: int) -> Optional[bytes]:
    """Put the extended XMP of ``guid`` together; ``None`` when parts are missing or it is over ``limit`` bytes."""
    parts: Dict[int, bytes] = {}
    total = -1
    taken = 0
    for offset, length in layout.extended:
        try:
            head = source.read(offset, 40)
            if length < 40 or head[:32] != guid:
                continue
            whole, place = struct.unpack(">II", head[32:40])
            taken += length
            if whole > limit or taken > 2 * limit or (total >= 0 and whole != total):
                return None
            total = whole
            parts.setdefault(place, source.read(offset + 40, length - 40))
        except BeyondEnd:
            return None
    chunks = []
    reached = 0
    for place in sorted(parts):
        if place != reached:
            return None
        chunks.append(parts[place])
        reached += len(parts[place])
    data = b"".join(chunks)
    return data if total >= 0 and len(data) == total else None
