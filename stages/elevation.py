"""Ground heights from an elevation model: any raster that GDAL reads, in any coordinate system.

Only the cells around the points asked for are read, so a country's model costs
no more memory than a field's. GDAL serves by its Python bindings, or by its
programs where those are missing.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

from .errors import FrameError, MissingDependency, UsageError
from .gdal_tools import find_gdal
from .geo import metres_per_degree
from .thresholds import DEFAULTS, Thresholds

LatLon = Tuple[float, float]
Pixel = Tuple[float, float]
Cell = Tuple[int, int]

_NEEDED_FOR = "--ground FILE"
_COMMAND = "apt-get install gdal-bin (or: pip install 'sensorgate[geo]')"
_PROGRAM_SETTINGS = {"GDAL_PAM_ENABLED": "NO", "PROJ_NETWORK": "OFF", "GDAL_CACHEMAX": "64"}
_BLOCK = 1 << 20
_HASHED_WHOLE = 64 * _BLOCK
_HASHED_IN_ALL = 512 * _BLOCK
_HELD = 64 * _BLOCK
_STEP_DEG = 1e-4
_FOOT_M, _US_FOOT_M = 0.3048, 1200.0 / 3937.0
_UNIT_WORDS = (
    (re.compile(r"us.*(ft|foot|feet)|(ft|foot|feet).*us"), _US_FOOT_M),
    (re.compile(r"ft|foot|feet"), _FOOT_M),
    (re.compile(r"^m\b|^met(re|er)"), 1.0),
)
_TYPE_BYTES = {"Byte": 1, "Int8": 1, "Int16": 2, "UInt16": 2, "Int32": 4, "UInt32": 4, "Float32": 4}


@dataclass(frozen=True)
class ElevationSource:
    """What an elevation model says of itself.

    ``vertical`` is the zero of its heights as the file names it, ``""`` where
    it does not. ``digest`` is the SHA-256, hex, over the content of its files
    (large ones by evenly spaced parts).
    """

    name: str
    width: int
    height: int
    vertical: str
    digest: str


class Elevation:
    """An opened elevation model; ``file`` is where it lies."""

    def __init__(self, file: Path, source: ElevationSource, band: "_Band", cells: "_Cells") -> None:
        self.file = file
        self.source = source
        self._band = band
        self._cells = cells

    def sample(self, points: Sequence[LatLon]) -> Tuple[Optional[float], ...]:
        """Ground height in metres at each (latitude, longitude) on WGS84, bilinear between cell centres.

        ``None`` outside the model and over its voids: where valid cells have
        less than half of the weight. Raises ``UsageError`` where the file
        cannot be read to the end.
        """
        pixels = self._cells.pixels(points)
        weights = [_weights(p, self.source.width, self.source.height) if p else {} for p in pixels]
        wanted = sorted({cell for around in weights for cell in around})
        heights = {c: self._band.height_m(v) for c, v in self._cells.values(wanted).items()}
        return tuple(_blend(around, heights) for around in weights)

    def spacing_m(self, point: LatLon) -> Optional[float]:
        """Distance of neighbouring cells at a point in metres, ``None`` where the coordinate system ends."""
        latitude, longitude = point
        here, there = self._cells.pixels([point, (latitude + _STEP_DEG, longitude)])
        if here is None or there is None:
            return None
        gap = math.hypot(there[0] - here[0], there[1] - here[1])
        return _STEP_DEG * metres_per_degree(latitude)[0] / gap if gap > 0 else None


def _weights(pixel: Pixel, width: int, height: int) -> Dict[Cell, float]:
    """Cells around a pixel position with their bilinear weights; empty outside. Cell centres lie at halves."""
    x, y = pixel
    if not (0.0 <= x <= width and 0.0 <= y <= height):
        return {}
    x, y = min(max(x - 0.5, 0.0), width - 1.0), min(max(y - 0.5, 0.0), height - 1.0)
    left, top = int(x), int(y)
    right, below = x - left, y - top
    around = {
        (left, top): (1 - right) * (1 - below),
        (left + 1, top): right * (1 - below),
        (left, top + 1): (1 - right) * below,
        (left + 1, top + 1): right * below,
    }
    return {cell: weight for cell, weight in around.items() if weight > 0}


def _blend(around: Mapping[Cell, float], heights: Mapping[Cell, Optional[float]]) -> Optional[float]:
    valid = [(w, h) for cell, w in sorted(around.items()) if (h := heights.get(cell)) is not None]
    share = sum(w for w, _ in valid)
    return sum(w * h for w, h in valid) / share if share >= 0.5 else None


@dataclass(frozen=True)
class _Band:
    """How a stored number becomes a height in metres."""

    scale: float
    offset: float
    unit_m: float
    nodata: Optional[float]
    low_m: float
    high_m: float

    def height_m(self, stored: Optional[float]) -> Optional[float]:
        if stored is None or not math.isfinite(stored):
            return None
        # A void value is compared as a 32-bit float: that is how it was stored.
        if self.nodata is not None and abs(stored - self.nodata) <= 1e-6 * max(1.0, abs(self.nodata)):
            return None
        height = (stored * self.scale + self.offset) * self.unit_m
        return height if self.low_m <= height <= self.high_m else None


class _Cells:
    """Positions in pixels (corner of the upper left cell = 0, 0) and stored numbers of cells."""

    def pixels(self, points: Sequence[LatLon]) -> List[Optional[Pixel]]:
        """Pixel position of each point, ``None`` where the coordinate system does not reach."""
        raise NotImplementedError

    def values(self, cells: Sequence[Cell]) -> Dict[Cell, Optional[float]]:
        """Stored number of each cell."""
        raise NotImplementedError


class _Bindings(_Cells):
    def __init__(self, gdal: Any, file: Path) -> None:
        self._file = file
        try:
            self._dataset = gdal.OpenEx(str(file), gdal.OF_RASTER | gdal.OF_READONLY)
            # The order of axes is longitude, latitude here whatever the authority says.
            self._transformer = gdal.Transformer(self._dataset, None, ["DST_SRS=EPSG:4326"])
        except RuntimeError as error:
            raise _no_grid(file, str(error)) from None
        self._band = self._dataset.GetRasterBand(1)
        self._float64 = gdal.GDT_Float64
        self._kind = gdal.GetDataTypeName(self._band.DataType)

    def pixels(self, points: Sequence[LatLon]) -> List[Optional[Pixel]]:
        return [self._pixel(latitude, longitude) for latitude, longitude in points]

    def _pixel(self, latitude: float, longitude: float) -> Optional[Pixel]:
        try:
            good, place = self._transformer.TransformPoint(1, longitude, latitude)
        except RuntimeError:
            return None
        return (place[0], place[1]) if good and math.isfinite(place[0]) and math.isfinite(place[1]) else None

    def values(self, cells: Sequence[Cell]) -> Dict[Cell, Optional[float]]:
        import struct

        wide, high = self._band.GetBlockSize()
        size = wide * high * _TYPE_BYTES.get(self._kind, 8)
        blocks: Dict[Cell, List[Cell]] = {}
        for x, y in cells:
            blocks.setdefault((y // high, x // wide), []).append((x, y))
        found: Dict[Cell, Optional[float]] = {}
        held = 0
        # Block by block, so that each is unpacked once and few are held.
        for block in sorted(blocks):
            for x, y in sorted(blocks[block]):
                try:
                    raw = self._band.ReadRaster(x, y, 1, 1, buf_type=self._float64)
                except RuntimeError as error:
                    raise _unreadable(self._file, str(error)) from None
                found[(x, y)] = struct.unpack("d", bytes(raw))[0]
            held += size
            if held > _HELD:
                self._dataset.FlushCache()
                held = 0
        return found


class _Programs(_Cells):
    def __init__(self, file: Path) -> None:
        self._file = file
        # Asked once here, so that a raster without a grid is told before anything rests on it.
        self._run(["gdaltransform", "-output_xy", str(file)], ["0 0"])

    def pixels(self, points: Sequence[LatLon]) -> List[Optional[Pixel]]:
        asked = [f"{lon!r} {lat!r}" for lat, lon in points]
        told = self._run(["gdaltransform", "-i", "-output_xy", "-t_srs", "EPSG:4326", str(self._file)], asked)
        return [_pair(line) for line in told]

    def values(self, cells: Sequence[Cell]) -> Dict[Cell, Optional[float]]:
        asked = [f"{x} {y}" for x, y in sorted(cells, key=lambda c: (c[1], c[0]))]
        told = self._run(["gdallocationinfo", "-valonly", "-b", "1", str(self._file)], asked)
        numbers = [float(line) if line.strip() else None for line in told]
        return dict(zip(sorted(cells, key=lambda c: (c[1], c[0])), numbers))

    def _run(self, command: List[str], asked: List[str]) -> List[str]:
        if not asked:
            return []
        try:
            done = subprocess.run(
                command,
                input="\n".join(asked) + "\n",
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
                env={**os.environ, **_PROGRAM_SETTINGS},
            )
        except OSError:
            raise MissingDependency("GDAL", _NEEDED_FOR, _COMMAND) from None
        lines = done.stdout.splitlines()
        if len(lines) != len(asked):
            raise (_no_grid if command[0] == "gdaltransform" else _unreadable)(self._file, done.stderr)
        return lines


def _pair(line: str) -> Optional[Pixel]:
    try:
        x, y = (float(part) for part in line.split()[:2])
    except ValueError:
        return None
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None


def open_elevation(file: str, limits: Thresholds = DEFAULTS) -> Elevation:
    """Open an elevation model.

    Raises ``UsageError`` where the file is missing, is no raster of heights or
    says not where it lies, and ``MissingDependency`` without GDAL.
    """
    path = Path(os.path.abspath(file))  # GDAL's programs would take a leading dash for an option
    if not path.is_file():
        raise UsageError(f"--ground: there is no file {file}. Give an elevation model or a height in metres.")
    try:
        info = find_gdal().info(path)
    except MissingDependency:
        raise MissingDependency("GDAL", _NEEDED_FOR, _COMMAND) from None
    except FrameError as error:
        raise UsageError(f"--ground: {error.message}. Give a raster of heights such as a GeoTIFF.") from None
    band = _band(path, info, limits)
    wkt = str((info.get("coordinateSystem") or {}).get("wkt") or "")
    width, height = (int(n) for n in info["size"])
    source = ElevationSource(
        name=path.name,
        width=width,
        height=height,
        vertical=_vertical(wkt),
        digest=_digest(path, info),
    )
    return Elevation(path, source, band, _cells(path))


def _cells(path: Path) -> _Cells:
    try:
        from osgeo import gdal
    except ImportError:
        return _Programs(path)
    return _Bindings(gdal, path)


def _band(path: Path, info: Mapping[str, Any], limits: Thresholds) -> _Band:
    """Check that the raster is one of heights with a place on Earth, and how its numbers are meant."""
    wkt = str((info.get("coordinateSystem") or {}).get("wkt") or "")
    if not wkt:
        raise UsageError(
            f"--ground: {path.name} has no coordinate system. Name the right one with: "
            f"gdal_translate -a_srs EPSG:CODE {path.name} with-crs.tif"
        )
    if "geoTransform" not in info and not info.get("gcps"):
        raise UsageError(f"--ground: {path.name} says not where on Earth it lies. Give a georeferenced raster.")
    bands = info.get("bands") or []
    if not bands or bands[0].get("colorInterpretation") in ("Red", "Palette", "Hue", "Cyan"):
        raise UsageError(f"--ground: {path.name} is a picture, not a raster of heights.")
    band = bands[0]
    block = math.prod(int(n) for n in band.get("block", (1, 1))) * _TYPE_BYTES.get(str(band.get("type")), 8)
    if block > limits.dem_block_mb * 2**20:
        raise UsageError(
            f"--ground: {path.name} is stored in one piece of {block // 2**20} MB. Write it in tiles first: "
            f"gdal_translate -co TILED=YES -co COMPRESS=DEFLATE {path.name} tiled.tif"
        )
    unit = str(band.get("unit") or "").strip().lower()
    unit_m = next((m for words, m in _UNIT_WORDS if words.search(unit)), None) if unit else _vertical_unit_m(wkt)
    if unit_m is None:
        raise UsageError(f"--ground: {path.name} says its numbers are {unit[:40]!r}, not metres or feet.")
    return _Band(
        scale=_number(band.get("scale"), 1.0),
        offset=_number(band.get("offset"), 0.0),
        unit_m=unit_m,
        nodata=None if band.get("noDataValue") is None else _number(band["noDataValue"], math.nan),
        low_m=limits.ground_min_m,
        high_m=limits.ground_max_m,
    )


def _number(value: Any, otherwise: float) -> float:
    try:
        return otherwise if value is None else float(value)
    except (TypeError, ValueError):
        return otherwise


_VERTICAL = re.compile(r'VERT(?:CRS|_CS|ICALCRS)\s*\[\s*"([^"]*)"')
_UNIT = re.compile(r'(?:LENGTHUNIT|UNIT)\s*\[\s*"[^"]*"\s*,\s*([0-9.eE+-]+)')


def _vertical(wkt: str) -> str:
    found = _VERTICAL.search(wkt)
    if found:
        return found.group(1)[:80]
    return "ellipsoid" if re.search(r"CS\s*\[\s*ellipsoidal\s*,\s*3\s*\]", wkt) else ""


def _vertical_unit_m(wkt: str) -> float:
    """Metres per unit of the vertical axis where the coordinate system has one."""
    found = _VERTICAL.search(wkt)
    unit = _UNIT.search(wkt, found.end()) if found else None
    return _number(unit.group(1), 1.0) if unit else 1.0


def _digest(path: Path, info: Mapping[str, Any]) -> str:
    """Identity of the model: its files by name, size and content, bounded in reading.

    What GDAL makes of them is left out: its spelling changes with its version.
    """
    digest = hashlib.sha256()
    left = _HASHED_IN_ALL
    for file in _files(path, info.get("files") or ()):
        try:
            size = file.stat().st_size
            digest.update(f"\0{file.name}\0{size}\0".encode("utf-8", "surrogateescape"))
            if left > 0:
                left -= _hash_parts(file, size, digest)
        except OSError:
            continue
    return digest.hexdigest()


def _files(path: Path, told: Iterable[str]) -> List[Path]:
    return sorted({path, *(Path(str(t)) for t in told)}, key=lambda p: (p.name, str(p)))


def _hash_parts(file: Path, size: int, digest: Any) -> int:
    """Hash a file whole, or 64 evenly spaced parts of a large one; returns the bytes read."""
    parts = [(0, size)]
    if size > _HASHED_WHOLE:
        count = _HASHED_WHOLE // _BLOCK
        parts = [((size - _BLOCK) * i // (count - 1), _BLOCK) for i in range(count)]
    with open(file, "rb") as stream:
        for start, length in parts:
            stream.seek(start)
            while length > 0:
                block = stream.read(min(length, _BLOCK))
                if not block:
                    break
                digest.update(block)
                length -= len(block)
    return min(size, _HASHED_WHOLE)


def _last_line(detail: str) -> str:
    lines = [line.strip() for line in detail.splitlines() if line.strip()]
    return lines[-1] if lines else "no reason given"


def _unreadable(path: Path, detail: str) -> UsageError:
    return UsageError(f"--ground: {path.name} cannot be read ({_last_line(detail)}). Copy or download it again.")


def _no_grid(path: Path, detail: str) -> UsageError:
    return UsageError(
        f"--ground: the coordinate system of {path.name} has no place on Earth ({_last_line(detail)}). "
        f"Name the right one with: gdal_translate -a_srs EPSG:CODE {path.name} with-crs.tif"
    )
