"""Ground control lists without any stack behind them: marks on frames, and points held out."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.stages.errors import UsageError
from sensorgate.stages.gcp import choose_check_points, marks_from_file, parse_gcp, told_twice
from sensorgate.stages.srs import lonlat_to_utm

from tests.stages.align.scenes import ORIGIN, frames, grid

E, N = lonlat_to_utm(ORIGIN[1], ORIGIN[0], 15, True)


def _list(rows, header="WGS84 UTM 15N"):
    return "\n".join([header, *rows]) + "\n"


def test_marks_stand_on_the_frames_that_are_named(tmp_path):
    group = frames(grid(1, 3))
    rows = [
        f"{E:.3f} {N:.3f} 201.5 10.5 20 000.jpg P1",
        f"{E:.3f} {N:.3f} 201.5 11 21 001.JPG P1",
        f"{E + 10:.3f} {N:.3f} 200 12 22 002.jpg check7",
        f"{E + 10:.3f} {N:.3f} 200 12 22 elsewhere.jpg check7",
        f"{E + 20:.3f} {N:.3f} nan 12 22 002.jpg flat",
        "short line",
    ]
    file = tmp_path / "gcp_list.txt"
    file.write_text(_list(rows), encoding="utf-8")
    marks = marks_from_file(file, group)
    assert [(m.path, m.name, m.check, m.x_px) for m in marks] == [
        ("a/000.jpg", "P1", False, 10.5),
        ("a/001.jpg", "P1", False, 11.0),
        ("a/002.jpg", "check7", True, 12.0),
    ]
    assert marks[0].point == marks[1].point != marks[2].point
    assert marks[0].latitude == pytest.approx(ORIGIN[0], abs=1e-7)
    assert marks[0].longitude == pytest.approx(ORIGIN[1], abs=1e-7)
    assert parse_gcp(_list(rows)).bad[0].short


def test_marks_that_repeat_or_contradict_are_left_out(tmp_path):
    group = frames(grid(1, 3))
    rows = [
        f"{E:.3f} {N:.3f} 201.5 10.5 20 000.jpg P1",
        f"{E:.3f} {N:.3f} 201.5 10.7 20 000.jpg P1",
        f"{E:.3f} {N:.3f} 201.5 11 21 001.jpg P1",
        f"{E:.3f} {N:.3f} 201.5 300 21 001.jpg P1",
        f"{E:.3f} {N:.3f} 201.5 12 22 002.jpg P1",
    ]
    file = tmp_path / "gcp_list.txt"
    file.write_text(_list(rows), encoding="utf-8")
    assert [(m.path, m.x_px) for m in marks_from_file(file, group)] == [("a/000.jpg", 10.5), ("a/002.jpg", 12.0)]
    found = told_twice([(line, line.image) for line in parse_gcp(_list(rows)).lines])
    assert (found.repeated, found.contradicting, found.unusable) == ((3,), ((4, 5),), {3, 4, 5})


SPOTS = {f"p{i}": (46.0 + dy * 1e-3, 8.0 + dx * 1e-3) for i, (dx, dy) in enumerate(
    [(-1, -1), (1, -1), (1, 1), (-1, 1), (0, 0), (0.4, 0.1), (-0.3, 0.2), (0.1, -0.4)]
)}  # fmt: skip


def _choose(wanted, images=4):
    points = {(i, 0.0, 0.0): name for i, name in enumerate(SPOTS)}
    places = {p: SPOTS[name] for p, name in points.items()}
    found = choose_check_points(points, places, dict.fromkeys(points, images), wanted)
    return {points[p] for p in found}


def test_so_many_are_held_out_and_the_corners_stay():
    for count in (1, 2, 3):
        out = _choose(str(count))
        assert len(out) == count and not out & {"p0", "p1", "p2", "p3"}


def test_names_are_held_out_and_unknown_ones_refused():
    assert _choose("p1, p4") == {"p1", "p4"}
    assert _choose(None) == set()
    with pytest.raises(UsageError, match="p9"):
        _choose("p1,p9")


@given(st.integers(0, 20))
def test_enough_points_are_always_left(count):
    if count > 3:
        with pytest.raises(UsageError):
            _choose(str(count))
    else:
        assert len(SPOTS) - len(_choose(str(count))) >= 5


def test_points_on_two_frames_cannot_be_spared_for_checks():
    with pytest.raises(UsageError):
        _choose("1", images=2)
