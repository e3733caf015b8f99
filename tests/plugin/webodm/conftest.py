"""What the panel's tests share. ``inside`` runs in a little WebODM of its own, started by ``test_server``; pytest
outside of it stays out."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Iterator, List

import pytest

collect_ignore = ["inside"]


@pytest.fixture(scope="session")
def survey(tmp_path_factory: pytest.TempPathFactory) -> List[Path]:
    """A mixed folder: two drones and a compact with JPEGs, a rig with TIFFs, thermal; and ground control."""
    from tests.simulator.run import render

    folder = tmp_path_factory.mktemp("survey")
    render("demo", folder, frames_scale=0.25)
    return [*sorted(p for p in (folder / "images").rglob("*") if p.is_file()), folder / "gcp_list.txt"]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A real browser for the tests of a module."""
    from .panel_browser import CHROMIUM, Browser

    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def dashboard(tmp_path: Path) -> Iterator[Any]:
    """A dashboard of its own for each test."""
    from .panel_server import Dashboard

    served = Dashboard(tmp_path / "server")
    yield served
    served.close()
