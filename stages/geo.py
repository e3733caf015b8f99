"""Small geodesy: degrees to local metres and back (pure, no library needed).

Distances inside one survey are what matters here; the local plane is exact to
better than 1 mm per kilometre squared, far below GPS.
"""

from __future__ import annotations

import math
from typing import List, Sequence, Tuple

_A = 6378137.0
_E2 = 6.69437999014e-3


def metres_per_degree(latitude: float) -> Tuple[float, float]:
    """Metres per degree of latitude and longitude on the WGS84 ellipsoid (meridian and normal radii)."""
    sine = math.sin(math.radians(latitude))
    root = math.sqrt(1.0 - _E2 * sine * sine)
    meridian = _A * (1.0 - _E2) / root**3
    normal = _A / root
    return math.radians(1.0) * meridian, math.radians(1.0) * normal * math.cos(math.radians(latitude))


def distance_m(a: Tuple[float, float], b: Tuple[float, float]) -> float:
    """Distance in metres between two (latitude, longitude) pairs, for survey-sized gaps."""
    north, east = metres_per_degree((a[0] + b[0]) / 2.0)
    d_lon = (b[1] - a[1] + 180.0) % 360.0 - 180.0
    return math.hypot((b[0] - a[0]) * north, d_lon * east)


def local_metres(points: Sequence[Tuple[float, float]], origin: Tuple[float, float]) -> Tuple[Tuple[float, float], ...]:
    """(latitude, longitude) pairs as (east, north) metres from ``origin``."""
    north, east = metres_per_degree(origin[0])
    return tuple((((lon - origin[1] + 180.0) % 360.0 - 180.0) * east, (lat - origin[0]) * north) for lat, lon in points)


def median(values: Sequence[float]) -> float:
    """The lower-middle median: one of the values itself, so it is exact and repeatable."""
    ordered = sorted(values)
    return ordered[(len(ordered) - 1) // 2]


def hull_area_m2(points: Sequence[Tuple[float, float]]) -> float:
    """Area of the convex hull (Andrew's monotone chain)."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return 0.0

    def half(sequence: Sequence[Tuple[float, float]]) -> List[Tuple[float, float]]:
        chain: List[Tuple[float, float]] = []
        for p in sequence:
            while len(chain) > 1 and _cross(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        return chain[:-1]

    hull = half(ordered) + half(ordered[::-1])
    return abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(hull, hull[1:] + hull[:1]))) / 2.0


def _cross(o: Tuple[float, float], a: Tuple[float, float], b: Tuple[float, float]) -> float:
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])


def flatness(points: Sequence[Tuple[float, float]]) -> float:
    """Second over first singular value of the centred points: 0 on one line, 1 round."""
    n = len(points)
    if n < 2:
        return 0.0
    mx, my = sum(p[0] for p in points) / n, sum(p[1] for p in points) / n
    sxx = sum((p[0] - mx) ** 2 for p in points)
    syy = sum((p[1] - my) ** 2 for p in points)
    sxy = sum((p[0] - mx) * (p[1] - my) for p in points)
    half, root = (sxx + syy) / 2.0, math.hypot((sxx - syy) / 2.0, sxy)
    return math.sqrt(max(0.0, half - root) / (half + root)) if half + root > 0 else 0.0
