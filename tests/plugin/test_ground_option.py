"""``--ground``, ``--gsd-trigger`` and what stands in the report's inputs, on files written for it."""

from __future__ import annotations

import datetime
import json
import shutil
import subprocess
from pathlib import Path

import pytest
from PIL import Image
from sensorgate.plugin import pipeline
from sensorgate.plugin.cli import main
from sensorgate.plugin.cli.common import ground_from, trigger_from
from sensorgate.plugin.inspection import Settings, inspect
from sensorgate.plugin.report.build import digest_of
from sensorgate.stages.errors import UsageError

SCHEMA = Path(__file__).resolve().parents[2] / "plugin/report/report.schema.json"
GPS, EXIF = 0x8825, 0x8769


def degrees(value):
    whole = int(value)
    minutes = int((value - whole) * 60)
    return (whole, minutes, round(((value - whole) * 60 - minutes) * 60, 5))


def write_frames(folder, altitude_m, *, first=0, count=8, prefix="a"):
    """Small Canon frames with a GPS altitude and no relative altitude, flown north from 50.005, 10.01."""
    folder.mkdir(exist_ok=True)
    start = datetime.datetime(2024, 5, 1, 10) + datetime.timedelta(hours=first)
    for i in range(count):
        exif = Image.Exif()
        exif[271], exif[272] = "Canon", "Canon PowerShot S110"
        exif.get_ifd(EXIF).update(
            {36867: (start + datetime.timedelta(seconds=4 * i)).strftime("%Y:%m:%d %H:%M:%S"), 37386: 5.2, 41989: 24}
        )
        exif.get_ifd(GPS).update(
            {1: "N", 2: degrees(50.005 + i * 2e-4), 3: "E", 4: degrees(10.01), 5: b"\0", 6: float(altitude_m)}
        )
        noise = Image.effect_noise((400, 300), 40 + i + first).convert("RGB")
        noise.save(folder / f"{prefix}{i:02d}.jpg", exif=exif, quality=90)


@pytest.fixture
def dem(tmp_path):
    if shutil.which("gdal_translate") is None:
        pytest.skip("GDAL's programs are not installed")
    head = "ncols 40\nnrows 40\nxllcorner 10.0\nyllcorner 50.0\ncellsize 0.0005\n"
    (tmp_path / "cells.asc").write_text(head + "\n".join(" ".join(["300"] * 40) for _ in range(40)), encoding="ascii")
    command = ["gdal_translate", "-q", "-a_srs", "EPSG:4326", str(tmp_path / "cells.asc"), str(tmp_path / "dem.tif")]
    subprocess.run(command, check=True)
    return tmp_path / "dem.tif"


def gate(capsys, *arguments):
    code = main(["gate", *map(str, arguments), "--json", "-"])
    return code, json.loads(capsys.readouterr().out)


def test_a_model_gives_heights_and_its_identity_stands_in_the_report(tmp_path, dem, capsys):
    jsonschema = pytest.importorskip("jsonschema")
    write_frames(tmp_path / "in", 400)
    write_frames(tmp_path / "in", 440, first=4, prefix="b")
    code, report = gate(capsys, tmp_path / "in", "--ground", dem)
    assert {f["height_source"] for f in report["frames"]} == {"dem"}
    assert sorted({f["height_m"] for f in report["frames"]}) == [100.0, 140.0]
    assert code == 1 and "gsd-mixed" in {f["code"] for f in report["findings"]}
    told = report["inputs"]["elevation"]
    assert told["name"] == "dem.tif" and len(told["digest"]) == 64
    assert str(tmp_path) not in json.dumps(told)
    gain = next(a["gain"] for a in report["actions"] if a["gain"]["chosen"])
    assert gain["ratio"] == pytest.approx(1.4, abs=1e-3)
    assert gain["resampled"]["size_bytes"] > gain["native"]["size_bytes"]
    jsonschema.validate(report, json.loads(SCHEMA.read_text(encoding="utf-8")))


def test_without_any_ground_nothing_is_resampled_and_the_finding_says_why(tmp_path, capsys):
    write_frames(tmp_path / "in", 400)
    write_frames(tmp_path / "in", 440, first=4, prefix="b")
    _, report = gate(capsys, tmp_path / "in")
    assert {f["height_source"] for f in report["frames"]} == {"unknown"}
    assert {a["scale"] for a in report["actions"]} == {1.0} and {a["gain"] for a in report["actions"]} == {None}
    (said,) = {f["message"] for f in report["findings"] if f["code"] == "gsd-unknown"}
    assert "relative altitude" in said
    _, metres = gate(capsys, tmp_path / "in", "--ground", "300")
    assert {f["height_source"] for f in metres["frames"]} == {"ground-option"}
    assert {a["scale"] for a in metres["actions"]} != {1.0}
    _, patient = gate(capsys, tmp_path / "in", "--ground", "300", "--gsd-trigger", "45%")
    assert {a["scale"] for a in patient["actions"]} == {1.0}
    assert patient["thresholds"]["changed"] == {"gsd_trigger": 0.45}


def test_another_content_under_one_name_is_another_input(tmp_path, dem):
    write_frames(tmp_path / "in", 400)
    settings = Settings(dem=str(dem))
    before = inspect([str(tmp_path / "in")], settings)
    same = inspect([str(tmp_path / "in")], settings)
    subprocess.run(
        ["gdal_translate", "-q", "-a_srs", "EPSG:4326", "-scale", "0", "1", "0", "0.99", str(tmp_path / "cells.asc"),
         str(dem)], check=True
    )  # fmt: skip
    after = inspect([str(tmp_path / "in")], settings)
    first, again, changed = (digest_of(i.survey, settings.identity()) for i in (before, same, after))
    assert first == again != changed


def test_the_options_carry_the_content_of_the_files_they_name(tmp_path):
    points = tmp_path / "points.csv"
    points.write_text("a,b,xa,ya,xb,yb\n", encoding="ascii")
    settings = Settings(control_points=str(points))
    before = settings.options()
    points.write_text("a,b,xa,ya,xb,yb\nGreen,NIR,1,2,3,4\n", encoding="ascii")
    after = settings.options()
    assert before["control_points"] == after["control_points"] == str(points)
    assert before["control_points_sha256"] != after["control_points_sha256"]
    assert settings.identity()["control_points_sha256"] == after["control_points_sha256"]
    with pytest.raises(UsageError, match="--control-points"):
        Settings(control_points=str(tmp_path / "none.csv")).options()


def test_ground_takes_a_file_or_metres(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert ground_from(None) == {}
    assert ground_from("-3.5") == {"ground_m": -3.5}
    assert ground_from("dem.tif") == {"dem": "dem.tif"}
    (tmp_path / "250").write_bytes(b"")
    assert ground_from("250") == {"dem": "250"}
    for wrong in ("1e6", "nan", "inf"):
        with pytest.raises(UsageError):
            ground_from(wrong)


@pytest.mark.parametrize("text, value", [("0.05", 0.05), ("5%", 0.05), (" 12.5 % ", 0.125), ("2", 2.0)])
def test_the_trigger_is_a_ratio_or_per_cent(text, value):
    assert trigger_from(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["0", "-0.1", "5 percent", "nan", "inf", "", "%", "2000%"])
def test_a_trigger_that_is_none_is_refused(text):
    with pytest.raises(UsageError, match="--gsd-trigger"):
        trigger_from(text)


def test_a_missing_model_ends_with_exit_code_2_before_anything_is_written(tmp_path, capsys):
    write_frames(tmp_path / "in", 400, count=1)
    arguments = ["run", str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--no-align", "--ground", "none.tif"]
    assert main(arguments) == 2
    assert "none.tif" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_written_plan_repeats_the_identity_and_the_gains(tmp_path, dem):
    pytest.importorskip("cv2")
    write_frames(tmp_path / "in", 400)
    write_frames(tmp_path / "in", 440, first=4, prefix="b")
    pipeline.run([str(tmp_path / "in")], tmp_path / "out", Settings(dem=str(dem), align=False))
    plan = json.loads((tmp_path / "out/plan.json").read_text(encoding="utf-8"))
    assert plan["inputs"]["elevation"]["name"] == "dem.tif"
    assert [round(g["ratio"], 2) for g in plan["harmonize"]["gains"]] == [1.0, 1.4]
