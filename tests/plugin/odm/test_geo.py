from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.plugin.odm.geo import (
    GeoFrame,
    accuracy_mixed,
    check_geo,
    geo_for,
    read_geo,
    rewrite_geo,
    uniform_accuracy_m,
)

FIXED = GeoFrame("a.jpg", -91.5, 46.8, 200.0, 0.05, 0.05, fixed=True, odm_sigma_m=(0.04, 0.04))
PLAIN = GeoFrame("b.jpg", -91.6, 46.9, 210.0, 3.0, 5.0)


def test_columns_as_odm_counts_them() -> None:
    geo = read_geo(
        "EPSG:4326\n# c\na.jpg 1.50 2 3\nb.jpg 1 2\nc.jpg 1 2 3 90 0 0\nd.jpg 1 2 3 nan nan nan 0.03 0.05 x y\n"
        "e.jpg 1 2 3 4 5\n"
    )
    assert geo.findings == ()
    assert [(g.image, g.z, g.angles, g.accuracies, g.rest) for g in geo.lines] == [
        ("a.jpg", "3", None, None, ""),
        ("b.jpg", None, None, None, ""),
        ("c.jpg", "3", ("90", "0", "0"), None, ""),
        ("d.jpg", "3", ("nan", "nan", "nan"), ("0.03", "0.05"), "x y"),
        ("e.jpg", "3", None, None, "4 5"),
    ]


def test_lines_that_odm_drops_or_dies_on() -> None:
    geo = read_geo("EPSG:4326\na.jpg 1\nb.jpg x y z\nc.jpg 1 2 nan\n")
    assert [f.code for f in geo.findings] == ["geo-malformed-line"] * 3
    assert geo.findings[0].odm_message == "Malformed geo line: a.jpg 1"
    assert geo.lines == ()


def test_rewriting_keeps_the_numbers() -> None:
    geo = read_geo("EPSG:32615\na.jpg 1.500 2 3 nan nan nan 0.03 0.05\nb.jpg 1 2\nc.jpg 1 2 3\n")
    assert rewrite_geo(geo, {"a.jpg": ["p_a.jpg", "q_a.jpg"], "b.jpg": ["b.jpg"]}) == (
        "EPSG:32615\np_a.jpg 1.500 2 3 nan nan nan 0.03 0.05\nq_a.jpg 1.500 2 3 nan nan nan 0.03 0.05\nb.jpg 1 2\n"
    )
    assert rewrite_geo(geo, {}) is None


def test_what_a_file_of_the_user_would_silently_do() -> None:
    geo = read_geo("EPSG:4326\na.jpg 1 2 3 0 0 0 0.1 0.1\nb.jpg 1 2\nc.jpg 1 2 3\nD.jpg 1 2 3\n")
    assert [(f.code, f.subjects) for f in check_geo(geo, ["a.jpg", "b.jpg", "c.jpg", "d.jpg"])] == [
        ("geo-image-unknown", ("D.jpg",)),
        ("geo-height-missing", ("b.jpg",)),
        ("geo-accuracy-missing", ("c.jpg",)),
    ]


def test_mixed_accuracies_get_a_file_with_every_column() -> None:
    assert accuracy_mixed([FIXED, PLAIN])
    text = geo_for([PLAIN, FIXED])
    assert text == (
        "EPSG:4326\n"
        "a.jpg 46.800000000 -91.500000000 200.000 nan nan nan 0.050 0.050\n"
        "b.jpg 46.900000000 -91.600000000 210.000 nan nan nan 3.000 5.000\n"
    )
    assert all(line.accuracies for line in read_geo(text or "").lines)


def test_frames_alike_need_no_file() -> None:
    assert geo_for([PLAIN, replace(PLAIN, name="c.jpg")]) is None
    assert geo_for([]) is None
    assert geo_for([replace(FIXED, altitude_m=None), replace(PLAIN, altitude_m=None)]) is None


def test_one_accuracy_only_where_odm_would_not_see_it() -> None:
    unseen = replace(FIXED, odm_sigma_m=None, sigma_vertical_m=0.08)
    assert uniform_accuracy_m([unseen, unseen]) == pytest.approx(0.08)
    assert uniform_accuracy_m([FIXED]) is None
    assert uniform_accuracy_m([PLAIN]) is None
    assert uniform_accuracy_m([unseen, PLAIN]) is None
    assert uniform_accuracy_m([]) is None
