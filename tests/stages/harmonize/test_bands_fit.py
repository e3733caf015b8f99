"""The choice of a band's homography: recovered from noisy points, judged on others, never from chance."""

from __future__ import annotations

from typing import List

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.harmonize.bands_fit import (
    CapturePoints,
    errors_px,
    fit,
    fit_user_points,
    held_mask,
    lens_choices,
    passes,
)
from sensorgate.stages.harmonize.bands_lens import Lens, project, rotation
from sensorgate.stages.thresholds import DEFAULTS

PRIMARY = Lens(1280, 960, 1450.0, (638.0, 487.0), "brown", (-0.1, 0.14, 0.0, 0.0, -0.02))
BAND = Lens(1280, 960, 1443.0, (642.0, 470.0), "brown", (-0.105, 0.15, 0.0, 0.0, -0.03))
TRUE = rotation((0.4, -0.3, 0.2))
TRUE = TRUE / TRUE[2, 2]


def capture(
    name: str, seed: int, *, count: int = 300, noise: float = 0.3, wrong: float = 0.1, matrix: np.ndarray = TRUE
) -> CapturePoints:
    gen = np.random.default_rng(seed)
    primary = gen.uniform((20, 20), (1260, 940), (count, 2))
    band = BAND.to_pixels(project(matrix, PRIMARY.to_rays(primary))) + gen.normal(0, noise, (count, 2))
    lost = gen.random(count) < wrong
    band[lost] += gen.uniform(-120, 120, (int(lost.sum()), 2))
    return CapturePoints(name, f"{name}.tif", np.hstack((primary, band)))


def away_px(matrix: object, lenses: object) -> float:
    """Greatest distance of a fitted map from the true one over the frame."""
    at = np.stack(np.meshgrid(np.linspace(0, 1279, 9), np.linspace(0, 959, 9)), -1)
    truth = BAND.to_pixels(project(TRUE, PRIMARY.to_rays(at)))
    seen = lenses.band.to_pixels(project(matrix, lenses.primary.to_rays(at)))  # type: ignore[attr-defined]
    return float(np.hypot(*np.moveaxis(seen - truth, -1, 0)).max())


@pytest.mark.parametrize("wrong", [0.0, 0.3, 0.6])
def test_true_map_is_recovered_among_false_matches(wrong: float) -> None:
    fitted = fit([capture(f"c{i}", i, wrong=wrong) for i in range(4)], PRIMARY, BAND, [], DEFAULTS)
    assert fitted is not None and passes(fitted, DEFAULTS)
    assert fitted.lenses.name == "calibrated"
    assert fitted.held_out is not None and 0.2 < fitted.held_out.median_px < 0.7
    assert away_px(fitted.matrix, fitted.lenses) < 0.6


def test_chance_does_not_pass() -> None:
    gen = np.random.default_rng(5)
    at = gen.uniform(0, 1, (800, 2)) * (1280, 960)
    false = np.hstack((at, at + gen.uniform(-128, 128, (800, 2))))
    fitted = fit([CapturePoints("c", "c.tif", false)], PRIMARY, BAND, [], DEFAULTS)
    assert fitted is None or not passes(fitted, DEFAULTS, residuals=False)


def test_too_few_points_do_not_pass() -> None:
    fitted = fit([capture("c", 1, count=20, wrong=0.0)], PRIMARY, BAND, [], DEFAULTS)
    assert fitted is None or not passes(fitted, DEFAULTS)


def test_points_that_scatter_are_refused_by_their_residual() -> None:
    fitted = fit([capture(f"c{i}", i, noise=1.6, wrong=0.0) for i in range(4)], PRIMARY, BAND, [], DEFAULTS)
    assert fitted is not None
    assert passes(fitted, DEFAULTS, residuals=False) and not passes(fitted, DEFAULTS)


def test_a_strange_capture_is_named_and_left_out() -> None:
    gen = np.random.default_rng(9)
    at = gen.uniform(0, 1, (60, 2)) * (1280, 960)
    strange = CapturePoints("x", "x.tif", np.hstack((at, at + gen.uniform(-128, 128, (60, 2)))))
    fitted = fit([*(capture(f"c{i}", i) for i in range(3)), strange], PRIMARY, BAND, [], DEFAULTS)
    assert fitted is not None and passes(fitted, DEFAULTS)
    assert [c.frame for c in fitted.captures if c.mismatch] == ["x.tif"]
    assert len(fitted.captures) == 4


def test_bands_that_lie_on_each_other_are_recognised() -> None:
    gen = np.random.default_rng(2)
    at = gen.uniform((10, 10), (1270, 950), (600, 2))
    near = np.hstack((at, at + gen.normal(0.0, 0.15, at.shape)))
    # Calibrations that belong to the frames before they were aligned must not bend the truth.
    fitted = fit([CapturePoints("c", "c.tif", near)], PRIMARY, BAND, [], DEFAULTS)
    assert fitted is not None and passes(fitted, DEFAULTS) and fitted.identity
    shifted = near + np.array([0, 0, 0.8, 0])
    fitted = fit([CapturePoints("c", "c.tif", shifted)], PRIMARY, BAND, [], DEFAULTS)
    assert fitted is not None and not fitted.identity


def test_rig_tags_are_taken_where_they_are_as_good() -> None:
    captures = [capture(f"c{i}", i) for i in range(3)]
    fitted = fit(captures, PRIMARY, BAND, [TRUE, TRUE.T], DEFAULTS)
    assert fitted is not None and fitted.model == "rig"
    assert np.abs(np.array(fitted.matrix).reshape(3, 3) - TRUE).max() < 1e-12
    fitted = fit(captures, PRIMARY, BAND, [TRUE.T], DEFAULTS)
    assert fitted is not None and fitted.model != "rig"


def test_captures_that_move_get_their_own() -> None:
    captures: List[CapturePoints] = []
    for i in range(4):
        matrix = rotation((0.4 + 0.05 * (i - 1.5), -0.3, 0.2))
        captures.append(capture(f"c{i}", i, count=500, noise=0.2, matrix=matrix))
    fitted = fit(captures, PRIMARY, BAND, [], DEFAULTS)
    assert fitted is not None and fitted.refine and passes(fitted, DEFAULTS)
    still = fit([capture(f"c{i}", i, count=500) for i in range(4)], PRIMARY, BAND, [], DEFAULTS)
    assert still is not None and not still.refine


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_residual_is_measured_on_points_the_fit_has_not_seen(seed: int) -> None:
    item = capture("c", seed, count=200)
    held = held_mask(item.points, PRIMARY, 0)
    assert 0.15 < held.mean() < 0.55
    spoiled = item.points.copy()
    spoiled[held, 2:] += 40.0
    first = fit([item], PRIMARY, BAND, [], DEFAULTS)
    second = fit([CapturePoints("c", "c.tif", spoiled)], PRIMARY, BAND, [], DEFAULTS)
    assert first is not None and first.held_out is not None
    lenses = lens_choices(PRIMARY, BAND)[0]
    if second is not None and second.lenses == first.lenses and second.model == first.model:
        assert second.matrix == first.matrix
        assert errors_px(first.matrix, lenses, spoiled)[held].min() > 3.0


def test_order_of_captures_does_not_matter_to_the_verdict() -> None:
    captures = [capture(f"c{i}", i) for i in range(3)]
    one = fit(captures, PRIMARY, BAND, [], DEFAULTS)
    again = fit(captures, PRIMARY, BAND, [], DEFAULTS)
    assert one == again


def test_users_points_are_judged_by_leaving_each_out() -> None:
    points = capture("u", 3, count=12, noise=0.4, wrong=0.0).points
    fitted = fit_user_points(points, PRIMARY, BAND, DEFAULTS)
    assert fitted is not None and fitted.held_out is not None
    assert fitted.held_out.points == 12 and fitted.held_out.median_px < 1.5
    points[4, 2:] += 60.0
    worse = fit_user_points(points, PRIMARY, BAND, DEFAULTS)
    assert worse is not None and worse.held_out is not None and worse.held_out.p95_px > 20.0
    assert fit_user_points(points[:5], PRIMARY, BAND, DEFAULTS) is None


def test_users_points_on_one_line_fix_nothing() -> None:
    line = np.linspace(0, 1, 8)[:, None] * np.array([1000.0, 700.0])
    assert fit_user_points(np.hstack((line, line + 3.0)), PRIMARY.plain(), BAND.plain(), DEFAULTS) is None
