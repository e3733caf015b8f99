"""Under a project's name: which of its tasks wait, and why, without opening them."""

from __future__ import annotations

from typing import Any, Dict

import pytest

from .panel_browser import Browser
from .panel_server import PROJECT, Dashboard
from .panel_steps import SHOTS

NOTICE = "document.querySelector('.sg-notice').innerText"


def waits(task: str, state: str, message: str, **more: Any) -> Dict[str, Any]:
    return {"id": task, "name": f"Field {task}", "state": state, "message": message, "progress": None, **more}


@pytest.mark.parametrize("theme", ["", "dark"])
def test_a_task_that_waits_says_so_under_its_project(browser: Browser, dashboard: Dashboard, theme: str) -> None:
    browser.errors.clear()
    why = "Held: none of these files can be used for a survey."
    under_way = waits("a", "checking", "Its cameras are looked at.", progress=0.4)
    dashboard.waiting = [[under_way, waits("c", "broken-off", "12 files are here."), waits("b", "held", why)]]
    browser.open(f"{dashboard.address}/?theme={theme}")
    browser.wait(f"{NOTICE}.includes('Field a')")
    said = browser.run(NOTICE)
    assert "1 task is held and needs your decision; 1 upload was broken off; 1 task waits for the camera check" in said
    places = [said.index(f"Field {task}") for task in "bca"]
    assert places == sorted(places), "what needs a decision comes first"
    assert why in said and "Its cameras are looked at." in said
    assert browser.run("document.querySelector('.sg-notice a').getAttribute('href')") == (
        f"/dashboard/?project_task_open={PROJECT}&project_task_expanded=b"
    )
    assert browser.run("document.querySelector('.sg-notice [role=progressbar]').getAttribute('aria-valuenow')") == "40"
    browser.screenshot(SHOTS / f"notice-{theme or 'light'}.png")
    assert browser.unreadable(".sg-notice") == []
    assert not browser.errors


def test_the_list_is_read_anew_when_a_task_goes_on(browser: Browser, dashboard: Dashboard) -> None:
    dashboard.waiting = [[waits("a", "working", "Harmonizing.")], []]
    browser.open(f"{dashboard.address}/")
    browser.wait(f"{NOTICE}.includes('1 task is being prepared on this server')")
    assert browser.run("dashboard.added") == 0
    browser.wait(f"{NOTICE} === ''", 15)
    assert browser.run("dashboard.added") == 1
    asked = len(dashboard.requests)
    browser.run("new Promise(done => setTimeout(done, 5500))")
    assert len(dashboard.requests) == asked, "nothing waits, so nothing is asked"


def test_a_form_that_is_filled_in_stays_open(browser: Browser, dashboard: Dashboard) -> None:
    dashboard.waiting = [[waits("a", "waiting", "Waiting.")], []]
    browser.open(f"{dashboard.address}/")
    browser.run("openForm(); 0")
    browser.wait(f"{NOTICE}.includes('1 task waits')")
    browser.wait(f"{NOTICE} === ''", 15)
    assert browser.run("dashboard.added") == 0 and browser.run("Boolean(document.querySelector('.new-task-panel'))")
