"""Steps that the panel's tests take, and where they keep their pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List

from .panel_browser import Browser
from .panel_server import Dashboard

ROOT = Path(__file__).resolve().parents[3]
SHOTS = ROOT / "build" / "panel"
READY = "document.querySelector('[data-key=create]') && !document.querySelector('[data-key=create]').disabled"
DOCK = "(document.querySelector('.sg-dock') || document.createElement('p')).innerText"
BASE = "North field - 5/1/2024"


def opened(browser: Browser, dashboard: Dashboard, files: List[Path], theme: str = "") -> None:
    """Open the dashboard and choose files."""
    browser.errors.clear()
    browser.open(f"{dashboard.address}/?theme={theme}")
    browser.choose("#files", files)


def checked(browser: Browser, dashboard: Dashboard, files: List[Path], theme: str = "") -> Dict[str, Any]:
    """The same, and wait for the verdict on all of them."""
    opened(browser, dashboard, files, theme)
    browser.wait(READY)
    return dict(dashboard.verdicts[-1])


def folders(files: List[Path], *names: str) -> List[Path]:
    """The files of some of the survey's folders."""
    return [f for f in files if f.parent.name in names]
