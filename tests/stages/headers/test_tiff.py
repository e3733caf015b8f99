"""Directories of TIFF, BigTIFF and DNG files."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from PIL import Image
from sensorgate.stages.errors import FrameError

from .build import ASCII, LONG, RATIONAL, SHORT, UNDEFINED, ifd_block, packet, read, tiff_file

ACME = [(0x010F, ASCII, "Acme"), (0x0110, ASCII, "Six-band camera")]
LENS = [(0x920A, RATIONAL, (55, 10)), (0xA431, ASCII, "S-77")]


def code_of(data, name="a.tif"):
    with pytest.raises(FrameError) as caught:
        read(data, name)
    return caught.value.code


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("big", [False, True])
def test_either_byte_order_and_both_sizes(order, big):
    frame = read(tiff_file(ACME, LENS, size=(12, 9), order=order, big=big), "a.tif")
    assert (frame.width, frame.height, frame.bits, frame.channels, frame.format) == (12, 9, 16, 1, "tiff")
    assert (frame.make, frame.model, frame.focal_mm, frame.serial) == ("Acme", "Six-band camera", 5.5, "S-77")


@pytest.mark.parametrize("order", ["<", ">"])
def test_packet_of_tag_700_at_the_end_of_the_file(order):
    xmp = packet(attributes='Camera:BandName="NIR" MicaSense:CaptureId="abc"')
    frame = read(tiff_file([*ACME, (700, 1, list(xmp))], LENS, size=(300, 200), order=order), "a.tif")
    assert (frame.bands, frame.capture_id) == (("NIR",), "abc")


def test_the_picture_is_the_largest_page_that_is_no_preview():
    file = tiff_file(ACME, size=(8, 8), extra_pages=[(600, 400, 1), (64, 48, 0), (32, 24, 4)], first_kind=1)
    frame = read(file, "a.tif")
    assert (frame.width, frame.height, frame.pages, frame.make) == (64, 48, 1, "Acme")
    file = tiff_file(ACME, size=(64, 48), extra_pages=[(64, 48, 0), (64, 48, 2)])
    assert read(file, "a.tif").pages == 3


def test_sub_directories_of_a_dng_hold_the_picture():
    strips = [(273, LONG, 8), (279, LONG, 16)]
    sub_at = 8 + 16
    sub = ifd_block([(254, LONG, 0), (256, LONG, 640), (257, LONG, 480), (258, SHORT, 16), (262, SHORT, 32803),
                     (277, SHORT, 1), *strips], sub_at)  # fmt: skip
    first_at = sub_at + len(sub)
    first = ifd_block([(254, LONG, 1), (256, LONG, 160), (257, LONG, 120), (258, SHORT, [8, 8, 8]), (277, SHORT, 3),
                       (330, LONG, sub_at), (0xC612, 1, [1, 4, 0, 0]), *ACME, *strips], first_at)  # fmt: skip
    frame = read(b"II*\x00" + struct.pack("<I", first_at) + bytes(16) + sub + first, "a.DNG")
    assert (frame.width, frame.height, frame.bits, frame.format) == (640, 480, 16, "dng")
    assert frame.channels == 3 and frame.make == "Acme"  # the mosaic becomes a colour picture


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (np.zeros((5, 7), np.uint8), (8, 1, "uint")),
        (np.zeros((5, 7), np.float32), (32, 1, "float")),
        (np.zeros((5, 7, 3), np.uint8), (8, 3, "uint")),
        (np.zeros((5, 7, 4), np.uint8), (8, 4, "uint")),
    ],
)
def test_sample_types_as_pillow_writes_them(array, expected):
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, "TIFF")
    frame = read(buffer.getvalue(), "a.tif")
    assert (frame.bits, frame.channels, frame.sample_format) == expected
    assert (frame.width, frame.height) == (7, 5)


def test_compressed_pages_of_pillow_are_read():
    buffer = io.BytesIO()
    pages = [Image.effect_noise((90, 60), 50) for _ in range(3)]
    pages[0].save(buffer, "TIFF", save_all=True, append_images=pages[1:], compression="tiff_lzw")
    assert read(buffer.getvalue(), "a.tif").pages == 3


def test_a_file_shorter_than_its_strips_is_truncated():
    buffer = io.BytesIO()
    Image.effect_noise((300, 200), 50).save(buffer, "TIFF")
    data = buffer.getvalue()
    assert read(data, "a.tif").width == 300
    if struct.unpack("<I", data[4:8])[0] < 1000:  # the directory stands in front
        assert code_of(data[:-1]) == "truncated-image"
    behind = tiff_file(ACME, size=(300, 200))
    for length in (9, 100, 60_000, len(behind) - 200):
        assert code_of(behind[:length]) == "truncated-image"


def test_directories_that_lead_nowhere_or_in_circles():
    data = tiff_file(ACME, LENS)
    at = struct.unpack("<I", data[4:8])[0]
    count = struct.unpack("<H", data[at : at + 2])[0]
    after = at + 2 + 12 * count
    looped = data[:after] + struct.pack("<I", at) + data[after + 4 :]
    assert read(looped, "a.tif").pages == 1
    assert code_of(data[:4] + struct.pack("<I", 0) + data[8:]) == "damaged-header"
    assert code_of(data[:at] + b"\x00\x00" + data[at + 2 :]) == "damaged-header"
    assert code_of(data[:at] + b"\xff\xff" + data[at + 2 :]) == "damaged-header"


def test_no_size_or_no_data_is_a_damaged_header():
    no_size = ifd_block([(273, LONG, 8), (279, LONG, 4), *ACME], 8)
    assert code_of(b"II*\x00\x08\x00\x00\x00" + no_size) == "damaged-header"
    no_data = ifd_block([(256, LONG, 4), (257, LONG, 4)], 8)
    assert code_of(b"II*\x00\x08\x00\x00\x00" + no_data) == "damaged-header"


def test_black_level_is_radiometry():
    assert read(tiff_file([(0xC61A, SHORT, [64, 64, 64, 64])]), "a.tif").radiometry == ("black-level",)
    assert read(tiff_file([(0x9999, UNDEFINED, b"1234567")]), "a.tif").radiometry == ()
