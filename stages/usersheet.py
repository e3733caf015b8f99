"""The user's own calibration sheet: JSON or CSV, read strictly.

Columns (CSV) or keys (JSON rows, or ``{"rows": [...]}``), ``make``, ``model`` and
one of ``sensor_width_mm``, ``focal_px`` are needed, the rest may be empty:
``make, model, width, height, lens, spectrum, band, serial, sensor_width_mm,
focal_mm, focal_px, pixel_um, projection, corrected_in_camera, k1, k2, p1, p2,
k3, cx, cy``. ``cx`` and ``cy`` are the principal point in pixels from the upper
left corner, the distortion is Brown's in OpenCV's order on ray-normalised
coordinates, ``width`` and ``height`` are those of the calibrated frames.
"""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

from .errors import UsageError
from .profile import SPECTRA
from .sensors import USER, SheetRow

TEXT = ("make", "model", "lens", "spectrum", "band", "serial", "projection", "corrected_in_camera")
DISTORTION = ("k1", "k2", "p1", "p2", "k3")
POSITIVE = ("width", "height", "sensor_width_mm", "focal_mm", "focal_px", "pixel_um", "cx", "cy")
COLUMNS = TEXT + POSITIVE + DISTORTION
MAX_BYTES = 4 * 1024 * 1024
_YES = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False, "": None, "unknown": None}

_Fault = Callable[[str, str], UsageError]


def read_user_sheet(path: Path) -> Tuple[SheetRow, ...]:
    """The rows of a user's sheet; ``UsageError`` names the line (or row) and column that is wrong."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise UsageError(f"{path.name} is larger than a calibration sheet can be ({MAX_BYTES // 2**20} MB).")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UsageError(f"The calibration sheet {path} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path.name} is not UTF-8 text; save it as UTF-8.") from error
    records = _json_records(path.name, text) if path.suffix.lower() == ".json" else _csv_records(path.name, text)
    return tuple(
        _row(values, f"user-{number}", _fault(path.name, where)) for number, (where, values) in enumerate(records, 1)
    )


def _fault(file: str, where: str) -> _Fault:
    return lambda column, message: UsageError(f"{file}, {where}, column {column!r}: {message}")


def _json_records(file: str, text: str) -> List[Tuple[str, Mapping[str, Any]]]:
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise UsageError(f"{file}, line {error.lineno}, column {error.colno}: {error.msg}.") from error
    except RecursionError as error:
        raise UsageError(f"{file} is nested too deeply for a calibration sheet.") from error
    rows = data.get("rows") if isinstance(data, dict) else data
    if not isinstance(rows, list):
        raise UsageError(f'{file}: a calibration sheet is a list of rows, or {{"rows": [...]}}.')
    records: List[Tuple[str, Mapping[str, Any]]] = []
    for number, row in enumerate(rows, 1):
        if not isinstance(row, dict):
            raise UsageError(f"{file}, row {number}: a row is an object with the columns as keys.")
        records.append((f"row {number}", row))
    return records


def _csv_records(file: str, text: str) -> List[Tuple[str, Mapping[str, Any]]]:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=";" if _semicolons(text) else ",")
    records: List[Tuple[str, Mapping[str, Any]]] = []
    header: Optional[List[str]] = None
    try:
        for cells in reader:
            if not any(c.strip() for c in cells) or cells[0].lstrip().startswith("#"):
                continue
            if header is None:
                header = [c.strip().lower() for c in cells]
                continue
            if len(cells) > len(header):
                raise UsageError(
                    f"{file}, line {reader.line_num}, column {len(header) + 1}: "
                    f"the header names only {len(header)} columns."
                )
            records.append((f"line {reader.line_num}", dict(zip(header, cells))))
    except csv.Error as error:
        raise UsageError(f"{file}, line {reader.line_num}: {error}.") from error
    if header is None:
        raise UsageError(f"{file} is empty; its first line must name the columns: {', '.join(COLUMNS)}.")
    for name in header:
        if name not in COLUMNS:
            raise UsageError(f"{file}, line 1, column {name!r}: unknown. Known columns: {', '.join(COLUMNS)}.")
    return records


def _semicolons(text: str) -> bool:
    first = text.split("\n", 1)[0]
    return first.count(";") > first.count(",")


def _number(values: Mapping[str, Any], column: str, fault: _Fault) -> Optional[float]:
    value = values.get(column)
    if value is None or (isinstance(value, str) and not value.strip()):
        return None
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise fault(column, f"{value!r} is not a number.")
    if column in POSITIVE and number <= 0:
        raise fault(column, f"{value!r} must be greater than 0.")
    return number


def _row(values: Mapping[str, Any], name: str, fault: _Fault) -> SheetRow:
    for key in values:
        if key not in COLUMNS:
            raise fault(str(key), f"unknown. Known columns: {', '.join(COLUMNS)}.")
    text: Dict[str, str] = {}
    for column in TEXT:
        value = values.get(column, "")
        if not isinstance(value, (str, int, float, type(None))):
            raise fault(column, f"{value!r} is not a text.")
        text[column] = "" if value is None else str(value).strip()
    for column in ("make", "model"):
        if not text[column]:
            raise fault(column, "must not be empty.")
    spectrum = text["spectrum"].lower()
    if spectrum and spectrum not in SPECTRA:
        raise fault("spectrum", f"{text['spectrum']!r} is none of {', '.join(SPECTRA)}.")
    projection = text["projection"].lower() or "brown"
    if projection not in ("brown", "perspective", "fisheye"):
        raise fault("projection", f"{text['projection']!r} is none of brown, perspective, fisheye.")
    corrected = text["corrected_in_camera"].lower()
    if corrected not in _YES:
        raise fault("corrected_in_camera", f"{text['corrected_in_camera']!r} is none of true, false or empty.")
    numbers = {column: _number(values, column, fault) for column in POSITIVE + DISTORTION}
    size = _size(numbers, fault)
    return SheetRow(
        id=name,
        makes=(text["make"],),
        models=(text["model"],),
        source="user's calibration sheet",
        spectrum=spectrum,
        band=text["band"].lower(),
        lenses=(text["lens"],) if text["lens"] else (),
        serial=text["serial"],
        sizes=(size,) if size else (),
        sensor_width_mm=_sensor_width(numbers, size, fault),
        focal_mm=numbers["focal_mm"],
        focal_px=numbers["focal_px"],
        pixel_um=numbers["pixel_um"],
        projection="brown" if projection == "perspective" else projection,
        corrected_jpeg=_YES[corrected],
        corrected_raw=_YES[corrected],
        center_px=_center(numbers, size, fault),
        distortion=_distortion(numbers),
        origin=USER,
    )


def _size(numbers: Mapping[str, Optional[float]], fault: _Fault) -> Optional[Tuple[int, int]]:
    width, height = numbers["width"], numbers["height"]
    if (width is None) != (height is None):
        raise fault("height" if height is None else "width", "width and height belong together.")
    if width is None or height is None:
        return None
    for column, value in (("width", width), ("height", height)):
        if value != int(value):
            raise fault(column, "pixels are whole numbers.")
    return int(width), int(height)


def _sensor_width(
    numbers: Mapping[str, Optional[float]], size: Optional[Tuple[int, int]], fault: _Fault
) -> Optional[float]:
    width_mm, pitch, focal_px = numbers["sensor_width_mm"], numbers["pixel_um"], numbers["focal_px"]
    if focal_px is not None and size is None:
        raise fault("width", "a focal length in pixels needs the width and height that it belongs to.")
    if width_mm is not None:
        return width_mm
    if pitch is not None and size is not None:
        return pitch * size[0] / 1000.0
    if focal_px is None:
        raise fault("sensor_width_mm", "must not be empty where focal_px is empty.")
    return None


def _center(
    numbers: Mapping[str, Optional[float]], size: Optional[Tuple[int, int]], fault: _Fault
) -> Optional[Tuple[float, float]]:
    cx, cy = numbers["cx"], numbers["cy"]
    if cx is None and cy is None:
        return None
    if cx is None or cy is None:
        raise fault("cx" if cx is None else "cy", "cx and cy belong together.")
    if size is None:
        raise fault("width", "a principal point in pixels needs the width and height that it belongs to.")
    if cx >= size[0] or cy >= size[1]:
        raise fault("cx" if cx >= size[0] else "cy", "the principal point lies outside the frame.")
    return cx, cy


def _distortion(numbers: Mapping[str, Optional[float]]) -> Optional[Tuple[float, ...]]:
    if all(numbers[k] is None for k in DISTORTION):
        return None
    return tuple(numbers[k] or 0.0 for k in DISTORTION)
