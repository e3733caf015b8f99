"""The New Task panel in a real browser, with real files, against the real gate."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Dict, List

import pytest
from sensorgate.stages.read import frame_from_header, read_frame

from .panel_browser import Browser
from .panel_server import NAME, Dashboard, Refused
from .panel_steps import BASE, DOCK, READY, ROOT, SHOTS, checked, folders, opened

REAL_FRAMES = ROOT.parent / "shared/data/real_frames"


def test_a_mixed_folder_is_judged_and_becomes_the_right_tasks(
    browser: Browser, dashboard: Dashboard, survey: List[Path]
) -> None:
    verdict = checked(browser, dashboard, survey)
    said = browser.text()
    for words in ("DJI FC6310", "MicaSense", "thermal", "If you upload this as one task", "What we suggest"):
        assert words in said
    assert verdict["headline"] in said and all(line in said for line in verdict["odm"] + verdict["ours"])
    browser.screenshot(SHOTS / "verdict.png")
    assert not dashboard.tasks, "nothing is created before the user says so"
    browser.click("create")
    browser.wait(f"{DOCK}.includes('All {len(verdict['tasks'])} tasks are started')")
    browser.screenshot(SHOTS / "uploaded.png")
    # The form is closed as its own Cancel does: none of its files is sent twice.
    assert not browser.run("document.querySelector('.new-task-panel')")
    assert browser.run("dashboard.added") >= 1 and browser.run("item.dropzone.files.length") == 0
    made = {t["name"]: t for t in dashboard.tasks.values()}
    assert len(made) == len(verdict["tasks"]) > 2
    for proposed in verdict["tasks"]:
        task = made[f"{BASE} - {proposed['name']}"]
        assert task["partial"] is False and task["auto_processing_node"] is True
        assert task["tags"] == proposed["tags"] and task["options"] == proposed["options"]
        expected = {name: survey[number].read_bytes() for number, name in proposed["files"]}
        expected.update({name: text.encode() for name, text in proposed["texts"].items()})
        assert task["files"] == expected
    assert any("gcp_list.txt" in t["files"] for t in made.values())
    claimed = {b["task"]: b["key"] for p, b in dashboard.bodies if p.endswith("/claim")}
    assert set(claimed) == set(dashboard.tasks)
    assert not browser.errors


def test_what_is_sent_reads_as_the_file_does(browser: Browser, dashboard: Dashboard, survey: List[Path]) -> None:
    real = (
        sorted(p for p in REAL_FRAMES.rglob("*") if p.suffix.lower() in (".jpg", ".tif"))
        if REAL_FRAMES.exists()
        else []
    )
    files = [*survey[:-1:5], *real]
    browser.open(f"{dashboard.address}/")
    browser.run(f"fetch('/plugins/{NAME}/headers.js').then(r => r.text()).then(t => {{ eval(t); }})")
    browser.run("document.getElementById('files').addEventListener('change', e => e.stopImmediatePropagation(), true)")
    browser.choose("#files", files)
    sent = browser.run(
        "Promise.all(Array.from(document.getElementById('files').files).map(f => sensorgate.headers.read(f)"
        ".then(all => all.map(r => [r[0], r[1].length]))))"
    )
    assert len(sent) == len(files)
    share = []
    for file, ranges in zip(files, sent):
        data = file.read_bytes()
        frame = frame_from_header(str(file), {o: data[o : o + n] for o, n in ranges}, len(data))
        whole = read_frame(file)
        # Whether a cut picture is whole is seen only by who has all of it.
        if not any(p.startswith("jpeg-end-missing") for p in frame.problems):
            assert frame == whole, file
        share.append(sum(n for _, n in ranges))
    assert max(share) < 100_000


def test_choices_change_the_tasks_and_can_be_taken_back(
    browser: Browser, dashboard: Dashboard, survey: List[Path]
) -> None:
    first = checked(browser, dashboard, survey)

    def after(script: str) -> Dict[str, Any]:
        before = len(dashboard.verdicts)
        browser.run(script)
        until = time.monotonic() + 20
        while len(dashboard.verdicts) == before and time.monotonic() < until:
            time.sleep(0.02)
        browser.wait(READY)
        return dict(dashboard.verdicts[-1])

    rule = "document.querySelector('[data-key=rule-split]')"
    # By keyboard: the box has the focus, keeps it over the redraw, and is ticked again.
    browser.run(f"{rule}.focus()")
    browser.press(" ")
    browser.wait(f"document.querySelectorAll('.sg-task').length === 1 && {READY}")
    assert len(dashboard.verdicts[-1]["tasks"]) == 1
    assert browser.run("document.activeElement.getAttribute('data-key')") == "rule-split"
    assert len(after(f"{rule}.click()")["tasks"]) == len(first["tasks"])
    # A payload goes elsewhere, another stays at home.
    moved = next(p for p in first["payloads"] if p["spectrum"] == "thermal")
    target = next(t for t in first["tasks"] if t["key"] != moved["task"])

    def move(payload: str, key: str) -> str:
        return (
            f"(s => {{ s.value = '{key}'; s.dispatchEvent(new Event('change')); }})"
            f"(document.querySelector('[data-key=\"move-{payload}\"]'))"
        )

    verdict = after(move(moved["id"], target["key"]))
    assert next(p for p in verdict["payloads"] if p["id"] == moved["id"])["task"] == target["key"]
    verdict = after(move(moved["id"], ""))
    assert not any(moved["id"] in t["payloads"] for t in verdict["tasks"])
    assert "Left out" in browser.text()
    verdict = after("document.querySelector('[data-key=reset]').click()")
    assert verdict["tasks"] == first["tasks"]
    # Or nothing of it: the form goes on as it always did.
    browser.click("before")
    assert browser.run("document.activeElement.innerText") == "Review"
    assert not dashboard.tasks and not browser.errors


def test_files_that_cannot_be_read_are_named(
    browser: Browser, dashboard: Dashboard, survey: List[Path], tmp_path: Path
) -> None:
    good = folders(survey, "p4p")
    (tmp_path / "EMPTY.JPG").write_bytes(b"")
    (tmp_path / "NOTES.JPG").write_bytes(b"this is a shopping list\n" * 40)
    (tmp_path / "CUT.JPG").write_bytes(good[0].read_bytes()[:300])
    whole = good[0].read_bytes()
    (tmp_path / "HALF.JPG").write_bytes(whole[: len(whole) * 2 // 3])
    (tmp_path / "FLIGHT.MP4").write_bytes(b"\0\0\0\x18ftypmp42")
    (tmp_path / "<img src=x onerror=document.title='owned'>.JPG").write_bytes(b"nothing")
    verdict = checked(browser, dashboard, [*good, *sorted(tmp_path.glob("*.*"))])
    assert len(verdict["left_out"]) == 4 and len(verdict["tasks"][0]["files"]) == len(good)
    browser.click("fold-left")
    said = browser.text()
    assert (
        "5 files are left out" in said
        and "breaks off" in said
        and "EMPTY.JPG" in said
        and "FLIGHT.MP4: not sent." in said
    )
    assert browser.run("document.title") == "Dashboard"
    assert not browser.errors


def test_nothing_readable_is_said_plainly(browser: Browser, dashboard: Dashboard, tmp_path: Path) -> None:
    (tmp_path / "NOTES.JPG").write_bytes(b"this is a shopping list\n" * 40)
    opened(browser, dashboard, [tmp_path / "NOTES.JPG"])
    browser.wait("document.body.innerText.includes('None of these files can be read')")
    assert "1 file is left out" in browser.text()
    assert not browser.run("document.querySelector('[data-key=create]') !== null")


def test_without_its_server_the_form_still_works(browser: Browser, dashboard: Dashboard, survey: List[Path]) -> None:
    down = {"now": True}

    def disturb(method: str, path: str) -> None:
        if down["now"] and path.endswith("/sessions"):
            raise Refused(404, "There is no such project.")

    dashboard.disturb = disturb
    files = folders(survey, "p4p")
    opened(browser, dashboard, files[:9])
    browser.wait("document.body.innerText.includes('There is no such project.')")
    assert "You can upload as always" in browser.text()
    down["now"] = False
    browser.click("Check again")
    browser.wait(READY)
    # More files are added to those that are there.
    browser.choose("#files", files[9:])
    browser.wait(f"document.body.innerText.includes('{len(files)} images checked') && {READY}")
    assert len(dashboard.verdicts[-1]["tasks"][0]["files"]) == len(files)


@pytest.mark.parametrize("theme", ["", "dark"])
def test_it_can_be_read_in_either_theme_on_a_small_screen(
    browser: Browser, dashboard: Dashboard, survey: List[Path], theme: str
) -> None:
    browser.resize(1024, 768)
    try:
        dashboard.hold = "hold"
        checked(browser, dashboard, survey, theme)
        browser.run("document.querySelectorAll('.sg-fold').forEach(f => { f.open = true; })")
        browser.screenshot(SHOTS / f"1024-{theme or 'light'}.png")
        assert browser.run("document.documentElement.scrollWidth") <= 1024
        assert browser.unreadable(".sg-panel") == []
        names = browser.run(
            "Array.from(document.querySelectorAll('.sg-panel select, .sg-panel input')).map("
            "e => e.getAttribute('aria-label') || e.closest('label').innerText)"
        )
        assert names and all(names)
    finally:
        browser.resize(1280, 1000)


def test_files_that_are_no_pictures_go_where_they_belong(
    browser: Browser, dashboard: Dashboard, survey: List[Path], tmp_path: Path
) -> None:
    """Before the click it is said what happens to each of them, and that is what happens."""
    names = ("align.laz", "image_groups.txt", "FLIGHT.MP4", "FLIGHT.SRT", "cloud.las", "log.bin")
    for name in names:
        (tmp_path / name).write_bytes(name.encode())
    chosen = [*folders(survey, "p4p", "thermal"), *(tmp_path / n for n in names)]
    verdict = checked(browser, dashboard, chosen)
    said = browser.text()
    for words in (
        "align.laz: sent along with each task.", "image_groups.txt: not sent.", "FLIGHT.MP4, FLIGHT.SRT: not sent.",
        "cloud.las: not sent.", "log.bin: not sent.",
    ):  # fmt: skip
        assert words in said
    assert len(verdict["tasks"]) > 1
    browser.click("create")
    browser.wait(f"{DOCK}.includes('All {len(verdict['tasks'])} tasks are started')")
    for task in dashboard.tasks.values():
        assert set(task["files"]) & set(names) == {"align.laz"} and task["files"]["align.laz"] == b"align.laz"
    # One task whose files keep their names can use the groups.
    for file in folders(survey, "p4p"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    alone = [*(tmp_path / f.name for f in folders(survey, "p4p")), tmp_path / "image_groups.txt"]
    dashboard.tasks.clear()
    (proposed,) = checked(browser, dashboard, alone)["tasks"]
    assert all(alone[number].name == name for number, name in proposed["files"])
    assert "image_groups.txt: sent along." in browser.text()
    browser.click("create")
    browser.wait(f"{DOCK}.includes('The task is started')")
    (task,) = dashboard.tasks.values()
    assert task["files"]["image_groups.txt"] == b"image_groups.txt"


def test_what_hold_mode_will_do_is_said_before_the_click(
    browser: Browser, dashboard: Dashboard, survey: List[Path]
) -> None:
    dashboard.hold = "hold"
    checked(browser, dashboard, folders(survey, "p4p", "thermal"))
    assert "sent as one, these files would be taken apart there" in browser.text()
    browser.click("rule-split")
    browser.wait(f"document.querySelectorAll('.sg-task').length === 1 && {READY}")
    assert "frames that do not belong together are taken apart again there" in browser.text()
    dashboard.claim_message = "This task will be taken apart again after the upload."
    browser.click("create")
    browser.wait(f"{DOCK}.includes('The task is started')")
    assert dashboard.claim_message in browser.run(DOCK)
    (claim,) = [b for p, b in dashboard.bodies if p.endswith("/claim")]
    assert claim["off"] == ["split"] and claim["moves"] == {}
