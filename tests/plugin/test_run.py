"""The main job end to end on small surveys: conservation, equal bytes, resuming, and every kind of bad input."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("cv2")
pytest.importorskip("pycolmap")

from sensorgate.plugin import pipeline
from sensorgate.plugin.cli import main
from sensorgate.plugin.plan_file import read_plan
from sensorgate.plugin.replay import settings_of
from sensorgate.stages.errors import BlockedError, UsageError

from tests.frames import REAL
from tests.story import lost_frames, open_loops, play, wrong_routes

SCHEMA = Path(__file__).resolve().parents[2] / "plugin/report/report.schema.json"
SOLVER_FILES = {"alignment.json", "calibration.json", "report.json", "report.html"}


def digests(folder, skip=()):
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(Path(folder).rglob("*"))
        if p.is_file() and p.name not in skip
    }


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return play("tiny", tmp_path_factory.mktemp("tiny"))


def test_the_tiny_survey_goes_where_its_truth_says(tiny):
    assert wrong_routes(tiny) == []
    assert lost_frames(tiny) == []
    assert open_loops(tiny) == []


def test_every_report_fits_its_schema(tiny):
    import jsonschema

    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    jsonschema.validate(json.loads((tiny.out / "report.json").read_text(encoding="utf-8")), schema)
    jsonschema.validate(pipeline.gate([str(tiny.survey / "images")]).report, schema)


def test_nothing_of_ours_stands_where_odm_writes(tiny):
    for project in (tiny.out / "projects").iterdir():
        assert {p.name for p in project.iterdir()} <= {"images", "gcp_list.txt", "geo.txt", "sensorgate"}
        assert os.access(project / "sensorgate/odm.sh", os.X_OK)
    assert not (tiny.out / ".work").exists()


def test_done_again_elsewhere_by_its_plan_gives_the_same_bytes(tiny, tmp_path):
    shutil.copytree(tiny.survey, tmp_path / "elsewhere")
    images = str(tmp_path / "elsewhere/images")
    plan = read_plan(str(tiny.out / "plan.json"))
    settings = settings_of(plan, pipeline.Settings(), [tmp_path / "elsewhere"])
    again = pipeline.run([images], tmp_path / "again", settings, plan=plan)
    assert again.exit_code == tiny.exit_code
    assert again.report["replay"]["differences"] == []
    assert digests(tmp_path / "again", SOLVER_FILES) == digests(tiny.out, SOLVER_FILES)


def test_originals_are_untouched_and_outputs_do_not_reach_them(tiny):
    before = digests(tiny.survey)
    for frame in tiny.report["frames"]:
        if frame["output"] and frame["change"]["how"] != "linked":
            assert not os.path.samefile(tiny.out / frame["output"], frame["path"])
    assert digests(tiny.survey) == before


@pytest.mark.parametrize("after_s", (0.3, 1.5, 4.0))
def test_killed_and_resumed_is_as_if_undisturbed(tiny, tmp_path, after_s):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "sensorgate.plugin", "run", str(tiny.survey / "images"), "--out", str(out)]
    if tiny.truth.gcp_file:
        command += ["--gcp", str(tiny.survey / tiny.truth.gcp_file)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        process.wait(after_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    done = subprocess.run([*command, "--resume"], capture_output=True, text=True)
    assert done.returncode == tiny.exit_code, done.stderr
    assert digests(out, SOLVER_FILES) == digests(tiny.out, SOLVER_FILES)


def bad_inputs(folder: Path):
    empty = folder / "empty"
    empty.mkdir()
    texts = folder / "texts"
    texts.mkdir()
    (texts / "notes.txt").write_text("no image here")
    lying = folder / "lying"
    lying.mkdir()
    (lying / "a.jpg").write_text("text in a jpg's clothes")
    (lying / "b.tif").write_bytes(b"")
    (lying / "c.JPG").write_bytes(b"\xff\xd8\xff\xe1\x00\x10Exif\x00\x00")
    return {"empty": empty, "texts": texts, "lying": lying}


@pytest.mark.parametrize("kind", ("empty", "texts", "lying"))
def test_input_without_a_usable_frame_is_blocked_and_leaves_nothing(tmp_path, kind, capsys):
    folder = bad_inputs(tmp_path)[kind]
    out = tmp_path / "out"
    assert main(["gate", str(folder)]) == 3
    assert main(["run", str(folder), "--out", str(out)]) == 3
    assert not out.exists()
    said = capsys.readouterr()
    assert "Traceback" not in said.err + said.out
    assert folder.name in said.err


def test_usage_errors_say_the_way_out(tmp_path, tiny, capsys):
    images = str(tiny.survey / "images")
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.txt").write_text("keep me")
    wrong = tmp_path / "wrong.json"
    wrong.write_text('{"no_such_number": 1}')
    for command in (
        ["gate", str(tmp_path / "nowhere")],
        ["run", images, "--out", str(full)],
        ["run", images, "--out", images + "/inside"],
        ["run", images, "--out", str(tmp_path / "o"), "--gcp", str(tmp_path / "no.txt")],
        ["run", images, "--out", str(tmp_path / "o"), "--max-dim", "3"],
        ["gate", images, "--thresholds", str(wrong)],
        ["gate", images, "--gsd-target", "tiny"],
        ["gate", images, "--calibration", str(wrong)],
    ):
        assert main(command) == 2, command
        said = capsys.readouterr()
        assert said.err.startswith("sensorgate: ") and "Traceback" not in said.err
    assert [p.name for p in full.iterdir()] == ["mine.txt"]
    assert not (tmp_path / "o").exists()


def test_a_finished_folder_is_not_overwritten_unasked(tiny):
    with pytest.raises(UsageError, match="--resume"):
        pipeline.run([str(tiny.survey / "images")], tiny.out)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_an_unreadable_file_is_one_frame_lost(tiny, tmp_path):
    folder = tmp_path / "in"
    shutil.copytree(tiny.survey / "images", folder)
    victim = sorted(p for p in folder.rglob("*") if p.is_file())[0]
    victim.chmod(0)
    report = pipeline.gate([str(folder)]).report
    assert report["findings"][0]["code"] == "unreadable-file"


def test_a_bad_file_among_good_ones_is_left_out_with_its_reason(tiny, tmp_path):
    folder = tmp_path / "in"
    shutil.copytree(tiny.survey / "images", folder)
    victim = sorted(p for p in folder.rglob("*") if p.is_file())[0]
    victim.write_bytes(victim.read_bytes()[: victim.stat().st_size // 2])
    assert pipeline.gate([str(folder)]).exit_code == 1
    result = pipeline.run([str(folder)], tmp_path / "out", pipeline.Settings(align=False))
    lost = [f for f in result.report["frames"] if f["subproject"] is None]
    assert [(Path(f["path"]).name, f["reason"]) for f in lost] == [(victim.name, "truncated-image")]
    assert result.exit_code == 1


def test_masks_follow_their_frames(tiny, tmp_path):
    from PIL import Image

    folder = tmp_path / "in"
    shutil.copytree(tiny.survey / "images", folder)
    frame = sorted(p for p in folder.rglob("*") if p.is_file())[0]
    with Image.open(frame) as picture:
        Image.new("L", picture.size, 255).save(frame.with_name(f"{frame.stem}_mask.png"))
    result = pipeline.run([str(folder)], tmp_path / "out", pipeline.Settings(align=False))
    assert result.report["ignored"]["masks"] == 1
    home = next(f["output"] for f in result.report["frames"] if f["path"].endswith("/" + frame.name))
    assert (tmp_path / "out" / home).with_name(f"{frame.stem}_mask.png").is_file()


def test_without_the_solver_the_job_says_so_before_it_starts(tiny, tmp_path, monkeypatch):
    import importlib.util

    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "pycolmap" else real(name, *a))
    out = tmp_path / "out"
    assert main(["run", str(tiny.survey / "images"), "--out", str(out)]) == 4
    assert not out.exists()


@pytest.mark.skipif(not REAL.is_dir(), reason="the real frames are not here")
def test_real_frames_all_have_a_home(tmp_path):
    result = pipeline.run([str(REAL)], tmp_path / "out", pipeline.Settings(align=False))
    assert len(result.report["frames"]) == 48
    away = {Path(f["path"]).name: f["reason"] for f in result.report["frames"] if not f["subproject"]}
    assert away == {"DJI_XTS.jpg": "picture-cut-short"}  # no decoder reads it to its end
    names = [Path(f["output"]).name.lower() for f in result.report["frames"] if f["output"]]
    assert len(set(names)) == 47
    spectra = {s["name"]: {f["spectrum"] for f in result.report["frames"] if f["subproject"] == s["name"]}
               for s in result.report["subprojects"]}  # fmt: skip
    assert all(len(s) == 1 for s in spectra.values())


@pytest.mark.skipif(not REAL.is_dir(), reason="the real frames are not here")
def test_the_real_dji_survey_proceeds_and_is_held_by_the_sheet(tmp_path):
    result = pipeline.run([str(REAL / "brighton_p3_rgb")], tmp_path / "out")
    (project,) = result.report["subprojects"]
    assert (project["route"], result.exit_code) == ("proceed", 0)
    found = project["alignment"]
    assert found["registered"] == found["frames"] == 18
    assert found["gps_rmse_m"] < 1.0
    assert abs(found["height_m"] - 40.0) < 2.0
    assert [c["source"] for c in project["calibration"]] == ["sheet"]
    assert {"use-fixed-camera-params"} <= {o["name"] for o in project["options"]}
    images = tmp_path / "out/projects" / project["name"] / "images"
    assert pipeline.gate([str(images)]).exit_code == 0


def test_blocked_is_an_error_of_its_own(tmp_path):
    (tmp_path / "in").mkdir()
    with pytest.raises(BlockedError):
        pipeline.run([str(tmp_path / "in")], tmp_path / "out")


def hurt_pictures(monkeypatch, chosen):
    """Let the solver say of the chosen frames that their picture cannot be decoded; returns their paths."""
    from sensorgate.stages import route
    from sensorgate.stages.align.images import undecoded_note

    prove, hurt = route.prove, []

    def proven(request, *args, **more):
        proof = prove(request, *args, **more)
        hurt.extend(f.path for f in request.frames[chosen])
        notes = tuple(undecoded_note(path, OSError("image file is truncated")) for path in hurt)
        (group,) = proof.groups
        report = replace(group.alignment, notes=(*group.alignment.notes, *notes))
        return replace(proof, groups=(replace(group, alignment=report),))

    monkeypatch.setattr(route, "prove", proven)
    return hurt


def test_a_frame_whose_picture_is_damaged_inside_is_left_out(tiny, tmp_path, monkeypatch):
    """Its header and its end are good; only decoding shows it, and one such frame would end ODM's run."""
    hurt = hurt_pictures(monkeypatch, slice(2, 3))
    report = pipeline.run([str(tiny.survey / "images")], tmp_path / "out").report
    (lost,) = [f for f in report["frames"] if not f["subproject"]]
    assert (lost["path"], lost["reason"]) == (hurt[0], "pixels-broken")
    assert "pixels-broken" in {f["code"] for f in report["findings"]}


def test_where_no_project_is_left_the_code_says_so(tiny, tmp_path, monkeypatch):
    hurt_pictures(monkeypatch, slice(None))
    result = pipeline.run([str(tiny.survey / "images")], tmp_path / "out")
    assert result.exit_code == 3 and result.report["subprojects"] == []
    assert {f["reason"] for f in result.report["frames"]} == {"pixels-broken"}
    assert (tmp_path / "out/report.html").is_file()
