"""The examples of the docs, each as a program of its own beside rendered frames."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cv2")
pytest.importorskip("pycolmap")

from tests import simulator
from tests.plugin.submit.node_double import NodeDouble
from tests.stages.test_rasters import gdal, ground, ortho

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs/examples"


def example(name: str, *words: Any) -> "subprocess.CompletedProcess[str]":
    """Run an example; it may print what it likes, but no traceback."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *map(str, words)],
        capture_output=True,
        text=True,
        env={**os.environ, "SENSORGATE_NODE_TOKEN": ""},
        cwd=ROOT,
        timeout=300,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    folder = tmp_path_factory.mktemp("examples")
    simulator.render("tiny", folder / "survey", frames_scale=2 / 3)
    return folder / "survey/images"


@pytest.fixture(scope="module")
def result(survey):
    """What ``run_and_submit.py`` writes, without a node."""
    out = survey.parents[1] / "result"
    done = example("run_and_submit.py", survey, out)
    assert done.returncode == 0 and "proceed" in done.stdout
    return out


def test_a_queue_is_gated(survey, tmp_path):
    shutil.copytree(survey, tmp_path / "queue/good")
    (tmp_path / "queue/none").mkdir()
    done = example("gate_queue.py", tmp_path / "queue")
    assert done.returncode == 3
    good, none = done.stdout.splitlines()
    assert good.split() == ["good", "consistent"] and none.split() == ["none", "blocked", "no-usable-frame"]


def test_every_stage_by_its_call(survey):
    done = example("stage_by_stage.py", survey)
    assert done.returncode == 0
    assert "verdict: consistent" in done.stdout and "group rgb: proceed, 8 frames" in done.stdout


def test_run_and_submit(result):
    with NodeDouble() as node:
        done = example("run_and_submit.py", "not-read-again", result, node.url)
    assert done.returncode in (0, 1), done.stderr
    (entry,) = json.loads((result / "submit.json").read_text(encoding="utf-8"))["projects"]
    assert entry["name"] == "rgb" and entry["images"] == 8
    assert "rgb" in done.stdout


def test_own_thresholds(survey):
    done = example("own_thresholds.py", survey, "min_proof_frames=9")
    assert "new: too-few-frames" in done.stdout
    wrong = example("own_thresholds.py", survey, "min_proof_frame=9")
    assert wrong.returncode == 2 and "min_proof_frames" in wrong.stderr


def test_own_camera(survey):
    done = example("own_camera.py", survey, EXAMPLES / "my_cameras.csv")
    assert done.returncode == 0
    assert "sensor 13.20 mm (user-sheet)" in done.stdout


def test_own_rule_speaks_where_overlap_is_low(survey, tmp_path):
    assert example("own_rule.py", survey).returncode == 0
    (flight,) = json.loads(example("own_stage.py", survey).stdout)
    assert flight["frames"] == 8 and 0.6 < flight["forward"] < 1.0
    thinned = tmp_path / "thinned"
    thinned.mkdir()
    simulator.render("clean", tmp_path / "clean", frames_scale=0.1)
    frames = sorted((tmp_path / "clean/images").rglob("*.*"))
    for frame in frames[::2]:
        shutil.copy(frame, thinned / frame.name)
    done = example("own_rule.py", thinned)
    assert done.returncode == 1 and "overlap-low" in done.stdout


def test_own_adapter(result, tmp_path):
    done = example("own_adapter.py", result, tmp_path / "lists")
    assert done.returncode == 0
    images = (tmp_path / "lists/rgb.txt").read_text(encoding="utf-8").split()
    assert len(images) == 8 and all(Path(i).is_file() for i in images)
    assert "dji-fc6310" in (tmp_path / "lists/rgb.cameras.csv").read_text(encoding="utf-8")


@gdal
def test_orthophotos_are_fused(tmp_path):
    picture = ground(600, 400)
    for name in ("rgb", "thermal"):
        ortho(tmp_path / f"projects/{name}/odm_orthophoto/odm_orthophoto.tif", [picture], 0.05)
    done = example("fuse_orthophotos.py", tmp_path, tmp_path / "all.tif")
    assert done.returncode == 0 and (tmp_path / "all.tif").is_file()


def test_the_sheet_says_what_is_wrong_with_it(survey, tmp_path):
    from sensorgate.stages.errors import UsageError
    from sensorgate.stages.usersheet import read_user_sheet

    text = (EXAMPLES / "my_cameras.csv").read_text(encoding="utf-8")
    assert len(read_user_sheet(EXAMPLES / "my_cameras.csv")) == 2
    (tmp_path / "bad.csv").write_text(text.replace("13.2,8.8", "13.2mm,8.8"), encoding="utf-8")
    with pytest.raises(UsageError, match=r"line 4, column 'sensor_width_mm'"):
        read_user_sheet(tmp_path / "bad.csv")
