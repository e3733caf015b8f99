"""Radiometry that is bound to sensor pixels, applied before a frame is warped.

MicaSense's published model: ``L = V(x, y) R(y) (p - p_black)`` with the mean of
the black level tag, the vignette ``V = 1 / (1 + k0 r + ... + k5 r^6)`` about its
centre and the row gradient ``R = 1 / (1 + a2 y / t - a3 y)``, t being the
exposure in seconds. The gain and a1 stay with the reader of the tags. What was
applied is neutralised: the tags keep form and length, their numbers become 0.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Callable, Optional, Tuple

import numpy as np
import numpy.typing as npt

from ..errors import FrameError
from ..headers.values import Numbers
from ..headers.xmp import parse
from ..thresholds import Thresholds
from .exif import EXIF_IFD, Entry, TiffBlock
from .metadata import is_tiff

_XMP, _BLACK_LEVEL, _EXPOSURE = 700, 0xC61A, 0x829A
_NUMBER_BYTES = {3: ("H", 2), 4: ("I", 4), 5: ("I", 8)}
_CENTER, _POLYNOMIAL = "Camera:VignettingCenter", "Camera:VignettingPolynomial"
_GRADIENT = "MicaSense:RadiometricCalibration"
_MAKERS_OWN = (
    "Camera:VignettingPolynomial2D",
    "Camera:BlackCurrent",
    "Camera:RowGradient",
    "MicaSense:RowGradient",
    "drone-dji:VignettingData",
    "drone-dji:VignettingPolynomial",
    "drone-dji:BlackLevel",
)
_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class Correction:
    """What a frame's tags say; ``row`` is a2 / t - a3 per pixel row."""

    black: float
    center: Tuple[float, float]
    polynomial: Tuple[float, ...]
    row: float

    def applied(self, pixels: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Level (h, w, c) counts; may come out below zero where noise is."""
        height, width = pixels.shape[:2]
        x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
        level = np.ones((height, width), np.float32)
        if self.polynomial:
            radius = np.hypot(x - np.float32(self.center[0]), y - np.float32(self.center[1]))
            fall = np.zeros_like(radius)
            for value in reversed(self.polynomial):
                fall = (fall + np.float32(value)) * radius
            level /= 1.0 + fall
        if self.row:
            level /= 1.0 + np.float32(self.row) * y
        return np.asarray((pixels.astype(np.float32) - np.float32(self.black)) * level[..., None])


def correction_of(data: bytes, limits: Thresholds) -> Optional[Correction]:
    """The correction of a frame's bytes; ``None`` where a tag is missing, or its maker has a model of its own."""
    if not is_tiff(data):
        return None
    try:
        block = TiffBlock(bytearray(data))
        xmp = parse([_packet(block)], limits)
        numbers = Numbers(xmp, [])
        if any(xmp.items(name) for name in _MAKERS_OWN):
            return None
        black = _black_level(block)
        polynomial, center = numbers.several(_POLYNOMIAL), numbers.several(_CENTER)
        gradient = numbers.several(_GRADIENT)
        exposure = _exposure(block)
    except FrameError:
        return None
    if black is None or bool(polynomial) != (len(center) == 2) or len(gradient) not in (0, 3):
        return None
    row = 0.0
    if gradient and (gradient[1] or gradient[2]):
        if exposure is None:
            return None
        row = gradient[1] / exposure - gradient[2]
    at = (center[0], center[1]) if polynomial else (0.0, 0.0)
    return Correction(black, at, polynomial, row)


def neutralised(data: bytes, limits: Thresholds) -> bytes:
    """Return the file with black level, vignette and row gradient set to nothing, every other byte as it was.

    Raises ``FrameError`` ``radiometry-not-rewritable`` where the tags are
    spelled in a way that cannot be rewritten in place.
    """
    block = TiffBlock(bytearray(data))
    entry = block.find(block.first, _BLACK_LEVEL)
    if entry is not None:
        _zero(block, entry)
    packet = block.find(block.first, _XMP)
    if packet is not None:
        old = bytes(block.data[packet.value_at : packet.value_at + packet.length])
        new = _without(old, b"VignettingPolynomial", 0)
        new = _without(new, b"RadiometricCalibration", 1)
        block.data[packet.value_at : packet.value_at + packet.length] = new
    result = bytes(block.data)
    left = correction_of(result, limits)
    if len(result) != len(data) or left is None or left.black or any(left.polynomial) or left.row:
        raise FrameError("radiometry-not-rewritable", "Its radiometric tags cannot be rewritten in place.")
    return result


def can_be_applied(data: bytes, limits: Thresholds) -> bool:
    """Whether the tags are complete and can be neutralised afterwards."""
    if correction_of(data, limits) is None:
        return False
    try:
        neutralised(data, limits)
    except FrameError:
        return False
    return True


def _packet(block: TiffBlock) -> bytes:
    entry = block.find(block.first, _XMP)
    return b"" if entry is None else bytes(block.data[entry.value_at : entry.value_at + entry.length])


def _black_level(block: TiffBlock) -> Optional[float]:
    entry = block.find(block.first, _BLACK_LEVEL)
    if entry is None or entry.kind not in _NUMBER_BYTES or not entry.count:
        return None
    code, size = _NUMBER_BYTES[entry.kind]
    values = []
    for index in range(entry.count):
        at = entry.value_at + index * size
        below = block.whole("I", at + 4) if size == 8 else 1
        if not below:
            return None
        values.append(block.whole(code, at) / below)
    return sum(values) / len(values)


def _zero(block: TiffBlock, entry: Entry) -> None:
    code, size = _NUMBER_BYTES.get(entry.kind, ("", 0))
    for index in range(entry.count if code else 0):
        block.put(code, entry.value_at + index * size, 0)


def _exposure(block: TiffBlock) -> Optional[float]:
    at = block.pointer(block.find(block.first, EXIF_IFD))
    entry = block.find(at, _EXPOSURE) if at is not None else None
    value = block.number(entry) if entry is not None else None
    return float(value) if value is not None and value > 0 else None


def _without(packet: bytes, name: bytes, keep: int) -> bytes:
    """Turn the numbers of a property to zeros of the same length, after the first ``keep``."""
    left = keep

    def zero(match: "re.Match[bytes]") -> bytes:
        nonlocal left
        left -= 1
        number = match.group()
        if left >= 0:
            return number
        return b"0" if len(number) == 1 else (b"0." + b"0" * len(number))[: len(number)]

    def in_text(match: "re.Match[bytes]") -> bytes:
        return _NUMBER.sub(zero, match.group())

    def in_element(match: "re.Match[bytes]") -> bytes:
        return match.group(1) + re.sub(rb"(?<=>)[^<]+", in_text, match.group(2)) + match.group(3)

    def in_attribute(match: "re.Match[bytes]") -> bytes:
        return match.group(1) + _NUMBER.sub(zero, match.group(2)) + match.group(3)

    forms: Tuple[Tuple[bytes, Callable[["re.Match[bytes]"], bytes]], ...] = (
        (rb"(?s)(<[\w.-]+:" + name + rb"(?=[\s>])[^<>]*)(>.*?)(</[\w.-]+:" + name + rb"\s*>)", in_element),
        (rb"(\s[\w.-]+:" + name + rb"\s*=\s*[\"'])([^\"'<]*)([\"'])", in_attribute),
    )
    for pattern, replace in forms:
        left = keep
        packet = re.sub(pattern, replace, packet, count=1)
    return packet


__all__ = ["Correction", "can_be_applied", "correction_of", "neutralised"]
