from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
from pathlib import Path

import pytest
from sensorgate.plugin.odm.options import Option
from sensorgate.plugin.odm.project import odm_arguments, odm_script, write_project
from sensorgate.stages.errors import UsageError

CAMERAS = {"dji fc6310 4 3 brown 0.6666": {"projection_type": "brown", "focal_x": 0.66}}
NASTY = "gr'e en$(touch pwned)`id`\"\\"
LOCK = Option("use-fixed-camera-params", True, "held\nrm -rf /")

SHOW = """#!/bin/sh
for word in "$@"; do printf '%s\\n' "$word"; done
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    folder = tmp_path / "out dir" / "rgb main"
    (folder / "images").mkdir(parents=True)
    return folder


def fake(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(SHOW)
    path.chmod(0o755)
    return path


def test_only_what_odm_reads_stands_at_the_root(project: Path) -> None:
    write_project(
        project, options=[LOCK], gcp_text="EPSG:4326\n", geo_text="EPSG:4326\n", calibration=CAMERAS, alignment={"a": 1}
    )
    assert sorted(p.name for p in project.iterdir()) == ["gcp_list.txt", "geo.txt", "images", "sensorgate"]
    assert sorted(p.name for p in (project / "sensorgate").iterdir()) == [
        "alignment.json",
        "calibration.json",
        "odm.sh",
        "options.json",
    ]
    assert json.loads((project / "sensorgate/options.json").read_text()) == [
        {"name": "use-fixed-camera-params", "value": True}
    ]
    assert json.loads((project / "sensorgate/calibration.json").read_text()) == CAMERAS
    assert (project / "sensorgate/odm.sh").stat().st_mode & stat.S_IXUSR


def test_writing_again_leaves_nothing_of_the_plan_before(project: Path) -> None:
    write_project(project, options=[], gcp_text="EPSG:4326\n", geo_text="x", calibration=CAMERAS, alignment={})
    write_project(project, options=[])
    assert sorted(p.name for p in project.iterdir()) == ["images", "sensorgate"]
    assert sorted(p.name for p in (project / "sensorgate").iterdir()) == ["odm.sh", "options.json"]


def test_results_of_an_earlier_odm_run_are_refused(project: Path) -> None:
    (project / "images.json").write_text("[]")
    with pytest.raises(UsageError, match=r"images\.json"):
        write_project(project, options=[])
    with pytest.raises(UsageError, match="no images folder"):
        write_project(project.parent, options=[])


def test_no_path_of_the_machine_and_the_same_bytes_twice(project: Path, tmp_path: Path) -> None:
    write_project(project, options=[LOCK], calibration=CAMERAS)
    first = {p: p.read_bytes() for p in (project / "sensorgate").iterdir()}
    write_project(project, options=[LOCK], calibration=CAMERAS)
    assert first == {p: p.read_bytes() for p in (project / "sensorgate").iterdir()}
    assert not any(str(tmp_path).encode() in data for data in first.values())


@pytest.mark.skipif(shutil.which("sh") is None, reason="needs a POSIX shell")
@pytest.mark.parametrize("how", ["docker", "native", ""])
def test_the_script_hands_every_value_through_a_real_shell(project: Path, tmp_path: Path, how: str) -> None:
    options = [LOCK, Option("primary-band", NASTY, "r"), Option("crop", 2.5, "r"), Option("dsm", False, "r")]
    write_project(project, options=options, calibration=CAMERAS, notes=["first\nsecond"])
    docker = fake(tmp_path / "bin/docker")
    home = fake(tmp_path / "odm/run.sh").parent
    run = subprocess.run(
        ["sh", str(project / "sensorgate/odm.sh"), *([how] if how else []), "--rerun-all"],
        cwd=tmp_path,
        env={"PATH": f"{docker.parent}{os.pathsep}{os.environ['PATH']}", "ODM_HOME": str(home)},
        capture_output=True,
        text=True,
        check=True,
    )
    words = run.stdout.splitlines()
    assert not (tmp_path / "pwned").exists()
    passed = ["--use-fixed-camera-params", "--primary-band", NASTY, "--crop", "2.5", "--rerun-all"]
    if how == "native":
        assert words[:2] == ["--project-path", str(project.parent)]
        assert words[2:4] == ["--cameras", str(project / "sensorgate/calibration.json")]
        assert words[4:] == [*passed, project.name]
    else:
        assert words[:4] == ["run", "--rm", "-v", f"{project}:/datasets/project"]
        assert words[5:8] == ["--project-path", "/datasets", "--cameras"]
        assert words[8] == "/datasets/project/sensorgate/calibration.json"
        assert words[9:] == [*passed, "project"]


def test_reasons_and_notes_stay_in_comments() -> None:
    text = odm_script([LOCK], calibration=False, notes=["a\nrm -rf /"])
    assert "\nrm " not in text
    assert "# use-fixed-camera-params: held rm -rf /" in text
    assert "--cameras" not in text


def test_flags_are_bare_and_false_ones_are_not_said() -> None:
    assert odm_arguments([LOCK, Option("dsm", False, ""), Option("crop", 3, "")]) == [
        "--use-fixed-camera-params",
        "--crop",
        "3",
    ]
