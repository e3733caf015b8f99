"""Segments, ends and payloads of JPEG files."""

from __future__ import annotations

import struct

import pytest
from sensorgate.stages.errors import FrameError
from sensorgate.stages.headers.source import HeaderIncomplete
from sensorgate.stages.read import frame_from_header, header_ranges, read_frame

from .build import ASCII, exif_stream, jpeg_file, packet, read, segment

MAKE = exif_stream([(0x010F, ASCII, "Acme")])


def code_of(data, name="a.jpg"):
    with pytest.raises(FrameError) as caught:
        read(data, name)
    return caught.value.code


@pytest.mark.parametrize(("mode", "channels"), [("RGB", 3), ("L", 1)])
def test_size_bits_and_channels(mode, channels):
    frame = read(jpeg_file(size=(70, 33), mode=mode))
    assert (frame.width, frame.height, frame.bits, frame.channels) == (70, 33, 8, channels)
    assert (frame.format, frame.make, frame.problems) == ("jpeg", "", ())


def test_fill_bytes_and_stray_bytes_between_segments_are_skipped():
    data = jpeg_file(MAKE)
    assert read(data[:2] + b"\xff" * 9 + data[2:]).make == "Acme"
    at = data.index(b"\xff\xdb")
    assert read(data[:at] + b"\x00" * 500 + data[at:]).make == "Acme"


def test_every_cut_of_a_file_is_seen():
    data = jpeg_file(MAKE, packet())
    for length in range(4, len(data) - 1, 7):
        assert code_of(data[:length]) in ("truncated-image", "not-an-image"), length
    assert read(data).make == "Acme"


def test_what_cameras_append_is_no_cut():
    data = jpeg_file(MAKE)
    preview = jpeg_file(size=(32, 24))
    for tail in (b"\x00" * 3000, preview, preview[:-40], b"\x5a" * 200_000):
        assert read(data + tail).problems == ()


def test_zeros_instead_of_the_second_half_are_a_cut():
    data = jpeg_file(MAKE, size=(400, 300))
    half = len(data) // 2
    assert code_of(data[:half] + b"\x00" * half) == "truncated-image"


def test_with_restart_markers_a_cut_in_the_last_interval_loses_only_rows():
    data = jpeg_file(MAKE, size=(160, 160), restart=5)
    last = data.rfind(b"\xff", 0, len(data) - 2)
    while not 0xD0 <= data[last + 1] <= 0xD7:
        last = data.rfind(b"\xff", 0, last)
    assert read(data[: last + 20]).problems == ("jpeg-end-missing:the last rows are cut",)
    assert code_of(data[:last]) == "truncated-image"


def test_end_marker_in_a_thumbnail_is_not_the_end():
    thumbnail = jpeg_file(size=(32, 24))
    data = jpeg_file(MAKE, segments=[(0xE2, thumbnail)], size=(200, 200))
    assert read(data).width == 200
    assert code_of(data[: -len(data) // 4]) == "truncated-image"


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"", "empty-file"),
        (b"\xff\xd8", "not-an-image"),
        (b"\x89PNG\r\n\x1a\n" + b"x" * 40, "not-an-image"),
        (b"\x00" * 1000, "not-an-image"),
        (b"\x00\x00\x00\x18ftypheic" + b"x" * 40, "not-an-image"),
        (b"\xff\xd8\xff\xd9", "truncated-image"),
        (b"\xff\xd8\xff\xe0\x00\x01" + b"x" * 80, "damaged-header"),
        (b"\xff\xd8\xff" + b"\x00" * 90_000, "damaged-header"),
    ],
)
def test_what_is_no_picture_has_its_own_code(data, code):
    assert code_of(data) == code


def test_a_picture_without_size_is_a_damaged_header():
    data = jpeg_file()
    at = data.index(b"\xff\xc0")
    assert code_of(data[: at + 5] + b"\x00\x00\x00\x00" + data[at + 9 :]) == "damaged-header"


def raw(total, marker=0xE3):
    return [(marker, b"\x11\x4b" * 32000)] * (total // 64000) + [(marker, b"\x11\x4b" * (total % 64000 // 2))]


def test_raw_thermal_data_beside_the_picture():
    assert read(jpeg_file(size=(320, 256), segments=raw(320 * 256 * 2))).thermal_payload == "DJI raw in APP3 x3"
    upscaled = jpeg_file(size=(640, 512), segments=[*raw(320 * 256 * 2, 0xE4), (0xE5, b"\x01" * 24000)])
    assert read(upscaled).thermal_payload == "DJI raw in APP4 x3"
    assert read(jpeg_file(size=(640, 512), segments=[(0xE4, b"debug" * 300)])).thermal_payload == ""


def test_flir_segments_are_counted_and_missing_ones_told():
    def flir(index, last):
        return (0xE1, b"FLIR\x00\x01" + bytes([index, last]) + b"FFF\x00" * 50)

    assert read(jpeg_file(segments=[flir(0, 1), flir(1, 1)])).thermal_payload == "FLIR FFF in APP1 x2"
    frame = read(jpeg_file(segments=[flir(0, 2), flir(2, 2)]))
    assert frame.problems == ("thermal-payload-incomplete:2 of 3 segments",)


def test_thermal_data_and_thumbnails_are_not_sent(tmp_path):
    file = tmp_path / "t.jpg"
    file.write_bytes(jpeg_file(MAKE, packet(), size=(320, 256), segments=raw(320 * 256 * 2)))
    ranges = header_ranges(file)
    assert sum(n for _, n in ranges) < 3000
    data = file.read_bytes()
    parts = {o: data[o : o + n] for o, n in ranges}
    assert frame_from_header("t.jpg", parts, len(data)) == read_frame(file, "t.jpg")


def test_a_sender_is_told_which_bytes_are_missing():
    data = jpeg_file(MAKE, packet(), size=(320, 256), segments=raw(320 * 256 * 2))
    parts = {0: data[:40]}
    for _ in range(40):
        try:
            frame = frame_from_header("t.jpg", parts, len(data))
            break
        except HeaderIncomplete as missing:
            assert missing.code == "header-incomplete" and missing.offset + missing.length <= len(data)
            parts[missing.offset] = data[missing.offset : missing.offset + missing.length]
    assert frame.make == "Acme" and frame.thermal_payload
    assert frame.problems == ("jpeg-end-missing:not among the header bytes",)
    assert sum(len(p) for p in parts.values()) < 3000


def extended(guid, chunks, total=None):
    whole = sum(len(c) for c in chunks) if total is None else total
    place = 0
    for chunk in chunks:
        yield 0xE1, b"http://ns.adobe.com/xmp/extension/\x00" + guid + struct.pack(">II", whole, place) + chunk
        place += len(chunk)


def test_extended_xmp_is_put_together_in_any_order():
    guid = b"0123456789ABCDEF0123456789ABCDEF"
    more = packet(attributes='drone-dji:RelativeAltitude="+40.5" drone-dji:RtkFlag="50"')
    main = packet(attributes=f'xmpNote:HasExtendedXMP="{guid.decode()}" drone-dji:RtkFlag="16"')
    parts = list(extended(guid, [more[:100], more[100:300], more[300:]]))
    other = list(extended(b"F" * 32, [b"<not-mine/>"]))
    frame = read(jpeg_file(MAKE, main, segments=[parts[2], *other, parts[0], parts[1]]))
    assert (frame.relative_altitude_m, frame.rtk_flag, frame.xmp_blocks, frame.problems) == (40.5, 16, 1, ())
    frame = read(jpeg_file(MAKE, main, segments=parts[:2]))
    assert frame.relative_altitude_m is None
    assert "xmp-extended-incomplete:not all parts are there" in frame.problems


def test_segments_are_bounded():
    many = b"".join(segment(0xE6, b"") for _ in range(5000))
    data = jpeg_file()
    assert code_of(data[:2] + many + data[2:]) == "damaged-header"
