"""Orthophotos of several payloads on one grid, in one file, with the distance between them measured.

Every raster is warped (bilinear) to the finest resolution of all, the bands
are stacked under their names and written as a cloud-optimized GeoTIFF (tiled
256, LZW). Nothing is shifted to fit: how far two payloads lie apart is
measured and told.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple
from xml.sax.saxutils import escape, quoteattr

from .errors import BlockedError, FrameError, UsageError
from .finding import Finding, sort_key
from .gdal_tools import Gdal, find_gdal, looks_like_tiff
from .harmonize.files import output_error
from .progress import Cancel, Progress, check
from .raster_findings import apart, of_shift, reprojected, unusable
from .raster_shift import Shift, measure_shift
from .thresholds import Thresholds

STAGE = "fuse"
_TILES = ("TILED=YES", "BLOCKXSIZE=256", "BLOCKYSIZE=256", "COMPRESS=LZW", "BIGTIFF=IF_SAFER")
_COG = ("COMPRESS=LZW", "BLOCKSIZE=256", "BIGTIFF=IF_SAFER", "RESAMPLING=AVERAGE")
_ALPHA = "Alpha"
_ORDER = ("Byte", "UInt16", "Int16", "UInt32", "Int32", "Float32", "Float64")
_RANGE = {"Byte": (0, 2**8 - 1), "UInt16": (0, 2**16 - 1), "Int16": (-(2**15), 2**15 - 1)}
# Below every 16-bit value, and below every 32-bit one.
_HOLE_UINT16, _HOLE_FLOAT, _HOLE_DOUBLE = 65535.0, -99999.0, -1e10


@dataclass(frozen=True)
class RasterBand:
    """One band of a source: its place (from 1), name, type and no-data value."""

    index: int
    name: str
    kind: str
    nodata: Optional[float]


@dataclass(frozen=True)
class Raster:
    """One source: who it belongs to, its coordinate system (WKT), bands without alpha, pixel size and extent.

    ``extent`` is west, south, east, north; ``pixel`` the size of a pixel; both
    in the coordinate system that the fused file will have.
    """

    name: str
    file: str
    crs: str
    bands: Tuple[RasterBand, ...]
    pixel: float = 0.0
    extent: Tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class FusedBand:
    """A band of the fused file, from 1, with the source it came from."""

    index: int
    name: str
    source: str
    source_band: int


@dataclass(frozen=True)
class Fusion:
    """What was fused. ``shifts`` are the distances of the other sources from ``reference``."""

    file: str
    crs: str
    pixel: float
    width: int
    height: int
    kind: str
    nodata: float
    reference: str
    bands: Tuple[FusedBand, ...]
    shifts: Tuple[Shift, ...]
    findings: Tuple[Finding, ...]


def fuse_rasters(
    sources: Sequence[Tuple[str, Path]],
    out: Path,
    thresholds: Thresholds,
    *,
    gdal: Optional[Gdal] = None,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Fusion:
    """Fuse ``sources`` (name, file) into ``out``; originals are only read.

    Raises ``BlockedError`` where no source can be used, ``UsageError`` for an
    ``out`` that cannot be written or is a source, ``MissingDependency``
    without GDAL, ``Cancelled``.
    """
    engine = gdal or find_gdal()
    if os.path.realpath(out) in {os.path.realpath(path) for _, path in sources}:
        raise UsageError(f"{out} is one of the orthophotos. Choose another --out.")
    findings: List[Finding] = []
    rasters = _described(engine, sources, findings)
    if not rasters:
        why = findings[0].message if findings else "There is none."
        raise BlockedError(f"No orthophoto can be fused. {why}")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=".fuse-", dir=out.parent))
    except OSError as error:
        raise output_error(out, error) from None
    try:
        return _fused(engine, rasters, out, scratch, findings, thresholds, progress, cancel)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _described(gdal: Gdal, sources: Sequence[Tuple[str, Path]], findings: List[Finding]) -> List[Raster]:
    """The sources that have a place on the map; the others are told."""
    rasters: List[Raster] = []
    for name, path in sorted(sources):
        try:
            if not looks_like_tiff(path):
                raise FrameError("raster-unusable", f"{path.name} is no readable TIFF.")
            rasters.append(described(name, path, gdal.info(path)))
        except FrameError as error:
            findings.append(unusable(name, error.code, error.message))
    return rasters


def described(name: str, path: Path, info: Dict[str, Any]) -> Raster:
    """Read gdalinfo's JSON; ``FrameError`` ``raster-without-crs`` where a raster has no place on the map."""
    crs = str((info.get("coordinateSystem") or {}).get("wkt") or "")
    if not crs:
        raise FrameError("raster-without-crs", "its orthophoto has no coordinate system.")
    if len(info.get("geoTransform") or ()) != 6:
        raise FrameError("raster-without-crs", "its orthophoto has no place in its coordinate system.")
    bands = []
    for entry in info.get("bands", ()):
        colour = str(entry.get("colorInterpretation", ""))
        if colour == _ALPHA:
            continue
        label = str(entry.get("description") or "") or (colour if colour not in ("", "Undefined", "Gray") else "")
        nodata = entry.get("noDataValue")
        bands.append(
            RasterBand(
                int(entry["band"]),
                label or f"band {entry['band']}",
                str(entry.get("type", "")),
                None if nodata is None else float(nodata),
            )
        )
    if not bands or any(b.kind not in _ORDER for b in bands):
        raise FrameError("raster-unusable", "its orthophoto has no band of real numbers.")
    return Raster(name, str(path), crs, tuple(bands))


def common_crs(rasters: Sequence[Raster]) -> str:
    """The coordinate system of most rasters; of equals the first by name."""
    counts = Counter(_same(r.crs) for r in rasters)
    best = min(rasters, key=lambda r: (-counts[_same(r.crs)], r.name))
    return best.crs


def _same(wkt: str) -> str:
    """Spelling of a coordinate system without its layout."""
    return "".join(wkt.split())


def common_type(bands: Sequence[RasterBand]) -> Tuple[str, float]:
    """Pixel type and no-data value that hold every band.

    A no-data value that all bands share is kept. Otherwise one is taken that
    no pixel can have, which may ask for the next larger type.
    """
    widest = max((b.kind for b in bands), key=_ORDER.index)
    kinds = {b.kind for b in bands}
    if "UInt16" in kinds and "Int16" in kinds:
        widest = "Float32" if _ORDER.index(widest) <= _ORDER.index("Float32") else widest
    if kinds & {"UInt32", "Int32"} and len(kinds) > 1:
        widest = "Float64"
    holes = {b.nodata for b in bands}
    shared = next(iter(holes)) if len(holes) == 1 else None
    if shared is not None:
        low, high = _RANGE.get(widest, (-math.inf, math.inf))
        if math.isnan(shared) or low <= shared <= high:
            return widest, shared
    if widest == "Byte":
        return "UInt16", _HOLE_UINT16
    if widest in ("UInt32", "Int32", "Float64"):
        return "Float64", _HOLE_DOUBLE
    return "Float32", _HOLE_FLOAT


def fused_bands(rasters: Sequence[Raster]) -> Tuple[FusedBand, ...]:
    """Bands in the order of the sources; a name that stands twice gets its source in front."""
    counts = Counter(b.name for r in rasters for b in r.bands)
    found: List[FusedBand] = []
    for raster in rasters:
        for place, band in enumerate(raster.bands, 1):
            name = band.name if counts[band.name] == 1 else f"{raster.name}: {band.name}"
            found.append(FusedBand(len(found) + 1, name, raster.name, place))
    return tuple(found)


def together(rasters: Sequence[Raster]) -> Tuple[List[Raster], List[Raster]]:
    """Those that overlap one another, as the largest such group by area, and the rest."""
    groups: List[List[Raster]] = []
    for raster in rasters:
        touching = [g for g in groups if any(overlap(raster.extent, o.extent) for o in g)]
        joined = [raster] + [r for g in touching for r in g]
        groups = [g for g in groups if g not in touching] + [joined]

    def area(group: Sequence[Raster]) -> float:
        return sum((r.extent[2] - r.extent[0]) * (r.extent[3] - r.extent[1]) for r in group)

    main = max(groups, key=lambda g: (len(g), area(g), sorted(r.name for r in g)))
    names = {r.name for r in main}
    return [r for r in rasters if r.name in names], [r for r in rasters if r.name not in names]


def overlap(
    a: Tuple[float, float, float, float], b: Tuple[float, float, float, float]
) -> Optional[Tuple[float, float, float, float]]:
    """The extent that two share, or ``None``."""
    west, south, east, north = max(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), min(a[3], b[3])
    return (west, south, east, north) if east > west and north > south else None


def _fused(
    gdal: Gdal,
    rasters: Sequence[Raster],
    out: Path,
    scratch: Path,
    findings: List[Finding],
    limits: Thresholds,
    progress: Optional[Progress],
    cancel: Optional[Cancel],
) -> Fusion:
    crs = common_crs(rasters)
    other = [r.name for r in rasters if _same(r.crs) != _same(crs)]
    findings.extend([reprojected(other)] if other else [])
    srs = scratch / "crs.wkt"
    srs.write_text(crs, encoding="utf-8")
    placed = [_placed(gdal, raster, srs, scratch / f"{i}.vrt") for i, raster in enumerate(rasters)]
    near, far = together(placed)
    findings.extend(apart(raster.name) for raster in far)
    reference = min(near, key=lambda r: (r.pixel, r.name))
    pixel = reference.pixel
    extent = _extent(near, pixel)
    width, height = round((extent[2] - extent[0]) / pixel), round((extent[3] - extent[1]) / pixel)
    if width * height > limits.fuse_max_gigapixels * 1e9:
        raise UsageError(
            f"The fused file would have {width} x {height} pixels. Fuse fewer orthophotos, or give files of one site."
        )
    kind, hole = common_type([b for r in near for b in r.bands])
    tiles: Dict[str, Path] = {}
    for number, raster in enumerate(near):
        check(cancel)
        tiles[raster.name] = scratch / f"on-grid-{number}.tif"
        _to_grid(gdal, raster, tiles[raster.name], srs, extent, pixel, kind, hole)
        if progress:
            progress(STAGE, number + 1, 2 * len(near) + 1)
    bands = fused_bands(near)
    stack = scratch / "stack.vrt"
    stack.write_text(_stack(crs, extent, pixel, (width, height), kind, hole, bands, tiles), encoding="utf-8")
    part = scratch / "fused.tif"
    options = [o for c in _COG for o in ("-co", c)]
    gdal.translate(["-of", "COG", *options], stack, part)
    shifts = []
    for number, raster in enumerate(near):
        check(cancel)
        shared = overlap(raster.extent, reference.extent)
        if raster is not reference and shared is not None:
            pair = (tiles[reference.name], tiles[raster.name])
            sizes = (pixel, max(raster.pixel, pixel))
            shift = measure_shift(gdal, pair, shared, sizes, (raster.name, reference.name), scratch, limits)
            shifts.append(shift)
            told = of_shift(shift, limits)
            findings.extend([told] if told is not None else [])
        if progress:
            progress(STAGE, len(near) + number + 1, 2 * len(near) + 1)
    try:
        part.replace(out)
    except OSError as error:
        raise output_error(out, error) from None
    if progress:
        progress(STAGE, 2 * len(near) + 1, 2 * len(near) + 1)
    return Fusion(
        file=out.name,
        crs=crs,
        pixel=pixel,
        width=width,
        height=height,
        kind=kind,
        nodata=hole,
        reference=reference.name,
        bands=bands,
        shifts=tuple(shifts),
        findings=tuple(sorted(findings, key=sort_key)),
    )


def _placed(gdal: Gdal, raster: Raster, srs: Path, view: Path) -> Raster:
    """Pixel size and extent as GDAL would warp the raster, north up, into the common coordinate system."""
    gdal.warp(["-of", "VRT", "-t_srs", str(srs)], Path(raster.file).resolve(), view)
    info = gdal.info(view)
    west, step, _, north, _, down = (float(v) for v in info["geoTransform"])
    width, height = (int(v) for v in info["size"])
    extent = (west, north + down * height, west + step * width, north)
    return replace(raster, pixel=min(abs(step), abs(down)), extent=extent)


def _extent(rasters: Sequence[Raster], pixel: float) -> Tuple[float, float, float, float]:
    """The extent of all, widened to whole pixels counted from the origin of the coordinate system."""
    west, south = (math.floor(min(r.extent[i] for r in rasters) / pixel + 1e-9) * pixel for i in (0, 1))
    east, north = (math.ceil(max(r.extent[i] for r in rasters) / pixel - 1e-9) * pixel for i in (2, 3))
    return west, south, east, north


def _to_grid(
    gdal: Gdal,
    raster: Raster,
    target: Path,
    srs: Path,
    extent: Tuple[float, float, float, float],
    pixel: float,
    kind: str,
    hole: float,
) -> None:
    options = ["-t_srs", str(srs), "-tr", repr(pixel), repr(pixel), "-te", *(repr(v) for v in extent)]
    options += ["-r", "bilinear", "-ot", kind, "-dstnodata", repr(hole), "-of", "GTiff"]
    gdal.warp([*options, *(o for c in _TILES for o in ("-co", c))], Path(raster.file).resolve(), target)


def _stack(
    crs: str,
    extent: Tuple[float, float, float, float],
    pixel: float,
    size: Tuple[int, int],
    kind: str,
    hole: float,
    bands: Sequence[FusedBand],
    tiles: Dict[str, Path],
) -> str:
    """A virtual raster that lists the bands of all sources under their names."""
    lines = [
        f'<VRTDataset rasterXSize="{size[0]}" rasterYSize="{size[1]}">',
        f"<SRS>{escape(crs)}</SRS>",
        f"<GeoTransform>{extent[0]!r}, {pixel!r}, 0.0, {extent[3]!r}, 0.0, {-pixel!r}</GeoTransform>",
    ]
    for band in bands:
        lines += [
            f'<VRTRasterBand dataType="{kind}" band="{band.index}">',
            f"<Description>{escape(band.name)}</Description>",
            f"<NoDataValue>{hole!r}</NoDataValue>",
            f"<SimpleSource><SourceFilename relativeToVRT={quoteattr('1')}>{escape(tiles[band.source].name)}"
            f"</SourceFilename><SourceBand>{band.source_band}</SourceBand></SimpleSource>",
            "</VRTRasterBand>",
        ]
    return "\n".join([*lines, "</VRTDataset>", ""])
