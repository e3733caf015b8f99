"""Parrot's fisheye polynomial in OpenCV's terms; the numbers are those of real Sequoia frames."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sensorgate.stages.fisheye import as_opencv

GREEN = ((0.0, 1.0, 0.00592627, -0.136981656), (1676.825547004, 0.0, 0.0, 1676.825547004))
RED_EDGE = ((0.0, 1.0, 0.009662624, -0.154314148), (1671.377898808, 0.0, 0.0, 1671.377898808))


@pytest.mark.parametrize("lens", [GREEN, RED_EDGE])
def test_a_grid_projects_to_the_same_pixels(lens):
    polynomial, affine = lens
    found = as_opencv(polynomial, affine, 1280, 960, 0.05)
    assert found is not None and found.error_px <= 0.05
    x, y = np.meshgrid(np.linspace(-0.7, 0.7, 29), np.linspace(-0.52, 0.52, 21))
    flat = np.hypot(x, y) + 1e-12
    angle = np.arctan(flat)
    truth = affine[0] * sum(p * (angle * 2 / math.pi) ** k for k, p in enumerate(polynomial))
    k1, k2, k3 = found.coefficients
    ours = found.focal_px * (angle + k1 * angle**3 + k2 * angle**5 + k3 * angle**7)
    inside = truth <= math.hypot(1280, 960) / 2
    assert inside.sum() > 500 and np.abs(ours - truth)[inside].max() < 0.05


def test_what_is_no_such_lens_is_not_converted():
    polynomial, affine = GREEN
    assert as_opencv(polynomial, (affine[0], 10.0, *affine[2:]), 1280, 960, 0.05) is None
    assert as_opencv(polynomial, (*affine[:3], 0.0), 1280, 960, 0.05) is None
    assert as_opencv(polynomial, affine[:2], 1280, 960, 0.05) is None
    assert as_opencv((0.0, 1.0, 0.5, -0.9), affine, 1280, 960, 0.05) is None
    assert as_opencv((0.0,), affine, 1280, 960, 0.05) is None
    assert as_opencv((0.0, -1.0), affine, 1280, 960, 0.05) is None
