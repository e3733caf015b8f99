"""How far two georeferenced rasters of one place lie apart, from what both show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional, Tuple

import numpy as np
import numpy.typing as npt

from .gdal_tools import Gdal
from .thresholds import Thresholds


@dataclass(frozen=True)
class Shift:
    """Distance of ``raster`` from ``reference``.

    ``east`` and ``north`` are the median displacement, ``median`` and ``p95``
    the distances of single points, all in units of the coordinate system;
    ``residual_p95`` is what is left when the median displacement is taken off.
    ``median_px`` is in pixels of the coarser raster. ``points`` is 0 where
    nothing could be measured.
    """

    raster: str
    reference: str
    points: int = 0
    east: Optional[float] = None
    north: Optional[float] = None
    median: Optional[float] = None
    p95: Optional[float] = None
    residual_p95: Optional[float] = None
    median_px: Optional[float] = None


def measure_shift(
    gdal: Gdal,
    pair: Tuple[Path, Path],
    extent: Tuple[float, float, float, float],
    pixels: Tuple[float, float],
    names: Tuple[str, str],
    scratch: Path,
    limits: Thresholds,
) -> Shift:
    """Compare the ``extent`` that both files (reference, raster) cover.

    ``pixels`` are the sizes of the finer and the coarser one's pixels; windows
    are compared at half the coarser one or more. ``names`` are the raster's
    and the reference's.
    """
    from .harmonize.bands_fit import CapturePoints, errors_px, fit, passes
    from .harmonize.bands_lens import Lens
    from .harmonize.bands_points import area_points

    unknown = Shift(*names)
    longest = max(extent[2] - extent[0], extent[3] - extent[1])
    step = max(pixels[0], pixels[1] / 2.0, longest / limits.fuse_compare_px)
    size = (int((extent[2] - extent[0]) / step), int((extent[3] - extent[1]) / step))
    if min(size) < 3 * limits.band_area_tile_px:
        return unknown
    first, seen_first = _read(gdal, pair[0], extent, size, scratch / "reference.img")
    second, seen_second = _read(gdal, pair[1], extent, size, scratch / "raster.img")
    both = seen_first & seen_second
    lens = Lens(size[0], size[1], float(size[0]), ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0))
    points = area_points(_stretched(first, both), _stretched(second, both), (lens, lens), np.eye(3), limits)
    points = points[_inside(points, both, int(limits.band_area_tile_px))]
    fitted = fit([CapturePoints(names[0], names[0], points)], lens, lens, [], limits) if len(points) else None
    if fitted is None or not passes(fitted, limits.replaced({"band_min_cover": 0.0}), residuals=False):
        return unknown
    good = points[errors_px(fitted.matrix, fitted.lenses, points) <= limits.band_outlier_px]
    moved = (good[:, 2:] - good[:, :2]) * np.array([step, -step])
    middle = np.median(moved, axis=0)
    away, rest = np.hypot(moved[:, 0], moved[:, 1]), np.hypot(*(moved - middle).T)
    return Shift(
        raster=names[0],
        reference=names[1],
        points=len(good),
        east=_short(middle[0]),
        north=_short(middle[1]),
        median=_short(np.median(away)),
        p95=_short(np.percentile(away, 95)),
        residual_p95=_short(np.percentile(rest, 95)),
        median_px=_short(np.median(away) / pixels[1]),
    )


def _short(value: Any) -> float:
    return float(f"{float(value):.4g}")


def _read(
    gdal: Gdal, file: Path, extent: Tuple[float, float, float, float], size: Tuple[int, int], target: Path
) -> Tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Mean of all bands over an extent and where every band has data, band by band from a plain file."""
    place = [repr(v) for v in extent]
    options = ["-te", *place, "-ts", str(size[0]), str(size[1]), "-r", "average", "-ot", "Float32"]
    gdal.warp([*options, "-dstnodata", "nan", "-of", "ENVI", "-co", "INTERLEAVE=BSQ"], file, target)
    layers = np.memmap(target, "<f4", mode="r").reshape(-1, size[1], size[0])
    total = np.zeros((size[1], size[0]), np.float32)
    seen = np.ones((size[1], size[0]), np.bool_)
    for layer in layers:
        seen &= np.isfinite(layer)
        # Bands are levelled first, or one in reflectance would vanish beside one in counts.
        total += np.nan_to_num(layer) / max(float(np.nanstd(layer)) if np.isfinite(layer).any() else 1.0, 1e-9)
    return total, seen


def _stretched(picture: npt.NDArray[np.float32], both: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    """8-bit copy; where one of the two has no data, the middle tone, so that rims make few edges."""
    from .harmonize.bands_points import to_grey8

    if not both.any():
        return np.zeros(picture.shape, np.uint8)
    return to_grey8(np.where(both, picture, np.float32(np.median(picture[both]))))


def _inside(points: npt.NDArray[np.float64], both: npt.NDArray[np.bool_], window: int) -> npt.NDArray[np.bool_]:
    """Points whose whole window has data in both rasters."""
    holes = np.pad(np.cumsum(np.cumsum(~both, axis=0), axis=1), ((1, 0), (1, 0)))
    half = window // 2 + 4

    def clear(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        x0, x1 = (np.clip(np.rint(x + d), 0, both.shape[1]).astype(int) for d in (-half, half))
        y0, y1 = (np.clip(np.rint(y + d), 0, both.shape[0]).astype(int) for d in (-half, half))
        return np.asarray(holes[y1, x1] - holes[y0, x1] - holes[y1, x0] + holes[y0, x0] == 0)

    return clear(points[:, 0], points[:, 1]) & clear(points[:, 2], points[:, 3])
