"""COLMAP's camera models for our settings: exactly the parameters that may move (pure)."""

from __future__ import annotations

from dataclasses import replace
from typing import List, Sequence, Tuple

from .solution import CameraSetting


def camera_model(setting: CameraSetting) -> Tuple[str, List[float]]:
    """Return COLMAP's model name and parameters in pixels of the working size."""
    f = setting.focal_px
    cx, cy = setting.center_px
    k1, k2, p1, p2, k3 = (*setting.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    if setting.solve_distortion and setting.solve_center:
        return "OPENCV", [f, f, cx, cy, k1, k2, p1, p2]
    if setting.solve_distortion:
        return "RADIAL", [f, cx, cy, k1, k2]
    if any((k1, k2, p1, p2, k3)):
        return "FULL_OPENCV", [f, f, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    return "SIMPLE_PINHOLE", [f, cx, cy]


def read_model(setting: CameraSetting, name: str, values: Sequence[float]) -> CameraSetting:
    """Return ``setting`` with the focal, principal point and distortion that COLMAP found."""
    side = float(max(setting.width, setting.height))
    if name == "SIMPLE_PINHOLE":
        focal, bend = values[0], (0.0, 0.0, 0.0, 0.0, 0.0)
    elif name == "RADIAL":
        focal, bend = values[0], (values[3], values[4], 0.0, 0.0, 0.0)
    elif name in ("OPENCV", "FULL_OPENCV"):
        k3 = values[8] if name == "FULL_OPENCV" else 0.0
        focal, bend = (values[0] + values[1]) / 2.0, (values[4], values[5], values[6], values[7], k3)
    else:
        raise ValueError(f"unexpected camera model {name}")
    center = setting.center_ratio
    if name == "OPENCV":
        center = ((values[2] - setting.width / 2.0) / side, (values[3] - setting.height / 2.0) / side)
    return replace(setting, focal_ratio=focal / side, distortion=bend, center_ratio=center)
