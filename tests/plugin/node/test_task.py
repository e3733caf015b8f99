"""Tasks end to end behind the folder, with a stand-in for ODM: parts, refusals, restarts, stops, exit codes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest

pytest.importorskip("cv2")

from .fake import make_node

NO_ALIGN = "--mixed-sensor-skip-alignment"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_node(tmp_path_factory.mktemp("node"))


@pytest.fixture
def node(made):
    """One folder for all tests, a data folder for each."""
    shutil.rmtree(made.data)
    made.data.mkdir()
    return made


def put(node, images, name="task"):
    (node.task(name)).mkdir()
    shutil.copytree(images, node.task(name) / "images")
    return node.task(name)


def stages(task):
    return [s["name"] for s in json.loads((task / "log.json").read_text())["stages"]]


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_a_clean_task_runs_as_it_came(node, clean_images):
    task = put(node, clean_images)
    done = node.run("task", "--dsm")
    assert done.returncode == 0, done.stdout + done.stderr
    (call,) = node.calls()
    assert call["argv"] == ["--dsm", "--project-path", str(node.data), "task"]
    assert call["images"] == names(task / "images")
    assert call["pythonpath"] is None, "ODM must not see our libraries"
    assert stages(task)[:2] == ["mixed_gate", "dataset"]
    assert names(task / "odm_report/sensorgate")[-1] == "report.json"
    assert json.loads((task / "odm_report/sensorgate/report.json").read_text())["verdict"] == "consistent"
    assert "Running mixed_gate stage" in done.stdout and "Finished mixed_gate stage" in done.stdout
    assert not (task / "sensorgate_node/run").exists()


def test_a_mixed_task_is_processed_in_parts(node, mixed_images):
    task = put(node, mixed_images)
    before = {p.name: p.read_bytes() for p in (task / "images").iterdir()}
    done = node.run("task", "--dsm", NO_ALIGN, "--mixed-sensor-policy", "auto")
    assert done.returncode == 0, done.stdout + done.stderr
    main, other = node.calls()
    assert len(main["images"]) == 8 and len(other["images"]) == 3
    assert Path(main["root"]).name == "rgb" and Path(other["root"]).name == "thermal"
    assert "--dsm" in main["argv"] and "--dsm" in other["argv"]
    assert (task / "odm_orthophoto/odm_orthophoto.tif").read_text().split() == main["images"]
    report = task / "odm_report/sensorgate"
    assert (report / "thermal/odm_orthophoto/odm_orthophoto.tif").read_text().split() == other["images"]
    told = json.loads((report / "parts.json").read_text())
    assert [(p["name"], p["main"], p["exit_code"]) for p in told] == [("rgb", True, 0), ("thermal", False, 0)]
    assert (report / "report.html").is_file() or "report.html" in done.stdout
    assert stages(task)[:3] == ["mixed_gate", "mixed_harmonize", "dataset"]
    assert {p.name: p.read_bytes() for p in (task / "images").iterdir()} == before
    assert "route: thermal: 3 frames, unproven" in done.stdout
    assert "2 parts" in done.stdout.splitlines()[-3]


def test_console_lines_are_short_ascii(node, mixed_images):
    put(node, mixed_images)
    done = node.run("task", NO_ALIGN, "--mixed-sensor-main-only")
    assert done.returncode == 0
    assert done.stdout.isascii()
    assert max(map(len, done.stdout.splitlines())) <= 200
    assert len(node.calls()) == 1
    assert "not processed, as asked" in done.stdout


def test_strict_refuses_a_mixed_task_in_words(node, mixed_images):
    task = put(node, mixed_images)
    done = node.run("task", "--mixed-sensor-policy", "strict")
    assert done.returncode == 65
    assert node.calls() == []
    last = done.stdout.splitlines()[-8:]
    assert any("mixes" in line and "thermal" in line for line in last)
    assert any("Refused by mixed-sensor-policy strict" in line for line in last)
    assert any("2 separate groups" in line for line in last)
    assert any("What to do" in line for line in last)
    assert all("[ERROR]" in line for line in last[-4:-1])
    log = json.loads((task / "log.json").read_text())
    assert log["error"]["code"] == 65 and log["success"] is False and log["stages"][0]["name"] == "mixed_gate"


def test_strict_takes_a_clean_task(node, clean_images):
    put(node, clean_images)
    assert node.run("task", "--mixed-sensor-policy", "strict").returncode == 0
    assert len(node.calls()) == 1


def test_report_changes_nothing(node, mixed_images):
    task = put(node, mixed_images)
    assert node.run("task", "--mixed-sensor-policy", "report").returncode == 0
    (call,) = node.calls()
    assert call["root"] == str(task)
    assert json.loads((task / "odm_report/sensorgate/report.json").read_text())["verdict"] == "inconsistent"


def test_off_leaves_no_trace(node, mixed_images):
    task = put(node, mixed_images)
    assert node.run("task", "--mixed-sensor-policy", "off").returncode == 0
    assert "sensorgate_node" not in names(task)
    assert "sensorgate" not in names(task / "odm_report")


def test_a_restart_goes_on_where_odm_was(node, mixed_images):
    task = put(node, mixed_images)
    assert node.run("task", NO_ALIGN, FAKE_ODM_FAIL="odm_orthophoto", FAKE_ODM_CODE="137").returncode == 137
    assert (task / "opensfm/reconstruction.json").is_file()
    done = node.run("task", NO_ALIGN, "--rerun-from", "opensfm")
    assert done.returncode == 0
    assert "prepared by an earlier run" in done.stdout and "Running mixed_gate" not in done.stdout
    first, again, other = node.calls()
    assert again["root"] == first["root"] and "opensfm" in again["found"]
    assert again["argv"][:2] == ["--rerun-from", "opensfm"]
    assert Path(other["root"]).name == "thermal"
    assert (task / "odm_orthophoto/odm_orthophoto.tif").is_file()
    assert stages(task)[:2] == ["mixed_gate", "mixed_harmonize"]


def test_other_images_are_looked_at_anew(node, mixed_images):
    task = put(node, mixed_images)
    assert node.run("task", NO_ALIGN).returncode == 0
    for path in (task / "images").glob("*04*"):
        path.unlink()
    left = len(names(task / "images"))
    done = node.run("task", NO_ALIGN)
    assert done.returncode == 0
    assert "Running mixed_gate" in done.stdout
    last = node.calls()[-1]
    assert len(last["images"]) == left
    assert "opensfm" not in last["found"], "nothing of the earlier images may be reused"


def test_switched_off_later_odm_starts_from_nothing_of_ours(node, mixed_images):
    task = put(node, mixed_images)
    assert node.run("task", NO_ALIGN).returncode == 0
    assert node.run("task", "--mixed-sensor-policy", "off").returncode == 0
    last = node.calls()[-1]
    assert last["root"] == str(task)
    assert "opensfm" not in last["found"]
    assert node.run("task", NO_ALIGN, "--mixed-sensor-policy", "report").returncode == 0
    assert node.calls()[-1]["root"] == str(task)
    assert node.run("task", NO_ALIGN).returncode == 0
    assert (task / "sensorgate_node/earlier/opensfm").is_dir()


@pytest.mark.parametrize("code", (1, 3))
def test_odms_exit_code_is_the_tasks(node, clean_images, code):
    put(node, clean_images)
    assert node.run("task", FAKE_ODM_FAIL="dataset", FAKE_ODM_CODE=str(code)).returncode == code


def test_another_part_that_fails_does_not_take_the_task_with_it(node, mixed_images):
    task = put(node, mixed_images)
    done = node.run("task", NO_ALIGN, FAKE_ODM_FAIL="odm_orthophoto", FAKE_ODM_FAIL_ON="thermal", FAKE_ODM_CODE="1")
    assert done.returncode == 0
    assert "could not process it (code 1)" in done.stdout
    told = json.loads((task / "odm_report/sensorgate/parts.json").read_text())
    assert told[1]["exit_code"] == 1


def wait_for(happened, seconds=60.0):
    until = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < until, "it never happened"
        time.sleep(0.05)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] if Path("/proc").is_dir() else "Z"
    return state != "Z"


def test_a_stop_reaches_odm(node, mixed_images):
    task = put(node, mixed_images)
    process = subprocess.Popen(
        node.command("task", NO_ALIGN),
        cwd=node.front,
        env={**node.env, "FAKE_ODM_HANG": "opensfm"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    wait_for(lambda: len(node.calls()) == 1)
    time.sleep(0.3)
    process.send_signal(signal.SIGTERM)
    said, _ = process.communicate(timeout=30)
    assert process.returncode == 130, said
    pid = node.calls()[0]["pid"]
    assert Path(f"{node.calls_file}.stopped").read_text().split() == [str(pid)]
    assert not alive(pid)
    done = node.run("task", NO_ALIGN)
    assert done.returncode == 0 and "prepared by an earlier run" in done.stdout
    assert (task / "odm_orthophoto/odm_orthophoto.tif").is_file()


def test_a_stop_while_looking_leaves_nothing_running(node, mixed_images):
    put(node, mixed_images)
    process = subprocess.Popen(
        node.command("task", NO_ALIGN), cwd=node.front, env=node.env, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert "mixed_gate" in process.stdout.readline()
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30)
    assert process.returncode == 130
    assert node.calls() == []
    assert node.run("task", NO_ALIGN).returncode == 0


@pytest.mark.parametrize("kind", ("pipe", "socket"))
def test_a_node_that_dies_takes_its_task_along(node, clean_images, kind):
    """NodeODM gives sockets, a shell gives pipes."""
    put(node, clean_images)
    if kind == "pipe":
        near, far = os.pipe()
    else:
        ours, theirs = socket.socketpair()
        near, far = ours.detach(), theirs.detach()
    hangs = {**node.env, "FAKE_ODM_HANG": "opensfm"}
    process = subprocess.Popen(node.command("task"), cwd=node.front, env=hangs, stdout=far)
    os.close(far)
    wait_for(lambda: len(node.calls()) == 1)
    os.close(near)
    assert process.wait(timeout=30) == 130
    assert not alive(node.calls()[0]["pid"])


@pytest.mark.parametrize("seed", ("split_merge_stop_at_reconstruction.txt", "exif/empty", "camera_models.json"))
def test_pieces_of_a_split_survey_pass_untouched(node, mixed_images, seed):
    task = put(node, mixed_images)
    (task / "opensfm" / seed).parent.mkdir(parents=True)
    (task / "opensfm" / seed).write_text("")
    assert node.run("task").returncode == 0
    (call,) = node.calls()
    assert call["root"] == str(task)
    assert "sensorgate_node" not in names(task)


def test_a_calibration_among_the_images_is_given_to_odm(node, mixed_images):
    task = put(node, mixed_images)
    file = task / "images/sensorgate_calibration.json"
    file.write_text(json.dumps({"dji fc6310 5472 3648 brown 0.6666": {"focal_x": 0.66}}))
    assert node.run("task", "--mixed-sensor-policy", "report").returncode == 0
    assert node.run("task").returncode == 0  # a prepared project is not prepared again
    file.write_text("{}")
    assert node.run("task").returncode == 0
    file.write_text("[1")
    done = node.run("task")
    assert done.returncode == 0 and "cannot be used" in done.stdout
    assert [str(file) in c["argv"] for c in node.calls()] == [True, True, False, False]
    assert all(c["root"] == str(task) for c in node.calls())


def test_ground_control_that_cannot_be_read_leaves_the_task_to_odm(node, mixed_images):
    put(node, mixed_images)
    bad = node.data / "gcp_list.txt"
    bad.write_text("no such system\n1 2 3 4 5 a.jpg\n")
    done = node.run("task", "--gcp", str(bad))
    assert done.returncode == 0, done.stdout
    assert "could not look" in done.stdout
    assert "--gcp" in node.calls()[0]["argv"]
    assert node.run("task", "--gcp", str(bad), "--mixed-sensor-policy", "strict").returncode == 65


def test_notes_are_not_taken_for_ground_control(node, clean_images):
    """A node names the first text file, and that may be anything."""
    task = put(node, clean_images)
    (task / "gcp").mkdir()
    (task / "gcp/a_notes.txt").write_text("flown at 45 m\nwind 3 m/s from the west, 1 2 3 4\n")
    (task / "gcp/gcp_list.txt").write_text("EPSG:4326\n8.7 47.2 440 100 200 DJI_0001.JPG\n")
    done = node.run("task", "--gcp", str(task / "gcp/a_notes.txt"), "--mixed-sensor-policy", "report")
    assert done.returncode == 0
    assert "a_notes.txt holds no ground control points" in done.stdout
    assert node.calls()[0]["argv"][:2] == ["--gcp", str(task / "gcp/gcp_list.txt")]


def test_folders_that_are_no_task_are_left_to_odm(node):
    (node.data / "empty").mkdir()
    assert node.run("empty").returncode != 0
    assert names(node.data / "empty") == []
    assert node.run("empty", "--no-such-option").returncode == 2


def test_by_hand_paths_may_be_relative(node, clean_images):
    task = put(node, clean_images)
    (task / "cameras.txt").write_text("{}")
    words = ["--cameras", "task/cameras.txt", "--project-path", ".", "task", "--mixed-sensor-policy", "off"]
    done = subprocess.run([str(node.front / "run.sh"), *words], cwd=node.data, env=node.env, capture_output=True)
    assert done.returncode == 0
    assert node.calls()[0]["argv"] == ["--cameras", str(task / "cameras.txt"), "--project-path", str(node.data), "task"]


def test_a_wrong_policy_is_a_usage_error(node, clean_images):
    put(node, clean_images)
    done = node.run("task", "--mixed-sensor-policy", "maybe")
    assert done.returncode == 2 and "one of off, report, auto, strict" in done.stdout
    assert node.calls() == []


def test_only_text_that_came_with_the_images_reaches_odm_as_one_word(node, clean_images):
    put(node, clean_images)
    nasty = '$(touch /tmp/owned) "; echo `id` \\'
    assert node.run("task", "--cameras", nasty).returncode == 0
    assert node.calls()[0]["argv"][:2] == ["--cameras", nasty]


def test_two_tasks_at_once_do_not_meet(node, mixed_images, clean_images):
    put(node, mixed_images, "a")
    put(node, clean_images, "b")
    running = [
        subprocess.Popen(node.command(n, NO_ALIGN), cwd=node.front, env=node.env, stdout=subprocess.DEVNULL)
        for n in ("a", "b")
    ]
    assert [p.wait(timeout=120) for p in running] == [0, 0]
    assert len(node.calls()) == 3
    assert names(node.task("b") / "odm_report/sensorgate")[-1] == "report.json"


def test_the_folder_works_where_it_is_copied_and_cannot_be_written(node, clean_images, tmp_path):
    elsewhere = tmp_path / "mounted here"
    shutil.copytree(node.front, elsewhere, symlinks=True)
    moved = tmp_path / "code"
    shutil.copytree(node.odm, moved)
    for path in elsewhere.rglob("*"):
        if not path.is_symlink():
            path.chmod(path.stat().st_mode & ~0o222)
    (elsewhere / "ODM_HOME").chmod(0o644)
    (elsewhere / "ODM_HOME").write_text("/nowhere\n")
    put(node, clean_images)
    command = [str(elsewhere / "run.sh"), "--project-path", str(node.data), "task"]
    done = subprocess.run(command, env={**node.env, "SENSORGATE_ODM": str(moved)}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    lost = subprocess.run(command, env=node.env, capture_output=True, text=True)
    assert lost.returncode == 3 and "SENSORGATE_ODM" in lost.stdout


def test_progress_goes_where_a_node_listens(node, mixed_images):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        try:
            ear.bind(("127.0.0.1", 6367))
        except OSError:
            pytest.skip("something on this machine listens to ODM's progress already")
        put(node, mixed_images)
        assert node.run("task", NO_ALIGN).returncode == 0
        ear.setblocking(False)
        heard = []
        while True:
            try:
                heard.append(ear.recv(1000).decode().split("/"))
            except BlockingIOError:
                break
    values = [float(v) for kind, _, name, v in heard if kind == "PGUP" and name == "task"]
    assert values == sorted(values)
    assert 2.0 in values and 4.0 in values
    # ODM's own figures carry the parts' names; ours are of the whole: 8 of 11 frames done when the first part is.
    assert any(abs(v - (4 + 96 * 8 / 11 * 0.99)) < 0.1 for v in values)
    assert values[-1] > 98.0
