"""Degrees to the units of a drawing, north up (pure)."""

from __future__ import annotations

from typing import Any, Mapping, Sequence, Tuple

from . import svg
from .sites import METRES_PER_DEGREE, Spot, narrowing, turned

Size = Tuple[float, float, float]  # width, least height, most height


def has_position(frame: Mapping[str, Any]) -> bool:
    """The frame has a position that is not the 0, 0 of a camera without a fix."""
    latitude, longitude = frame["latitude"], frame["longitude"]
    return latitude is not None and longitude is not None and (abs(latitude) > 1e-6 or abs(longitude) > 1e-6)


class Plane:
    """Degrees to drawing units, north up."""

    def __init__(self, spots: Sequence[Spot], size: Size, margin: float) -> None:
        self.width, least, most = size
        self.latitude, self.longitude = spots[0]
        self.narrow = narrowing(self.latitude)
        metres = [self._metres(spot) for spot in spots]
        east, north = [m[0] for m in metres], [m[1] for m in metres]
        width, depth = max(max(east) - min(east), 40.0), max(max(north) - min(north), 20.0)
        self.scale = min((self.width - 2 * margin) / width, (most - 2 * margin) / depth)
        self.height = max(least, depth * self.scale + 2 * margin)
        self.middle = ((max(east) + min(east)) / 2, (max(north) + min(north)) / 2)

    def _metres(self, spot: Spot) -> Tuple[float, float]:
        east = turned(spot[1], self.longitude) * METRES_PER_DEGREE * self.narrow
        return east, (spot[0] - self.latitude) * METRES_PER_DEGREE

    def __call__(self, spot: Spot) -> svg.Point:
        """Where a latitude and longitude lies on the drawing."""
        east, north = self._metres(spot)
        return (
            self.width / 2 + (east - self.middle[0]) * self.scale,
            self.height / 2 - (north - self.middle[1]) * self.scale,
        )

    def inside(self, at: svg.Point) -> bool:
        """The point is on the drawing."""
        return 4 <= at[0] <= self.width - 4 and 4 <= at[1] <= self.height - 4
