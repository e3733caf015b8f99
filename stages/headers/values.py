"""Numbers, positions and times as XMP and Exif spell them."""

from __future__ import annotations

import math
import re
from datetime import datetime
from typing import List, Optional, Sequence, Tuple

from .xmp import Xmp

_DEGREES = re.compile(r"^\s*(\d+(?:\.\d+)?)(?:,(\d+(?:\.\d+)?))?(?:,(\d+(?:\.\d+)?))?\s*([NSEW])\s*$", re.IGNORECASE)
_TIME = re.compile(r"^\s*(\d{4})[:\-/](\d\d)[:\-/](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:\.(\d+))?")
_DIGITS = re.compile(r"^\s*(\d+)\s*$")


def to_number(text: str) -> Optional[float]:
    """A finite number from ``12.5``, ``+12.5`` or ``25/2``, else ``None``."""
    top, slash, bottom = text.partition("/")
    try:
        number = float(top)
        if slash:
            number /= float(bottom)
    except (ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) and "_" not in text else None


class Numbers:
    """Typed access to XMP properties; what is there and is no number is noted in ``problems``."""

    def __init__(self, xmp: Xmp, problems: List[str]) -> None:
        self._xmp = xmp
        self._problems = problems

    def _bad(self, name: str) -> None:
        note = f"xmp-not-a-number:{name.partition(':')[2]}"
        if note not in self._problems:
            self._problems.append(note)

    def one(self, *names: str) -> Optional[float]:
        """The first of these properties that is a finite number."""
        for name in names:
            text = self._xmp.text(name)
            if text:
                number = to_number(text)
                if number is not None:
                    return number
                self._bad(name)
        return None

    def whole(self, *names: str) -> Optional[int]:
        """The first of these properties as a whole number."""
        number = self.one(*names)
        return int(number) if number is not None and number == int(number) else None

    def several(self, *names: str) -> Tuple[float, ...]:
        """All numbers of the first of these properties, as a list or as text with commas; all or none."""
        for name in names:
            items = self._xmp.items(name)
            if not items:
                continue
            parts = [p for item in items for p in item.replace(";", ",").split(",") if p.strip()]
            if len(parts) == 1:
                parts = parts[0].split()
            numbers = [to_number(p) for p in parts]
            if numbers and all(n is not None for n in numbers):
                return tuple(n for n in numbers if n is not None)
            self._bad(name)
        return ()


def degrees(parts: Sequence[Optional[float]]) -> Optional[float]:
    """Degrees from degrees, minutes and seconds; ``None`` where one of them is missing or below zero."""
    total, scale = 0.0, 1.0
    for part in parts[:3]:
        if part is None or part < 0:
            return None
        total += part / scale
        scale *= 60.0
    return total if parts else None


def degrees_text(text: str) -> Optional[float]:
    """Signed degrees from XMP's ``46,50.5564N`` or ``46,50,33.4N`` or a plain signed number."""
    match = _DEGREES.match(text)
    if match is None:
        return to_number(text) if text else None
    value = degrees([float(g) for g in match.groups()[:3] if g is not None])
    return -value if value is not None and match.group(4).upper() in "SW" else value


def iso_time(text: str, subsec: str = "") -> Optional[str]:
    """ISO text without a zone from Exif or XMP time; ``None`` when it is no date. Sub-seconds to the microsecond."""
    match = _TIME.match(text)
    if match is None:
        return None
    year, month, day, hour, minute, second = (int(g) for g in match.groups()[:6])
    try:
        moment = datetime(year, month, day, hour, minute, second)
    except ValueError:
        return None
    fraction = match.group(7) or ""
    digits = _DIGITS.match(subsec)
    if digits is not None:
        fraction = digits.group(1)
    fraction = fraction[:6].rstrip("0")
    return f"{moment.isoformat()}.{fraction}" if fraction else moment.isoformat()
