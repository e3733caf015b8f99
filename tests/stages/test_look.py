"""The look at pixels: a converted camera is suspected, visible light is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from sensorgate.stages.look import look, sample, shares_of, suspected
from sensorgate.stages.read import scan
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import build
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import REAL, strip, survey_of

# Reflectance of ground in blue, green, red and near infrared light.
LEAF, SOIL, RED_SOIL, ASPHALT, WATER = (
    (0.04, 0.10, 0.05, 0.47),
    (0.08, 0.12, 0.18, 0.28),
    (0.06, 0.12, 0.30, 0.38),
    (0.09, 0.10, 0.11, 0.12),
    (0.06, 0.05, 0.03, 0.01),
)
# What red, green and blue pixels collect of blue, green, red and infrared light: the dyes let infrared through.
VISIBLE = ((0.02, 0.10, 0.90, 0.0), (0.08, 0.90, 0.10, 0.0), (0.90, 0.10, 0.02, 0.0))
BLUE_AND_INFRARED = ((0.02, 0.02, 0.0, 0.95), (0.15, 0.02, 0.0, 0.50), (0.90, 0.02, 0.0, 0.50))
INFRARED = ((0.0, 0.0, 0.10, 0.95), (0.0, 0.0, 0.01, 0.45), (0.0, 0.0, 0.01, 0.45))


def picture(camera, fields, seed=0):
    """A 60 x 80 picture of patches of ground in random shares of light, gamma 2.2, exposed to its brightest tenth."""
    rng = np.random.default_rng(seed)
    ground = np.asarray(fields)[rng.integers(0, len(fields), (6, 8))].repeat(10, 0).repeat(10, 1)
    light = ground * rng.uniform(0.5, 1.0, ground.shape[:2])[..., None]
    linear = light @ np.asarray(camera).T
    linear = np.clip(linear / np.quantile(linear, 0.97), 0, 1)
    return np.clip(np.round(250 * linear ** (1 / 2.2)), 0, 255).astype(np.uint8)


def found(camera, fields, count=6):
    return suspected([shares_of(picture(camera, fields, i), DEFAULTS) for i in range(count)], DEFAULTS)


GROUNDS = {
    "crop": (LEAF, LEAF, LEAF, SOIL),
    "half": (LEAF, SOIL, ASPHALT),
    "bare": (SOIL, SOIL, ASPHALT),
    "red": (RED_SOIL, RED_SOIL, LEAF),
    "shore": (WATER, WATER, SOIL),
}


@pytest.mark.parametrize("ground", sorted(GROUNDS))
def test_visible_light_is_never_suspected(ground):
    assert not found(VISIBLE, GROUNDS[ground])


@pytest.mark.parametrize("camera", [BLUE_AND_INFRARED, INFRARED])
@pytest.mark.parametrize("ground", ["crop", "half"])
def test_converted_cameras_over_plants_are_suspected(camera, ground):
    assert found(camera, GROUNDS[ground])


def test_few_frames_and_dark_frames_are_not_judged():
    assert not found(INFRARED, GROUNDS["crop"], count=2)
    assert shares_of(np.zeros((10, 10, 3), np.uint8), DEFAULTS) is None


def write(folder: Path, camera, count=5):
    for number, frame in enumerate(strip(count=count, folder=str(folder))):
        Image.fromarray(picture(camera, GROUNDS["crop"], number)).save(frame.path, quality=95)
    return survey_of(strip(count=count, folder=str(folder)))


def test_the_finding_names_the_profile_and_excludes_nothing(tmp_path):
    survey = write(tmp_path, BLUE_AND_INFRARED)
    (finding,) = look(survey, DEFAULTS)
    assert finding.code == "infrared-suspected" and finding.severity == "warning"
    assert finding.subjects == (survey.profiles[0].id,)
    assert look(write(tmp_path, VISIBLE), DEFAULTS) == ()


def test_files_that_do_not_decode_are_passed_over(tmp_path):
    survey = write(tmp_path, INFRARED)
    for path in survey.profiles[0].frames:
        Path(path).write_bytes(b"\xff\xd8 nothing")
    assert look(survey, DEFAULTS) == ()
    assert look(replace(survey, frames=()), DEFAULTS) == ()


@given(st.integers(0, 200), st.integers(2, 20))
def test_a_sample_is_bounded_spread_and_in_order(count, most):
    paths = [str(i) for i in range(count)]
    chosen = sample(paths, most)
    assert len(chosen) == min(count, most)
    assert list(chosen) == sorted(set(chosen), key=int)
    assert not chosen or (chosen[0], chosen[-1]) == (paths[0], paths[-1])


@pytest.mark.skipif(not REAL.exists(), reason="the real frames are not here")
def test_real_colour_cameras_are_not_suspected():
    survey = build(scan([str(REAL)]), load_sheet(), DEFAULTS)
    assert any(p.spectrum == "rgb" and len(p.frames) > 10 for p in survey.profiles)
    assert look(survey, DEFAULTS) == ()
