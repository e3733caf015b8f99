"""Exif: typed access to the directories of a stream, with a note of what cannot be read."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Dict, List, Optional, Tuple

from . import tiff
from .source import BeyondEnd

# IFD0
MAKE, MODEL, ORIENTATION, SOFTWARE, DATE_TIME = 0x010F, 0x0110, 0x0112, 0x0131, 0x0132
XMP_PACKET, EXIF_IFD, GPS_IFD, BLACK_LEVEL, CAMERA_SERIAL = 0x02BC, 0x8769, 0x8825, 0xC61A, 0xC62F
DNG_VERSION, UNIQUE_MODEL = 0xC612, 0xC614
# OriginalDefaultFinalSize (DNG 1.4): the size of the larger file that this one was made from.
ORIGINAL_SIZE = 0xC791
IMAGE_TAGS = frozenset(
    (MAKE, MODEL, ORIENTATION, SOFTWARE, DATE_TIME, XMP_PACKET, EXIF_IFD, GPS_IFD, BLACK_LEVEL, CAMERA_SERIAL)
) | frozenset((DNG_VERSION, UNIQUE_MODEL, ORIGINAL_SIZE))  # fmt: skip
# Exif sub-directory
EXPOSURE_TIME, F_NUMBER, ISO, SENSITIVITY, ISO_SPEED = 0x829A, 0x829D, 0x8827, 0x8832, 0x8833
TIME_ORIGINAL, TIME_DIGITIZED, SUBSEC, SUBSEC_ORIGINAL, SUBSEC_DIGITIZED = 0x9003, 0x9004, 0x9290, 0x9291, 0x9292
FOCAL_LENGTH, MAKER_NOTE, IMAGE_NUMBER = 0x920A, 0x927C, 0x9211
PIXEL_X, PIXEL_Y, DIGITAL_ZOOM, FOCAL_35MM = 0xA002, 0xA003, 0xA404, 0xA405
PLANE_X_RES, PLANE_Y_RES, PLANE_UNIT = 0xA20E, 0xA20F, 0xA210
BODY_SERIAL, LENS_MODEL = 0xA431, 0xA434
EXIF_TAGS = frozenset(
    (
        EXPOSURE_TIME, F_NUMBER, ISO, SENSITIVITY, ISO_SPEED, TIME_ORIGINAL, TIME_DIGITIZED, SUBSEC, SUBSEC_ORIGINAL,
        SUBSEC_DIGITIZED, FOCAL_LENGTH, MAKER_NOTE, IMAGE_NUMBER, PIXEL_X, PIXEL_Y, DIGITAL_ZOOM, FOCAL_35MM,
        PLANE_X_RES, PLANE_Y_RES, PLANE_UNIT, BODY_SERIAL, LENS_MODEL,
    )
)  # fmt: skip
# GPS sub-directory
LATITUDE_REF, LATITUDE, LONGITUDE_REF, LONGITUDE, ALTITUDE_REF, ALTITUDE, SPEED_REF, SPEED = 1, 2, 3, 4, 5, 6, 12, 13
GPS_TAGS = frozenset((LATITUDE_REF, LATITUDE, LONGITUDE_REF, LONGITUDE, ALTITUDE_REF, ALTITUDE, SPEED_REF, SPEED))

NAMES = {
    MAKE: "Make", MODEL: "Model", ORIENTATION: "Orientation", SOFTWARE: "Software", DATE_TIME: "DateTime",
    CAMERA_SERIAL: "CameraSerialNumber", UNIQUE_MODEL: "UniqueCameraModel", EXPOSURE_TIME: "ExposureTime",
    F_NUMBER: "FNumber", ISO: "PhotographicSensitivity", SENSITIVITY: "RecommendedExposureIndex",
    ISO_SPEED: "ISOSpeed", TIME_ORIGINAL: "DateTimeOriginal", TIME_DIGITIZED: "DateTimeDigitized",
    SUBSEC: "SubSecTime", SUBSEC_ORIGINAL: "SubSecTimeOriginal", SUBSEC_DIGITIZED: "SubSecTimeDigitized",
    FOCAL_LENGTH: "FocalLength", IMAGE_NUMBER: "ImageNumber", PIXEL_X: "PixelXDimension",
    PIXEL_Y: "PixelYDimension", DIGITAL_ZOOM: "DigitalZoomRatio", FOCAL_35MM: "FocalLengthIn35mmFilm",
    PLANE_X_RES: "FocalPlaneXResolution", PLANE_Y_RES: "FocalPlaneYResolution",
    PLANE_UNIT: "FocalPlaneResolutionUnit", BODY_SERIAL: "BodySerialNumber", LENS_MODEL: "LensModel",
    ORIGINAL_SIZE: "OriginalDefaultFinalSize",
    LATITUDE_REF: "GPSLatitudeRef", LATITUDE: "GPSLatitude", LONGITUDE_REF: "GPSLongitudeRef",
    LONGITUDE: "GPSLongitude", ALTITUDE_REF: "GPSAltitudeRef", ALTITUDE: "GPSAltitude",
    SPEED_REF: "GPSSpeedRef", SPEED: "GPSSpeed",
}  # fmt: skip

_UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f\x80-\x9f\ud800-\udfff]+")
_MAX_TEXT_BYTES = 1024


def clean_text(text: str) -> str:
    """One line of printable text without blanks around it."""
    return _UNPRINTABLE.sub(" ", text).strip()


@dataclass
class Tags:
    """One directory of a stream. Everything unreadable is ``None`` or ``""`` and a note in ``problems``."""

    stream: Optional[tiff.Stream]
    fields: Dict[int, tiff.Value]
    problems: List[str]

    def __contains__(self, tag: int) -> bool:
        return tag in self.fields

    def _values(self, tag: int) -> Tuple[tiff.Number, ...]:
        value = self.fields.get(tag)
        if value is None or self.stream is None:
            return ()
        try:
            if value.type == 2:
                self.problems.append(f"exif-wrong-type:{NAMES[tag]}")
                return ()
            return tiff.numbers(self.stream, value, _MAX_TEXT_BYTES)
        except tiff.Damaged as damage:
            self.problems.append(f"exif-damaged:{NAMES[tag]}, {damage}")
            return ()

    def numbers(self, tag: int) -> Tuple[Optional[float], ...]:
        """The numbers of a field; each that is no finite number is ``None`` and noted once."""
        result: List[Optional[float]] = []
        for number in self._values(tag):
            if number is not None and math.isfinite(number):
                result.append(float(number))
                continue
            zero = "focal-plane-rational-zero" if tag in (PLANE_X_RES, PLANE_Y_RES) else "exif-rational-zero"
            note = f"{zero if number is None else 'exif-not-finite'}:{NAMES[tag]}"
            if note not in self.problems:
                self.problems.append(note)
            result.append(None)
        return tuple(result)

    def number(self, tag: int) -> Optional[float]:
        """The first number of a field."""
        values = self.numbers(tag) if tag in self.fields else ()
        return values[0] if values else None

    def positive(self, tag: int, zero_is_unknown: bool = True) -> Optional[float]:
        """The first number where it is above zero; below zero is noted, zero only when it has no meaning."""
        number = self.number(tag)
        if number is None or number > 0:
            return number
        if number < 0 or not zero_is_unknown:
            self.problems.append(f"exif-not-positive:{NAMES[tag]}")
        return None

    def integer(self, tag: int) -> Optional[int]:
        """The first number of a field where it is a whole one."""
        number = self.number(tag)
        return int(number) if number is not None and number == int(number) else None

    def text(self, tag: int) -> str:
        """Text up to the first NUL, UTF-8 or else Latin-1."""
        value = self.fields.get(tag)
        if value is None or self.stream is None:
            return ""
        if value.type not in (1, 2, 7):
            return "" if value.type in (5, 10) else " ".join(str(n) for n in self._values(tag) if n is not None)
        shown = tiff.Value(value.type, min(value.count, _MAX_TEXT_BYTES), value.offset)
        try:
            data = tiff.raw_bytes(self.stream, shown).split(b"\x00", 1)[0]
        except tiff.Damaged as damage:
            self.problems.append(f"exif-damaged:{NAMES[tag]}, {damage}")
            return ""
        try:
            return clean_text(data.decode("utf-8"))
        except UnicodeDecodeError:
            self.problems.append(f"exif-not-utf8:{NAMES[tag]}")
            return clean_text(data.decode("latin-1"))


@dataclass(frozen=True)
class ExifBlock:
    """The three directories that describe a frame."""

    image: Tags
    exif: Tags
    gps: Tags


def read_block(
    stream: Optional[tiff.Stream], image_fields: Optional[Dict[int, tiff.Value]], problems: List[str]
) -> ExifBlock:
    """Read IFD0 (unless given), Exif and GPS of a stream; ``None`` gives empty directories."""
    if stream is None:
        return ExifBlock(Tags(None, {}, problems), Tags(None, {}, problems), Tags(None, {}, problems))
    if image_fields is None:
        image_fields = _fields(stream, stream.first, IMAGE_TAGS, "IFD0", problems)
    image = Tags(stream, image_fields, problems)
    parts = []
    for pointer, wanted, name in ((EXIF_IFD, EXIF_TAGS, "Exif"), (GPS_IFD, GPS_TAGS, "GPS")):
        value = image_fields.get(pointer)
        fields: Dict[int, tiff.Value] = {}
        if value is not None:
            try:
                offset = tiff.numbers(stream, value, 64)[0]
            except tiff.Damaged:
                offset = None
            if isinstance(offset, int):
                fields = _fields(stream, offset, wanted, name, problems)
            else:
                problems.append(f"exif-damaged:{name}, no offset")
        parts.append(Tags(stream, fields, problems))
    return ExifBlock(image, parts[0], parts[1])


def _fields(
    stream: tiff.Stream, offset: int, wanted: "frozenset[int]", name: str, problems: List[str]
) -> Dict[int, tiff.Value]:
    try:
        return tiff.directory(stream, offset, wanted)[0]
    except (tiff.Damaged, BeyondEnd) as damage:
        problems.append(f"exif-damaged:{name}, {damage}")
        return {}
