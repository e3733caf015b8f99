"""Rays and pixels of band lenses: inverse of each other, true under resampling, cheap grids exact enough."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from sensorgate.stages.frame import FileCalibration, Frame
from sensorgate.stages.harmonize.bands_lens import (
    Lens,
    lens_of,
    project,
    rig_matrix,
    rotation,
    sample_places,
    scaled,
)
from sensorgate.stages.intrinsics import Intrinsics

BROWN = Lens(1280, 960, 1450.0, (646.2, 471.4), "brown", (-0.1, 0.14, 3e-4, -2e-4, -0.02))
# Parrot's own figures for a green band: polynomial and affine matrix as its XMP gives them.
PARROT = Lens(1280, 960, 1067.5, (662.9, 467.5), "fisheye", (0.0, 1.0, 0.0059, -0.137), (1676.8, 0.0, 0.0, 1676.8))


def grid(lens: Lens) -> np.ndarray:
    return np.stack(np.meshgrid(np.linspace(0, lens.width - 1, 9), np.linspace(0, lens.height - 1, 7)), axis=-1)


@pytest.mark.parametrize("lens", [BROWN, PARROT, BROWN.plain(), replace(BROWN, aspect_ratio=0.998)])
def test_pixels_go_to_rays_and_back(lens: Lens) -> None:
    assert np.abs(lens.to_pixels(lens.to_rays(grid(lens))) - grid(lens)).max() < 1e-4


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-0.2, 0.2),
    st.floats(-0.15, 0.15),
    st.floats(-1e-3, 1e-3),
    st.floats(-1e-3, 1e-3),
    st.floats(-0.03, 0.03),
    st.floats(0.9, 2.0),
)
def test_any_usual_lens_inverts(k1: float, k2: float, p1: float, p2: float, k3: float, ratio: float) -> None:
    lens = Lens(1280, 960, 1280 * ratio, (640.0, 470.0), "brown", (k1, k2, p1, p2, k3))
    # A lens reaches its corners: the polynomial still grows where they are, with room for the tangential part.
    rays = np.linspace(0.0, 2.0, 400)
    seen = rays * (1.0 + rays**2 * (k1 + rays**2 * (k2 + rays**2 * k3)))
    grows = np.concatenate(([True], np.diff(seen) > 0.1 * np.diff(rays)))
    assume(
        seen[: len(rays) if grows.all() else int(np.argmin(grows))].max() > 1.1 * np.hypot(640.0, 490.0) / lens.focal_px
    )
    assert np.abs(lens.to_pixels(lens.to_rays(grid(lens))) - grid(lens)).max() < 0.01


@pytest.mark.parametrize("aspect", [1.0, 0.998])
def test_brown_is_opencvs(aspect: float) -> None:
    lens = replace(BROWN, focal_px=BROWN.focal_px * (1.0 + aspect) / 2.0, aspect_ratio=aspect)
    across, down = BROWN.focal_px, BROWN.focal_px * aspect
    matrix = np.array([[across, 0, BROWN.center_px[0]], [0, down, BROWN.center_px[1]], [0, 0, 1]])
    rays = BROWN.plain().to_rays(grid(BROWN)).reshape(-1, 2)
    points = np.hstack((rays, np.ones((len(rays), 1))))
    seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(BROWN.distortion))
    assert np.abs(seen[:, 0] - lens.to_pixels(rays)).max() < 1e-6


def test_fisheye_angle_follows_its_polynomial() -> None:
    angle = math.radians(25.0)
    share = angle / (math.pi / 2)
    rho = share + 0.0059 * share**2 - 0.137 * share**3
    seen = PARROT.to_pixels(np.array([math.tan(angle), 0.0]))
    assert seen[0] == pytest.approx(662.9 + 1676.8 * rho, abs=1e-6)
    assert seen[1] == pytest.approx(467.5)


@pytest.mark.parametrize("lens", [BROWN, PARROT])
def test_a_resampled_frame_sees_the_same_rays(lens: Lens) -> None:
    half = scaled(lens, (640, 480))
    at = grid(lens)
    assert np.abs(half.to_rays((at + 0.5) / 2 - 0.5) - lens.to_rays(at)).max() < 1e-9


@pytest.mark.parametrize("pair", [(BROWN, PARROT), (PARROT, BROWN), (BROWN, scaled(BROWN, (160, 120)))])
def test_grid_of_places_is_the_exact_one(pair: tuple) -> None:
    primary, band = pair
    matrix = rotation((0.3, -0.5, 0.2))
    places = sample_places(primary, band, matrix)
    assert places.shape == (primary.height, primary.width, 2)
    at = np.stack(np.meshgrid(np.arange(1, primary.width, 37), np.arange(2, primary.height, 29)), -1).reshape(-1, 2)
    exact = band.to_pixels(project(matrix, primary.to_rays(at.astype(float))))
    seen = ((exact >= 0) & (exact <= np.array([band.width - 1, band.height - 1]))).all(axis=1)
    assert seen.sum() > 100
    assert np.abs(places[at[:, 1], at[:, 0]] - exact)[seen].max() < 0.02


def test_lens_takes_the_files_fisheye_and_half_pixel() -> None:
    calibration = FileCalibration(
        "xmp-camera", "fisheye", focal_px=1067.5, center_px=(663.4, 468.0), distortion=(0.0, 1.0, 0.006, -0.137),
        fisheye_affine=(1676.8, 0.0, 0.0, 1676.8),
    )  # fmt: skip
    frame = Frame("a.tif", 1, "TIFF", 1280, 960, calibration=calibration)
    lens = lens_of(frame, Intrinsics(focal_ratio=1067.5 / 1280))
    assert lens.projection == "fisheye"
    assert lens.center_px == pytest.approx((662.9, 467.5))


def test_lens_without_any_calibration_is_a_plain_pinhole() -> None:
    lens = lens_of(Frame("a.tif", 1, "TIFF", 640, 512), Intrinsics())
    assert lens == Lens(640, 512, 640.0, (319.5, 255.5))


def test_rig_relatives_need_both_bands_and_an_angle() -> None:
    assert rig_matrix(None, (0.1, 0.2, 0.3)) is None
    assert rig_matrix((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) is None
    same = rig_matrix((0.1, 0.2, 0.3), (0.1, 0.2, 0.3))
    assert same is not None and np.abs(same - np.eye(3)).max() < 1e-12
