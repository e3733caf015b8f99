"""The verb: which orthophotos it finds, how it calls them, what it prints and exits with."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pytest
from sensorgate.plugin import fuse as fusing
from sensorgate.plugin.cli import fuse as verb
from sensorgate.stages.errors import UsageError

from tests.stages.test_rasters import gdal, ground, ortho


def project(folder: Path, name: str, picture: np.ndarray, pixel: float) -> Path:
    return ortho(folder / "projects" / name / "odm_orthophoto" / "odm_orthophoto.tif", [picture], pixel)


def called(*words: str) -> int:
    parser = argparse.ArgumentParser()
    verb.register(parser.add_subparsers(dest="verb"))
    args = parser.parse_args(["fuse", *words])
    code: int = args.call(args)
    return code


@gdal
def test_projects_are_fused_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = ground(600, 400)
    project(tmp_path, "rgb", picture, 0.05)
    project(tmp_path, "thermal", 255 - picture.reshape(200, 2, 300, 2).mean(axis=(1, 3)).astype(np.uint8), 0.10)
    (tmp_path / "projects" / "unfinished").mkdir()
    out, report = tmp_path / "fused.tif", tmp_path / "fused.json"
    assert called(str(tmp_path), "--out", str(out), "--json", str(report)) == 0
    told = json.loads(report.read_text())
    assert told["schema_version"] == 1 and told["file"] == "fused.tif"
    assert [b["source"] for b in told["bands"]] == ["rgb", "thermal"]
    assert [b["name"] for b in told["bands"]] == ["rgb: band 1", "thermal: band 1"]
    (shift,) = told["shifts"]
    assert shift["raster"] == "thermal" and shift["median"] < 0.03
    assert str(tmp_path) not in report.read_text()
    printed = capsys.readouterr().out
    assert "thermal on rgb" in printed and "600 x 400" in printed


@gdal
def test_a_shifted_payload_is_exit_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = ground(600, 400)
    first = ortho(tmp_path / "a.tif", [picture], 0.05)
    second = ortho(tmp_path / "b.tif", [picture], 0.05, west=500_000.5)
    assert called(str(first), str(second), "--out", str(tmp_path / "o.tif")) == 1
    assert "raster-shifted" in capsys.readouterr().out


def test_names_come_from_the_projects(tmp_path: Path) -> None:
    for name in ("b", "a"):
        place = tmp_path / name / "odm_orthophoto" / "odm_orthophoto.tif"
        place.parent.mkdir(parents=True)
        place.write_bytes(b"II*\x00")
    assert [n for n, _ in fusing.find_orthophotos(tmp_path)] == ["a", "b"]
    place = tmp_path / "a" / "odm_orthophoto" / "odm_orthophoto.tif"
    assert [n for n, _ in fusing.named([place, place, Path("x/map.tif")])] == ["a", "a-2", "map"]


def test_nothing_to_fuse_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="Process the sub-projects first"):
        fusing.fuse([tmp_path], tmp_path / "o.tif")
    with pytest.raises(UsageError, match="does not exist"):
        fusing.fuse([tmp_path / "absent.tif"], tmp_path / "o.tif")
