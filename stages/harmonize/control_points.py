"""The user's control points between two bands: ``--control-points FILE``.

JSON: ``{"pairs": [{"a": "IMG_0001_2.tif", "b": "IMG_0001_6.tif", "points":
[[xa, ya, xb, yb], ...]}]}``. CSV: columns ``a,b,xa,ya,xb,yb`` with a heading.
``a`` and ``b`` are file names of one capture or band names (``Green``,
``LWIR``), which then hold for the whole rig. Pixels, 0,0 being the centre of
the upper left one, in frames as the camera wrote them.
"""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple, Union

from ..errors import UsageError
from ..thresholds import Thresholds

Point = Tuple[float, float, float, float]
_COLUMNS = ("a", "b", "xa", "ya", "xb", "yb")


@dataclass(frozen=True)
class ControlPair:
    """Points seen in two bands: x, y in ``a`` and x, y in ``b``."""

    a: str
    b: str
    points: Tuple[Point, ...]

    def turned(self) -> "ControlPair":
        """The same points with the two sides exchanged."""
        return ControlPair(self.b, self.a, tuple((xb, yb, xa, ya) for xa, ya, xb, yb in self.points))


def read_control_points(file: Union[str, Path], limits: Thresholds) -> Tuple[ControlPair, ...]:
    """Read a file of control points. Raises ``UsageError`` that names the entry at fault."""
    path = Path(file)
    try:
        if path.stat().st_size > limits.max_text_bytes:
            raise UsageError(f"{path} is larger than {limits.max_text_bytes // 2**20} MB: this is no list of points.")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UsageError(f"The control points {path} cannot be read ({error.strerror or error}).") from None
    except UnicodeDecodeError:
        raise UsageError(f"The control points {path} are not UTF-8 text. Save them as JSON or CSV.") from None
    pairs = _from_json(text, path) if text.lstrip().startswith(("{", "[")) else _from_csv(text, path)
    if not pairs:
        raise UsageError(f"There is no control point in {path}.")
    return pairs


def _from_json(text: str, path: Path) -> Tuple[ControlPair, ...]:
    try:
        told = json.loads(text)
    except (ValueError, RecursionError):
        raise UsageError(f"The control points {path} are not valid JSON.") from None
    listed = told.get("pairs") if isinstance(told, dict) else told
    if not isinstance(listed, list):
        raise UsageError(f'{path} needs a list named "pairs", each with "a", "b" and "points".')
    pairs: List[ControlPair] = []
    for number, item in enumerate(listed, 1):
        where = f"Pair {number} of {path}"
        if not isinstance(item, dict) or not isinstance(item.get("points"), list):
            raise UsageError(f'{where} needs "a", "b" and a list "points".')
        points = tuple(_point(values, where) for values in item["points"])
        pairs.append(ControlPair(_name(item.get("a"), where), _name(item.get("b"), where), points))
    return tuple(p for p in pairs if p.points)


def _from_csv(text: str, path: Path) -> Tuple[ControlPair, ...]:
    rows = csv.reader(io.StringIO(text), delimiter=";" if ";" in text.partition("\n")[0] else ",")
    found: Dict[Tuple[str, str], List[Point]] = {}
    try:
        heading = [h.strip().lower() for h in next(rows, [])]
        missing = [c for c in _COLUMNS if c not in heading]
        if missing:
            raise UsageError(f"{path} lacks the column {missing[0]}. Its first line is to be: {','.join(_COLUMNS)}")
        at = [heading.index(c) for c in _COLUMNS]
        for row in rows:
            if not any(cell.strip() for cell in row):
                continue
            where = f"Line {rows.line_num} of {path}"
            if len(row) <= max(at):
                raise UsageError(f"{where} has {len(row)} columns, the first line names {len(heading)}.")
            a, b, *numbers = (row[i].strip() for i in at)
            found.setdefault((_name(a, where), _name(b, where)), []).append(_point(numbers, where))
    except csv.Error as error:
        raise UsageError(f"The control points {path} cannot be read: {error}.") from None
    return tuple(ControlPair(a, b, tuple(points)) for (a, b), points in found.items())


def _name(value: Any, where: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise UsageError(f"{where} does not name its two frames or bands.")
    return value.strip()


def _point(values: Any, where: str) -> Point:
    if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != 4:
        raise UsageError(f"{where}: a point is four numbers, xa, ya, xb, yb.")
    numbers = []
    for value in values:
        try:
            number = math.nan if isinstance(value, bool) else float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            raise UsageError(f"{where}: {value!r} is no pixel position.")
        numbers.append(number)
    return (numbers[0], numbers[1], numbers[2], numbers[3])
