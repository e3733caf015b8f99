"""OpenSfM's camera models: where a point in camera coordinates falls in the image (numpy, pure).

Image coordinates are OpenSfM's: pixels from the image centre over
max(width, height). The formulas are those of Brown (perspective, brown) and of
Kannala and Brandt, doi:10.1109/TPAMI.2006.153 (fisheye).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping, Tuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MODELS = ("perspective", "brown", "fisheye", "fisheye_opencv")


@dataclass(frozen=True)
class OpenSfmCamera:
    """One camera of a reconstruction.

    ``focal`` (x, y) and ``center`` are over max(width, height). ``radial``
    holds k1, k2, k3, k4 and ``tangential`` p1, p2; what a model lacks is zero.
    """

    id: str
    model: str
    width: int
    height: int
    focal: Tuple[float, float]
    center: Tuple[float, float] = (0.0, 0.0)
    radial: Tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    tangential: Tuple[float, float] = (0.0, 0.0)

    @property
    def side(self) -> int:
        """Pixels of one unit of image coordinates."""
        return max(self.width, self.height)

    @property
    def focal_ratio(self) -> float:
        """Focal length over the longer side, the mean of across and down."""
        return (self.focal[0] + self.focal[1]) / 2.0

    @property
    def aspect_ratio(self) -> float:
        """Focal down over focal across (fy / fx); only of a camera that is ``known``."""
        return self.focal[1] / self.focal[0]

    @property
    def brown(self) -> Tuple[float, float, float, float, float]:
        """k1, k2, p1, p2, k3; zero for a fisheye, whose distortion is none of Brown's."""
        if self.model not in ("perspective", "brown"):
            return (0.0, 0.0, 0.0, 0.0, 0.0)
        k1, k2, k3, _ = self.radial
        return (k1, k2, *self.tangential, k3)

    @property
    def known(self) -> bool:
        """Whether ``project`` has its formula."""
        return self.model in MODELS


def camera_from_json(identity: str, value: Any) -> OpenSfmCamera:
    """Read a camera as ``cameras`` of a reconstruction or ``camera_models.json`` spell it.

    Raises ``ValueError`` where a figure is missing or not a number. A model
    without formula here (spherical, dual, ...) keeps its name and nothing else.
    """
    if not isinstance(value, Mapping):
        raise ValueError("a camera is an object")
    model = str(value.get("projection_type", "perspective"))
    width, height = int(_number(value, "width")), int(_number(value, "height"))
    if not (0 < width < 1 << 20 and 0 < height < 1 << 20):
        raise ValueError("a camera needs a width and a height")
    if model not in MODELS:
        return OpenSfmCamera(identity, model, width, height, (0.0, 0.0))
    both = "focal_x" in value
    focal = (_number(value, "focal_x" if both else "focal"), _number(value, "focal_y" if both else "focal"))
    if min(focal) <= 0:
        raise ValueError("a focal length must be positive")
    names = {"perspective": 2, "fisheye": 2, "brown": 3, "fisheye_opencv": 4}[model]
    k = [_number(value, f"k{i + 1}", 0.0) for i in range(names)] + [0.0] * (4 - names)
    center = (_number(value, "c_x", 0.0), _number(value, "c_y", 0.0))
    bend = (_number(value, "p1", 0.0), _number(value, "p2", 0.0)) if model == "brown" else (0.0, 0.0)
    return OpenSfmCamera(identity, model, width, height, focal, center, (k[0], k[1], k[2], k[3]), bend)


def _number(value: Mapping[str, Any], name: str, default: float = float("nan")) -> float:
    found = value.get(name, default)
    if isinstance(found, bool) or not isinstance(found, (int, float)) or not abs(found) < 1e9:
        raise ValueError(f"{name} is no number")
    return float(found)


def project(camera: OpenSfmCamera, points: Array) -> Array:
    """Return image coordinates (N, 2) of points in camera coordinates (N, 3: right, down, forward).

    Raises ``ValueError`` for a model without formula here. A point in the
    plane of the camera gives infinities, never an error.
    """
    if not camera.known:
        raise ValueError(f"no formula for {camera.model}")
    x, y, z = points.T
    k1, k2, k3, k4 = camera.radial
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if camera.model.startswith("fisheye"):
            flat = np.hypot(x, y)
            theta = np.arctan2(flat, z)
            t2 = theta * theta
            bent = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
            scale = np.where(flat > 1e-12, bent / np.where(flat > 1e-12, flat, 1.0), 1.0)
            u, v = x * scale, y * scale
        else:
            u, v = x / z, y / z
            r2 = u * u + v * v
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            p1, p2 = camera.tangential
            u, v = (
                u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u),
                v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v,
            )
    fx, fy = camera.focal
    cx, cy = camera.center
    return np.stack([fx * u + cx, fy * v + cy], axis=1)


def rotation_matrix(axis_angle: Array) -> Array:
    """Rotation matrix (3, 3) of an axis-angle vector (Rodrigues)."""
    angle = float(np.linalg.norm(axis_angle))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = axis_angle / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    result: Array = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    return result
