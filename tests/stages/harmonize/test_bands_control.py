"""The user's file of control points: both spellings, and plain words for what is wrong with one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from sensorgate.stages.errors import UsageError
from sensorgate.stages.harmonize.control_points import ControlPair, read_control_points
from sensorgate.stages.thresholds import DEFAULTS


def put(folder: Path, text: str) -> Path:
    path = folder / "points.txt"
    path.write_text(text, encoding="utf-8")
    return path


def test_json_and_csv_say_the_same(tmp_path: Path) -> None:
    told = {"pairs": [{"a": "Green", "b": "LWIR", "points": [[1, 2, 3.5, 4], [5, 6, 7, 8]]}]}
    from_json = read_control_points(put(tmp_path, json.dumps(told)), DEFAULTS)
    from_csv = read_control_points(
        put(tmp_path, "a,b,xa,ya,xb,yb\nGreen,LWIR,1,2,3.5,4\n\nGreen,LWIR,5,6,7,8\n"), DEFAULTS
    )
    assert from_json == from_csv == (ControlPair("Green", "LWIR", ((1.0, 2.0, 3.5, 4.0), (5.0, 6.0, 7.0, 8.0))),)
    assert from_json[0].turned().points[0] == (3.5, 4.0, 1.0, 2.0)


def test_semicolons_and_a_mark_in_front_are_read(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(b"\xef\xbb\xbfxa;ya;xb;yb;a;b\r\n1;2;3;4;IMG_1_2.tif;IMG_1_6.tif\r\n")
    assert read_control_points(path, DEFAULTS) == (ControlPair("IMG_1_2.tif", "IMG_1_6.tif", ((1.0, 2.0, 3.0, 4.0),)),)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "column"),
        ("a,b,xa,ya,xb\nG,R,1,2,3", "column yb"),
        ("a,b,xa,ya,xb,yb\n", "no control point"),
        ("a,b,xa,ya,xb,yb\nG,R,1,2,3", "5 columns"),
        ("a,b,xa,ya,xb,yb\nG,R,1,2,3,up", "'up'"),
        ("a,b,xa,ya,xb,yb\nG,R,1,2,3,nan", "'nan'"),
        ("a,b,xa,ya,xb,yb\n,R,1,2,3,4", "name"),
        ("{", "JSON"),
        ('{"pairs": 3}', "list"),
        ('{"pairs": [{"a": "G", "b": "R", "points": [[1, 2, 3]]}]}', "four numbers"),
        ('{"pairs": [{"a": "G", "b": "R", "points": ["1234"]}]}', "four numbers"),
        ('{"pairs": [{"a": "G", "b": "R", "points": [[1, 2, 3, true]]}]}', "True"),
        ('{"pairs": [{"b": "R", "points": [[1, 2, 3, 4]]}]}', "name"),
        ("[" * 100_000, "JSON"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, word: str) -> None:
    with pytest.raises(UsageError, match=word):
        read_control_points(put(tmp_path, text), DEFAULTS)


def test_unreadable_and_huge_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        read_control_points(tmp_path / "absent.csv", DEFAULTS)
    with pytest.raises(UsageError, match="UTF-8"):
        path = tmp_path / "x"
        path.write_bytes(b"\xff\xfe\x00a")
        read_control_points(path, DEFAULTS)
    with pytest.raises(UsageError, match="larger"):
        read_control_points(put(tmp_path, "x" * 100), DEFAULTS.replaced({"max_text_bytes": 50}))
