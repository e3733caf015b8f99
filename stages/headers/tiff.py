"""Directories of a TIFF, BigTIFF or DNG stream, and of the Exif block of a JPEG.

Either byte order, directories anywhere in the file. References: TIFF 6.0,
BigTIFF (libtiff), TIFF/EP and DNG 1.6 (SubIFDs, NewSubfileType), Exif 2.32.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Dict, FrozenSet, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

from ..errors import FrameError
from .source import BeyondEnd, ByteSource

Number = Union[int, float, None]

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_CODES = {1: "B", 3: "H", 4: "I", 6: "b", 7: "B", 8: "h", 9: "i", 11: "f", 12: "d", 13: "I", 16: "Q", 17: "q", 18: "Q"}
MAX_VALUE_BYTES = 64 * 1024
_MAX_PAGES = 256
_MAX_SUB_IFDS = 64
_MAX_STRIPS = 65536

SUBFILE_TYPE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC = 254, 256, 257, 258, 259, 262
STRIP_OFFSETS, CHANNELS, STRIP_COUNTS, SUB_IFDS = 273, 277, 279, 330
TILE_OFFSETS, TILE_COUNTS, SAMPLE_FORMAT, OLD_JPEG, OLD_JPEG_LENGTH = 324, 325, 339, 513, 514
PAGE_TAGS = frozenset(
    (
        SUBFILE_TYPE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, STRIP_OFFSETS, CHANNELS, STRIP_COUNTS, SUB_IFDS,
        TILE_OFFSETS, TILE_COUNTS, SAMPLE_FORMAT, OLD_JPEG, OLD_JPEG_LENGTH,
    )
)  # fmt: skip
_COLOR_FILTER_ARRAY = 32803
_SAMPLE_FORMATS = {1: "uint", 2: "int", 3: "float", 5: "complex", 6: "complex"}


class Damaged(Exception):
    """A directory or a value is not where or what it should be; the text says which."""


class PastEnd(Damaged):
    """A directory that the stream ends before."""


@dataclass(frozen=True)
class Stream:
    """A TIFF stream: ``length`` bytes of ``source`` from ``base``.

    ``first`` is the offset of its first directory; one of more than
    ``max_entries`` fields is damaged.
    """

    source: ByteSource
    base: int
    length: int
    order: str
    big: bool
    first: int
    max_entries: int

    def read(self, offset: int, length: int) -> bytes:
        """Bytes of the stream; ``BeyondEnd`` outside of it."""
        if offset < 0 or length < 0 or offset + length > self.length:
            raise BeyondEnd(offset, length, self.length)
        return self.source.read(self.base + offset, length)


@dataclass(frozen=True)
class Value:
    """One field of a directory: its TIFF type, count, and where its bytes are."""

    type: int
    count: int
    offset: int


Directory = Dict[int, Value]


class Listing(NamedTuple):
    """The wanted fields of a directory, the offset of the next one (0: none), and how many fields it has in all."""

    fields: Directory
    following: int
    entries: int


def open_stream(source: ByteSource, base: int, length: int, max_entries: int) -> Stream:
    """Read the 8 or 16 bytes in front; ``Damaged`` when they are none of a TIFF."""
    try:
        head = source.read(base, min(16, length))
    except BeyondEnd:
        raise Damaged("no TIFF header") from None
    order = {b"II": "<", b"MM": ">"}.get(head[:2], "")
    if not order or len(head) < 8:
        raise Damaged("no TIFF header")
    magic = struct.unpack(order + "H", head[2:4])[0]
    if magic == 43 and len(head) == 16:
        return Stream(source, base, length, order, True, struct.unpack(order + "Q", head[8:16])[0], max_entries)
    if magic != 42:
        raise Damaged("no TIFF header")
    return Stream(source, base, length, order, False, struct.unpack(order + "I", head[4:8])[0], max_entries)


def directory(stream: Stream, offset: int, wanted: FrozenSet[int]) -> Listing:
    """Read the directory at ``offset``.

    ``Damaged`` when it is not inside of the stream or has an impossible count.
    Fields of unknown type are left out; of a repeated tag the first counts.
    """
    count_size, entry_size = (8, 20) if stream.big else (2, 12)
    layout = stream.order + ("HHQ8s" if stream.big else "HHI4s")
    minimum = 16 if stream.big else 8
    if offset < minimum:
        raise Damaged(f"a directory at byte {offset}")
    try:
        count = struct.unpack(stream.order + ("Q" if stream.big else "H"), stream.read(offset, count_size))[0]
        if not 0 < count <= stream.max_entries:
            raise Damaged(f"a directory of {count} entries")
        at = offset + count_size
        block = stream.read(at, count * entry_size)
    except BeyondEnd:
        raise PastEnd(f"a directory at byte {offset}, past the end") from None
    fields: Directory = {}
    inline = 8 if stream.big else 4
    for index, (tag, kind, number, _) in enumerate(struct.iter_unpack(layout, block)):
        if tag in wanted and kind in _SIZES and number and tag not in fields:
            place = at + index * entry_size + entry_size - inline
            if number * _SIZES[kind] > inline:
                raw = block[place - at : place - at + inline]
                place = struct.unpack(stream.order + ("Q" if stream.big else "I"), raw)[0]
            fields[tag] = Value(kind, number, place)
    after = at + count * entry_size
    try:
        following = struct.unpack(stream.order + ("Q" if stream.big else "I"), stream.read(after, inline))[0]
    except BeyondEnd:
        following = 0
    return Listing(fields, following, count)


def raw_bytes(stream: Stream, value: Value, limit: int = MAX_VALUE_BYTES) -> bytes:
    """The bytes of a field; ``Damaged`` when they are outside of the stream or more than ``limit``."""
    length = value.count * _SIZES[value.type]
    if length > limit:
        raise Damaged(f"a value of {length} bytes")
    try:
        return stream.read(value.offset, length)
    except BeyondEnd:
        raise Damaged("a value past the end") from None


def numbers(stream: Stream, value: Value, limit: int = MAX_VALUE_BYTES) -> Tuple[Number, ...]:
    """The numbers of a field, ``None`` for a rational over zero; ``Damaged`` for text."""
    data = raw_bytes(stream, value, limit)
    if value.type in (5, 10):
        pairs = struct.unpack(f"{stream.order}{2 * value.count}{'I' if value.type == 5 else 'i'}", data)
        return tuple(n / d if d else None for n, d in zip(pairs[::2], pairs[1::2]))
    code = _CODES.get(value.type)
    if code is None:
        raise Damaged("text for a number")
    return struct.unpack(f"{stream.order}{value.count}{code}", data)


@dataclass(frozen=True)
class Page:
    """One image of a TIFF file. ``reduced`` marks previews, overviews and masks."""

    fields: Directory
    width: int
    height: int
    bits: int
    channels: int
    sample_format: str
    reduced: bool


def pages(stream: Stream, metadata: FrozenSet[int]) -> Tuple[List[Page], Directory]:
    """Every image of the file, chain and sub-directories, and the first directory's fields.

    ``metadata`` are tags to keep besides those that describe an image.
    ``FrameError`` when the first directory cannot be read.
    """
    wanted = PAGE_TAGS | metadata
    found: List[Page] = []
    first: Directory = {}
    seen: Set[int] = set()
    queue = [stream.first]
    budget = 4 * stream.max_entries
    while queue and len(seen) < _MAX_PAGES and budget > 0:
        offset = queue.pop(0)
        if offset in seen:
            continue
        seen.add(offset)
        try:
            fields, following, entries = directory(stream, offset, wanted)
        except Damaged as damage:
            if found:
                continue
            if isinstance(damage, PastEnd):
                raise FrameError(
                    "truncated-image", "The file ends before its directory: it was not copied whole."
                ) from None
            raise FrameError("damaged-header", f"The TIFF header is damaged: {damage}.") from None
        budget -= entries
        first = first or fields
        page = _page(stream, fields)
        if page is not None:
            found.append(page)
        if following:
            queue.append(following)
        if SUB_IFDS in fields:
            queue.extend(_bounded(stream, fields, SUB_IFDS, _MAX_SUB_IFDS))
    return found, first


def _bounded(stream: Stream, fields: Directory, tag: int, most: int) -> List[int]:
    """The first ``most`` whole numbers of a field; none where it is absent or damaged."""
    value = fields.get(tag)
    if value is None:
        return []
    if value.count > most and value.count * _SIZES[value.type] > (8 if stream.big else 4):
        value = Value(value.type, most, value.offset)
    try:
        return [n for n in numbers(stream, value, most * 8) if isinstance(n, int) and n >= 0]
    except Damaged:
        return []


def _integer(stream: Stream, fields: Directory, tag: int, default: int) -> int:
    values = _bounded(stream, fields, tag, 1)
    return values[0] if values else default


def _page(stream: Stream, fields: Directory) -> Optional[Page]:
    width = _integer(stream, fields, WIDTH, 0)
    height = _integer(stream, fields, HEIGHT, 0)
    if not width or not height:
        return None
    channels = _integer(stream, fields, CHANNELS, 1)
    if _integer(stream, fields, PHOTOMETRIC, 1) == _COLOR_FILTER_ARRAY:
        channels = 3  # a mosaic of one sample a pixel is a colour picture once developed
    return Page(
        fields=fields,
        width=width,
        height=height,
        bits=_integer(stream, fields, BITS, 1),
        channels=channels,
        sample_format=_SAMPLE_FORMATS.get(_integer(stream, fields, SAMPLE_FORMAT, 1), "unknown"),
        reduced=bool(_integer(stream, fields, SUBFILE_TYPE, 0) & 5),
    )


def full_resolution(found: Sequence[Page]) -> Page:
    """The picture itself: the largest image that is no preview, overview or mask; the first of equals."""
    candidates = [p for p in found if not p.reduced] or list(found)
    if not candidates:
        raise FrameError("damaged-header", "The TIFF header gives no picture size.")
    return max(candidates, key=lambda p: p.width * p.height)


def check_data(stream: Stream, page: Page) -> None:
    """See that the file holds every strip or tile of the page.

    ``FrameError`` ``damaged-header`` when the page names no data,
    ``truncated-image`` when the file ends before it.
    """
    for offsets_tag, counts_tag in (
        (STRIP_OFFSETS, STRIP_COUNTS),
        (TILE_OFFSETS, TILE_COUNTS),
        (OLD_JPEG, OLD_JPEG_LENGTH),
    ):
        if offsets_tag not in page.fields:
            continue
        offsets = _bounded(stream, page.fields, offsets_tag, _MAX_STRIPS)
        counts = _bounded(stream, page.fields, counts_tag, _MAX_STRIPS)
        if not offsets:
            raise FrameError(
                "truncated-image", "The table of the picture data is missing: the file was not copied whole."
            )
        ends = [o + c for o, c in zip(offsets, counts)] if counts else offsets
        last = max(ends, default=0)
        if last > stream.length:
            share = math.floor(100 * stream.length / last)
            raise FrameError(
                "truncated-image", f"The file holds {share} % of its picture data: it was not copied whole."
            )
        return
    raise FrameError("damaged-header", "The TIFF header names no picture data.")
