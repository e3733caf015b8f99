"""Control points by area: thermal against reflected light of a rendered rig, and never where there is nothing."""

from __future__ import annotations

from typing import List, Tuple

import numpy as np
import pytest
from sensorgate.stages.harmonize.bands_fit import CapturePoints, fit, passes
from sensorgate.stages.harmonize.bands_lens import Lens, project
from sensorgate.stages.harmonize.bands_points import area_points, feature_points, features, match_scales, to_grey8
from sensorgate.stages.thresholds import DEFAULTS

from tests.simulator import Plan, Survey, catalogue, fly, renderer
from tests.simulator.camera import Camera, tilt
from tests.simulator.run import world_of
from tests.simulator.stories import GROUND

from .samples import texture

TURN = (0.6, -0.4, 0.3)
RIG = catalogue.with_band_size(catalogue.micasense(), 0.5)
GREEN = RIG.bands[1].camera
HEAT = Camera(320, 256, 9.0 / 7.68, (1.5, -0.8))


def lens_of(camera: Camera) -> Lens:
    return Lens(camera.width, camera.height, camera.focal_px, camera.principal_px, "brown", camera.distortion)


@pytest.fixture(scope="module")
def pictures() -> List[Tuple[np.ndarray, np.ndarray]]:
    """Green and thermal of five captures; the thermal camera hangs 5 cm beside and looks half a degree off."""
    shots = [s for s in fly(RIG, Plan(90.0, 1, 5, forward=0.7), GROUND, 0) if s.band == 1]
    world = world_of(Survey("heat", (GROUND,), (RIG,), tuple(shots)), GROUND, 0)
    found = []
    for shot in shots:
        rotation, center = shot.rotation(RIG), np.array(shot.position)
        green = np.asarray(renderer.sample(world, ("ms-green",), GREEN, rotation, center)[0]).squeeze()
        beside = center + rotation.T @ np.array([0.05, 0.0, 0.0])
        heat = np.asarray(renderer.sample(world, ("thermal",), HEAT, tilt(TURN) @ rotation, beside)[0]).squeeze()
        heat = heat + np.random.default_rng(1).normal(0.0, 0.05, heat.shape)
        found.append((to_grey8(green), to_grey8(heat)))
    return found


def test_thermal_lies_on_green_by_its_edges(pictures: List[Tuple[np.ndarray, np.ndarray]]) -> None:
    lenses = (lens_of(GREEN), lens_of(HEAT))
    captures = [
        CapturePoints(str(i), str(i), area_points(g, h, lenses, np.eye(3), DEFAULTS))
        for i, (g, h) in enumerate(pictures)
    ]
    fitted = fit(captures, *lenses, [], DEFAULTS)
    assert fitted is not None and passes(fitted, DEFAULTS)
    at = np.stack(np.meshgrid(np.arange(60, 600, 60), np.arange(40, 450, 50)), -1).astype(float)
    true = lenses[1].to_pixels(project(tilt(TURN), lenses[0].to_rays(at)))
    seen = fitted.lenses.band.to_pixels(project(fitted.matrix, fitted.lenses.primary.to_rays(at)))
    inside = ((true > 0) & (true < (320, 256))).all(axis=-1)
    away = np.hypot(*np.moveaxis(seen - true, -1, 0))[inside]
    assert inside.sum() > 30 and np.median(away) < 0.7 and away.max() < 1.5


def test_thermal_of_another_capture_gives_nothing_to_believe(pictures: List[Tuple[np.ndarray, np.ndarray]]) -> None:
    lenses = (lens_of(GREEN), lens_of(HEAT))
    captures = [
        CapturePoints(str(i), str(i), area_points(g, pictures[(i + 1) % 5][1], lenses, np.eye(3), DEFAULTS))
        for i, (g, _) in enumerate(pictures)
    ]
    fitted = fit(captures, *lenses, [], DEFAULTS)
    assert fitted is None or not passes(fitted, DEFAULTS, residuals=False)


def test_blank_frames_give_no_points() -> None:
    lens = Lens(320, 240, 350.0, (159.5, 119.5))
    blank = np.full((240, 320), 128, np.uint8)
    assert len(area_points(blank, blank, (lens, lens), np.eye(3), DEFAULTS)) == 0
    assert len(features(blank, lens, 1.0, DEFAULTS)[0]) == 0
    nothing = features(blank, lens, 1.0, DEFAULTS)
    assert len(feature_points(nothing, nothing, (lens, lens), np.eye(3), DEFAULTS)) == 0


def test_features_meet_across_resolutions() -> None:
    picture = texture(640, 480, 1)[:, :, 0]
    fine, coarse = Lens(640, 480, 700.0, (319.5, 239.5)), Lens(320, 240, 350.0, (159.5, 119.5))
    small = picture.reshape(240, 2, 320, 2).mean(axis=(1, 3)).astype(np.uint8)
    mine, other = match_scales(fine, coarse, DEFAULTS)
    assert (mine, other) == (0.5, 1.0)
    points = feature_points(
        features(picture, fine, mine, DEFAULTS), features(small, coarse, other, DEFAULTS), (fine, coarse), np.eye(3),
        DEFAULTS,
    )  # fmt: skip
    assert len(points) > 50
    assert np.median(np.abs((points[:, :2] + 0.5) / 2 - 0.5 - points[:, 2:])) < 0.2


def test_grey_copy_survives_odd_input() -> None:
    assert to_grey8(np.full((4, 5), np.nan, np.float32)).max() == 0
    wide = to_grey8(np.linspace(0, 65535, 300).reshape(15, 20).astype(np.uint16))
    assert wide.dtype == np.uint8 and wide.min() == 0 and wide.max() == 255
    colour = to_grey8(np.zeros((6, 7, 3), np.uint8))
    assert colour.shape == (6, 7)
