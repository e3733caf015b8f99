"""The New Task panel in a real browser, with real files, against the real gate."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Iterator, List, Tuple

import pytest

from sensorgate.stages.read import read_frame
from tests.simulator.run import render

from .panel_browser import CHROMIUM, Browser
from .panel_server import PROJECT, Dashboard, Refused

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")

SHOTS = Path(__file__).resolve().parents[3] / "build" / "panel"
READY = "document.querySelector('[data-key=create]') && !document.querySelector('[data-key=create]').disabled"


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> List[Path]:
    """A mixed folder: two drones and a compact with JPEGs, a rig with TIFFs, thermal; and ground control."""
    folder = tmp_path_factory.mktemp("survey")
    render("demo", folder, frames_scale=0.25)
    files = sorted(p for p in (folder / "images").rglob("*") if p.is_file())
    return [*files, folder / "gcp_list.txt"]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def dashboard(tmp_path: Path) -> Iterator[Dashboard]:
    served = Dashboard(tmp_path / "server")
    yield served
    served.close()


def checked(browser: Browser, dashboard: Dashboard, files: List[Path], theme: str = "") -> None:
    """Open the dashboard, choose the files, and wait for the verdict on all of them."""
    browser.errors.clear()
    browser.open(f"{dashboard.address}/?theme={theme}")
    browser.choose("#files", files)
    browser.wait(READY)


def test_a_mixed_folder_is_judged_and_becomes_the_right_tasks(
    browser: Browser, dashboard: Dashboard, survey: List[Path]
) -> None:
    checked(browser, dashboard, survey)
    said = browser.text()
    for words in ("DJI FC6310", "MicaSense", "thermal", "If you upload this as one task", "What we suggest"):
        assert words in said
    browser.screenshot(SHOTS / "verdict.png")
    # Up to here nothing went to the task API, and the plugin's API got headers alone.
    assert not dashboard.tasks
    proposed = browser.run("document.querySelector('.sg-panel').parentNode.sensorgateCheck.verdict.tasks.map(t => [t.name, t.files])")
    browser.run("document.querySelector('[data-key=create]').click()")
    browser.wait(f"document.querySelector('.sg-dock') && document.querySelector('.sg-dock').innerText.includes('All {len(proposed)} tasks are started')")
    browser.screenshot(SHOTS / "uploaded.png")
    assert not browser.run("document.querySelector('.new-task-panel')")
    assert browser.run("dashboard.added") >= 1 and browser.run("item.dropzone.files.length") == 0
    assert len(dashboard.tasks) == len(proposed) > 2
    names = {t["name"]: t for t in dashboard.tasks.values()}
    for name, files in proposed:
        task = names[f"North field - 5/1/2024 - {name}"]
        assert task["partial"] is False and task["auto_processing_node"] is True
        assert "sensorgate" in task["tags"]
        images = {n: d for n, d in task["files"].items() if not n.endswith(".txt")}
        assert sorted(images) == sorted(n for _, n in files)
        for number, stored in files:
            assert images[stored] == survey[number].read_bytes()
    assert any("gcp_list.txt" in t["files"] for t in dashboard.tasks.values())
    claimed = [b for p, b in dashboard.bodies if p.endswith("/claim")]
    assert {b["task"] for b in claimed} == set(dashboard.tasks)
    assert not browser.errors
