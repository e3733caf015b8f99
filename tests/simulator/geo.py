"""Local east-north-up coordinates, WGS84 and UTM.

Formulas: ECEF and its inverse (Bowring, iterated), and Karney's Krüger series
in n for transverse Mercator, good to well below a millimetre inside a zone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

A_M = 6378137.0
F = 1.0 / 298.257223563
E2 = F * (2.0 - F)
K0 = 0.9996


def _ecef(lat_deg: float, lon_deg: float, alt_m: float) -> Tuple[float, float, float]:
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    n = A_M / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    across = (n + alt_m) * math.cos(lat)
    return across * math.cos(lon), across * math.sin(lon), (n * (1.0 - E2) + alt_m) * math.sin(lat)


def _geodetic(x: float, y: float, z: float) -> Tuple[float, float, float]:
    p = math.hypot(x, y)
    lat = math.atan2(z, p * (1.0 - E2))
    alt = 0.0
    for _ in range(8):
        n = A_M / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
        alt = p / math.cos(lat) - n
        lat = math.atan2(z, p * (1.0 - E2 * n / (n + alt)))
    return math.degrees(lat), math.degrees(math.atan2(y, x)), alt


@dataclass(frozen=True)
class Origin:
    """Where east, north, up are zero: WGS84 degrees and metres."""

    latitude: float
    longitude: float
    altitude_m: float

    def to_geodetic(self, east: float, north: float, up: float) -> Tuple[float, float, float]:
        """Latitude, longitude (degrees), altitude (m) of a local point (m)."""
        lat, lon = math.radians(self.latitude), math.radians(self.longitude)
        x0, y0, z0 = _ecef(self.latitude, self.longitude, self.altitude_m)
        sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
        x = x0 - so * east - sl * co * north + cl * co * up
        y = y0 + co * east - sl * so * north + cl * so * up
        z = z0 + cl * north + sl * up
        return _geodetic(x, y, z)

    def to_enu(self, latitude: float, longitude: float, altitude_m: float) -> Tuple[float, float, float]:
        """East, north, up (m) of a geodetic point."""
        lat, lon = math.radians(self.latitude), math.radians(self.longitude)
        x0, y0, z0 = _ecef(self.latitude, self.longitude, self.altitude_m)
        x1, y1, z1 = _ecef(latitude, longitude, altitude_m)
        dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
        sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
        return (
            -so * dx + co * dy,
            -sl * co * dx - sl * so * dy + cl * dz,
            cl * co * dx + cl * so * dy + sl * dz,
        )


def utm_zone(longitude: float) -> int:
    """The UTM zone of a longitude in degrees."""
    return int((longitude + 180.0) // 6.0) % 60 + 1


def utm(latitude: float, longitude: float, zone: int) -> Tuple[float, float]:
    """Easting and northing (m) on WGS84; southern northings get the false 10,000 km."""
    n = F / (2.0 - F)
    radius = A_M / (1.0 + n) * (1.0 + n**2 / 4.0 + n**4 / 64.0)
    alpha = (
        n / 2.0 - 2.0 * n**2 / 3.0 + 5.0 * n**3 / 16.0 + 41.0 * n**4 / 180.0,
        13.0 * n**2 / 48.0 - 3.0 * n**3 / 5.0 + 557.0 * n**4 / 1440.0,
        61.0 * n**3 / 240.0 - 103.0 * n**4 / 140.0,
        49561.0 * n**4 / 161280.0,
    )
    lat = math.radians(latitude)
    dlon = math.radians(longitude - (zone * 6 - 183))
    e = math.sqrt(E2)
    t = math.sinh(math.atanh(math.sin(lat)) - e * math.atanh(e * math.sin(lat)))
    xi = math.atan2(t, math.cos(dlon))
    eta = math.asinh(math.sin(dlon) / math.hypot(t, math.cos(dlon)))
    east, north = eta, xi
    for j, a in enumerate(alpha, start=1):
        east += a * math.cos(2 * j * xi) * math.sinh(2 * j * eta)
        north += a * math.sin(2 * j * xi) * math.cosh(2 * j * eta)
    return 500000.0 + K0 * radius * east, K0 * radius * north + (0.0 if latitude >= 0 else 1e7)
