"""What the panel uploads: real files into tasks, over lines that break."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import List

import pytest

from .panel_browser import Browser
from .panel_server import Dashboard, Refused
from .panel_steps import DOCK, checked, folders


def test_what_was_filled_in_above_goes_along(browser: Browser, dashboard: Dashboard, survey: List[Path]) -> None:
    checked(browser, dashboard, folders(survey, "p4p"))
    browser.run(
        "dashboard.info = { selectedNode: { key: '3', id: 3 }, tags: ['mine'], alignTo: 'auto', resizeMode: 0,"
        " options: [{ name: 'dsm', value: true }, { name: 'fast-orthophoto', value: false }] }; 0"
    )
    browser.run("document.querySelector('.edit-task-form input').value = 'West'; 0")
    browser.click("create")
    browser.wait(f"{DOCK}.includes('The task is started')")
    (task,) = dashboard.tasks.values()
    assert task["name"] == "West" and task["tags"][0] == "mine" and "sensorgate" in task["tags"]
    assert task["processing_node"] == 3 and task["auto_processing_node"] is False
    assert {"name": "dsm", "value": True} in task["options"] and all(o["value"] for o in task["options"])
    assert "align_to" not in task and "resize_to" not in task


def test_a_broken_line_loses_nothing(
    browser: Browser, dashboard: Dashboard, survey: List[Path], tmp_path: Path
) -> None:
    """Large files go up in pieces, what fails is tried again, what is up stays up."""
    files = folders(survey, "p4p")
    large = tmp_path / files[0].name
    data = files[0].read_bytes()
    large.write_bytes(data[:-2] + b"\0" * 17_000_000 + data[-2:])
    files = [large, *files[1:]]
    refused = {"upload": 0}
    lock = threading.Lock()

    def disturb(method: str, path: str) -> None:
        with lock:
            if path.endswith("/upload/"):
                refused["upload"] += 1
                if refused["upload"] == 2:
                    raise Refused(503, "Busy.")
            if path.endswith("/commit/") and refused.pop("commit", None) is None and "committed" not in refused:
                refused["committed"] = 1
                raise Refused(400, "You need to upload at least 1 file before commit")

    dashboard.disturb = disturb
    checked(browser, dashboard, files)
    browser.click("create")
    browser.wait(f"{DOCK}.includes('The upload stopped')", 60)
    assert "You need to upload at least 1 file" in browser.run(DOCK)
    (task,) = dashboard.tasks.values()
    assert task["partial"] is True
    uploads = task["uploads"]
    browser.click("Try again")
    browser.wait(f"{DOCK}.includes('The task is started')")
    assert task["uploads"] == uploads, "what is up is not sent again"
    assert {len(d) for d in task["files"].values()} == {f.stat().st_size for f in files}
    assert task["files"][large.name] == large.read_bytes() and len(task["files"]) == len(files)
    assert len(dashboard.tasks) == 1 and task["partial"] is False


@pytest.mark.parametrize("slow", ["/upload/", "/tasks/"])
def test_a_cancelled_upload_leaves_no_half_task(
    browser: Browser, dashboard: Dashboard, survey: List[Path], slow: str
) -> None:
    def disturb(method: str, path: str) -> None:
        if path.endswith(slow):
            time.sleep(0.5)

    dashboard.disturb = disturb
    checked(browser, dashboard, folders(survey, "p4p"))
    browser.click("create")
    browser.wait(f"{DOCK}.includes('{'Creating the task' if slow == '/tasks/' else 'of 18 files'}')")
    browser.answer_dialogs(True)
    browser.click("Cancel upload")
    browser.wait(f"{DOCK}.includes('Upload cancelled')")
    until = time.monotonic() + 10
    while not any("removed" in t for t in dashboard.tasks.values()) and time.monotonic() < until:
        time.sleep(0.02)
    (task,) = dashboard.tasks.values()
    assert task.get("removed") and task["partial"] is True
    browser.wait("document.querySelector('[data-key=Close]')")
    browser.click("Close")
    assert browser.run(DOCK).strip() == ""
