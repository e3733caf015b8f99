"""A task's row in the dashboard: why it waits, what its user may do, what comes of it."""

from __future__ import annotations

from typing import Any, Dict

import pytest

from .panel_browser import Browser
from .panel_server import NAME, PROJECT, Dashboard
from .panel_steps import SHOTS

FAILED, RUNNING = 30, 20
STATE = f"/api/plugins/{NAME}/projects/{PROJECT}/tasks/a/state"


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
    assert browser.unreadable(".sg-state") == []
    # To let it go is asked back; no is no.
    browser.answer_dialogs(False)
    browser.click("override")
    assert not any(p.endswith("/override") for _, p, _ in dashboard.requests)
    browser.click("split")
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
    browser.click("judge")
    browser.wait("document.querySelector('[data-key=split]')")
    said = browser.text()
    for words in (judgement["reasons"][0], "--gps-accuracy 3", "14 frames", "Field - rgb", "Create the suggested task"):
        assert words in said
    browser.screenshot(SHOTS / "judged.png")
    browser.click("split")
    browser.wait("document.body.innerText.includes('Created from it: Field - thermal')")
    assert [b for p, b in dashboard.bodies if p.endswith("/split")] == [{"align": True}]


def test_who_may_not_see_it_sees_nothing(browser: Browser, dashboard: Dashboard) -> None:
    shown(browser, dashboard, RUNNING)
    browser.wait(f"performance.getEntriesByName(location.origin + '{STATE}').length")
    assert browser.run("document.querySelector('.sg-state').childElementCount") == 0


def test_a_closed_row_asks_no_more(browser: Browser, dashboard: Dashboard) -> None:
    dashboard.states["a"] = [state("waiting", "Waiting until its cameras have been checked.", "check")]
    shown(browser, dashboard, RUNNING)
    browser.wait("document.body.innerText.includes('Waiting until')")
    browser.run("row.componentWillUnmount()")
    asked = [p for _, p, _ in dashboard.requests].count(STATE)
    browser.run("new Promise(done => setTimeout(done, 4500))")
    assert [p for _, p, _ in dashboard.requests].count(STATE) == asked


def test_a_task_whose_upload_was_broken_off_says_so(browser: Browser, dashboard: Dashboard) -> None:
    browser.open(f"{dashboard.address}/")
    browser.run(f"showTask({{ id: 'a', project: {PROJECT}, name: 'Field', status: null, partial: true }}); 0")
    browser.wait("document.body.innerText.includes('Not all of its files are here yet.')")
