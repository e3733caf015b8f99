"""The New Task panel in a real browser, with real files, against the real gate."""

from __future__ import annotations

import re
import threading
import time
from pathlib import Path
from typing import Any, Dict, Iterator, List

import pytest
from sensorgate.stages.read import frame_from_header, read_frame

from tests.simulator.run import render

from .panel_browser import CHROMIUM, Browser
from .panel_server import NAME, Dashboard, Refused

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")

ROOT = Path(__file__).resolve().parents[3]
SHOTS = ROOT / "build" / "panel"
REAL_FRAMES = ROOT.parent / "shared/data/real_frames"
CONTRAST = Path(__file__).with_name("panel_contrast.js").read_text(encoding="utf-8")
READY = "document.querySelector('[data-key=create]') && !document.querySelector('[data-key=create]').disabled"
CREATE = "document.querySelector('[data-key=create]').click()"
DOCK = "(document.querySelector('.sg-dock') || document.createElement('p')).innerText"
BASE = "North field - 5/1/2024"


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> List[Path]:
    """A mixed folder: two drones and a compact with JPEGs, a rig with TIFFs, thermal; and ground control."""
    folder = tmp_path_factory.mktemp("survey")
    render("demo", folder, frames_scale=0.25)
    return [*sorted(p for p in (folder / "images").rglob("*") if p.is_file()), folder / "gcp_list.txt"]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def dashboard(tmp_path: Path) -> Iterator[Dashboard]:
    served = Dashboard(tmp_path / "server")
    yield served
    served.close()


def opened(browser: Browser, dashboard: Dashboard, files: List[Path], theme: str = "") -> None:
    browser.errors.clear()
    browser.open(f"{dashboard.address}/?theme={theme}")
    browser.choose("#files", files)


def checked(browser: Browser, dashboard: Dashboard, files: List[Path], theme: str = "") -> Dict[str, Any]:
    """Open the dashboard, choose the files, and wait for the verdict on all of them."""
    opened(browser, dashboard, files, theme)
    browser.wait(READY)
    return dict(dashboard.verdicts[-1])


def folders(files: List[Path], *names: str) -> List[Path]:
    return [f for f in files if f.parent.name in names]


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
    browser.run(CREATE)
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
    browser.run("document.querySelector('[data-key=before]').click()")
    assert browser.run("document.activeElement.innerText") == "Review"
    assert not dashboard.tasks and not browser.errors


def test_what_was_filled_in_above_goes_along(browser: Browser, dashboard: Dashboard, survey: List[Path]) -> None:
    checked(browser, dashboard, folders(survey, "p4p"))
    browser.run(
        "dashboard.info = { selectedNode: { key: '3', id: 3 }, tags: ['mine'], alignTo: 'auto', resizeMode: 0,"
        " options: [{ name: 'dsm', value: true }, { name: 'fast-orthophoto', value: false }] }; 0"
    )
    browser.run("document.querySelector('.edit-task-form input').value = 'West'; 0")
    browser.run(CREATE)
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
    browser.run(CREATE)
    browser.wait(f"{DOCK}.includes('The upload stopped')", 60)
    assert "You need to upload at least 1 file" in browser.run(DOCK)
    (task,) = dashboard.tasks.values()
    assert task["partial"] is True
    uploads = task["uploads"]
    browser.run("document.querySelector('[data-key=\"Try again\"]').click()")
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
    browser.run(CREATE)
    browser.wait(f"{DOCK}.includes('{'Creating the task' if slow == '/tasks/' else 'of 18 files'}')")
    browser.answer_dialogs(True)
    browser.run("document.querySelector('[data-key=\"Cancel upload\"]').click()")
    browser.wait(f"{DOCK}.includes('Upload cancelled')")
    until = time.monotonic() + 10
    while not any("removed" in t for t in dashboard.tasks.values()) and time.monotonic() < until:
        time.sleep(0.02)
    (task,) = dashboard.tasks.values()
    assert task.get("removed") and task["partial"] is True
    browser.wait("document.querySelector('[data-key=Close]')")
    browser.run("document.querySelector('[data-key=Close]').click()")
    assert browser.run(DOCK).strip() == ""


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
    browser.run("document.querySelector('[data-key=fold-left]').click()")
    said = browser.text()
    assert "5 files are left out" in said and "breaks off" in said and "EMPTY.JPG" in said and "1 other file" in said
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
    browser.run("document.querySelector('[data-key=\"Check again\"]').click()")
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
        assert browser.run(CONTRAST + "('.sg-panel', 4.5)") == []
        names = browser.run(
            "Array.from(document.querySelectorAll('.sg-panel select, .sg-panel input')).map("
            "e => e.getAttribute('aria-label') || e.closest('label').innerText)"
        )
        assert names and all(names)
    finally:
        browser.resize(1280, 1000)


def test_the_verdict_comes_while_a_thousand_large_files_are_still_read(
    browser: Browser, dashboard: Dashboard, survey: List[Path], tmp_path: Path
) -> None:
    """1,000 frames of 10 MB: at most 1 % of their bytes is sent, the page answers all the while."""
    files = sorted(copies(folders(survey, "p4p", "rededge"), tmp_path, 1000, 10_000_000))
    browser.open(f"{dashboard.address}/")
    watch = (
        "window.gaps = []; window.last = performance.now(); setInterval(() => {"
        " const now = performance.now(); gaps.push(now - last); last = now; }, 20)"
    )
    browser.run(watch + "; 0")
    began = time.monotonic()
    browser.choose("#files", files)
    browser.wait("document.querySelector('.sg-headline')", 60)
    first = time.monotonic() - began
    browser.screenshot(SHOTS / "reading.png")
    browser.wait(READY, 120)
    whole = time.monotonic() - began
    total = sum(f.stat().st_size for f in files)
    sent = dashboard.sent_bytes("/api/plugins/")
    longest = max(browser.run("gaps"))
    print(
        f"sent {100 * sent / total:.3f} %, first verdict after {first:.1f} s, all after {whole:.1f} s, "
        f"longest pause {longest:.0f} ms"
    )
    assert sent <= 0.01 * total
    assert dashboard.verdicts[0]["files"] < len(files) == dashboard.verdicts[-1]["files"]
    # The first verdict knows of every camera, though the files are chosen folder by folder.
    assert {c["id"] for c in dashboard.verdicts[0]["cameras"]} == {c["id"] for c in dashboard.verdicts[-1]["cameras"]}
    assert first < whole and not dashboard.tasks
    assert dashboard.sent_bytes("/api/projects/") == 0
    assert longest < 1000


def test_two_thousand_files_at_once(browser: Browser, dashboard: Dashboard, survey: List[Path], tmp_path: Path) -> None:
    files = copies(folders(survey, "p4p", "thermal"), tmp_path, 2000, 100_000)
    browser.open(f"{dashboard.address}/")
    browser.run("window.gaps = []; window.last = 0; 0")
    browser.choose("#files", files)
    browser.run(
        "last = performance.now(); setInterval(() => { const now = performance.now(); gaps.push(now - last);"
        " last = now; }, 20); 0"
    )
    browser.wait(READY, 180)
    assert sum(len(t["files"]) for t in dashboard.verdicts[-1]["tasks"]) + len(
        dashboard.verdicts[-1]["left_out"]
    ) == len(files)
    assert max(browser.run("gaps")) < 1000


def copies(models: List[Path], folder: Path, count: int, size: int) -> List[Path]:
    """Frames of a survey with the heads of ``models``, each with a second of its own, blown up to ``size`` bytes."""
    made = []
    for number in range(count):
        model = models[number % len(models)]
        stamp = f"2024:05:01 {10 + number // 3600:02d}:{number // 60 % 60:02d}:{number % 60:02d}".encode()
        data = re.sub(rb"20\d\d:\d\d:\d\d \d\d:\d\d:\d\d", stamp, model.read_bytes())
        file = folder / f"{model.parent.name}_{number:04d}{model.suffix}"
        with file.open("wb") as stream:
            stream.write(data)
            if len(data) < size:
                # A hole: it takes no room on the disk. A JPEG ends with its marker.
                stream.seek(size - 2)
                stream.write(data[-2:])
        made.append(file)
    return made
