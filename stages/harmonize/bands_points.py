"""Control points between two bands of one capture.

Descriptors for reflected light (SIFT on robustly stretched 8-bit copies, each
feature compared only with those that a rig's geometry allows); for thermal
against reflected light, where descriptors lie, windows of gradient magnitude
are laid over each other.
References: Lowe 2004; Arandjelovic and Zisserman 2012 (root of the descriptor).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, List, Optional, Tuple

import numpy as np
import numpy.typing as npt

from ..thresholds import Thresholds
from .bands_fit import HOMOGRAPHY, Lenses, errors_px, solve
from .bands_lens import Lens, Points, project, sample_places, scaled
from .bands_model import CALIBRATED
from .resample import opencv, resize

Image = npt.NDArray[np.uint8]
_STRETCH = (0.5, 99.5)
_CONTRAST = 0.01
_NEAR_PEAK_PX = 3
_COARSEST = 4
_COARSE_PX = 240
_FINE_REACH_PX = 7


def to_grey8(pixels: npt.NDArray[Any]) -> Image:
    """Stretch (h, w[, c]) of any depth between its 0.5th and 99.5th percentile; no-data (NaN) goes to 0."""
    grey = np.asarray(pixels, np.float32)
    if grey.ndim == 3:
        grey = grey.mean(axis=2)
    sample = grey[::3, ::3]
    sample = sample[np.isfinite(sample)]
    if not sample.size:
        return np.zeros(grey.shape, np.uint8)
    low, high = (float(v) for v in np.percentile(sample, _STRETCH))
    grey = (np.nan_to_num(grey, nan=low) - low) * (255.0 / max(high - low, 1e-6))
    return np.asarray(np.clip(grey, 0, 255).astype(np.uint8))


def features(image: Image, lens: Lens, pixel_scale: float, limits: Thresholds) -> Tuple[Points, npt.NDArray[Any]]:
    """Positions in pixels of the full frame (n, 2) and unit descriptors (n, 128).

    ``pixel_scale`` shrinks the frame first (1 or less), so that both bands
    show the same detail.
    """
    cv2 = opencv()
    size = (max(16, round(lens.width * pixel_scale)), max(16, round(lens.height * pixel_scale)))
    small = resize(image, size) if pixel_scale < 1.0 else image
    finder = cv2.SIFT_create(nfeatures=int(limits.band_features), contrastThreshold=_CONTRAST)
    spots, descriptors = finder.detectAndCompute(small, None)
    if not spots:
        return np.empty((0, 2)), np.empty((0, 128), np.float32)
    at = np.array([s.pt for s in spots], np.float64)
    at = (at + 0.5) * np.array([lens.width / small.shape[1], lens.height / small.shape[0]]) - 0.5
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)).astype(np.float32)
    order = np.lexsort((at[:, 1], at[:, 0]))[: int(limits.band_features)]
    return at[order], root[order]


def match(
    primary: Tuple[Points, npt.NDArray[Any]],
    band: Tuple[Points, npt.NDArray[Any]],
    expected: Points,
    radius_px: float,
    ratio: float,
) -> npt.NDArray[np.int64]:
    """Pairs of indices (n, 2): mutual best within ``radius_px`` of ``expected`` and distinct by Lowe's ratio.

    ``expected`` is where the rig's geometry puts each primary feature in the band (n, 2).
    """
    if len(primary[0]) < 2 or len(band[0]) < 2:
        return np.empty((0, 2), np.int64)
    likeness = primary[1] @ band[1].T
    for axis in (0, 1):
        # Rows and columns outside of the radius fall away one axis at a time: no third array of this size.
        likeness[np.abs(expected[:, axis, None] - band[0][None, :, axis]) > radius_px] = -1.0
    rows = np.arange(len(likeness))
    best = likeness.argmax(axis=1)
    top = likeness[rows, best]
    mutual = likeness.argmax(axis=0)[best] == rows
    likeness[rows, best] = -1.0
    second = likeness.max(axis=1)
    near, next_near = np.sqrt(np.maximum(2.0 - 2.0 * top, 0.0)), np.sqrt(np.maximum(2.0 - 2.0 * second, 0.0))
    kept = mutual & (top > 0) & (near < ratio * next_near)
    return np.stack((rows[kept], best[kept]), axis=1).astype(np.int64)


def match_scales(primary: Lens, band: Lens, limits: Thresholds) -> Tuple[float, float]:
    """Scales at which two bands show the same detail, neither longer than ``band_match_dim_px``."""
    coarse = min(primary.focal_px, band.focal_px)
    scales = [coarse / lens.focal_px for lens in (primary, band)]
    longest = max(max(lens.width, lens.height) * s for lens, s in zip((primary, band), scales))
    shrink = min(1.0, limits.band_match_dim_px / longest)
    return scales[0] * shrink, scales[1] * shrink


def expected_in_band(pixels: Points, primary: Lens, band: Lens, prior: Any) -> Points:
    """Where the prior (primary rays to band rays) puts pixels of the primary in the band."""
    return np.nan_to_num(band.to_pixels(project(prior, primary.to_rays(pixels))), nan=-1e9)


def feature_points(
    primary: Tuple[Points, npt.NDArray[Any]],
    band: Tuple[Points, npt.NDArray[Any]],
    lenses: Tuple[Lens, Lens],
    prior: Any,
    limits: Thresholds,
) -> Points:
    """Matched features as (n, 4): x, y in the primary, x, y in the band."""
    expected = expected_in_band(primary[0], lenses[0], lenses[1], prior)
    radius = limits.band_max_shift * max(lenses[1].width, lenses[1].height)
    pairs = match(primary, band, expected, radius, limits.band_match_ratio)
    return np.hstack((primary[0][pairs[:, 0]], band[0][pairs[:, 1]]))


def area_points(primary: Image, band: Image, lenses: Tuple[Lens, Lens], prior: Any, limits: Thresholds) -> Points:
    """Windows of gradient magnitude that have one clear best place, as (n, 4) like ``feature_points``.

    First at a fraction of the coarser band's resolution, each window searching
    within ``band_max_shift`` of the prior; where those agree on one homography,
    again at full resolution a few pixels around it. Where they do not, the
    coarse points come back: they contradict each other, and that is told.
    """
    coarse = min(lens.focal_px for lens in lenses)
    longest = max(max(lens.width, lens.height) * coarse / lens.focal_px for lens in lenses)
    shrink = min(1.0, max(1.0 / _COARSEST, _COARSE_PX / longest))
    reach = limits.band_max_shift * longest * shrink
    tile = int(limits.band_area_tile_px)
    found = _area_level(primary, band, lenses, prior, coarse * shrink, reach, tile // 2, limits)
    if shrink == 1.0:
        return found
    pair = Lenses(*lenses, CALIBRATED)
    start = solve(found, pair, HOMOGRAPHY, replace(limits, band_ransac_px=limits.band_ransac_px / shrink))
    if start is None:
        return found
    agreeing = errors_px(start, pair, found) <= limits.band_ransac_px / shrink
    if agreeing.sum() < max(limits.band_min_held, limits.band_min_share * len(found)):
        return found
    return _area_level(primary, band, lenses, start, coarse, _FINE_REACH_PX, tile, limits)


def _area_level(
    primary: Image,
    band: Image,
    lenses: Tuple[Lens, Lens],
    prior: Any,
    focal_px: float,
    reach_px: float,
    stride: int,
    limits: Thresholds,
) -> Points:
    """One resolution: the primary laid over the band by ``prior``, then compared window by window."""
    cv2 = opencv()
    band_size = _size_at(lenses[1], focal_px)
    target = scaled(lenses[1], band_size)
    band_small = resize(band, band_size)
    small_lens = scaled(lenses[0], _size_at(lenses[0], focal_px))
    back = np.linalg.inv(np.asarray(prior, np.float64).reshape(3, 3))
    source = sample_places(target, small_lens, back)
    laid = cv2.remap(
        resize(primary, (small_lens.width, small_lens.height)),
        source[..., 0].astype(np.float32),
        source[..., 1].astype(np.float32),
        cv2.INTER_LINEAR,
    )
    seen = (source[..., 0] >= 0) & (source[..., 0] <= small_lens.width - 1)
    seen &= (source[..., 1] >= 0) & (source[..., 1] <= small_lens.height - 1)
    inner = cv2.erode(seen.astype(np.uint8), np.ones((7, 7), np.uint8), borderValue=0).astype(bool)
    found = _windows(_edges(laid), _edges(band_small), inner, max(4, round(reach_px)), stride, limits)
    if not found:
        return np.empty((0, 4))
    pairs = np.array(found)
    in_primary = small_lens.to_pixels(project(back, target.to_rays(pairs[:, :2])))
    return np.hstack((_full(in_primary, small_lens, lenses[0]), _full(pairs[:, 2:], target, lenses[1])))


def _size_at(lens: Lens, focal_px: float) -> Tuple[int, int]:
    return max(16, round(lens.width * focal_px / lens.focal_px)), max(16, round(lens.height * focal_px / lens.focal_px))


def _full(pixels: Points, small: Lens, full: Lens) -> Points:
    return np.asarray((pixels + 0.5) * np.array([full.width / small.width, full.height / small.height]) - 0.5)


def _edges(image: Image) -> npt.NDArray[np.float32]:
    """Gradient magnitude, evened out over the frame: edges agree across spectra where their sign does not."""
    cv2 = opencv()
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    strength = cv2.magnitude(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    level = cv2.GaussianBlur(strength, (0, 0), 16.0)
    return np.asarray(np.sqrt(strength / np.maximum(level, 1e-3)), np.float32)


def _windows(
    template: npt.NDArray[np.float32],
    image: npt.NDArray[np.float32],
    seen: npt.NDArray[np.bool_],
    reach: int,
    stride: int,
    limits: Thresholds,
) -> List[Tuple[float, float, float, float]]:
    """Each window's centre in the template and its best place in the image, both in pixels of the small frames."""
    cv2 = opencv()
    height, width = image.shape
    tile = min(int(limits.band_area_tile_px), height // 3, width // 3)
    found: List[Tuple[float, float, float, float]] = []
    for top in range(0, height - tile + 1, min(stride, tile)):
        for left in range(0, width - tile + 1, min(stride, tile)):
            if not seen[top : top + tile, left : left + tile].all():
                continue
            y0, x0 = max(0, top - reach), max(0, left - reach)
            y1, x1 = min(height, top + tile + reach), min(width, left + tile + reach)
            scores = cv2.matchTemplate(
                image[y0:y1, x0:x1], template[top : top + tile, left : left + tile], cv2.TM_CCOEFF_NORMED
            )
            peak = _clear_peak(np.nan_to_num(scores), limits)
            if peak is not None:
                middle = (tile - 1) / 2.0
                found.append((left + middle, top + middle, x0 + peak[0] + middle, y0 + peak[1] + middle))
    return found


def _clear_peak(scores: npt.NDArray[Any], limits: Thresholds) -> Optional[Tuple[float, float]]:
    """Place of the one clear maximum, to parts of a pixel by a parabola; ``None`` at the rim or where none is clear."""
    y, x = (int(v) for v in np.unravel_index(int(scores.argmax()), scores.shape))
    best = float(scores[y, x])
    if best < limits.band_area_score or not (0 < y < scores.shape[0] - 1 and 0 < x < scores.shape[1] - 1):
        return None
    others = scores.copy()
    r = _NEAR_PEAK_PX
    others[max(0, y - r) : y + r + 1, max(0, x - r) : x + r + 1] = -1.0
    if float(others.max()) * limits.band_area_distinct > best:
        return None
    return (
        x + _vertex(float(scores[y, x - 1]), best, float(scores[y, x + 1])),
        y + _vertex(float(scores[y - 1, x]), best, float(scores[y + 1, x])),
    )


def _vertex(before: float, top: float, after: float) -> float:
    curve = before - 2.0 * top + after
    return 0.0 if curve >= 0 else 0.5 * (before - after) / curve
