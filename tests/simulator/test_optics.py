"""Coordinates and lenses agree with their referees."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulator.camera import Camera, distort, look, project, rays, undistort
from tests.simulator.geo import Origin, utm, utm_zone

cv2 = pytest.importorskip("cv2", reason="frames are rendered with OpenCV")


def test_enu_goes_to_degrees_and_back():
    origin = Origin(-33.4, 151.2, 62.0)
    place = origin.to_geodetic(812.0, -455.0, 97.0)
    assert origin.to_enu(*place) == pytest.approx((812.0, -455.0, 97.0), abs=1e-4)
    north = origin.to_geodetic(0.0, 100.0, 0.0)
    assert (north[0] - origin.latitude) * 110.92e3 == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize("place", [(47.2184, 8.7315), (-33.4, 151.2), (64.1, -21.9), (0.2, -78.5)])
def test_utm_agrees_with_proj(place):
    pyproj = pytest.importorskip("pyproj", reason="the referee for UTM")
    zone = utm_zone(place[1])
    code = (32600 if place[0] >= 0 else 32700) + zone
    expected = pyproj.Transformer.from_crs(4326, code, always_xy=True).transform(place[1], place[0])
    assert utm(*place, zone) == pytest.approx(expected, abs=1e-3)


def test_projection_agrees_with_opencv():
    camera = Camera(1280, 960, 0.73, (5.5, -4.0), (-0.085, 0.061, 0.0006, -0.0004, -0.012))
    rotation, center = look(37.0, -78.0, 4.0), np.array([3.0, -8.0, 55.0])
    points = np.array([[3.0, -4.0, 1.0], [-12.0, 2.0, 0.0], [14.0, 9.0, 3.0]])
    cx, cy = camera.principal_px
    matrix = np.array([[camera.focal_px, 0, cx], [0, camera.focal_px, cy], [0, 0, 1]])
    turn = cv2.Rodrigues(rotation)[0]
    expected = cv2.projectPoints(points, turn, -rotation @ center, matrix, np.array(camera.distortion))[0][:, 0]
    assert project(points, camera, rotation, center) == pytest.approx(expected, abs=1e-6)


def test_undistort_inverts_distort_and_rays_use_it():
    camera = Camera(640, 480, 0.7, (2.0, 1.0), (-0.1, 0.13, 0.0005, -0.0003, 0.01))
    x, y = rays(camera, 1)
    back = distort(np.stack((x, y), axis=-1).astype(float), camera.distortion) * camera.focal_px
    rows, columns = np.mgrid[0:480, 0:640]
    assert np.abs(back[..., 0] + camera.principal_px[0] - columns).max() < 2e-3
    assert np.abs(back[..., 1] + camera.principal_px[1] - rows).max() < 2e-3
    spot = np.array([[0.4, -0.3]])
    assert distort(undistort(spot, camera.distortion), camera.distortion) == pytest.approx(spot, abs=1e-8)


def test_a_fisheye_is_pix4ds():
    camera = Camera(1280, 960, 0.83, (20.0, -9.0), fisheye=(0.0059, -0.137))
    ray = np.array([[0.6, -0.45]])
    share = np.arctan(0.75) * 2.0 / np.pi
    affine = camera.focal_px * np.pi / 2.0
    expected = affine * (share + 0.0059 * share**2 - 0.137 * share**3) * ray / 0.75
    assert camera.bend(ray) * camera.focal_px == pytest.approx(expected)
    assert camera.unbend(camera.bend(ray)) == pytest.approx(ray, abs=1e-7)


def test_a_gimbal_looks_where_it_says():
    nadir = look(0.0, -90.0, 0.0)
    assert nadir[0] == pytest.approx([1, 0, 0], abs=1e-12)  # right is east
    assert nadir[1] == pytest.approx([0, -1, 0], abs=1e-12)  # down in the frame is south
    assert look(90.0, 0.0, 0.0)[2] == pytest.approx([1, 0, 0], abs=1e-12)  # level, facing east
