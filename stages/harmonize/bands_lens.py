"""Pixels of a band to rays and back.

A ray is (x/z, y/z) in the camera's frame, x right and y down. Pixel (0, 0) is
the centre of the first pixel. Brown's model as OpenCV spells it (k1, k2, p1,
p2, k3). Parrot's fisheye as Pix4D publishes it: the angle from the axis as a
share of 90 degrees goes through a polynomial, then through an affine matrix in
pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Optional, Tuple

import numpy as np
import numpy.typing as npt

from ..focals import both_focals
from ..frame import Frame
from ..intrinsics import Intrinsics

Points = npt.NDArray[np.float64]

BROWN, FISHEYE = "brown", "fisheye"
_STEPS = 40
_CLOSE = 1e-10
_NEWTON_STEPS = 12
_RIGHT_ANGLE = math.pi / 2.0
_NODE_PX = 8


@dataclass(frozen=True)
class Lens:
    """One band's optics in pixels of its frame; ``center_px`` is the principal point.

    ``distortion`` is Brown's five or, for ``fisheye``, the polynomial from its
    constant term on; ``affine`` is Parrot's C, D, E, F. ``aspect_ratio`` is
    focal down over focal across, whose mean ``focal_px`` is.
    """

    width: int
    height: int
    focal_px: float
    center_px: Tuple[float, float]
    projection: str = BROWN
    distortion: Tuple[float, ...] = ()
    affine: Tuple[float, ...] = ()
    aspect_ratio: float = 1.0

    def plain(self) -> "Lens":
        """The same frame as an ideal pinhole about its middle."""
        middle = _middle(self.width, self.height)
        return replace(self, center_px=middle, projection=BROWN, distortion=(), affine=(), aspect_ratio=1.0)

    def to_rays(self, pixels: Points) -> Points:
        """Undistort pixels (..., 2) to rays of the same shape."""
        return _fisheye_rays(self, pixels) if self.projection == FISHEYE else _brown_rays(self, pixels)

    def to_pixels(self, rays: Points) -> Points:
        """Distort rays (..., 2) to pixels of the same shape."""
        center = np.array(self.center_px)
        if self.projection == FISHEYE:
            return _fisheye_pixels(self, rays)
        return np.asarray(bend(rays, self.distortion) * self.focals_px + center)

    @property
    def focals_px(self) -> Points:
        """Focal lengths across and down (2,)."""
        return np.array(both_focals(self.focal_px, self.aspect_ratio))


def _middle(width: int, height: int) -> Tuple[float, float]:
    return (width - 1) / 2.0, (height - 1) / 2.0


def lens_of(frame: Frame, intrinsics: Intrinsics) -> Lens:
    """The lens that the best source knows; without a focal length, one as long as the frame is wide."""
    width, height = frame.width, frame.height
    given = frame.calibration
    focal = (intrinsics.focal_ratio or 1.0) * width
    center = _middle(width, height)
    if given is not None and given.projection == FISHEYE and given.fisheye_affine and given.distortion:
        c, d, e, f = given.fisheye_affine
        if abs(c * f - d * e) > 0 and len(given.distortion) >= 2 and given.distortion[1] > 0:
            at = given.center_px or (width / 2.0, height / 2.0)
            return Lens(
                width, height, focal, (at[0] - 0.5, at[1] - 0.5), FISHEYE, given.distortion, given.fisheye_affine
            )
    if intrinsics.center_ratio is not None:
        longer = max(width, height)
        center = (center[0] + intrinsics.center_ratio[0] * longer, center[1] + intrinsics.center_ratio[1] * longer)
    distortion: Tuple[float, ...] = ()
    if intrinsics.projection == BROWN and intrinsics.distortion and any(intrinsics.distortion):
        distortion = intrinsics.distortion
    return Lens(width, height, focal, center, BROWN, distortion, aspect_ratio=intrinsics.aspect_ratio)


def scaled(lens: Lens, size: Tuple[int, int]) -> Lens:
    """The lens of the same frame resampled to ``size``."""
    across, down = size[0] / lens.width, size[1] / lens.height
    center = (lens.center_px[0] + 0.5) * across - 0.5, (lens.center_px[1] + 0.5) * down - 0.5
    affine = lens.affine
    if affine:
        affine = (affine[0] * across, affine[1] * across, affine[2] * down, affine[3] * down)
    return replace(
        lens, width=size[0], height=size[1], focal_px=lens.focal_px * across, center_px=center, affine=affine
    )


def bend(rays: Points, coefficients: Tuple[float, ...]) -> Points:
    """Brown's distortion of rays (..., 2)."""
    if not coefficients:
        return rays
    k1, k2, p1, p2, k3 = coefficients
    x, y = rays[..., 0], rays[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ),
        axis=-1,
    )


def _brown_rays(lens: Lens, pixels: Points) -> Points:
    bent = (np.asarray(pixels, np.float64) - np.array(lens.center_px)) / lens.focals_px
    rays = bent.copy()
    if lens.distortion:
        for _ in range(_STEPS):
            rest = bend(rays, lens.distortion) - bent
            rays -= rest
            if float(np.abs(rest).max(initial=0.0)) < _CLOSE:
                break
    return np.asarray(rays)


def _rho(coefficients: Tuple[float, ...], share: Points) -> Points:
    total = np.zeros_like(share)
    for value in reversed(coefficients):
        total = total * share + value
    return total


def _slope(coefficients: Tuple[float, ...], share: Points) -> Points:
    return _rho(tuple(i * c for i, c in enumerate(coefficients))[1:], share)


def _fisheye_rays(lens: Lens, pixels: Points) -> Points:
    c, d, e, f = lens.affine
    inverse = np.linalg.inv(np.array([[c, d], [e, f]]))
    flat = (np.asarray(pixels, np.float64) - np.array(lens.center_px)) @ inverse.T
    rho = np.hypot(flat[..., 0], flat[..., 1])
    share = rho / lens.distortion[1]
    for _ in range(_NEWTON_STEPS):
        share = share - (_rho(lens.distortion, share) - rho) / _slope(lens.distortion, share)
    tangent = np.tan(np.clip(share, 0.0, 0.99) * _RIGHT_ANGLE)
    safe = np.where(rho > 1e-12, rho, 1.0)
    factor = np.where(rho > 1e-12, tangent / safe, _RIGHT_ANGLE / lens.distortion[1])
    return np.asarray(flat * factor[..., None])


def _fisheye_pixels(lens: Lens, rays: Points) -> Points:
    c, d, e, f = lens.affine
    radius = np.hypot(rays[..., 0], rays[..., 1])
    rho = _rho(lens.distortion, np.arctan(radius) / _RIGHT_ANGLE)
    safe = np.where(radius > 1e-12, radius, 1.0)
    factor = np.where(radius > 1e-12, rho / safe, lens.distortion[1] / _RIGHT_ANGLE)
    flat = rays * factor[..., None]
    return np.asarray(flat @ np.array([[c, d], [e, f]]).T + np.array(lens.center_px))


def project(matrix: Any, rays: Points) -> Points:
    """Take rays (..., 2) through a 3x3 matrix; what would lie behind comes out as NaN."""
    m = np.asarray(matrix, np.float64).reshape(3, 3)
    below = rays @ m[2, :2] + m[2, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        result = (rays @ m[:2, :2].T + m[:2, 2]) / below[..., None]
    return np.asarray(np.where(below[..., None] > 0, result, np.nan))


def rotation(degrees_xyz: Tuple[float, float, float]) -> Points:
    """Rx.Ry.Rz of angles in degrees, as the camera namespace of the XMP means its rig relatives."""
    x, y, z = (math.radians(a) for a in degrees_xyz)
    about_x = np.array([[1, 0, 0], [0, math.cos(x), -math.sin(x)], [0, math.sin(x), math.cos(x)]])
    about_y = np.array([[math.cos(y), 0, math.sin(y)], [0, 1, 0], [-math.sin(y), 0, math.cos(y)]])
    about_z = np.array([[math.cos(z), -math.sin(z), 0], [math.sin(z), math.cos(z), 0], [0, 0, 1]])
    return np.asarray(about_x @ about_y @ about_z)


def rig_matrix(
    primary: Optional[Tuple[float, float, float]], band: Optional[Tuple[float, float, float]]
) -> Optional[Points]:
    """Primary rays to band rays at infinite distance by the rig relatives of both; ``None`` where one has none.

    ``R_primary' R_band``, MicaSense's published use of the tag.
    """
    if primary is None or band is None or not (any(primary) or any(band)):
        return None
    return np.asarray(rotation(primary).T @ rotation(band))


def sample_places(primary: Lens, band: Lens, matrix: Any) -> Points:
    """Where in the band each pixel of the primary's grid lies, (h, w, 2).

    ``distort_band(H(undistort_primary(pixel)))`` at every eighth pixel, in
    between linear: over eight pixels lenses bend by a hundredth of a pixel at most.
    """
    columns = np.arange(0, primary.width + _NODE_PX, _NODE_PX, dtype=np.float64)
    rows = np.arange(0, primary.height + _NODE_PX, _NODE_PX, dtype=np.float64)
    nodes = np.stack(np.meshgrid(columns, rows), axis=-1)
    there = np.nan_to_num(band.to_pixels(project(matrix, primary.to_rays(nodes))), nan=-1e6)
    across, down = _weights(primary.width, len(columns)), _weights(primary.height, len(rows))
    return np.stack([down @ there[..., i] @ across.T for i in (0, 1)], axis=-1)


def _weights(count: int, nodes: int) -> Points:
    at = np.arange(count) / _NODE_PX
    low = np.minimum(at.astype(np.int64), nodes - 2)
    weights = np.zeros((count, nodes))
    weights[np.arange(count), low] = 1.0 - (at - low)
    weights[np.arange(count), low + 1] = at - low
    return weights
