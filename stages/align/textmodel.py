"""COLMAP's text models: cameras, poses, observations and points, read and re-written.

The format is documented at https://colmap.github.io/format.html: quaternions
w, x, y, z and translations take the world into the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, List, Mapping, Tuple

import numpy as np

from .models import camera_model
from .solution import Array, CameraSetting


@dataclass(frozen=True)
class TextImage:
    """One placed image: pose (world to camera), camera, name, observed pixels (N, 2) and their point ids (N,)."""

    name: str
    camera_id: int
    rotation: Array
    translation: Array
    pixels: Array
    point_ids: Tuple[int, ...]


@dataclass(frozen=True)
class TextModel:
    """One model as text: camera id -> (model name, parameters), images, point id -> place."""

    cameras: Mapping[int, Tuple[str, Tuple[float, ...]]]
    images: Tuple[TextImage, ...]
    points: Mapping[int, Array]

    def errors(self, image: TextImage) -> Array:
        """Reprojection errors in px of an image's observations of points."""
        rows = [k for k, point in enumerate(image.point_ids) if point in self.points]
        if not rows:
            return np.zeros(0)
        places = np.asarray([self.points[image.point_ids[k]] for k in rows])
        local = places @ image.rotation.T + image.translation
        ahead = local[:, 2] > 1e-9
        name, values = self.cameras[image.camera_id]
        offset = project(name, values, local[ahead]) - image.pixels[rows][ahead]
        return np.asarray(np.hypot(offset[:, 0], offset[:, 1]))


def project(name: str, values: Tuple[float, ...], local: Array) -> Array:
    """Project camera coordinates (N, 3) to pixels (N, 2) under the models that are used here."""
    u, v = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
    r2 = u * u + v * v
    if name in ("OPENCV", "FULL_OPENCV"):
        fx, fy, cx, cy, k1, k2, p1, p2 = values[:8]
        k3 = values[8] if name == "FULL_OPENCV" else 0.0
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
        y = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
        return np.stack([fx * x + cx, fy * y + cy], axis=1)
    if name == "PINHOLE":
        fx, fy, cx, cy = values
        return np.stack([fx * u + cx, fy * v + cy], axis=1)
    f, cx, cy = values[:3]
    k1, k2 = values[3:5] if name == "RADIAL" else (0.0, 0.0)
    radial = 1.0 + r2 * (k1 + r2 * k2)
    return np.stack([f * u * radial + cx, f * v * radial + cy], axis=1)


def _lines(path: Path) -> Iterator[str]:
    with open(path, encoding="utf-8") as stream:
        for line in stream:
            if not line.startswith("#"):
                yield line.rstrip("\n")


def read_model_text(folder: Path) -> TextModel:
    """Read ``cameras.txt``, ``images.txt`` and ``points3D.txt``; raises ``OSError`` or ``ValueError``."""
    cameras: Dict[int, Tuple[str, Tuple[float, ...]]] = {}
    for line in _lines(folder / "cameras.txt"):
        parts = line.split()
        if parts:
            cameras[int(parts[0])] = (parts[1], tuple(float(v) for v in parts[4:]))
    images: List[TextImage] = []
    rows = _lines(folder / "images.txt")
    for head in rows:
        if not head.strip():
            continue
        parts = head.split()
        body = next(rows, "").split()
        observed = np.asarray(body, dtype=float).reshape(-1, 3)
        images.append(
            TextImage(
                name=parts[9],
                camera_id=int(parts[8]),
                rotation=rotation_of(*(float(v) for v in parts[1:5])),
                translation=np.asarray([float(v) for v in parts[5:8]]),
                pixels=observed[:, :2],
                point_ids=tuple(int(v) for v in observed[:, 2]),
            )
        )
    points: Dict[int, Array] = {}
    for line in _lines(folder / "points3D.txt"):
        parts = line.split()
        if parts:
            points[int(parts[0])] = np.asarray([float(v) for v in parts[1:4]])
    return TextModel(cameras, tuple(sorted(images, key=lambda i: i.name)), points)


def rotation_of(w: float, x: float, y: float, z: float) -> Array:
    """Rotation matrix of a quaternion, which is normalised first."""
    w, x, y, z = np.asarray([w, x, y, z]) / np.sqrt(w * w + x * x + y * y + z * z)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def write_cameras(folder: Path, settings: Mapping[int, CameraSetting]) -> None:
    """Rewrite ``cameras.txt`` with the given settings by camera id."""
    lines = []
    for camera_id in sorted(settings):
        setting = settings[camera_id]
        name, values = camera_model(setting)
        numbers = " ".join(repr(float(v)) for v in values)
        lines.append(f"{camera_id} {name} {setting.width} {setting.height} {numbers}")
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
