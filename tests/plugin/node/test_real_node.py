"""Behaviour held against a real node with the folder in front of a real ODM.

``SENSORGATE_TEST_FIELD_NODE=http://localhost:3000`` names a NodeODM or NodeODX that was started with a folder written
by ``sensorgate node``. ODM is asked for its first stage alone, so that its programs need not be there.
"""

from __future__ import annotations

import json
import os
import time
import zipfile

import pytest

URL = os.environ.get("SENSORGATE_TEST_FIELD_NODE", "")
pytestmark = pytest.mark.skipif(not URL, reason="SENSORGATE_TEST_FIELD_NODE is not set")
pyodm = pytest.importorskip("pyodm")

QUICK = {"end-with": "dataset"}
COMPLETED, FAILED, CANCELED = 40, 30, 50


@pytest.fixture(scope="module")
def node():
    return pyodm.Node.from_url(URL)


def send(node, images, **options):
    files = sorted(str(p) for p in images.iterdir())
    asked = {**QUICK, **{k.replace("_", "-"): v for k, v in options.items()}}
    return node.create_task(files, asked, name="behaviour", parallel_uploads=1, progress_callback=lambda percent: None)


def until(task, *codes, seconds=300):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        info = task.info()
        if info.status.value in codes:
            return info
        time.sleep(0.3)
    raise AssertionError("\n".join(task.output(0)[-20:]))


def until_said(task, text, seconds=300):
    end = time.monotonic() + seconds
    while text not in "\n".join(task.output(0)):
        assert time.monotonic() < end, task.output(0)[-20:]
        time.sleep(0.2)


def archive(task, folder):
    with zipfile.ZipFile(task.download_zip(str(folder))) as packed:
        return {n: packed.read(n) for n in packed.namelist() if not n.endswith("/")}


def test_the_options_are_in_the_list(node):
    options = {o.name: o for o in node.options()}
    assert options["mixed-sensor-policy"].domain == ["off", "report", "auto", "strict"]
    assert {"mixed-sensor-gsd-target", "mixed-sensor-skip-alignment", "mixed-sensor-main-only", "force-gcp"} <= set(
        options
    )
    assert {"dsm", "orthophoto-resolution", "cameras"} <= set(options)


def test_a_clean_task(node, clean_images, tmp_path):
    task = send(node, clean_images)
    assert until(task, COMPLETED, FAILED).status.value == COMPLETED
    held = archive(task, tmp_path)
    assert json.loads(held["odm_report/sensorgate/report.json"])["verdict"] == "consistent"
    assert [s["name"] for s in json.loads(held["log.json"])["stages"]] == ["mixed_gate", "dataset"]
    task.remove()


def test_a_mixed_task_and_its_restart(node, mixed_images, tmp_path):
    task = send(node, mixed_images, mixed_sensor_skip_alignment=True)
    assert until(task, COMPLETED, FAILED).status.value == COMPLETED
    held = archive(task, tmp_path)
    assert "odm_report/sensorgate/thermal/images.json" in held
    assert len(json.loads(held["images.json"])) == 8
    parts = json.loads(held["odm_report/sensorgate/parts.json"])
    assert [(p["name"], p["exit_code"]) for p in parts] == [("rgb", 0), ("thermal", 0)]
    task.restart()
    until_said(task, "prepared by an earlier run")
    assert until(task, COMPLETED, FAILED).status.value == COMPLETED
    task.remove()


def test_a_refusal_can_be_read(node, mixed_images):
    task = send(node, mixed_images, mixed_sensor_policy="strict")
    info = until(task, COMPLETED, FAILED)
    assert info.status.value == FAILED
    assert info.last_error == "Processing failed (65)"
    assert any("Refused by mixed-sensor-policy strict" in line for line in task.output(0)[-10:])
    task.remove()


def test_a_cancelled_task_can_be_restarted(node, mixed_images):
    task = send(node, mixed_images, mixed_sensor_skip_alignment=True)
    until_said(task, "mixed_gate")
    task.cancel()
    assert until(task, CANCELED).status.value == CANCELED
    time.sleep(2.0)
    task.restart()
    assert until(task, COMPLETED, FAILED).status.value == COMPLETED
    task.remove()
