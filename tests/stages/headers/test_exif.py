"""Exif values: which directory they come from, and what becomes of the impossible ones."""

from __future__ import annotations

import math

import piexif
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from .build import ASCII, DOUBLE, LONG, RATIONAL, SHORT, SRATIONAL, UNDEFINED, exif_stream, jpeg_file, packet, read

PICTURE = jpeg_file()


def frame_of(image=(), exif=(), gps=(), order="<", xmp=b""):
    return read(jpeg_file(exif_stream(image, exif, gps, order), xmp))


def gps(north=b"N\x00", latitude=None, east=b"E\x00", longitude=None, more=()):
    rows = [
        (2, RATIONAL, latitude or [(46, 1), (30, 1), (36, 1)]),
        (4, RATIONAL, longitude or [(7, 1), (15, 1), (0, 1)]),
    ]
    rows += [(1, ASCII, north)] * bool(north) + [(3, ASCII, east)] * bool(east)
    return rows + list(more)


@pytest.mark.parametrize("order", ["<", ">"])
def test_focal_length_comes_from_the_exif_directory_alone(order):
    lens = [(0x920A, RATIONAL, (88, 10)), (0xA405, SHORT, 24)]
    frame = frame_of([(0x920A, RATIONAL, (50, 1)), (0xA20E, RATIONAL, (9, 1))], lens, order=order)
    assert (frame.focal_mm, frame.focal_35mm, frame.focal_plane_x_res) == (8.8, 24.0, None)
    assert frame_of([(0x920A, RATIONAL, (50, 1))], [(0x829D, RATIONAL, (28, 10))], order=order).focal_mm is None


def test_piexif_writes_what_is_read():
    block = piexif.dump(
        {
            "0th": {271: b"DJI", 272: b"FC6310", 274: 1, 305: b"v01.08"},
            "Exif": {33434: (1, 500), 33437: (56, 10), 34855: 100, 36867: b"2020:02:29 23:59:59", 37521: b"07",
                     37386: (88, 10), 40962: 5472, 40963: 3648, 41486: (5472, 13), 41487: (3648, 9), 41488: 4,
                     41988: (2, 1), 41989: 24, 42033: b"0K8TE", 42036: b"24mm", 37500: b"note"},
            "GPS": {1: b"S", 2: ((33, 1), (51, 1), (3125, 100)), 3: b"E", 4: ((151, 1), (12, 1), (4050, 100)),
                    5: 1, 6: (125, 10), 12: b"N", 13: (10, 1)},
        }
    )  # fmt: skip
    frame = read(PICTURE[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + PICTURE[2:])
    assert (frame.make, frame.model, frame.software, frame.serial) == ("DJI", "FC6310", "v01.08", "0K8TE")
    assert (frame.focal_mm, frame.focal_35mm, frame.digital_zoom, frame.lens) == (8.8, 24.0, 2.0, "24mm")
    assert frame.focal_plane_x_res == pytest.approx(5472 / 13) and frame.focal_plane_unit == 4
    assert frame.focal_plane_y_res == pytest.approx(3648 / 9)
    assert (frame.exif_width, frame.exif_height, frame.orientation) == (5472, 3648, 1)
    assert (frame.exposure_s, frame.f_number, frame.iso) == (0.002, 5.6, 100.0)
    assert frame.time == "2020-02-29T23:59:59.07"
    assert frame.latitude == pytest.approx(-(33 + 51 / 60 + 31.25 / 3600))
    assert frame.longitude == pytest.approx(151 + 12 / 60 + 40.5 / 3600)
    assert frame.altitude_m == -12.5 and frame.speed_mps == pytest.approx(5.14444)
    assert frame.has_makernote and frame.problems == ()


@pytest.mark.parametrize("tag", [(0xA20E, "FocalPlaneXResolution"), (0xA20F, "FocalPlaneYResolution")])
@pytest.mark.parametrize("value", [(0, 0), (500, 0)])
def test_a_focal_plane_over_zero_has_its_own_code(tag, value):
    frame = frame_of(exif=[(tag[0], RATIONAL, value), (0xA210, SHORT, 3)])
    assert frame.focal_plane_x_res is None and frame.focal_plane_y_res is None
    assert frame.problems == (f"focal-plane-rational-zero:{tag[1]}",)


@pytest.mark.parametrize(
    ("row", "problem"),
    [
        ((0x920A, RATIONAL, (88, 0)), "exif-rational-zero:FocalLength"),
        ((0x920A, SRATIONAL, (-88, 10)), "exif-not-positive:FocalLength"),
        ((0x920A, DOUBLE, math.nan), "exif-not-finite:FocalLength"),
        ((0x920A, DOUBLE, math.inf), "exif-not-finite:FocalLength"),
        ((0x920A, ASCII, "8.8 mm"), "exif-wrong-type:FocalLength"),
        ((0x920A, RATIONAL, (0, 10)), None),
    ],
)
def test_a_focal_length_that_is_none(row, problem):
    frame = frame_of(exif=[row])
    assert frame.focal_mm is None
    assert frame.problems == ((problem,) if problem else ())


def test_zoom_and_equivalent_of_zero_mean_unknown():
    frame = frame_of(exif=[(0xA404, RATIONAL, (0, 1)), (0xA405, SHORT, 0)])
    assert (frame.digital_zoom, frame.focal_35mm, frame.problems) == (None, None, ())


def test_a_missing_reference_is_told_and_the_signed_xmp_position_taken():
    frame = frame_of(gps=gps(north=b""))
    assert frame.gps_reference_missing and frame.latitude == pytest.approx(46.51)
    xmp = packet(attributes='drone-dji:GpsLatitude="-46.51" drone-dji:GpsLongtitude="+7.25"')
    frame = frame_of(gps=gps(north=b""), xmp=xmp)
    assert frame.gps_reference_missing and (frame.latitude, frame.longitude) == (-46.51, 7.25)
    assert not frame_of(gps=gps()).gps_reference_missing


@pytest.mark.parametrize(
    ("latitude", "problem"),
    [([(95, 1), (0, 1), (0, 1)], "gps-out-of-range:GPSLatitude, GPSLongitude"),
     ([(46, 0), (0, 1), (0, 1)], "exif-rational-zero:GPSLatitude")],
)  # fmt: skip
def test_an_impossible_position_is_none(latitude, problem):
    frame = frame_of(gps=gps(latitude=latitude))
    assert (frame.latitude, frame.longitude, frame.problems) == (None, None, (problem,))


def test_zero_zero_is_kept_as_the_camera_wrote_it_and_is_no_position():
    zero = [(0, 1), (0, 1), (0, 1)]
    frame = frame_of(gps=gps(latitude=zero, longitude=zero))
    assert (frame.latitude, frame.longitude, frame.has_gps) == (0.0, 0.0, False)
    xmp = packet(attributes='drone-dji:GpsLatitude="46.5" drone-dji:GpsLongitude="7.25"')
    assert frame_of(gps=gps(latitude=zero, longitude=zero), xmp=xmp).has_gps


@pytest.mark.parametrize(
    ("reference", "sign"), [((5, 1, 0), 1), ((5, 1, 1), -1), ((5, ASCII, "1"), -1), ((5, UNDEFINED, b"\x01"), -1)]
)
def test_altitude_has_the_sign_of_its_reference(reference, sign):
    assert frame_of(gps=gps(more=[reference, (6, RATIONAL, (1005, 10))])).altitude_m == sign * 100.5


@pytest.mark.parametrize(
    ("original", "subsec", "expected"),
    [
        ("2016:11:22 16:32:34", "498032", "2016-11-22T16:32:34.498032"),
        ("2016:11:22 16:32:34", "5", "2016-11-22T16:32:34.5"),
        ("2016:11:22 16:32:34", "200159489", "2016-11-22T16:32:34.200159"),
        ("2016:11:22 16:32:34", "-1", "2016-11-22T16:32:34"),
        ("1970:01:01 00:00:00", "", "1970-01-01T00:00:00"),
        ("0000:00:00 00:00:00", "", None),
        ("2016:13:45 99:00:00", "", None),
        ("    :  :     :  :  ", "", None),
    ],
)
def test_times(original, subsec, expected):
    assert frame_of(exif=[(0x9003, ASCII, original), (0x9291, ASCII, subsec)]).time == expected


def test_sub_seconds_of_the_change_time_count_only_when_it_is_the_same_moment():
    rows = [(0x9003, ASCII, "2016:11:22 16:32:34"), (0x9290, ASCII, "25")]
    assert frame_of([(0x132, ASCII, "2016:11:22 16:32:34")], rows).time == "2016-11-22T16:32:34.25"
    assert frame_of([(0x132, ASCII, "2019:01:01 00:00:00")], rows).time == "2016-11-22T16:32:34"


def test_text_ends_at_its_nul_and_is_one_clean_line():
    frame = frame_of([(0x010F, ASCII, b" DJI \x00junk"), (0x0110, ASCII, b"FC\n63\x0110\x00")])
    assert (frame.make, frame.model) == ("DJI", "FC 63 10")
    frame = frame_of([(0x010F, ASCII, b"Hasselbl\xe4d\x00")])
    assert (frame.make, frame.problems) == ("Hasselbläd", ("exif-not-utf8:Make",))


@pytest.mark.parametrize(
    ("own", "attributes", "expected"),
    [
        ("B1", 'drone-dji:DroneSerialNumber="D1" drone-dji:CameraSerialNumber="C1"', "B1"),
        ("0", 'drone-dji:DroneSerialNumber="D1" drone-dji:CameraSerialNumber="C1"', "C1"),
        ("", 'drone-dji:DroneSerialNumber="D1"', "D1"),
        ("0", "", "0"),
        ("", 'Camera:SerialNumber="M1" drone-dji:DroneSerialNumber="D1"', "M1"),
    ],
)
def test_the_cameras_own_serial_comes_before_the_drones(own, attributes, expected):
    assert frame_of(exif=[(0xA431, ASCII, own)], xmp=packet(attributes=attributes)).serial == expected


@pytest.mark.parametrize("pointer", [3, 1_000_000, 0])
def test_a_lost_exif_directory_is_told_and_the_rest_read(pointer):
    frame = read(
        jpeg_file(b"II*\x00\x08\x00\x00\x00" + exif_stream([(0x010F, ASCII, "Acme"), (0x8769, LONG, pointer)])[8:])
    )
    assert frame.make == "Acme"
    assert len(frame.problems) == 1 and frame.problems[0].startswith("exif-damaged:Exif")


def test_a_block_that_is_no_exif_costs_only_the_metadata():
    frame = read(jpeg_file(b"this is no TIFF stream at all"))
    assert (frame.width, frame.make) == (64, "")
    assert frame.problems == ("exif-damaged:IFD0, no TIFF header",)


rationals = st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))


@settings(max_examples=100, deadline=None)
@given(rationals, rationals, rationals, st.sampled_from("<>"))
def test_any_rational_is_its_quotient_or_nothing(focal, x, y, order):
    frame = frame_of(exif=[(0x920A, RATIONAL, focal), (0xA20E, RATIONAL, x), (0xA20F, RATIONAL, y)], order=order)
    for mine, (top, bottom) in ((frame.focal_mm, focal), (frame.focal_plane_x_res, x), (frame.focal_plane_y_res, y)):
        assert mine == (top / bottom if bottom and top else None)
