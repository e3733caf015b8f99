"""An elevation model against solved ground of known truth: relief fixes the vertical scale, flat ground says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sensorgate.stages.align.enu import enu
from sensorgate.stages.align.solution import UNPLACED
from sensorgate.stages.align.terrain import Terrain
from sensorgate.stages.align.tried import geometry_of
from sensorgate.stages.align.vertical import BOTH, DISAGREE, FLYING, MODEL, vertical_scale
from sensorgate.stages.align.world import ground_of
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import ORIGIN, frames, grid, moved, request, solution

RTK, PLAIN = (0.02, 0.03), (1.0, 1.5)
HEIGHT_M, STEP_M = 80.0, 3.0


def _hills(gen, half_m, relief_m, wave_m=70.0):
    """Heights on a grid of STEP_M over a square, of the given spread: a sum of waves, rough down to an eighth."""
    axis = np.arange(-half_m, half_m + STEP_M, STEP_M)
    x, y = np.meshgrid(axis, axis)
    total = np.zeros_like(x)
    for octave in range(4):
        for _ in range(6):
            angle, phase = gen.uniform(0, np.pi), gen.uniform(0, 2 * np.pi)
            size = 2 * np.pi * 2**octave / (wave_m * gen.uniform(1.2, 2.5))
            total += 0.5**octave * np.sin(size * (x * np.cos(angle) + y * np.sin(angle)) + phase)
    return relief_m * total / total.std()


def _scene(seed, relief_m, error, *, level=None, drift_m=0.0, sigma=RTK, model_error_m=0.3, strips=6, places=None):
    """A nadir block solved with a focal that is wrong by a share, over hills that the elevation model knows roughly."""
    gen = np.random.default_rng(seed)
    places = grid(strips, 9, HEIGHT_M, 25.0) if places is None else places
    half = float(np.abs(places[:, :2]).max()) + HEIGHT_M
    true = _hills(gen, half, relief_m)
    points = gen.uniform(-half + 35.0, half - 35.0, (5000, 2))
    spot = np.floor((points + half) / STEP_M).astype(int)
    up = true[spot[:, 1], spot[:, 0]] + gen.normal(0.0, 0.1, len(points))
    up += np.where(gen.random(len(points)) < 0.15, gen.uniform(0.0, 12.0, len(points)), 0.0)
    group, noise = [], RTK if sigma == RTK else PLAIN
    slow = drift_m * np.sin(np.outer(np.arange(len(places)) / len(places), gen.uniform(2, 6, 3)) + gen.uniform(0, 6, 3))
    for frame, along in zip(frames(places), slow):
        off = gen.normal(0.0, [noise[0], noise[0], noise[1]]) + along
        group.append(moved([replace(frame, sigma_m=sigma)], off)[0])
    asked = request(group)
    stretch = np.array([1.0, 1.0, 1.0 + error])
    solved = solution(asked, places * stretch, np.column_stack([points, up]) * stretch)
    ground = ground_of(asked.frames, asked.cameras, 1200, DEFAULTS)
    zero = enu(np.asarray([ground.origin]), np.asarray(ORIGIN))[0]
    told = true + _hills(gen, half, model_error_m, 40.0) - zero[2] - (17.0 if level is None else level[0])
    terrain = Terrain(-half - zero[0], -half - zero[1], STEP_M, told, 1.0, DEFAULTS.dem_sigma_floor_m, level)
    return asked, solved, replace(ground, terrain=terrain)


def _scale(seed, relief_m, error, **more):
    asked, solved, ground = _scene(seed, relief_m, error, **more)
    return vertical_scale(asked.frames, solved, ground, np.arange(len(asked.frames)), DEFAULTS)


@pytest.mark.parametrize("error", [0.04, -0.04, 0.0])
def test_relief_fixes_the_scale(error):
    """Four percent are refused beyond three standard errors, and what the model says is right within them."""
    for seed in range(3):
        found = _scale(seed, 12.0, error)
        assert found.by == MODEL and found.sigma < 0.01
        assert found.ratio * (1.0 + error) == pytest.approx(1.0, abs=3.0 * found.sigma)
        assert (abs(found.ratio - 1.0) > 3.0 * found.sigma) is (error != 0.0)


def test_trees_and_roofs_do_not_pull():
    assert all(abs(_scale(seed, 6.0, 0.0).ratio - 1.0) < 0.02 for seed in range(3))


@pytest.mark.parametrize("relief_m", [0.0, 0.5, 2.0])
def test_flat_ground_with_an_unknown_zero_says_nothing(relief_m):
    for seed in range(3):
        found = _scale(seed, relief_m, 0.04)
        assert 3.0 * found.sigma > 0.04
        assert abs(found.ratio * 1.04 - 1.0) <= 3.0 * found.sigma


def test_flat_ground_with_a_measured_zero_fixes_it():
    for seed in range(3):
        found = _scale(seed, 0.5, 0.04, level=(5.0, 0.3))
        assert found.by == MODEL and 0.003 < found.sigma < 0.01
        assert found.ratio == pytest.approx(1.0 / 1.04, abs=3.0 * found.sigma)


def test_a_zero_known_to_metres_fixes_nothing():
    assert _scale(0, 0.5, 0.04, level=(5.0, 5.0)).sigma > 0.05


def test_plain_gps_that_drifts_stays_within_its_error():
    """The tilt of the ground and the scale of the plan are as uncertain as the receiver, and counted."""
    for seed in range(3):
        found = _scale(seed, 12.0, 0.04, sigma=None, drift_m=1.0)
        assert 0.003 < found.sigma < 0.02
        assert found.ratio * 1.04 == pytest.approx(1.0, abs=3.0 * found.sigma)


def test_flying_heights_and_the_model_are_weighed_or_contradict_each_other():
    low, high = grid(5, 8, 60.0, 25.0), grid(4, 8, 90.0, 25.0)
    places = np.concatenate([low, high])
    assert _scale(1, 12.0, 0.04, places=places).by == FLYING
    both = _scale(1, 12.0, 0.04, places=places, sigma=None)
    assert both.by == BOTH and both.ratio == pytest.approx(1.0 / 1.04, abs=3.0 * both.sigma)
    asked, solved, ground = _scene(1, 12.0, 0.0, places=places)
    rows = np.arange(len(asked.frames))
    alone = vertical_scale(asked.frames, solved, replace(ground, terrain=None), rows, DEFAULTS)
    assert alone.by == FLYING and alone.ratio == pytest.approx(1.0, abs=3.0 * alone.sigma)
    wrong = replace(ground.terrain, up_m=1.1 * ground.terrain.up_m)
    found = vertical_scale(asked.frames, solved, replace(ground, terrain=wrong), rows, DEFAULTS)
    assert found.by == DISAGREE and found.sigma > 0.05
    assert not geometry_of(asked, solved, replace(ground, terrain=wrong), rows, DEFAULTS).by_heights(DEFAULTS)


def test_without_ground_under_the_block_there_is_no_scale_and_it_is_known_why():
    asked, solved, ground = _scene(0, 12.0, 0.0)
    rows = np.arange(len(asked.frames))
    void = replace(ground, terrain=replace(ground.terrain, up_m=np.full_like(ground.terrain.up_m, np.nan)))
    assert vertical_scale(asked.frames, solved, void, rows, DEFAULTS) is None
    geometry = geometry_of(asked, solved, void, rows, DEFAULTS)
    assert geometry.height_sigma is None and geometry.height_by == MODEL
    bare = replace(solved, point_model=np.full_like(solved.point_model, UNPLACED))
    assert vertical_scale(asked.frames, bare, ground, rows, DEFAULTS) is None


def test_a_grid_is_read_between_its_nodes_and_not_beyond():
    terrain = Terrain(10.0, 20.0, 2.0, np.arange(12.0).reshape(3, 4), 1.0, 0.3)
    found = terrain.at(np.array([[11.0, 21.0], [10.0, 20.0], [16.0, 24.0], [9.9, 21.0], [11.0, 24.1]]))
    assert found[0] == pytest.approx([2.5, 0.5, 2.0])
    assert found[1, 0] == 0.0 and found[2, 0] == 11.0
    assert np.isnan(found[3:]).all()
