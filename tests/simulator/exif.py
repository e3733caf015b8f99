"""A small TIFF/EXIF writer: directories, JPEG segments and uncompressed TIFF files.

A directory is ``{tag: (type, value)}`` with the types of TIFF 6.0 by name.
"""

from __future__ import annotations

import io
import struct
from fractions import Fraction
from typing import Any, Dict, List, Mapping, Optional, Tuple

import numpy as np

Directory = Dict[int, Tuple[str, Any]]

_TYPES = {
    "byte": (1, 1, "B"),
    "ascii": (2, 1, "s"),
    "short": (3, 2, "H"),
    "long": (4, 4, "L"),
    "rational": (5, 8, "LL"),
    "undefined": (7, 1, "B"),
    "srational": (10, 8, "ll"),
    "double": (12, 8, "d"),
}

EXIF_POINTER, GPS_POINTER = 0x8769, 0x8825


def _ratio(value: Any, signed: bool) -> Tuple[int, int]:
    """A number, or a pair of integers as it is (so that 0/0 can be written)."""
    if isinstance(value, tuple):
        return int(value[0]), int(value[1])
    fraction = Fraction(float(value)).limit_denominator(1_000_000)
    top = 2**31 - 1 if signed else 2**32 - 1
    while abs(fraction.numerator) > top:
        fraction = fraction.limit_denominator(max(1, fraction.denominator // 10))
    return fraction.numerator, fraction.denominator


def _encode(kind: str, value: Any, order: str) -> Tuple[int, bytes]:
    """Count and bytes of a value."""
    letter = _TYPES[kind][2]
    if kind == "ascii":
        data = value if isinstance(value, bytes) else str(value).encode("utf-8")
        return len(data) + 1, data + b"\0"
    if kind in ("byte", "undefined"):
        data = bytes(value) if not isinstance(value, int) else bytes([value])
        return len(data), data
    single = not isinstance(value, (list, np.ndarray))
    values = [value] if single else list(value)
    if kind in ("rational", "srational"):
        pairs = [_ratio(v, kind == "srational") for v in values]
        return len(pairs), b"".join(struct.pack(order + letter, *p) for p in pairs)
    return len(values), struct.pack(order + letter * len(values), *values)


def _size(directory: Mapping[int, Tuple[str, Any]], order: str) -> int:
    total = 2 + 12 * len(directory) + 4
    for kind, value in directory.values():
        length = len(_encode(kind, value, order)[1])
        if length > 4:
            total += length + length % 2
    return total


def _pack(directory: Mapping[int, Tuple[str, Any]], start: int, following: int, order: str) -> bytes:
    """The bytes of one directory that stands at offset ``start``, its long values right behind it."""
    head = struct.pack(order + "H", len(directory))
    values_at = start + 2 + 12 * len(directory) + 4
    tail = b""
    for tag in sorted(directory):
        kind, value = directory[tag]
        count, data = _encode(kind, value, order)
        head += struct.pack(order + "HHL", tag, _TYPES[kind][0], count)
        if len(data) <= 4:
            head += data.ljust(4, b"\0")
        else:
            head += struct.pack(order + "L", values_at + len(tail))
            tail += data + b"\0" * (len(data) % 2)
    return head + struct.pack(order + "L", following) + tail


def tiff_block(
    image: Directory,
    exif: Directory,
    gps: Directory,
    *,
    at: int = 8,
    big_endian: bool = False,
    thumbnail: bytes = b"",
) -> bytes:
    """IFD0 with its Exif and GPS directories (and a thumbnail in IFD1), laid out from offset ``at``."""
    order = ">" if big_endian else "<"
    main = dict(image)
    if exif:
        main[EXIF_POINTER] = ("long", 0)
    if gps:
        main[GPS_POINTER] = ("long", 0)
    exif_at = at + _size(main, order)
    gps_at = exif_at + (_size(exif, order) if exif else 0)
    next_at = gps_at + (_size(gps, order) if gps else 0)
    if exif:
        main[EXIF_POINTER] = ("long", exif_at)
    if gps:
        main[GPS_POINTER] = ("long", gps_at)
    block = _pack(main, at, next_at if thumbnail else 0, order)
    if exif:
        block += _pack(exif, exif_at, 0, order)
    if gps:
        block += _pack(gps, gps_at, 0, order)
    if thumbnail:
        small: Directory = {
            0x0103: ("short", 6),
            0x011A: ("rational", (72, 1)),
            0x011B: ("rational", (72, 1)),
            0x0128: ("short", 2),
            0x0201: ("long", 0),
            0x0202: ("long", len(thumbnail)),
        }
        small[0x0201] = ("long", next_at + _size(small, order))
        block += _pack(small, next_at, 0, order) + thumbnail
    return block


def tiff_header(first: int, big_endian: bool = False) -> bytes:
    """The eight bytes that every TIFF structure starts with."""
    return (b"MM\0*" if big_endian else b"II*\0") + struct.pack(">L" if big_endian else "<L", first)


def segment(marker: int, data: bytes) -> bytes:
    """One JPEG marker segment (at most 65533 bytes of data)."""
    if len(data) > 65533:
        raise ValueError(f"a JPEG segment holds 65533 bytes, not {len(data)}")
    return bytes([0xFF, marker]) + struct.pack(">H", len(data) + 2) + data


def jpeg_file(
    pixels: np.ndarray, quality: int, exif: bytes, xmp: str = "", segments: Optional[List[Tuple[int, bytes]]] = None
) -> bytes:
    """A JPEG of RGB ``pixels`` with an Exif block, an XMP packet and further segments (marker, data)."""
    import cv2

    ok, coded = cv2.imencode(".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise ValueError("the frame could not be coded as JPEG")
    data = coded.tobytes()
    body = 2
    while data[body] == 0xFF and data[body + 1] == 0xE0:
        body += 2 + struct.unpack(">H", data[body + 2 : body + 4])[0]
    out = io.BytesIO()
    out.write(b"\xff\xd8")
    if exif:
        out.write(segment(0xE1, b"Exif\0\0" + exif))
    if xmp:
        out.write(segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + xmp.encode("utf-8")))
    for marker, content in segments or []:
        for start in range(0, max(len(content), 1), 65532):
            out.write(segment(marker, content[start : start + 65532]))
    out.write(data[body:])
    return out.getvalue()


def small_jpeg(pixels: np.ndarray, width: int = 160) -> bytes:
    """A thumbnail."""
    import cv2

    size = (width, max(1, round(pixels.shape[0] * width / pixels.shape[1])))
    reduced = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    bgr = cv2.cvtColor(reduced, cv2.COLOR_RGB2BGR) if reduced.ndim == 3 else reduced
    return bytes(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes())


def tiff_file(
    pixels: np.ndarray,
    image: Directory,
    exif: Directory,
    gps: Directory,
    rows_per_strip: int = 100,
    directories_first: bool = False,
) -> bytes:
    """An uncompressed TIFF: the strips first, the directories and what hangs on them (XMP) at the end of the file.

    ``directories_first`` puts one strip behind the directories instead.
    """
    if directories_first:
        rows_per_strip = pixels.shape[0]
    height, width = pixels.shape[:2]
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    bits = pixels.dtype.itemsize * 8
    data = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder("<"))).tobytes()
    row = width * channels * pixels.dtype.itemsize
    starts = list(range(0, height, rows_per_strip))
    counts = [row * (min(r + rows_per_strip, height) - r) for r in starts]
    main: Directory = {
        0x00FE: ("long", 0),
        0x0100: ("long", width),
        0x0101: ("long", height),
        0x0102: ("short", [bits] * channels),
        0x0103: ("short", 1),
        0x0106: ("short", 1 if channels == 1 else 2),
        0x0111: ("long", [8 + row * r for r in starts]),
        0x0112: ("short", 1),
        0x0115: ("short", channels),
        0x0116: ("long", rows_per_strip),
        0x0117: ("long", counts),
        0x011C: ("short", 1),
    }
    main.update(image)
    if directories_first:
        behind = 8 + len(tiff_block(main, exif, gps, at=8))
        main[0x0111] = ("long", [behind])
        return tiff_header(8) + tiff_block(main, exif, gps, at=8) + data
    at = 8 + len(data)
    return tiff_header(at) + data + tiff_block(main, exif, gps, at=at)
