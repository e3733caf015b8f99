"""The true camera: pinhole with Brown distortion, and where it stands.

Camera axes: x right, y down, z forward. World axes: east, north, up. Pixel
(0, 0) is the centre of the first pixel. Distortion is k1, k2, p1, p2, k3 in
OpenCV's order on ray-normalised coordinates, or Pix4D's fisheye polynomial.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Callable, Tuple

import numpy as np

Vector = Tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """Optics of one lens and sensor mode.

    ``focal_ratio`` is focal length in pixels over ``width``. ``center_px`` is
    the principal point minus the image centre ((width-1)/2, (height-1)/2).
    ``fisheye`` are p2 and p3 of Pix4D's polynomial p(t) = t + p2 t^2 + p3 t^3,
    t the angle off the axis as a share of 90 degrees; it replaces ``distortion``.
    """

    width: int
    height: int
    focal_ratio: float
    center_px: Tuple[float, float] = (0.0, 0.0)
    distortion: Tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    fisheye: Tuple[float, ...] = ()

    def bend(self, xy: np.ndarray) -> np.ndarray:
        """Normalised rays (..., 2) as the lens puts them on the sensor, in focal lengths."""
        return fish(xy, self.fisheye) if self.fisheye else distort(xy, self.distortion)

    def unbend(self, xy: np.ndarray) -> np.ndarray:
        """Inverse of ``bend``, to 1e-8."""
        if not self.fisheye:
            return undistort(xy, self.distortion)
        return _solve(xy, lambda guess: fish(guess, self.fisheye), 80)

    @property
    def focal_px(self) -> float:
        return self.focal_ratio * self.width

    @property
    def principal_px(self) -> Tuple[float, float]:
        return (self.width - 1) / 2.0 + self.center_px[0], (self.height - 1) / 2.0 + self.center_px[1]

    def scaled(self, factor: float) -> "Camera":
        """The same optics read out at ``factor`` times the pixels, to whole even sizes."""
        width = max(2, 2 * round(self.width * factor / 2))
        height = max(2, 2 * round(self.height * factor / 2))
        ratio = width / self.width
        return Camera(
            width,
            height,
            self.focal_ratio,
            (self.center_px[0] * ratio, self.center_px[1] * ratio),
            self.distortion,
            self.fisheye,
        )

    def zoomed(self, factor: float) -> "Camera":
        """The middle of the picture blown up to the full size: a digital zoom."""
        center = (self.center_px[0] * factor, self.center_px[1] * factor)
        return Camera(self.width, self.height, self.focal_ratio * factor, center, self.distortion, self.fisheye)


def distort(xy: np.ndarray, coefficients: Tuple[float, ...]) -> np.ndarray:
    """Brown's model on normalised coordinates, shape (..., 2)."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xy2 = 2.0 * x * y
    bent = np.empty_like(xy)
    bent[..., 0] = x * radial + p1 * xy2 + p2 * (r2 + 2.0 * x * x)
    bent[..., 1] = y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy2
    return bent


def undistort(xy: np.ndarray, coefficients: Tuple[float, ...]) -> np.ndarray:
    """Inverse of ``distort`` by fixed-point iteration, to 1e-8 (a hundred-thousandth of a pixel)."""
    if not any(coefficients):
        return xy
    return _solve(xy, lambda guess: distort(guess, coefficients), 30)


def fish(xy: np.ndarray, coefficients: Tuple[float, ...]) -> np.ndarray:
    """Pix4D's fisheye on normalised coordinates, shape (..., 2), scaled so that the axis keeps its focal length."""
    p2, p3 = coefficients
    r = np.maximum(np.hypot(xy[..., 0], xy[..., 1]), 1e-12)
    t = np.arctan(r) * 2.0 / math.pi
    return xy * (t * (1.0 + t * (p2 + t * p3)) * math.pi / 2.0 / r)[..., None]


def _solve(xy: np.ndarray, bend: Callable[[np.ndarray], np.ndarray], steps: int) -> np.ndarray:
    guess = xy.copy()
    for _ in range(steps):
        rest = bend(guess) - xy
        guess -= rest
        if float(np.abs(rest).max()) < 1e-8:
            break
    return guess


@functools.lru_cache(maxsize=8)
def rays(camera: Camera, step: int = 1) -> Tuple[np.ndarray, np.ndarray]:
    """Normalised ray x and y of every ``step``-th pixel, float32 grids.

    The grid with ``step`` > 1 reaches one node beyond the frame, so that it
    can be interpolated up to the last pixel.
    """
    columns = np.arange(0, camera.width + (step if step > 1 else 0), step, dtype=np.float64)
    rows = np.arange(0, camera.height + (step if step > 1 else 0), step, dtype=np.float64)
    cx, cy = camera.principal_px
    grid = np.stack(np.meshgrid((columns - cx) / camera.focal_px, (rows - cy) / camera.focal_px), axis=-1)
    grid = camera.unbend(grid)
    return grid[..., 0].astype(np.float32), grid[..., 1].astype(np.float32)


def look(yaw_deg: float, pitch_deg: float, roll_deg: float) -> np.ndarray:
    """World-to-camera rotation, 3x3. Yaw clockwise from north, pitch -90 at nadir (as gimbals report)."""
    yaw, pitch, roll = (math.radians(a) for a in (yaw_deg, pitch_deg, roll_deg))
    forward = np.array([math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)])
    right = np.array([math.cos(yaw), -math.sin(yaw), 0.0])
    down = np.cross(forward, right)
    turned = math.cos(roll) * right + math.sin(roll) * down
    return np.stack((turned, np.cross(forward, turned), forward))


def tilt(degrees_xyz: Vector) -> np.ndarray:
    """Small mounting rotation about the camera's own axes, Rz.Ry.Rx."""
    ax, ay, az = (math.radians(a) for a in degrees_xyz)
    rx = np.array([[1, 0, 0], [0, math.cos(ax), -math.sin(ax)], [0, math.sin(ax), math.cos(ax)]])
    ry = np.array([[math.cos(ay), 0, math.sin(ay)], [0, 1, 0], [-math.sin(ay), 0, math.cos(ay)]])
    rz = np.array([[math.cos(az), -math.sin(az), 0], [math.sin(az), math.cos(az), 0], [0, 0, 1]])
    return rz @ ry @ rx


def project(points: np.ndarray, camera: Camera, rotation: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of world points (N, 3); NaN where a point lies behind the camera."""
    local = (np.atleast_2d(points) - center) @ rotation.T
    with np.errstate(divide="ignore", invalid="ignore"):
        xy = local[:, :2] / local[:, 2:3]
    pixels = camera.bend(xy) * camera.focal_px + np.array(camera.principal_px)
    pixels[local[:, 2] <= 0] = np.nan
    return pixels
