from __future__ import annotations

import builtins
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.stages.errors import MissingDependency, UsageError
from sensorgate.stages.srs import LONLAT, OTHER, UTM, lonlat_to_utm, parse_srs, to_lonlat, utm_to_lonlat, utm_zone

pyproj = pytest.importorskip("pyproj")

zones = st.integers(1, 60)
offsets = st.floats(-6.0, 6.0)
latitudes = st.floats(0.0, 84.0)


@given(zones, st.booleans(), offsets, latitudes)
def test_krueger_agrees_with_pyproj_to_a_micrometre(zone: int, north: bool, offset: float, latitude: float) -> None:
    lon, lat = zone * 6 - 183 + offset, latitude if north else -latitude
    reference = pyproj.Transformer.from_crs(4326, (32600 if north else 32700) + zone, always_xy=True)
    expected = reference.transform(lon, lat)
    found = lonlat_to_utm(lon, lat, zone, north)
    assert math.dist(found, expected) < 1e-6
    lon_, lat_ = utm_to_lonlat(*found, zone, north)
    assert abs((lon_ - lon + 180) % 360 - 180) * math.cos(math.radians(lat)) < 1e-11
    assert abs(lat_ - lat) < 1e-11


@pytest.mark.parametrize(
    ("line", "kind", "zone", "north", "header"),
    [
        ("WGS84 UTM 15N", UTM, 15, True, "WGS84 UTM 15N"),
        ("  wgs84   utm 7s \r", UTM, 7, False, "WGS84 UTM 7S"),
        ("\ufeffEPSG:4326", LONLAT, None, True, "EPSG:4326"),
        ("epsg:32633", UTM, 33, True, "EPSG:32633"),
        ("EPSG:32733", UTM, 33, False, "EPSG:32733"),
        ("EPSG:2154", OTHER, None, True, "EPSG:2154"),
        ("+proj=utm +zone=17 +datum=WGS84 +units=m +no_defs", UTM, 17, True, None),
        ("+proj=utm +zone=17 +south +ellps=WGS84", UTM, 17, False, None),
        ("+proj=utm +zone=32 +ellps=GRS80 +units=m", OTHER, None, True, None),
        ("+proj=utm +zone=32 +datum=WGS84 +units=us-ft", OTHER, None, True, None),
        ("+proj=longlat +datum=WGS84 +no_defs", LONLAT, None, True, None),
    ],
)
def test_headers(line: str, kind: str, zone: int, north: bool, header: str) -> None:
    srs = parse_srs(line)
    assert (srs.kind, srs.zone, srs.north) == (kind, zone, north)
    assert srs.header == (header or line)


@pytest.mark.parametrize("line", ["", "geo_x geo_y geo_z", "WGS84", "WGS84 UTM 61N", "WGS84 UTM 15", "32615", "EPSG:"])
def test_headers_on_which_odm_would_stop(line: str) -> None:
    with pytest.raises(UsageError, match="WGS84 UTM 15N"):
        parse_srs(line)


def test_other_systems_go_through_pyproj_easting_first() -> None:
    ((lon, lat),) = to_lonlat(parse_srs("EPSG:2154"), [(652709.401, 6859290.946)])
    assert (lon, lat) == pytest.approx((2.3553, 48.8316), abs=1e-3)
    with pytest.raises(UsageError, match="not known"):
        to_lonlat(parse_srs("EPSG:999999"), [(0.0, 0.0)])


def test_without_pyproj_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def absent(name: str, *args: Any, **more: Any) -> Any:
        if name == "pyproj":
            raise ImportError(name)
        return real(name, *args, **more)

    monkeypatch.setattr(builtins, "__import__", absent)
    assert to_lonlat(parse_srs("WGS84 UTM 31N"), [(500000.0, 0.0)]) == [pytest.approx((3.0, 0.0))]
    with pytest.raises(MissingDependency, match="pip install"):
        to_lonlat(parse_srs("EPSG:2154"), [(0.0, 0.0)])


@given(st.floats(-180.0, 179.999))
def test_zone_holds_its_longitude(longitude: float) -> None:
    assert abs((longitude - (utm_zone(longitude) * 6 - 183) + 180) % 360 - 180) <= 3.0000001
