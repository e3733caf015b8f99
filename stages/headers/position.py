"""Where the camera was and how it looked: Exif GPS first, XMP where it is missing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional, Tuple

from . import exif
from .values import Numbers, degrees, degrees_text
from .xmp import Xmp

_ABOVE_TAKE_OFF = (
    "drone-dji:RelativeAltitude",
    "DJI:RelativeAltitude",
    "Camera:AboveGroundAltitude",
    "FLIR:MAVRelativeAltitude",
)
# No survey looks so far backwards: below this a pitch is counted from the horizon, as FLIR does, not from nadir.
_FROM_HORIZON_DEG = -45.0
_SPEED_MPS = {"K": 1 / 3.6, "M": 0.44704, "N": 0.514444}


@dataclass(frozen=True)
class Position:
    """Degrees, metres, metres per second; the angles are DJI's (pitch -90 looks straight down)."""

    latitude: Optional[float] = None
    longitude: Optional[float] = None
    reference_missing: bool = False
    altitude_m: Optional[float] = None
    relative_altitude_m: Optional[float] = None
    speed_mps: Optional[float] = None
    yaw_deg: Optional[float] = None
    pitch_deg: Optional[float] = None
    roll_deg: Optional[float] = None


def read(gps: exif.Tags, xmp: Xmp, problems: List[str]) -> Position:
    """Read position, altitude, speed and angles of one frame."""
    numbers = Numbers(xmp, problems)
    latitude, longitude, missing = _coordinates(gps, xmp, problems)
    yaw, pitch, roll = _angles(numbers)
    return Position(
        latitude=latitude,
        longitude=longitude,
        reference_missing=missing,
        altitude_m=_altitude(gps, numbers),
        relative_altitude_m=numbers.one(*_ABOVE_TAKE_OFF),
        speed_mps=_speed(gps, numbers),
        yaw_deg=yaw,
        pitch_deg=pitch,
        roll_deg=roll,
    )


def _coordinates(gps: exif.Tags, xmp: Xmp, problems: List[str]) -> Tuple[Optional[float], Optional[float], bool]:
    latitude = degrees(gps.numbers(exif.LATITUDE)) if exif.LATITUDE in gps else None
    longitude = degrees(gps.numbers(exif.LONGITUDE)) if exif.LONGITUDE in gps else None
    north, east = gps.text(exif.LATITUDE_REF).upper(), gps.text(exif.LONGITUDE_REF).upper()
    there = latitude is not None and longitude is not None
    missing = there and (north[:1] not in ("N", "S") or east[:1] not in ("E", "W"))
    if latitude is not None and north.startswith("S"):
        latitude = -latitude
    if longitude is not None and east.startswith("W"):
        longitude = -longitude
    if there and not _on_earth(latitude, longitude):
        problems.append("gps-out-of-range:GPSLatitude, GPSLongitude")
        there = missing = False
    if not there or missing or (latitude == 0.0 and longitude == 0.0):
        other = _xmp_coordinates(xmp)
        if other is not None:
            return other[0], other[1], missing
    return (latitude, longitude, missing) if there else (None, None, False)


def _xmp_coordinates(xmp: Xmp) -> Optional[Tuple[float, float]]:
    for north, east in (
        (("drone-dji:GpsLatitude", "drone-dji:GPSLatitude"), ("drone-dji:GpsLongitude", "drone-dji:GpsLongtitude",
                                                              "drone-dji:GPSLongitude", "drone-dji:GPSLongtitude")),
        (("drone-dji:Latitude",), ("drone-dji:Longitude",)),
        (("exif:GPSLatitude",), ("exif:GPSLongitude",)),
    ):  # fmt: skip
        latitude, longitude = degrees_text(xmp.text(*north)), degrees_text(xmp.text(*east))
        if (
            latitude is not None
            and longitude is not None
            and _on_earth(latitude, longitude)
            and (latitude or longitude)
        ):
            return latitude, longitude
    return None


def _on_earth(latitude: Optional[float], longitude: Optional[float]) -> bool:
    return latitude is not None and longitude is not None and abs(latitude) <= 90.0 and abs(longitude) <= 180.0


def _altitude(gps: exif.Tags, numbers: Numbers) -> Optional[float]:
    altitude = gps.number(exif.ALTITUDE)
    if altitude is None:
        return numbers.one("drone-dji:AbsoluteAltitude", "DJI:AbsoluteAltitude")
    reference = gps.fields.get(exif.ALTITUDE_REF)
    below = False
    if reference is not None:
        below = gps.text(exif.ALTITUDE_REF) == "1" if reference.type == 2 else gps.integer(exif.ALTITUDE_REF) in (1, 3)
    return -abs(altitude) if below else altitude


def _speed(gps: exif.Tags, numbers: Numbers) -> Optional[float]:
    x, y = numbers.one("drone-dji:FlightXSpeed"), numbers.one("drone-dji:FlightYSpeed")
    if x is not None and y is not None:
        return math.hypot(x, y)
    speed = gps.number(exif.SPEED)
    if speed is None or speed < 0:
        return None
    return speed * _SPEED_MPS.get(gps.text(exif.SPEED_REF).upper()[:1], _SPEED_MPS["K"])


def _angles(numbers: Numbers) -> Tuple[Optional[float], Optional[float], Optional[float]]:
    for prefix in ("drone-dji", "DJI"):
        pitch = numbers.one(f"{prefix}:GimbalPitchDegree")
        if pitch is not None:
            yaw = numbers.one(f"{prefix}:GimbalYawDegree")
            return yaw, pitch, numbers.one(f"{prefix}:GimbalRollDegree")
    pitch = numbers.one("drone-parrot:CameraPitchDegree")
    if pitch is not None:
        return numbers.one("drone-parrot:CameraYawDegree"), pitch, numbers.one("drone-parrot:CameraRollDegree")
    pitch = numbers.one("Camera:Pitch")  # 0 looks straight down in this namespace
    if pitch is not None and pitch > _FROM_HORIZON_DEG:
        pitch -= 90.0
    return numbers.one("Camera:Yaw"), pitch, numbers.one("Camera:Roll")
