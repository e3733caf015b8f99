"""Mutated headers: whatever the bytes, a frame or a FrameError, in bounded time and memory."""

from __future__ import annotations

import contextlib
import random
import struct
import time
import tracemalloc

import pytest
from sensorgate.stages import record
from sensorgate.stages.errors import FrameError
from sensorgate.stages.frame import Frame

from .build import ASCII, LONG, RATIONAL, SHORT, exif_stream, ifd_block, jpeg_file, packet, read, segment, tiff_file

XMP = packet(
    "<Camera:BandName><rdf:Seq><rdf:li>Red</rdf:li></rdf:Seq></Camera:BandName>",
    'drone-dji:DewarpData="d;64,66,1,2,0.1,0.1,0,0,0" Camera:PrincipalPoint="2.3,1.7" drone-dji:RtkFlag="50" '
    'Camera:PerspectiveFocalLength="5.4" exif:GPSLatitude="46,30.5N" exif:GPSLongitude="7,1E"',
)
IMAGE = [(0x010F, ASCII, "Acme camera company"), (0x0110, ASCII, "Model of many letters"), (0x0112, SHORT, 1)]
EXIF = [(0x829A, RATIONAL, (1, 500)), (0x9003, ASCII, "2020:01:01 10:00:00"), (0x920A, RATIONAL, (88, 10)),
        (0xA20E, RATIONAL, (4000, 13)), (0xA210, SHORT, 3), (0xA431, ASCII, "SERIAL-1"),
        (0x927C, 7, b"note" * 9)]  # fmt: skip
GPS = [(1, ASCII, "N"), (2, RATIONAL, [(46, 1), (30, 1), (0, 1)]), (3, ASCII, "E"),
       (4, RATIONAL, [(7, 1), (0, 1), (0, 1)]), (5, 1, 0), (6, RATIONAL, (500, 1))]  # fmt: skip
SEEDS = {
    "jpeg": jpeg_file(exif_stream(IMAGE, EXIF, GPS), XMP, segments=[(0xE3, b"\x11" * 9000)]),
    "jpeg-be": jpeg_file(exif_stream(IMAGE, EXIF, GPS, ">"), XMP, mode="L"),
    "tiff": tiff_file([*IMAGE, (700, 1, list(XMP))], EXIF, GPS, extra_pages=[(3, 2, 1)]),
    "tiff-be": tiff_file([*IMAGE, (700, 1, list(XMP))], EXIF, GPS, order=">"),
    "bigtiff": tiff_file([*IMAGE, (700, 1, list(XMP))], EXIF, GPS, big=True),
}
EDGES = (0, 1, 2, 7, 8, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)


def header_places(data):
    """Offsets worth hitting: everything but the picture data."""
    if data[:2] == b"\xff\xd8":
        return range(0, data.index(b"\xff\xda") + 14)
    first = struct.unpack("<I" if data[:2] == b"II" else ">I", data[4:8])[0]
    return range(0, len(data)) if first > len(data) else [*range(0, 16), *range(8, len(data))]


def mutate(data, rng):
    data = bytearray(data)
    places = header_places(bytes(data))
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        at = rng.choice(places)
        kind = rng.randrange(7)
        if kind == 0:
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            data[at] = rng.randrange(256)
        elif kind == 2:
            size, code = rng.choice(((2, "H"), (4, "I")))
            value = rng.choice(EDGES) & (256**size - 1)
            data[at : at + size] = struct.pack(rng.choice("<>") + code, value)
        elif kind == 3:
            other = rng.choice(places)
            length = rng.randrange(1, 40)
            data[at : at + length] = data[other : other + length]
        elif kind == 4:
            del data[at : at + rng.randrange(1, 30)]
        elif kind == 5:
            data[at:at] = bytes(rng.randrange(256) for _ in range(rng.randrange(1, 12)))
        else:
            del data[rng.randrange(1, len(data)) :]
        if len(data) < 4:
            break
        places = range(0, len(data))
    return bytes(data)


@pytest.mark.parametrize("name", sorted(SEEDS))
def test_mutated_headers_give_a_frame_or_a_frame_error(name):
    rng = random.Random(f"headers of {name}")
    worst = 0.0
    outcomes = {"frame": 0, "error": 0}
    for _ in range(1500):
        data = mutate(SEEDS[name], rng)
        before = time.process_time()
        try:
            frame = read(data)
        except FrameError as error:
            assert error.code in {
                "empty-file", "not-an-image", "damaged-header", "truncated-image",
            }  # fmt: skip
            assert error.message
            outcomes["error"] += 1
        else:
            assert frame.width > 0 and frame.height > 0
            assert record.from_plain(Frame, record.to_plain(frame)) == frame
            record.dumps(frame).encode("utf-8")
            outcomes["frame"] += 1
        worst = max(worst, time.process_time() - before)
    assert min(outcomes.values()) > 50  # the mutations neither miss the header nor destroy it all
    assert worst < 0.25


def many_pages():
    tags = [(256, LONG, 4), (257, LONG, 4), (273, LONG, 8), (279, LONG, 4)]
    tags += [(60000 + i, LONG, i) for i in range(1500)]
    data = bytearray(b"II*\x00" + struct.pack("<I", 8))
    for _ in range(300):
        block = ifd_block(tags, len(data))
        data += block[:-4] + struct.pack("<I", len(data) + len(block))
    return bytes(data)


def wide_counts():
    wide = [(n, SHORT, [8] * 30000) for n in (254, 258, 259, 262, 274, 277, 339)]
    block = ifd_block([(256, LONG, 4), (257, LONG, 4), (273, LONG, 8), (279, LONG, 4), *wide], 8)
    return b"II*\x00\x08\x00\x00\x00" + block


def many_strips():
    strips = [(256, LONG, 4), (257, LONG, 4), (273, LONG, [8] * 300_000), (279, LONG, [1] * 300_000)]
    return b"II*\x00\x08\x00\x00\x00" + ifd_block(strips, 8)


HOSTILE = {
    "pages": many_pages(),
    "counts": wide_counts(),
    "strips": many_strips(),
    "segments": b"\xff\xd8" + segment(0xE7, b"") * 100_000,
    "fill": b"\xff\xd8" + b"\xff" * 5_000_000,
    "packets": b"\xff\xd8" + segment(0xE1, b"http://ns.adobe.com/xap/1.0/\x00" + packet().ljust(60000)) * 400
    + jpeg_file()[2:],
    "extended": b"\xff\xd8" + segment(0xE1, b"http://ns.adobe.com/xmp/extension/\x00" + b"G" * 32
                                      + struct.pack(">II", 2**31, 0) + b"x" * 60000) * 400
    + jpeg_file(xmp=packet(attributes=f'xmpNote:HasExtendedXMP="{"G" * 32}"'))[2:],
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(HOSTILE))
def test_hostile_headers_are_bounded(name):
    data = HOSTILE[name]
    tracemalloc.start()
    with contextlib.suppress(FrameError):
        read(data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < len(data) + 64 * 1024 * 1024
    before = time.process_time()
    with contextlib.suppress(FrameError):
        read(data)
    assert time.process_time() - before < 0.25  # measured below 0.05
