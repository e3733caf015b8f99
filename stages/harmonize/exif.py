"""Editing the directories of a TIFF structure (an Exif block or a TIFF file) without moving anything.

Maker notes hold offsets that count from the start of the block, so values are
overwritten where they stand. A directory that must grow is written anew behind
the end and only the pointer to it changes; what was there stays.
References: TIFF 6.0 section 2, CIPA DC-008 (Exif 2.3) section 4.6.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction
from typing import Dict, List, Optional, Tuple

from ..errors import FrameError
from ..thresholds import DEFAULTS

TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
_WHOLE = {1: "B", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 13: "I"}
_LIMIT = {1: 0xFF, 3: 0xFFFF, 4: 0xFFFFFFFF, 6: 0x7F, 8: 0x7FFF, 9: 0x7FFFFFFF, 13: 0xFFFFFFFF}
_SHORT, _LONG, _RATIONAL, _SRATIONAL, _FLOAT, _DOUBLE = 3, 4, 5, 10, 11, 12

IMAGE_WIDTH, IMAGE_LENGTH = 0x0100, 0x0101
EXIF_IFD, GPS_IFD, INTEROP_IFD = 0x8769, 0x8825, 0xA005
FOCAL_LENGTH, FOCAL_35MM = 0x920A, 0xA405
PIXEL_X, PIXEL_Y = 0xA002, 0xA003
FOCAL_PLANE_X, FOCAL_PLANE_Y, FOCAL_PLANE_UNIT = 0xA20E, 0xA20F, 0xA210
FOCAL_PLANE_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
RELATED_WIDTH, RELATED_LENGTH = 0x1001, 0x1002
# OriginalDefaultFinalSize (DNG 1.4): the size of the larger original that a file was made from.
ORIGINAL_SIZE = 0xC791
_THUMBNAIL_AT, _THUMBNAIL_BYTES = 0x0201, 0x0202
_STRIPS, _STRIP_BYTES = 0x0111, 0x0117


@dataclass(frozen=True)
class TagEdit:
    """What changes in a frame's tags.

    ``size`` is (old width, old height, new width, new height) in pixels when
    the frame was resampled: focal-plane resolutions are multiplied by
    new/old, sizes rewritten, thumbnails dropped. ``focal_mm`` and
    ``focal_35mm`` replace the tags of that name and are added where absent.
    ``focal_plane`` is (width, height in pixels, sensor width in mm): both
    focal-plane resolutions are set to that density, in the unit that the file
    uses, and the sizes to these. Either leaves the size that the camera wrote in
    ``OriginalDefaultFinalSize``: calibrations of the XMP packet, which is kept
    as it is, count in its pixels.
    """

    size: Optional[Tuple[int, int, int, int]] = None
    focal_mm: Optional[float] = None
    focal_35mm: Optional[float] = None
    focal_plane: Optional[Tuple[int, int, float]] = None

    @property
    def empty(self) -> bool:
        """Nothing is to be changed."""
        return self == TagEdit()


@dataclass(frozen=True)
class Entry:
    """One directory entry: where it stands, where its value stands, how long the value is (bytes)."""

    at: int
    tag: int
    kind: int
    count: int
    value_at: int
    length: int


def damaged(detail: str) -> FrameError:
    """Say that a file's tags cannot be rewritten safely."""
    return FrameError("tags-not-rewritable", f"The tags of this file cannot be rewritten: {detail}.")


class TiffBlock:
    """A TIFF structure in a ``bytearray``: reads are bounded by it, writes stay inside of it.

    ``FrameError`` ``tags-not-rewritable`` when it has no TIFF header.
    """

    def __init__(self, data: bytearray) -> None:
        if data[:4] == b"II*\x00":
            self.order = "<"
        elif data[:4] == b"MM\x00*":
            self.order = ">"
        else:
            raise damaged("they do not begin with a TIFF header (BigTIFF is not read)")
        if len(data) < 8:
            raise damaged("the TIFF header is cut")
        self.data = data

    def whole(self, code: str, at: int) -> int:
        """Unsigned or signed whole number of struct ``code`` at byte ``at``."""
        size = struct.calcsize(code)
        if at < 0 or at + size > len(self.data):
            raise damaged("a value lies outside of the file")
        return int(struct.unpack_from(self.order + code, self.data, at)[0])

    def put(self, code: str, at: int, *values: float) -> None:
        """Overwrite at byte ``at``, which lies inside the block."""
        struct.pack_into(self.order + code, self.data, at, *values)

    @property
    def first(self) -> int:
        """Offset of the first directory."""
        return self.whole("I", 4)

    def entries(self, at: int) -> Tuple[List[Entry], int]:
        """Return the readable entries of the directory at ``at`` and the offset of its next-directory pointer."""
        if at < 8 or at + 2 > len(self.data):
            raise damaged("a directory lies outside of the file")
        count = self.whole("H", at)
        if count > DEFAULTS.max_ifd_entries or at + 2 + 12 * count > len(self.data):
            raise damaged("a directory is longer than the file")
        found: List[Entry] = []
        for index in range(count):
            place = at + 2 + 12 * index
            tag, kind = self.whole("H", place), self.whole("H", place + 2)
            number = self.whole("I", place + 4)
            length = TYPE_BYTES.get(kind, 0) * number
            value_at = place + 8 if length <= 4 else self.whole("I", place + 8)
            if kind in TYPE_BYTES and value_at + length <= len(self.data):
                found.append(Entry(place, tag, kind, number, value_at, length))
        return found, at + 2 + 12 * count

    def find(self, at: int, tag: int) -> Optional[Entry]:
        """Return the entry ``tag`` of the directory at ``at``, or ``None``."""
        return next((e for e in self.entries(at)[0] if e.tag == tag), None)

    def pointer(self, entry: Optional[Entry]) -> Optional[int]:
        """Offset that a directory entry points to, ``None`` where it is absent or impossible."""
        if entry is None or entry.count != 1 or entry.kind not in (_LONG, 13):
            return None
        offset = self.whole("I", entry.value_at)
        return offset if 8 <= offset < len(self.data) - 1 else None

    def number(self, entry: Entry) -> Optional[Fraction]:
        """Value of a one-number entry, ``None`` where it is no number (0/0)."""
        if entry.count != 1:
            return None
        if entry.kind in _WHOLE:
            return Fraction(self.whole(_WHOLE[entry.kind], entry.value_at))
        if entry.kind in (_RATIONAL, _SRATIONAL):
            code = "I" if entry.kind == _RATIONAL else "i"
            under = self.whole(code, entry.value_at + 4)
            return Fraction(self.whole(code, entry.value_at), under) if under else None
        if entry.kind in (_FLOAT, _DOUBLE):
            code = "f" if entry.kind == _FLOAT else "d"
            value = struct.unpack_from(self.order + code, self.data, entry.value_at)[0]
            return Fraction(value) if abs(value) < 1e18 else None
        return None

    def set_number(self, entry: Entry, value: Fraction) -> bool:
        """Overwrite a one-number entry in place; ``False`` where its type cannot hold the value."""
        if entry.count != 1:
            return False
        if entry.kind in (_RATIONAL, _SRATIONAL):
            limit = 0xFFFFFFFF if entry.kind == _RATIONAL else 0x7FFFFFFF
            above, under = as_rational(value, limit)
            self.put("II" if entry.kind == _RATIONAL else "ii", entry.value_at, above, under)
            return True
        if entry.kind in (_FLOAT, _DOUBLE):
            self.put("f" if entry.kind == _FLOAT else "d", entry.value_at, float(value))
            return True
        if entry.kind in _WHOLE and value.denominator == 1:
            if value <= _LIMIT[entry.kind]:
                self.put(_WHOLE[entry.kind], entry.value_at, int(value))
                return True
            if entry.kind == _SHORT:
                self.put("H", entry.at + 2, _LONG)
                self.put("I", entry.at + 8, int(value))
                return True
        return False

    def grow(self, pointer_at: int, additions: Dict[int, Tuple[int, bytes]]) -> int:
        """Write the directory that the pointer at ``pointer_at`` names anew at the end, with more entries.

        ``additions`` is tag -> (type, one value's bytes in this block's
        order). Returns the directory's new offset.
        """
        old = self.whole("I", pointer_at)
        kept: Dict[int, bytes] = {}
        following = b"\x00\x00\x00\x00"
        if old:
            entries, next_at = self.entries(old)
            kept = {e.tag: bytes(self.data[e.at : e.at + 12]) for e in entries}
            following = bytes(self.data[next_at : next_at + 4]).ljust(4, b"\x00")
        self.data.extend(b"\x00" * (len(self.data) % 2))
        start = len(self.data)
        tags = sorted(set(kept) | set(additions))
        behind = start + 2 + 12 * len(tags) + 4
        directory = bytearray(struct.pack(self.order + "H", len(tags)))
        values = bytearray()
        for tag in tags:
            if tag not in additions:
                directory += kept[tag]
                continue
            kind, value = additions[tag]
            count = len(value) // TYPE_BYTES[kind]
            directory += struct.pack(self.order + "HHI", tag, kind, count)
            if len(value) <= 4:
                directory += value.ljust(4, b"\x00")
            else:
                directory += struct.pack(self.order + "I", behind + len(values))
                values += value
        self.data += directory + following + values
        self.put("I", pointer_at, start)
        return start


def as_rational(value: Fraction, limit: int = 0xFFFFFFFF) -> Tuple[int, int]:
    """Numerator and denominator of at most ``limit`` that come nearest to a value not below zero."""
    if value > limit:
        return limit, 1
    simple = value.limit_denominator(limit)
    if simple.numerator > limit:
        simple = value.limit_denominator(max(1, int(limit / value) - 1))
    return simple.numerator, simple.denominator


def decimal(value: float) -> Fraction:
    """Return the short decimal fraction that a camera meant by a float: 4.386 is 4386/1000."""
    return Fraction(value).limit_denominator(1_000_000)


def edit_tags(block: TiffBlock, edit: TagEdit, most: Optional[int] = None) -> None:
    """Carry out ``edit`` in place. Only directories that lack an asked-for tag are written anew.

    ``most`` is the size in bytes up to which the block may grow for the
    original size, which is left out where it would not fit. Raises
    ``FrameError`` ``tags-not-rewritable`` when the structure is broken where
    the edit needs it.
    """
    exif = block.find(block.first, EXIF_IFD) if block.first else None
    exif_at = block.pointer(exif)
    original = _original_size(block, edit, exif_at)
    if edit.size is not None:
        _edit_size(block, edit.size, exif_at)
    if edit.focal_plane is not None and exif_at is not None:
        _edit_focal_plane(block, exif_at, *edit.focal_plane)
    wanted: Dict[int, Tuple[int, bytes]] = {}
    if edit.focal_mm is not None:
        focal = decimal(edit.focal_mm)
        if not _set(block, exif_at, FOCAL_LENGTH, focal):
            wanted[FOCAL_LENGTH] = (_RATIONAL, struct.pack(block.order + "II", *as_rational(focal)))
    if edit.focal_35mm is not None:
        equivalent = Fraction(round(edit.focal_35mm))
        if not _set(block, exif_at, FOCAL_35MM, equivalent):
            wanted[FOCAL_35MM] = (_SHORT, struct.pack(block.order + "H", min(int(equivalent), 0xFFFF)))
    if wanted:
        if exif is None or exif_at is None:
            block.grow(4, {EXIF_IFD: (_LONG, struct.pack(block.order + "I", 0))})
            exif = block.find(block.first, EXIF_IFD)
        if exif is None:
            raise damaged("there is no room for a focal length")
        block.grow(exif.value_at, wanted)
    if original is not None:
        _keep_original_size(block, original, most)


def _original_size(block: TiffBlock, edit: TagEdit, exif_at: Optional[int]) -> Optional[Tuple[int, int]]:
    """Size that the camera wrote, where the edit would take it away; ``None`` where it is told already."""
    if not block.first or block.find(block.first, ORIGINAL_SIZE) is not None:
        return None
    if edit.size is not None:
        now, after = edit.size[:2], edit.size[2:]
    elif edit.focal_plane is not None:
        now = after = edit.focal_plane[:2]
    else:
        return None
    told = []
    for tag in (PIXEL_X, PIXEL_Y):
        entry = block.find(exif_at, tag) if exif_at is not None else None
        number = block.number(entry) if entry is not None else None
        told.append(int(number) if number is not None and 0 < number <= 0xFFFF else 0)
    # Sizes of another shape are those before a crop, which moves no pixel apart.
    same_shape = all(told) and abs(told[0] * now[1] / (told[1] * now[0]) - 1.0) <= DEFAULTS.aspect_tolerance
    original = (told[0], told[1]) if same_shape else now
    return original if original != after else None


def _keep_original_size(block: TiffBlock, size: Tuple[int, int], most: Optional[int]) -> None:
    next_at = block.entries(block.first)[1]
    grown = len(block.data) + 1 + (next_at - block.first) + 12 + 4 + 8
    if most is None or grown <= most:
        block.grow(4, {ORIGINAL_SIZE: (_LONG, struct.pack(block.order + "II", *size))})


def _set(block: TiffBlock, at: Optional[int], tag: int, value: Fraction) -> bool:
    entry = block.find(at, tag) if at is not None else None
    if entry is None:
        return False
    return block.number(entry) == value or block.set_number(entry, value)


def _edit_focal_plane(block: TiffBlock, exif_at: int, width: int, height: int, sensor_width_mm: float) -> None:
    """Say the true size and sensor width; square pixels, so both directions have one density."""
    unit_entry = block.find(exif_at, FOCAL_PLANE_UNIT)
    unit = block.number(unit_entry) if unit_entry is not None else Fraction(2)
    unit_mm = FOCAL_PLANE_UNIT_MM.get(int(unit)) if unit is not None else None
    if unit_mm is None or sensor_width_mm <= 0:
        return
    density = decimal(width * unit_mm / sensor_width_mm)
    for tag, value in (
        (FOCAL_PLANE_X, density),
        (FOCAL_PLANE_Y, density),
        (PIXEL_X, Fraction(width)),
        (PIXEL_Y, Fraction(height)),
    ):
        _set(block, exif_at, tag, value)


def _edit_size(block: TiffBlock, size: Tuple[int, int, int, int], exif_at: Optional[int]) -> None:
    old_width, old_height, width, height = size
    places: List[Tuple[Optional[int], int, int]] = [
        (block.first or None, IMAGE_WIDTH, width),
        (block.first or None, IMAGE_LENGTH, height),
    ]
    if exif_at is not None:
        interop = block.pointer(block.find(exif_at, INTEROP_IFD))
        places += [(exif_at, PIXEL_X, width), (exif_at, PIXEL_Y, height)]
        places += [(interop, RELATED_WIDTH, width), (interop, RELATED_LENGTH, height)]
        # Both are read before either is written: writers may let them share one value.
        planes = []
        for tag, factor in ((FOCAL_PLANE_X, Fraction(width, old_width)), (FOCAL_PLANE_Y, Fraction(height, old_height))):
            entry = block.find(exif_at, tag)
            before = block.number(entry) if entry is not None else None
            if entry is not None and before is not None and before > 0:
                planes.append((entry, before * factor))
        for entry, value in reversed(planes):
            block.set_number(entry, value)
    for at, tag, number in places:
        _set(block, at, tag, Fraction(number))


def drop_thumbnail(block: TiffBlock) -> None:
    """Unlink the second directory and blank its picture; the end of the block is cut where only that was.

    The thumbnail shows the frame before it was resampled. Nothing else moves.
    """
    if not block.first:
        return
    _, next_at = block.entries(block.first)
    if next_at + 4 > len(block.data):
        return
    second = block.whole("I", next_at)
    if not second:
        return
    block.put("I", next_at, 0)
    try:
        parts = {e.tag: block.number(e) for e in block.entries(second)[0]}
    except FrameError:
        return
    for at_tag, length_tag in ((_THUMBNAIL_AT, _THUMBNAIL_BYTES), (_STRIPS, _STRIP_BYTES)):
        at, length = parts.get(at_tag), parts.get(length_tag)
        if at is None or length is None or not 8 <= at <= at + length <= len(block.data):
            continue
        start, end = int(at), int(at + length)
        if start < _used_end(block) or length == 0:
            continue
        block.data[start:end] = b"\x00" * (end - start)
        if not any(block.data[end:]):
            del block.data[start:]


def _used_end(block: TiffBlock) -> int:
    """End of the last byte that the first directory and its sub-directories use."""
    end = 8
    pending, seen = [block.first], set()
    while pending:
        at = pending.pop()
        if at in seen:
            continue
        seen.add(at)
        try:
            entries, next_at = block.entries(at)
        except FrameError:
            continue
        end = max(end, next_at + 4)
        for entry in entries:
            end = max(end, entry.value_at + entry.length)
            if entry.tag in (EXIF_IFD, GPS_IFD, INTEROP_IFD):
                inner = block.pointer(entry)
                if inner is not None:
                    pending.append(inner)
    return end
