"""Latitude, longitude and height to a local metric frame: east, north, up.

WGS 84 through earth-centred coordinates, so that it needs no projection
library and is exact near its origin.
"""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_A = 6378137.0
_F = 1.0 / 298.257223563
_E2 = _F * (2.0 - _F)


def earth_centred(positions: Array) -> Array:
    """Return x, y, z in metres for rows of latitude, longitude (degrees) and height (m); shape (N, 3)."""
    lat, lon = np.radians(positions[:, 0]), np.radians(positions[:, 1])
    height = positions[:, 2]
    n = _A / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (n + height) * np.cos(lat) * np.cos(lon),
            (n + height) * np.cos(lat) * np.sin(lon),
            (n * (1.0 - _E2) + height) * np.sin(lat),
        ],
        axis=1,
    )


def local_frame(positions: Sequence[Tuple[float, float, float]]) -> Array:
    """Return east, north, up in metres about the median position; shape (N, 3).

    The origin is the median of each coordinate, so one wrong position does not
    tilt the frame. Up is the ellipsoid's normal at the origin.
    """
    rows = np.asarray(positions, dtype=float).reshape(-1, 3)
    if len(rows) == 0:
        return np.zeros((0, 3))
    return enu(rows, np.median(rows, axis=0))


def enu(rows: Array, origin: Array) -> Array:
    """Return east, north, up in metres of ``rows`` (latitude, longitude, height) about ``origin``."""
    lat, lon = np.radians(origin[0]), np.radians(origin[1])
    offset = earth_centred(rows) - earth_centred(origin[None, :])
    rotation = np.array(
        [
            [-np.sin(lon), np.cos(lon), 0.0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ]
    )
    result: Array = offset @ rotation.T
    return result
