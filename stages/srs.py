"""The first line of ``gcp_list.txt`` and ``geo.txt``, and its coordinates as longitude and latitude.

WGS84 UTM and plain longitude/latitude are converted here (Krüger's series to
the sixth order in n; Karney, "Transverse Mercator with an accuracy of a few
nanometers", J. Geodesy 85, 2011), so that the gate needs no library for them.
Anything else is pyproj's.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

from .errors import MissingDependency, UsageError

LONLAT = "lonlat"
UTM = "utm"
OTHER = "other"

_A_M = 6378137.0
_F = 1.0 / 298.257223563
_SCALE = 0.9996
_FALSE_EASTING_M = 500000.0
_FALSE_NORTHING_M = 10000000.0
_N = _F / (2.0 - _F)
_RADIUS_M = _A_M / (1.0 + _N) * (1.0 + _N**2 / 4.0 + _N**4 / 64.0 + _N**6 / 256.0)
_ALPHA = (
    _N / 2 - 2 * _N**2 / 3 + 5 * _N**3 / 16 + 41 * _N**4 / 180 - 127 * _N**5 / 288 + 7891 * _N**6 / 37800,
    13 * _N**2 / 48 - 3 * _N**3 / 5 + 557 * _N**4 / 1440 + 281 * _N**5 / 630 - 1983433 * _N**6 / 1935360,
    61 * _N**3 / 240 - 103 * _N**4 / 140 + 15061 * _N**5 / 26880 + 167603 * _N**6 / 181440,
    49561 * _N**4 / 161280 - 179 * _N**5 / 168 + 6601661 * _N**6 / 7257600,
    34729 * _N**5 / 80640 - 3418889 * _N**6 / 1995840,
    212378941 * _N**6 / 319334400,
)
_BETA = (
    _N / 2 - 2 * _N**2 / 3 + 37 * _N**3 / 96 - _N**4 / 360 - 81 * _N**5 / 512 + 96199 * _N**6 / 604800,
    _N**2 / 48 + _N**3 / 15 - 437 * _N**4 / 1440 + 46 * _N**5 / 105 - 1118711 * _N**6 / 3870720,
    17 * _N**3 / 480 - 37 * _N**4 / 840 - 209 * _N**5 / 4480 + 5569 * _N**6 / 90720,
    4397 * _N**4 / 161280 - 11 * _N**5 / 504 - 830251 * _N**6 / 7257600,
    4583 * _N**5 / 161280 - 108847 * _N**6 / 3991680,
    20648693 * _N**6 / 638668800,
)
_E = math.sqrt(_F * (2.0 - _F))

_UTM_NAME = re.compile(r"^WGS84\s+UTM\s+(\d{1,2})([NS])$", re.IGNORECASE)
_EPSG = re.compile(r"^EPSG:\s*(\d{3,6})$", re.IGNORECASE)


@dataclass(frozen=True)
class Srs:
    """A coordinate system as a header names it. ``header`` is the spelling that all readers take."""

    header: str
    kind: str
    zone: Optional[int] = None
    north: bool = True


def parse_srs(line: str) -> Srs:
    """Read a header line: ``EPSG:n``, ``WGS84 UTM 15N`` or a proj4 string.

    Raises ``UsageError`` where it names none, with the forms that work.
    """
    text = " ".join(line.replace("\ufeff", "").split())
    named = _UTM_NAME.match(text)
    if named and 1 <= int(named.group(1)) <= 60:
        zone, north = int(named.group(1)), named.group(2).upper() == "N"
        return Srs(f"WGS84 UTM {zone}{'N' if north else 'S'}", UTM, zone, north)
    epsg = _EPSG.match(text)
    if epsg:
        return _from_epsg(int(epsg.group(1)))
    if "+proj" in text:
        return _from_proj4(text.strip("'"))
    raise UsageError(
        f"The first line {line.strip()[:80]!r} names no coordinate system. It must be like EPSG:32615, "
        "WGS84 UTM 15N or a proj4 string (+proj=utm +zone=15 +datum=WGS84)."
    )


def _from_epsg(code: int) -> Srs:
    header = f"EPSG:{code}"
    if code == 4326:
        return Srs(header, LONLAT)
    if 32601 <= code <= 32660:
        return Srs(header, UTM, code - 32600, True)
    if 32701 <= code <= 32760:
        return Srs(header, UTM, code - 32700, False)
    return Srs(header, OTHER)


def _from_proj4(text: str) -> Srs:
    words = dict(([*w.lstrip("+").split("=", 1), ""])[:2] for w in text.split() if w.startswith("+"))
    wgs84 = words.get("datum") == "WGS84" or ("datum" not in words and words.get("ellps") == "WGS84")
    plain = not {"towgs84", "nadgrids", "geoidgrids", "pm", "to_meter", "axis"} & set(words)
    if wgs84 and plain and words.get("units", "m") == "m":
        if words.get("proj") in ("longlat", "latlong"):
            return Srs(text, LONLAT)
        zone = words.get("zone", "")
        if words.get("proj") == "utm" and zone.isdigit() and 1 <= int(zone) <= 60:
            return Srs(text, UTM, int(zone), "south" not in words)
    return Srs(text, OTHER)


def utm_to_lonlat(x_m: float, y_m: float, zone: int, north: bool) -> Tuple[float, float]:
    """Easting and northing in metres to (longitude, latitude) in degrees on WGS84."""
    xi = (y_m - (0.0 if north else _FALSE_NORTHING_M)) / (_SCALE * _RADIUS_M)
    eta = (x_m - _FALSE_EASTING_M) / (_SCALE * _RADIUS_M)
    xi_, eta_ = xi, eta
    for j, beta in enumerate(_BETA, start=1):
        xi_ -= beta * math.sin(2 * j * xi) * math.cosh(2 * j * eta)
        eta_ -= beta * math.cos(2 * j * xi) * math.sinh(2 * j * eta)
    sinh_eta, cos_xi = math.sinh(eta_), math.cos(xi_)
    longitude = math.atan2(sinh_eta, cos_xi)
    tau = _tau(math.sin(xi_) / math.hypot(sinh_eta, cos_xi))
    return (math.degrees(longitude) + _meridian(zone) + 180.0) % 360.0 - 180.0, math.degrees(math.atan(tau))


def lonlat_to_utm(longitude: float, latitude: float, zone: int, north: bool) -> Tuple[float, float]:
    """(longitude, latitude) in degrees on WGS84 to easting and northing in metres."""
    lam = math.radians((longitude - _meridian(zone) + 180.0) % 360.0 - 180.0)
    tau_ = _tau_prime(math.tan(math.radians(latitude)))
    xi_ = math.atan2(tau_, math.cos(lam))
    eta_ = math.asinh(math.sin(lam) / math.hypot(tau_, math.cos(lam)))
    xi, eta = xi_, eta_
    for j, alpha in enumerate(_ALPHA, start=1):
        xi += alpha * math.sin(2 * j * xi_) * math.cosh(2 * j * eta_)
        eta += alpha * math.cos(2 * j * xi_) * math.sinh(2 * j * eta_)
    x_m = _SCALE * _RADIUS_M * eta + _FALSE_EASTING_M
    return x_m, _SCALE * _RADIUS_M * xi + (0.0 if north else _FALSE_NORTHING_M)


def utm_zone(longitude: float) -> int:
    """The zone of a longitude, without Norway's exceptions, which readers of these headers do not know."""
    return math.floor((longitude + 180.0) / 6.0) % 60 + 1


def _meridian(zone: int) -> float:
    return zone * 6.0 - 183.0


def _tau_prime(tau: float) -> float:
    sigma = math.sinh(_E * math.atanh(_E * tau / math.hypot(1.0, tau)))
    return tau * math.hypot(1.0, sigma) - sigma * math.hypot(1.0, tau)


def _tau(tau_prime: float) -> float:
    """Newton's method on ``_tau_prime`` (Karney 2011, eq. 19-21); three steps reach the last bit."""
    tau = tau_prime / (1.0 - _E**2)
    for _ in range(5):
        there = _tau_prime(tau)
        inverse_slope = (1.0 + (1.0 - _E**2) * tau**2) / ((1.0 - _E**2) * math.hypot(1.0, tau))
        tau += (tau_prime - there) / math.hypot(1.0, there) * inverse_slope
    return tau


def to_lonlat(srs: Srs, points: Sequence[Tuple[float, float]]) -> List[Tuple[float, float]]:
    """(x, y) pairs as (longitude, latitude) degrees; x is easting or longitude whatever the EPSG axis order.

    Raises ``MissingDependency`` where pyproj is needed and absent,
    ``UsageError`` where it does not know the system.
    """
    if srs.kind == LONLAT:
        return [(float(x), float(y)) for x, y in points]
    if srs.kind == UTM and srs.zone is not None:
        return [utm_to_lonlat(x, y, srs.zone, srs.north) for x, y in points]
    try:
        import pyproj
    except ImportError:
        raise MissingDependency(
            "pyproj", f"coordinates in {srs.header[:60]}", "pip install 'sensorgate[all]'"
        ) from None
    try:
        transformer = pyproj.Transformer.from_crs(pyproj.CRS.from_user_input(srs.header), "EPSG:4326", always_xy=True)
    except pyproj.exceptions.ProjError as error:
        raise UsageError(f"The coordinate system {srs.header[:80]!r} is not known: {error}.") from None
    return [(float(lon), float(lat)) for lon, lat in (transformer.transform(x, y) for x, y in points)]
