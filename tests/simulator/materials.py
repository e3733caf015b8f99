"""What the ground is made of, and how bright each material is to each channel.

Reflectances are plausible round values of their kind, not measurements:
vegetation is dark in red and bright in the near infrared, soil rises slowly
with wavelength, metal roofs look cold to a thermal camera. ``thermal`` is a
surface temperature in degrees Celsius of an early afternoon.
"""

from __future__ import annotations

from typing import Dict, Tuple

import numpy as np

CHANNELS = ("red", "green", "blue", "ms-blue", "ms-green", "ms-red", "ms-rededge", "ms-nir")

# name: reflectance per channel in the order above, temperature, texture strength
_TABLE: Dict[str, Tuple[Tuple[float, ...], float, float]] = {
    "natural": ((0.0,) * 8, 0.0, 1.0),
    "asphalt": ((0.15, 0.15, 0.155, 0.13, 0.14, 0.16, 0.17, 0.19), 43.0, 0.35),
    "dirt": ((0.46, 0.37, 0.27, 0.20, 0.30, 0.41, 0.45, 0.50), 37.0, 0.6),
    "roof-tile": ((0.44, 0.21, 0.15, 0.11, 0.16, 0.40, 0.45, 0.48), 47.0, 0.55),
    "roof-grey": ((0.36, 0.36, 0.38, 0.33, 0.34, 0.36, 0.37, 0.38), 45.0, 0.35),
    "roof-dark": ((0.12, 0.12, 0.13, 0.10, 0.11, 0.12, 0.13, 0.15), 56.0, 0.5),
    "roof-white": ((0.74, 0.73, 0.70, 0.66, 0.70, 0.73, 0.74, 0.74), 33.0, 0.15),
    "roof-metal": ((0.33, 0.42, 0.52, 0.50, 0.44, 0.36, 0.38, 0.42), 12.0, 0.2),
    "concrete": ((0.54, 0.53, 0.50, 0.44, 0.50, 0.54, 0.55, 0.56), 39.0, 0.35),
    "canopy": ((0.13, 0.20, 0.08, 0.04, 0.11, 0.05, 0.26, 0.52), 23.0, 1.6),
    "canopy-light": ((0.21, 0.28, 0.10, 0.05, 0.15, 0.07, 0.31, 0.57), 24.0, 1.6),
    "shrub": ((0.17, 0.23, 0.11, 0.06, 0.13, 0.08, 0.27, 0.44), 25.0, 1.2),
    "stone": ((0.58, 0.56, 0.52, 0.42, 0.50, 0.56, 0.58, 0.60), 36.0, 0.3),
    "pit": ((0.16, 0.14, 0.11, 0.08, 0.11, 0.14, 0.17, 0.21), 33.0, 0.4),
    "straw": ((0.62, 0.53, 0.34, 0.24, 0.42, 0.55, 0.60, 0.64), 38.0, 0.6),
    "paint": ((0.82, 0.82, 0.80, 0.74, 0.78, 0.80, 0.80, 0.80), 38.0, 0.1),
    "car-red": ((0.48, 0.06, 0.06, 0.05, 0.05, 0.44, 0.50, 0.52), 41.0, 0.05),
    "car-blue": ((0.08, 0.14, 0.40, 0.34, 0.14, 0.07, 0.12, 0.20), 42.0, 0.05),
    "car-white": ((0.85, 0.85, 0.84, 0.80, 0.82, 0.83, 0.83, 0.83), 34.0, 0.05),
    "car-black": ((0.05, 0.05, 0.06, 0.04, 0.04, 0.05, 0.05, 0.06), 52.0, 0.05),
    "water": ((0.06, 0.10, 0.11, 0.09, 0.09, 0.05, 0.03, 0.015), 19.0, 0.25),
    "target-white": ((0.95, 0.95, 0.95, 0.9, 0.9, 0.9, 0.9, 0.9), 30.0, 0.0),
    "target-black": ((0.03, 0.03, 0.03, 0.03, 0.03, 0.03, 0.03, 0.03), 52.0, 0.0),
}

NAMES = tuple(_TABLE)
ID = {name: index for index, name in enumerate(NAMES)}

# Open ground is a mix of these by the share of vegetation, and of that the share that is ripe or dry.
SOIL = (0.40, 0.31, 0.22, 0.16, 0.24, 0.34, 0.38, 0.42)
GRASS = (0.20, 0.28, 0.10, 0.05, 0.13, 0.06, 0.28, 0.56)
DRY = (0.52, 0.44, 0.24, 0.13, 0.30, 0.42, 0.46, 0.50)
SOIL_C = 40.0
GRASS_C = 27.0
DRY_C = 33.0


def _lut(values: Tuple[float, ...]) -> np.ndarray:
    table = np.zeros(256, np.float32)
    table[: len(values)] = values
    return table


def reflectance(channel: str) -> np.ndarray:
    """Material id -> reflectance, 256 float32."""
    index = CHANNELS.index(channel)
    return _lut(tuple(row[0][index] for row in _TABLE.values()))


def temperature() -> np.ndarray:
    """Material id -> degrees Celsius, 256 float32."""
    return _lut(tuple(row[1] for row in _TABLE.values()))


def texture() -> np.ndarray:
    """Material id -> how strongly fine detail modulates it, 256 float32."""
    return _lut(tuple(row[2] for row in _TABLE.values()))
