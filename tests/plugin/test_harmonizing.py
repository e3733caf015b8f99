"""From a rig's folder to projects: bands on one grid, a band that cannot be laid on it in a project of its own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2")

from sensorgate.plugin import pipeline
from sensorgate.plugin.harmonizing import kept_native
from sensorgate.stages.harmonize import tiff
from sensorgate.stages.harmonize.exif import TagEdit
from sensorgate.stages.harmonize.model import HarmonizedFrame
from sensorgate.stages.thresholds import DEFAULTS

from tests.simulator import Plan, Survey, catalogue, fly, render
from tests.simulator.stories import GROUND

SCHEMA = Path(__file__).resolve().parents[2] / "plugin/report/report.schema.json"
APART = pipeline.Settings(align=False)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Three captures of a five-band rig at half size."""
    folder = tmp_path_factory.mktemp("rig")
    camera = catalogue.with_band_size(catalogue.micasense(), 0.5)
    shots = fly(camera, Plan(90.0, 1, 3, forward=0.75), GROUND, 0)
    render(Survey("rig", (GROUND,), (camera,), shots), folder)
    return folder / "images"


def blank(file: Path) -> None:
    """Take the picture out of a band file and leave its tags."""
    data = file.read_bytes()
    pixels = tiff.decode(data, DEFAULTS)
    file.write_bytes(tiff.encode(data, np.full_like(pixels, 900), TagEdit(None, None, None)))


def options(project):
    return {o["name"]: o["value"] for o in project["options"]}


@pytest.fixture(scope="module")
def aligned(rig, tmp_path_factory):
    out = tmp_path_factory.mktemp("aligned") / "out"
    return out, pipeline.run([str(rig)], out, APART).report


def test_bands_come_out_on_one_grid_and_odm_is_told(aligned):
    import jsonschema

    _, report = aligned
    jsonschema.validate(report, json.loads(SCHEMA.read_text(encoding="utf-8")))
    (project,) = report["subprojects"]
    assert len(project["frames"]) == 15
    told = options(project)
    assert (told["primary-band"], told["skip-band-alignment"]) == ("Green", True)
    assert told["radiometric-calibration"] == "camera"
    (bands,) = report["bands"]
    assert [(f["state"], f["captures"]) for f in bands["fits"]] == [("warp", 3)] * 4
    assert all(f["held_out"]["median_px"] < 0.5 for f in bands["fits"])
    changed = {f["band"]: f["change"]["how"] for f in report["frames"]}
    assert changed.pop("green") != "warped" and set(changed.values()) == {"warped"}
    assert len({(f["change"]["width"], f["change"]["height"]) for f in report["frames"]}) == 1


def test_the_written_rig_passes_the_gate_as_one_camera_per_band(aligned):
    out, report = aligned
    again = pipeline.gate([str(out / "projects" / report["subprojects"][0]["name"] / "images")])
    assert again.exit_code == 0
    assert len(again.report["profiles"]) == 5


def test_resuming_takes_up_what_was_measured(rig, aligned, tmp_path, monkeypatch):
    """The plan of the bands is kept: a resumed run does not measure again, and says the same."""
    from sensorgate.plugin import placing
    from sensorgate.stages.harmonize import bands

    def fall(*_args, **_more):
        raise RuntimeError("power cut")

    out = tmp_path / "out"
    with monkeypatch.context() as cut:
        cut.setattr(placing, "write_project", fall)
        with pytest.raises(RuntimeError):
            pipeline.run([str(rig)], out, APART)
    monkeypatch.setattr(bands, "measure", fall)
    report = pipeline.run([str(rig)], out, APART, resume=True).report
    first = aligned[1]
    assert report["bands"] == first["bands"] and report["findings"] == first["findings"]
    for frame in report["frames"]:
        assert (out / frame["output"]).read_bytes() == (aligned[0] / frame["output"]).read_bytes()


def test_a_band_that_cannot_be_laid_on_the_primary_gets_its_own_project(rig, tmp_path):
    import shutil

    folder = tmp_path / "images"
    shutil.copytree(rig, folder)
    for file in folder.rglob("*_4.tif"):
        blank(file)
    report = pipeline.run([str(folder)], tmp_path / "out", APART).report
    assert {len(s["frames"]): s["name"] for s in report["subprojects"]}[3].endswith("-nir")
    whole, lone = sorted(report["subprojects"], key=lambda s: -len(s["frames"]))
    assert len(whole["frames"]) == 12 and options(whole)["skip-band-alignment"] is True
    assert {Path(p).name[-6:] for p in lone["frames"]} == {"_4.tif"} and "skip-band-alignment" not in options(lone)
    assert all(f["subproject"] for f in report["frames"])
    assert "band-refused" in {f["code"] for f in report["findings"]}
    for project in report["subprojects"]:
        assert pipeline.gate([str(tmp_path / "out/projects" / project["name"] / "images")]).exit_code == 0


def test_a_mask_that_cannot_be_scaled_costs_the_mask_alone(tmp_path):
    """The frame goes in without its mask, and the report says so."""
    from tests.simulator.stories import tiny

    folder = tmp_path / "survey"
    render(tiny(0), folder)
    first = sorted((folder / "images").rglob("*.JPG"))[0]
    first.with_name(first.stem + "_mask.png").write_bytes(b"no picture")
    settings = pipeline.Settings(align=False, gsd_target=2.6)
    report = pipeline.run([str(folder / "images")], tmp_path / "out", settings).report
    assert {f["change"]["how"] for f in report["frames"]} == {"resampled"}
    assert all(f["subproject"] for f in report["frames"])
    assert "mask-unusable" in {f["code"] for f in report["findings"]}


def test_frames_of_a_kind_that_is_not_rewritten_are_named():
    copies = {
        "a.tif": HarmonizedFrame("a.tif", "x/a.tif", "a.tif", 40, 30, 1.0, "linked", "pixels-not-supported"),
        "b.tif": HarmonizedFrame("b.tif", "x/b.tif", "b.tif", 80, 60, 2.0, "resampled"),
    }
    (finding,) = kept_native(copies)
    assert (finding.code, finding.severity, finding.subjects) == ("pixels-not-supported", "warning", ("a.tif",))
