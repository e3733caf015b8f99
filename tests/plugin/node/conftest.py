"""The two surveys on which tasks are tried."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests import simulator
from tests.simulator import catalogue
from tests.simulator.flight import Plan, fly
from tests.simulator.stories import GROUND
from tests.simulator.survey import Survey


def flat(survey, folder: Path) -> Path:
    """The frames of a survey in one folder, as a node holds them."""
    simulator.render(survey, folder / "survey")
    images = folder / "images"
    images.mkdir()
    for path in sorted((folder / "survey/images").rglob("*")):
        if path.is_file():
            shutil.copy2(path, images / path.name)
    return images


@pytest.fixture(scope="session")
def clean_images(tmp_path_factory):
    return flat("tiny", tmp_path_factory.mktemp("clean"))


@pytest.fixture(scope="session")
def mixed_images(tmp_path_factory):
    """Eight colour frames and three thermal ones."""
    camera = catalogue.with_band_size(catalogue.phantom4pro(), 0.5)
    heat = catalogue.thermal(project="thermal")
    shots = fly(camera, Plan(height_m=45.0, strips=2, per_strip=4, side=0.6), GROUND, 0)
    warm = fly(heat, Plan(60.0, 1, 3, start_s=46800.0, first_number=401), GROUND, 0)
    survey = Survey("mix", (GROUND,), (camera, heat), (*shots, *warm))
    return flat(survey, tmp_path_factory.mktemp("mixed"))
