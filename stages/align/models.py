"""COLMAP's camera models for our settings: exactly the parameters that may move (pure).

RADIAL has one focal: a distortion that is solved without its centre is solved
for square pixels, whatever the setting's aspect, and is read back so. Models
with two focals start from the setting's and solve both.
"""

from __future__ import annotations

from dataclasses import replace
from typing import List, Sequence, Tuple

from ..focals import mean_and_aspect
from .solution import CameraSetting


def camera_model(setting: CameraSetting) -> Tuple[str, List[float]]:
    """Return COLMAP's model name and parameters in pixels of the working size."""
    f = setting.focal_px
    fx, fy = setting.focals_px
    cx, cy = setting.center_px
    k1, k2, p1, p2, k3 = (*setting.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    if setting.solve_distortion and setting.solve_center:
        return "OPENCV", [fx, fy, cx, cy, k1, k2, p1, p2]
    if setting.solve_distortion:
        return "RADIAL", [f, cx, cy, k1, k2]
    if any((k1, k2, p1, p2, k3)):
        return "FULL_OPENCV", [fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    if setting.aspect_ratio != 1.0:
        return "PINHOLE", [fx, fy, cx, cy]
    return "SIMPLE_PINHOLE", [f, cx, cy]


def read_model(setting: CameraSetting, name: str, values: Sequence[float]) -> CameraSetting:
    """Return ``setting`` with the focal, aspect, principal point and distortion that COLMAP found."""
    side = float(max(setting.width, setting.height))
    focal, aspect = values[0], 1.0
    bend = (0.0, 0.0, 0.0, 0.0, 0.0)
    if name == "RADIAL":
        bend = (values[3], values[4], 0.0, 0.0, 0.0)
    elif name == "PINHOLE":
        focal, aspect = mean_and_aspect(values[0], values[1])
    elif name in ("OPENCV", "FULL_OPENCV"):
        k3 = values[8] if name == "FULL_OPENCV" else 0.0
        focal, aspect = mean_and_aspect(values[0], values[1])
        bend = (values[4], values[5], values[6], values[7], k3)
    elif name != "SIMPLE_PINHOLE":
        raise ValueError(f"unexpected camera model {name}")
    center = setting.center_ratio
    if name == "OPENCV":
        center = ((values[2] - setting.width / 2.0) / side, (values[3] - setting.height / 2.0) / side)
    return replace(setting, focal_ratio=focal / side, distortion=bend, center_ratio=center, aspect_ratio=aspect)
