"""A task's row in the dashboard: why it waits, what its user may do, what comes of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Iterator

import pytest

from .panel_browser import CHROMIUM, Browser
from .panel_server import PROJECT, Dashboard

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")

SHOTS = Path(__file__).resolve().parents[3] / "build" / "panel"
CONTRAST = Path(__file__).with_name("panel_contrast.js").read_text(encoding="utf-8")
FAILED, RUNNING = 30, 20


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile"), 1024, 600) as opened:
        yield opened


@pytest.fixture
def dashboard(tmp_path: Path) -> Iterator[Dashboard]:
    served = Dashboard(tmp_path / "server")
    yield served
    served.close()


def state(name: str, message: str, *actions: str, **more: Any) -> Dict[str, Any]:
    told: Dict[str, Any] = {
        "state": name, "message": message, "progress": None, "verdict": None, "report": None, "actions": list(actions),
        "tasks": [], "engine": "gate", "engine_message": "",
    }  # fmt: skip
    return {**told, **more}


def shown(browser: Browser, dashboard: Dashboard, status: int, theme: str = "") -> None:
    browser.errors.clear()
    browser.open(f"{dashboard.address}/?theme={theme}")
    browser.run(f"window.row = showTask({{ id: 'a', project: {PROJECT}, name: 'Field', status: {status} }}); 0")


def click(browser: Browser, action: str) -> None:
    browser.wait(f"document.querySelector('[data-key={action}]:not([disabled])')")
    browser.run(f"document.querySelector('[data-key={action}]').click()")


@pytest.mark.parametrize("theme", ["", "dark"])
def test_a_held_task_says_why_and_is_split(browser: Browser, dashboard: Dashboard, theme: str) -> None:
    why = "Held: two cameras that do not belong in one task. Split it, or ask an administrator to let it go."
    made = [
        {"id": "b", "project": PROJECT, "name": "Field - rgb"},
        {"id": "c", "project": PROJECT, "name": "Field - t"},
    ]
    dashboard.states["a"] = [
        state("checking", "Its cameras are being checked.", progress=0.4),
        state("held", why, "split", "override", "check", report="/plugins/x/tasks/a/report", verdict="inconsistent"),
        state("split", "Split into two tasks.", tasks=made),
    ]
    shown(browser, dashboard, RUNNING, theme)
    browser.wait(f"document.body.innerText.includes({why!r})")
    assert browser.run("document.querySelector('.sg-state a').getAttribute('href')") == "/plugins/x/tasks/a/report"
    browser.screenshot(SHOTS / f"held-{theme or 'light'}.png")
    assert browser.run(CONTRAST + "('.sg-state', 4.5)") == []
    # To let it go is asked back; no is no.
    browser.answer_dialogs(False)
    click(browser, "override")
    assert not any(p.endswith("/override") for _, p, _ in dashboard.requests)
    click(browser, "split")
    browser.wait("document.body.innerText.includes('Field - rgb, Field - t')")
    assert browser.run("dashboard.added") == 1
    assert not browser.errors


def test_a_failed_task_is_judged_and_leads_to_its_parts(browser: Browser, dashboard: Dashboard) -> None:
    judgement = {
        "route": "isolate",
        "reasons": ["The thermal frames did not register with the others."],
        "tasks": [{"name": "thermal", "frames": 14, "options": [{"name": "gps-accuracy", "value": 3}]}],
        "anchor": {"id": "d", "name": "Field - rgb"},
    }
    dashboard.states["a"] = [
        state("none", "", "judge", "check"),
        state("none", "It should be split.", "split", "judge", judgement=judgement),
        state("split", "Done.", tasks=[{"id": "e", "project": PROJECT, "name": "Field - thermal"}]),
    ]
    shown(browser, dashboard, FAILED)
    browser.wait("document.querySelector('[data-key=judge]')")
    assert "Why did it fail?" in browser.text()
    click(browser, "judge")
    browser.wait("document.querySelector('[data-key=split]')")
    said = browser.text()
    for words in (judgement["reasons"][0], "--gps-accuracy 3", "14 frames", "Field - rgb", "Create the suggested task"):
        assert words in said
    browser.screenshot(SHOTS / "judged.png")
    click(browser, "split")
    browser.wait("document.body.innerText.includes('Created from it: Field - thermal')")
    assert [b for p, b in dashboard.bodies if p.endswith("/split")] == [{"align": True}]


def test_who_may_not_see_it_sees_nothing(browser: Browser, dashboard: Dashboard) -> None:
    shown(browser, dashboard, RUNNING)
    browser.wait(
        "performance.getEntriesByName(location.origin + '/api/plugins/sensorgate-1/projects/7/tasks/a/state').length"
    )
    assert browser.run("document.querySelector('.sg-state').childElementCount") == 0


def test_a_closed_row_asks_no_more(browser: Browser, dashboard: Dashboard) -> None:
    dashboard.states["a"] = [state("waiting", "Waiting until its cameras have been checked.", "check")]
    shown(browser, dashboard, RUNNING)
    browser.wait("document.body.innerText.includes('Waiting until')")
    browser.run("row.componentWillUnmount()")
    asked = len(dashboard.requests)
    browser.run("new Promise(done => setTimeout(done, 4500))")
    assert len(dashboard.requests) == asked
