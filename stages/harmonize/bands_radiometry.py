"""Radiometry that is bound to sensor pixels, taken off before a frame is warped.

Published models, each of the black level ``b``, the fall-off of light and,
where told, the row gradient ``R = 1 / (1 + a2 y / t - a3 y)``, t being the
exposure in seconds: ``L = V(x, y) R(y) (p - b)``.

- MicaSense: ``V = 1 / (1 + k0 r + ... + k5 r^6)``, r in pixels about a centre.
- DJI (P4 Multispectral and Mavic 3M image processing guides):
  ``V = 1 + k0 r + ... + k5 r^6``.
- Parrot (SEQ-AN-02), Pix4D's tag specification, later MicaSense cameras:
  ``V = 1 / sum c_ij (x / width)^i (y / height)^j``.

MicaSense's radial model is what ODM applies as well: there the level is applied
for good and the tags are neutralised (they keep form and length, their numbers
become 0), gain and a1 stay with the reader of the tags. The others ODM reads
in part or not at all, and the primary band is never rewritten: applied to the
warped bands alone, ratios with the primary would carry the primary's fall-off.
There the level is taken off, the frame is warped, and the level of the new
place is put back: the tags stay true to the byte, whoever reads them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any, Callable, Optional, Tuple

import numpy as np
import numpy.typing as npt

from ..errors import FrameError
from ..headers.values import Numbers
from ..headers.xmp import Xmp, parse
from ..thresholds import Thresholds
from .bands_model import APPLIED, KEPT, VOIDED
from .exif import EXIF_IFD, IMAGE_LENGTH, IMAGE_WIDTH, Entry, TiffBlock
from .metadata import is_tiff

_XMP, _BLACK_LEVEL, _EXPOSURE, _MAKE = 700, 0xC61A, 0x829A, 0x010F
_NUMBER_BYTES = {3: ("H", 2), 4: ("I", 4), 5: ("I", 8)}
_CENTER, _POLYNOMIAL = "Camera:VignettingCenter", "Camera:VignettingPolynomial"
_PLANE, _POWERS = "Camera:VignettingPolynomial2D", "Camera:VignettingPolynomial2DName"
_GRADIENT = "MicaSense:RadiometricCalibration"
_DJI_POLYNOMIAL = ("drone-dji:VignettingData", "drone-dji:VignettingPolynomial")
_DJI_CENTER = ("drone-dji:CalibratedOpticalCenterX", "drone-dji:CalibratedOpticalCenterY")
_BLACK_NAMES = ("Camera:BlackCurrent", "Camera:BlackLevel", "drone-dji:BlackLevel")
_UNPUBLISHED = ("Camera:RowGradient", "MicaSense:RowGradient", "Sentera:VignettingPolynomial")
_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
# Lenses lose at most a few parts of their light: a factor outside of this is no fall-off but a damaged tag.
_LEAST_LEVEL, _MOST_LEVEL = 0.2, 20.0
_MOST_POWER = 12
_PROBES = 33
LOSS, GAIN, PLANE = "loss", "gain", "plane"


@dataclass(frozen=True)
class Correction:
    """What a frame's tags say; ``row`` is a2 / t - a3 per pixel row.

    ``form`` is ``loss`` (light is divided by the radial polynomial), ``gain``
    (multiplied) or ``plane`` (divided by the polynomial over both axes, its
    exponents in ``powers``). What is ``kept`` is put back after warping.
    """

    black: float
    center: Tuple[float, float]
    polynomial: Tuple[float, ...]
    row: float
    form: str = LOSS
    powers: Tuple[Tuple[int, int], ...] = ()
    kept: bool = False

    @property
    def neutral(self) -> bool:
        """There is nothing to apply."""
        return not (self.black or any(self.polynomial) or self.row)

    def level(self, size: Tuple[int, int], out: Optional[Tuple[int, int]] = None) -> npt.NDArray[np.float32]:
        """Factors (h, w) over a frame of ``size`` (width, height), told at ``out`` pixels."""
        width, height = out or size
        x = _centers(width, size[0])
        y = _centers(height, size[1])[:, None]
        level = np.ones((height, width), np.float32)
        if self.form == PLANE:
            total = np.zeros((height, width), np.float32)
            across, down = x / np.float32(size[0]), y / np.float32(size[1])
            for value, (i, j) in zip(self.polynomial, self.powers):
                total += np.float32(value) * across**i * down**j
            level /= total
        elif self.polynomial:
            radius = np.hypot(x - np.float32(self.center[0]), y - np.float32(self.center[1]))
            fall = np.zeros_like(radius)
            for value in reversed(self.polynomial):
                fall = (fall + np.float32(value)) * radius
            level = level * (1.0 + fall) if self.form == GAIN else level / (1.0 + fall)
        if self.row:
            level = level / (1.0 + np.float32(self.row) * y)
        return np.asarray(level, np.float32)

    def applied(self, pixels: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Level (h, w, c) counts; may come out below zero where noise is."""
        level = self.level((pixels.shape[1], pixels.shape[0]))
        return np.asarray((pixels.astype(np.float32) - np.float32(self.black)) * level[..., None])

    def put_back(self, levelled: npt.NDArray[Any], size: Tuple[int, int]) -> npt.NDArray[np.float32]:
        """Counts (h, w, c) that the camera of frames of ``size`` would have written where ``levelled`` lie now."""
        level = self.level(size, (levelled.shape[1], levelled.shape[0]))
        return np.asarray(levelled / level[..., None] + np.float32(self.black), np.float32)


def _centers(count: int, over: int) -> npt.NDArray[np.float32]:
    """Pixel centres of ``count`` pixels in pixels of a frame that has ``over`` of them."""
    return np.asarray((np.arange(count) + 0.5) * (over / count) - 0.5, np.float32)


def correction_of(data: bytes, limits: Thresholds) -> Optional[Correction]:
    """The correction of a frame's bytes; ``None`` where a tag is missing, or in no published form."""
    if not is_tiff(data):
        return None
    try:
        block = TiffBlock(bytearray(data))
        xmp = parse([_packet(block)], limits)
        numbers = Numbers(xmp, [])
        written, exposure = _black_level(block), _exposure(block)
        dji = _text(block, _MAKE).upper() == "DJI"
        size = _size(block)
    except FrameError:
        return None
    gradient = numbers.several(_GRADIENT)
    black = written if written is not None else numbers.one(*_BLACK_NAMES)
    if black is None or size is None or len(gradient) not in (0, 3) or any(xmp.items(n) for n in _UNPUBLISHED):
        return None
    row = 0.0
    if gradient and (gradient[1] or gradient[2]):
        if exposure is None:
            return None
        row = gradient[1] / exposure - gradient[2]
    kept = dji or any(xmp.items(name) for name in (_PLANE, *_DJI_POLYNOMIAL, *_BLACK_NAMES))
    found = _with_falloff(Correction(black, (0.0, 0.0), (), row, kept=kept), xmp, numbers, dji)
    return found if found is not None and _believable(found, size) else None


def _with_falloff(base: Correction, xmp: Xmp, numbers: Numbers, dji: bool) -> Optional[Correction]:
    """``base`` with the fall-off that the tags tell; ``None`` where they are not complete."""
    center = numbers.several(_CENTER)
    if xmp.items(_POLYNOMIAL) or center:
        radial = numbers.several(_POLYNOMIAL)
        if not radial or len(center) != 2:
            return None
        return replace(base, center=(center[0], center[1]), polynomial=radial, form=GAIN if dji else LOSS)
    if any(xmp.items(name) for name in _DJI_POLYNOMIAL):
        radial, at = numbers.several(*_DJI_POLYNOMIAL), [numbers.one(name) for name in _DJI_CENTER]
        if not radial or at[0] is None or at[1] is None:
            return None
        return replace(base, center=(at[0], at[1]), polynomial=radial, form=GAIN)
    if xmp.items(_PLANE):
        terms, powers = numbers.several(_PLANE), numbers.several(_POWERS)
        whole = [int(p) for p in powers if p == int(p) and 0 <= p <= _MOST_POWER]
        if not terms or len(whole) != 2 * len(terms) or len(powers) != len(whole):
            return None
        return replace(base, polynomial=terms, form=PLANE, powers=tuple(zip(whole[::2], whole[1::2])))
    return base


def _believable(correction: Correction, size: Tuple[int, int]) -> bool:
    with np.errstate(all="ignore"):
        level = correction.level(size, (min(_PROBES, size[0]), min(_PROBES, size[1])))
    return bool(np.isfinite(level).all() and level.min() >= _LEAST_LEVEL and level.max() <= _MOST_LEVEL)


def treatment(data: bytes, limits: Thresholds) -> str:
    """What can be done with a frame's radiometry when it is warped: ``applied``, ``kept`` or ``none``."""
    found = correction_of(data, limits)
    if found is None:
        return VOIDED
    if found.kept:
        return KEPT
    try:
        neutralised(data, limits)
    except FrameError:
        return KEPT
    return APPLIED


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
    if len(result) != len(data) or left is None or not left.neutral:
        raise FrameError("radiometry-not-rewritable", "Its radiometric tags cannot be rewritten in place.")
    return result


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


def _size(block: TiffBlock) -> Optional[Tuple[int, int]]:
    found = [block.find(block.first, tag) for tag in (IMAGE_WIDTH, IMAGE_LENGTH)]
    values = [int(block.number(e) or 0) if e is not None else 0 for e in found]
    return (values[0], values[1]) if min(values) > 0 else None


def _text(block: TiffBlock, tag: int) -> str:
    entry = block.find(block.first, tag)
    if entry is None:
        return ""
    return bytes(block.data[entry.value_at : entry.value_at + entry.length]).decode("latin-1").strip("\0 ")


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
    for pattern, zeroed in forms:
        left = keep
        packet = re.sub(pattern, zeroed, packet, count=1)
    return packet


__all__ = ["Correction", "correction_of", "neutralised", "treatment"]
