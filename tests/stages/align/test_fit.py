from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.align.enu import enu
from sensorgate.stages.align.fit import (
    bowing,
    called,
    collinear,
    height_above_ground,
    residual_fit,
    robust_similarity,
    surface_bow,
    umeyama,
)

from tests.stages.align.scenes import ORIGIN, geographic, grid, ground_points


def _turn(a: float, b: float, c: float) -> np.ndarray:
    x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    return x @ y @ z


angle = st.floats(-3.1, 3.1)


@settings(max_examples=40, deadline=None)
@given(angle, angle, angle, st.floats(0.01, 100.0), st.integers(3, 20))
def test_umeyama_returns_the_similarity_that_was_applied(a, b, c, scale, count):
    points = np.random.default_rng(count).normal(0, 10, (count, 3))
    turn, shift = _turn(a, b, c), np.array([5.0, -7.0, 900.0])
    found = umeyama(points, scale * points @ turn.T + shift)
    assert found is not None
    assert found.scale == pytest.approx(scale, rel=1e-6)
    assert np.allclose(found.rotation, turn, atol=1e-6)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_wild_positions_do_not_move_the_fit():
    places = grid(4, 8)
    measured = places + np.random.default_rng(3).normal(0, 0.5, places.shape)
    measured[[4, 17, 25]] += [[400.0, 0, 0], [0, -900.0, 30.0], [60.0, 60.0, 0]]
    fit = robust_similarity(places * 0.1, measured, 1.0)
    assert fit is not None
    keep = np.ones(len(places), dtype=bool)
    keep[[4, 17, 25]] = False
    assert np.linalg.norm(fit.points(places * 0.1)[keep] - places[keep], axis=1).max() < 1.5


def test_the_robust_fit_is_the_same_every_time():
    places = grid()
    measured = places + np.random.default_rng(5).normal(0, 2.0, places.shape)
    first, second = (robust_similarity(places, measured, 3.0) for _ in range(2))
    assert first is not None and second is not None
    assert np.array_equal(first.points(places), second.points(places))


@pytest.mark.parametrize("rows", [np.zeros((0, 3)), np.zeros((2, 3)), np.ones((6, 3))])
def test_no_similarity_from_nothing(rows):
    assert robust_similarity(rows, rows, 1.0) is None


def test_residual_is_corrected_for_the_freedoms_of_the_fit():
    gen = np.random.default_rng(0)
    true_sigma, found = 2.0, []
    for _ in range(300):
        places = grid(2, 5)
        measured = places + gen.normal(0, true_sigma, places.shape)
        fit = umeyama(places, measured)
        assert fit is not None
        shown = residual_fit(fit.points(places) - measured, (true_sigma, true_sigma), len(places), False)
        found.append((shown.horizontal_m**2 + shown.vertical_m**2) / 3.0)
    assert math.sqrt(np.mean(found)) == pytest.approx(true_sigma, rel=0.05)


def test_residual_of_too_few_centres_is_missing_not_small():
    shown = residual_fit(np.full((2, 3), 0.01), (3.0, 5.0), 2, False)
    assert shown.horizontal_m is None and shown.vertical_m is None


def test_one_line_is_called_one_line():
    line = np.stack([np.linspace(0, 100, 12), np.linspace(0, 50, 12), np.full(12, 60.0)], axis=1)
    assert collinear(line + np.random.default_rng(1).normal(0, 0.3, line.shape), 0.03)
    assert not collinear(grid(2, 6), 0.03)


@settings(max_examples=25, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-0.05, 0.05), st.floats(-20, 20))
def test_bowing_is_found_under_tilt_and_offset(bow, slope, offset):
    places = grid(5, 8)
    r2 = (places[:, :2] ** 2).sum(axis=1)
    radius = math.sqrt(np.percentile(((places[:, :2] - np.median(places[:, :2], axis=0)) ** 2).sum(axis=1), 95))
    solved = places.copy()
    solved[:, 2] += bow * r2 / radius**2 + slope * places[:, 0] + offset
    shown = bowing(solved, places, ["f"] * len(places))
    assert shown.bowing_m == pytest.approx(bow, abs=2e-3)
    assert shown.radius_m == pytest.approx(radius, abs=0.01)


def test_bowing_below_the_noise_is_not_called_and_above_it_is():
    places = grid(4, 6)
    noise = np.random.default_rng(2).normal(0, 0.15, len(places))
    r2 = (places[:, :2] ** 2).sum(axis=1) / np.percentile((places[:, :2] ** 2).sum(axis=1), 95)
    for bow, expected in ((0.0, False), (1.5, True)):
        solved = places.copy()
        solved[:, 2] += bow * r2 + noise
        assert called(bowing(solved, places, ["f"] * len(places)), 3.0) is expected


def test_a_barometer_offset_between_flights_is_no_bow():
    first, second = grid(3, 6), grid(3, 6) * [0.4, 0.4, 1.0]
    measured = np.concatenate([first, second])
    solved = measured.copy()
    solved[len(first) :, 2] += 4.0
    groups = ["one"] * len(first) + ["two"] * len(second)
    assert bowing(solved, measured, groups).bowing_m == pytest.approx(0.0, abs=1e-6)
    assert abs(bowing(solved, measured, ["same"] * len(groups)).bowing_m) > 1.0


def test_bowing_of_few_cameras_is_missing():
    places = grid(1, 5)
    assert bowing(places, places, ["f"] * 5).bowing_m is None


def test_terrain_cancels_between_two_surfaces():
    ground = ground_points(relief_m=30.0)
    bowed = ground.copy()
    bowed[:, 2] += -0.8 * (ground[:, :2] ** 2).sum(axis=1) / 100.0**2
    shown = surface_bow(bowed, ground, 20)
    radius = shown.radius_m
    assert shown.bowing_m == pytest.approx(-0.8 * radius**2 / 100.0**2, rel=0.02)
    assert called(shown, 3.0)


def test_height_above_ground_follows_the_slope():
    ground = ground_points(2000)
    ground[:, 2] += 0.3 * ground[:, 0]
    places = grid()
    places[:, 2] += 0.3 * places[:, 0]
    height, relief = height_above_ground(places, ground)
    assert height == pytest.approx(60.0, abs=1.0)
    assert relief > 20.0
    assert height_above_ground(places, ground[:3]) == (None, None)


def test_local_frame_turns_degrees_into_metres():
    local = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, 50.0]])
    back = enu(np.asarray(geographic(local)), np.asarray(ORIGIN))
    assert np.allclose(back, local, atol=1e-6)
