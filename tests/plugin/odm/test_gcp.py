"""The form of the file, and the real behaviour of ODM that it answers to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.odm.gcp import GcpFrame, PlacedMark, align_marks, as_odm_prints, read_gcp, scaled, write_gcp
from sensorgate.stages.errors import UsageError
from sensorgate.stages.gcp import read_text

FRAME = GcpFrame("a/IMG_1.JPG", "a_IMG_1.JPG", 4000, 3000, 4000, 3000)


def test_columns_by_blanks_or_tabs_with_names_and_extras() -> None:
    found = read_gcp(
        "WGS84 UTM 15N\r\n# comment\r\n\r\n"
        "577100.500 5188200.25 198.0 1000 2000.5 IMG_1.JPG gcp01 note more\r\n"
        "577100.500\t5188200.25\t198.0\t10\t20\tIMG 2.JPG\tgcp 01\n"
        "  1e5 2 nan 3 4 x.jpg\n"
    )
    assert [(line.number, line.image, line.extras) for line in found.lines] == [
        (4, "IMG_1.JPG", "gcp01 note more"),
        (5, "IMG 2.JPG", "gcp 01"),
        (6, "x.jpg", ""),
    ]
    assert found.lines[0].label == "gcp01"
    assert found.lines[2].label == "1e5 2 nan"
    assert found.findings == ()


def test_lines_that_odm_drops_or_dies_on_are_said() -> None:
    found = read_gcp(
        "EPSG:4326\n1 2 3 4 5\ngeo_x geo_y geo_z im_x im_y image_name\n1,5 2 3 4 5 a.jpg\n1 2 inf 4 5 a.jpg\n"
    )
    assert [f.code for f in found.findings] == ["gcp-malformed-line"] * 4 + ["gcp-no-entries"]
    assert found.findings[0].odm_message == "Malformed GCP line: 1 2 3 4 5"
    assert [f.subjects for f in found.findings[:4]] == [(f"line {n}",) for n in (2, 3, 4, 5)]


def test_the_header_must_stand_first() -> None:
    with pytest.raises(UsageError, match="names no coordinate system"):
        read_gcp("# comment\nEPSG:4326\n1 2 3 4 5 a.jpg\n")


def test_what_is_not_resampled_is_kept_as_spelled_and_in_order() -> None:
    text = "EPSG:32615\n577100.500 5188200.250 198.0 1000 2000.50 IMG_1.JPG gcp01\n1 2 3 4 5 IMG_1.JPG\n"
    gcp = read_gcp(text)
    assert write_gcp(gcp.srs, [(line, FRAME) for line in gcp.lines]) == text.replace("IMG_1.JPG", "a_IMG_1.JPG")


def test_pixels_follow_a_resampled_frame() -> None:
    gcp = read_gcp("EPSG:4326\n1 2 3 1000 2000.50 IMG_1.JPG g\n")
    doubled = replace(FRAME, out_width=8000, out_height=6000)
    assert write_gcp(gcp.srs, [(gcp.lines[0], doubled)]).splitlines()[1] == "1 2 3 2000.500 4001.500 a_IMG_1.JPG g"


@given(st.floats(-0.5, 9999.0), st.integers(100, 10000), st.integers(100, 40000), st.integers(100, 10000))
def test_odms_normalised_coordinate_does_not_move(pixel: float, width: int, out: int, height: int) -> None:
    # OpenSfM: (pixel + 0.5 - size / 2) / max(size)
    out_height = height * out / width
    before = (pixel + 0.5 - width / 2) / max(width, height)
    after = (float(scaled(repr(pixel), width, out)) + 0.5 - out / 2) / max(out, out_height)
    assert abs(before - after) * max(out, out_height) <= 0.00051


def test_marks_for_the_alignment_are_in_pixels_of_the_written_file() -> None:
    gcp = read_gcp("EPSG:4326\n1 2 3 10 20 IMG_1.JPG g\n1 2 3 30 40 other.JPG g\n1 2 nan 1 1 IMG_1.JPG\n")
    placed = [PlacedMark(line, f"a/{line.image}", 2.0, 1.0) for line in gcp.lines]
    (mark,) = align_marks(placed, [replace(FRAME, out_width=2000, out_height=1500)])
    assert (mark.path, mark.x_px, mark.y_px, mark.altitude_m) == ("a/IMG_1.JPG", 4.75, 9.75, 3.0)


def test_odms_own_spelling_of_a_line() -> None:
    (line,) = read_gcp("EPSG:4326\n1 2 3 4 5 a.jpg n\n").lines
    assert as_odm_prints(line) == "1.0 2.0 3.0 4.0 5.0 a.jpg n"


def test_files_that_odm_could_not_read(tmp_path: Path) -> None:
    good, latin = tmp_path / "good.txt", tmp_path / "latin.txt"
    good.write_bytes("\ufeffEPSG:4326\n".encode())
    latin.write_bytes("EPSG:4326\n1 2 3 4 5 a.jpg Stra\xdfe\n".encode("latin-1"))
    assert read_text(good) == "EPSG:4326\n"
    for bad in (latin, tmp_path / "missing.txt", tmp_path):
        with pytest.raises(UsageError):
            read_text(bad)
