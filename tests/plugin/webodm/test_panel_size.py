"""Large folders in the panel: bytes sent, the first verdict, a page that answers all the while."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import List

from .panel_browser import Browser
from .panel_server import Dashboard
from .panel_steps import READY, SHOTS, folders


def test_the_verdict_comes_while_a_thousand_large_files_are_still_read(
    browser: Browser, dashboard: Dashboard, survey: List[Path], tmp_path: Path
) -> None:
    """1,000 frames of 10 MB: at most 1 % of their bytes is sent, the page answers all the while."""
    files = sorted(copies(folders(survey, "p4p", "rededge"), tmp_path, 1000, 10_000_000))
    browser.open(f"{dashboard.address}/")
    began = time.monotonic()
    browser.choose("#files", files)
    browser.wait("document.querySelector('.sg-headline')", 60)
    first = time.monotonic() - began
    browser.screenshot(SHOTS / "reading.png")
    longest = browser.busiest(READY, 120)
    whole = time.monotonic() - began
    total = sum(f.stat().st_size for f in files)
    sent = dashboard.sent_bytes("/api/plugins/")
    print(
        f"sent {100 * sent / total:.3f} %, first verdict after {first:.1f} s, all after {whole:.1f} s, "
        f"longest pause {longest:.2f} s"
    )
    assert sent <= 0.01 * total
    assert dashboard.verdicts[0]["files"] < len(files) == dashboard.verdicts[-1]["files"]
    # The first verdict knows of every camera, though the files are chosen folder by folder.
    assert {c["id"] for c in dashboard.verdicts[0]["cameras"]} == {c["id"] for c in dashboard.verdicts[-1]["cameras"]}
    assert first < whole and not dashboard.tasks
    assert dashboard.sent_bytes("/api/projects/") == 0
    assert longest < 0.5


def test_two_thousand_files_at_once(browser: Browser, dashboard: Dashboard, survey: List[Path], tmp_path: Path) -> None:
    files = copies(folders(survey, "p4p", "thermal"), tmp_path, 2000, 100_000)
    browser.open(f"{dashboard.address}/")
    browser.choose("#files", files)
    assert browser.busiest(READY, 240) < 0.5, "the page answers all the while"
    assert sum(len(t["files"]) for t in dashboard.verdicts[-1]["tasks"]) + len(
        dashboard.verdicts[-1]["left_out"]
    ) == len(files)


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
