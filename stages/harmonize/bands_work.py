"""One job inside a worker: control points of a capture, or one band frame warped onto its primary."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple

import numpy as np
import numpy.typing as npt

from ..errors import FrameError
from ..record import from_plain
from ..thresholds import Thresholds
from . import jpeg, tiff
from .bands_fit import Fitted, Lenses, better, errors_px, held_mask, own_matrix, residual
from .bands_lens import Lens, Points, sample_places, scaled
from .bands_model import APPLIED, KEPT
from .bands_points import area_points, feature_points, features, match_scales, to_grey8
from .bands_radiometry import correction_of, neutralised
from .exif import TagEdit
from .metadata import is_jpeg, is_tiff
from .resample import blur_sigma, decode_jpeg, encode_jpeg, opencv
from .worker import put_once, read_source

# Raised whenever the same input would give other bytes than before.
RECIPE = 2
MEASURE, WARP = "measure", "warp"
ALWAYS, FALLBACK, NEVER = "always", "fallback", "never"
_REMAPPED = ("u1", "u2", "i2", "f4", "f8")
_WITHOUT = ("source", "target", "known", "primary_source")


def perform(job: Mapping[str, Any], limits: Thresholds) -> Dict[str, Any]:
    """Do one job; the answer is plain JSON."""
    return _measure(job, limits) if job["what"] == MEASURE else _warp(job, limits)


def decode(data: bytes, lens: Lens, limits: Thresholds) -> npt.NDArray[Any]:
    """Decode a JPEG or TIFF frame to (h, w, c); its size must be what the header said."""
    if lens.width * lens.height > limits.max_input_megapixels * 1e6:
        raise FrameError("frame-too-large", f"{lens.width}x{lens.height} pixels are more than can be worked on.")
    if is_jpeg(data):
        if not jpeg.complete(data):
            raise FrameError("truncated-image", "The picture data breaks off: the file was not copied whole.")
        pixels = decode_jpeg(data, grey=jpeg.sampling(data) is None)
    elif is_tiff(data):
        pixels = tiff.decode(data, limits)
    else:
        raise FrameError("pixels-not-supported", "Only JPEG and TIFF bands are aligned.")
    if pixels.shape[:2] != (lens.height, lens.width):
        raise FrameError("frame-changed", "The picture has another size than its header said.")
    return pixels if pixels.ndim == 3 else pixels[:, :, None]


class _Capture:
    """A primary frame and its features at each scale they were asked for."""

    def __init__(self, source: str, lens: Lens, limits: Thresholds) -> None:
        self.lens, self._limits = lens, limits
        self.grey = to_grey8(decode(Path(source).read_bytes(), lens, limits))
        self._found: Dict[float, Tuple[Points, npt.NDArray[Any]]] = {}

    def at(self, scale: float) -> Tuple[Points, npt.NDArray[Any]]:
        if scale not in self._found:
            self._found[scale] = features(self.grey, self.lens, scale, self._limits)
        return self._found[scale]

    def points(self, source: str, lens: Lens, prior: Any, descriptors: str) -> Tuple[Points, Points]:
        """Control points by features and by area.

        ``descriptors`` is ``always``, ``fallback`` (where too few windows of
        the area agree to be of use) or ``never`` (other physics, other look).
        """
        limits = self._limits
        grey = to_grey8(decode(Path(source).read_bytes(), lens, limits))
        pair = (self.lens, lens)
        by_area = area_points(self.grey, grey, pair, prior, limits)
        by_features = np.empty((0, 4))
        if descriptors == ALWAYS or (descriptors == FALLBACK and len(by_area) < 2 * limits.min_inliers):
            mine, other = match_scales(self.lens, lens, limits)
            by_features = feature_points(self.at(mine), features(grey, lens, other, limits), pair, prior, limits)
        return by_features, by_area


def _measure(job: Mapping[str, Any], limits: Thresholds) -> Dict[str, Any]:
    capture = _Capture(job["primary"]["source"], from_plain(Lens, job["primary"]["lens"]), limits)
    points: Dict[str, Any] = {}
    broken: Dict[str, Any] = {}
    for band in job["bands"]:
        try:
            by_features, by_area = capture.points(
                band["source"], from_plain(Lens, band["lens"]), band["prior"], band["descriptors"]
            )
        except FrameError as error:
            broken[band["path"]] = [error.code, error.message]
            continue
        except FileNotFoundError:
            broken[band["path"]] = ["frame-vanished", "The file was there when the folder was read and is gone now."]
            continue
        points[band["path"]] = {"features": _rounded(by_features), "area": _rounded(by_area)}
    return {"points": points, "broken": broken}


def _rounded(points: Points) -> List[List[float]]:
    return [[round(float(v), 3) for v in row] for row in points]


def _warp(job: Mapping[str, Any], limits: Thresholds) -> Dict[str, Any]:
    data = read_source(job["source"], job["size_bytes"])
    digests = [hashlib.sha256(data).hexdigest()]
    if job["refine"]:
        digests.append(hashlib.sha256(Path(job["primary_source"]).read_bytes()).hexdigest())
    settings = {k: v for k, v in job.items() if k not in _WITHOUT}
    settings.update(recipe=RECIPE, sources=digests, quality=limits.jpeg_quality, engine=str(opencv().__version__))
    key = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()
    return put_once(job["target"], key, job["known"], lambda: warp_file(data, job, limits))


def warp_file(data: bytes, job: Mapping[str, Any], limits: Thresholds) -> bytes:
    """Return a band's file with its pixels on the primary's grid, its tags kept."""
    primary, band = from_plain(Lens, job["primary_lens"]), from_plain(Lens, job["band_lens"])
    pixels = decode(data, band, limits)
    matrix = np.asarray(job["matrix"], np.float64)
    if job["refine"]:
        matrix = _own(job, primary, band, matrix, limits)
    shape: Tuple[int, int] = (job["out_width"], job["out_height"])
    correction = correction_of(data, limits) if job["radiometry"] in (APPLIED, KEPT) else None
    if job["radiometry"] == APPLIED:
        if correction is None:
            raise FrameError(
                "radiometry-incomplete",
                "Its radiometric tags are not complete although those of its band's other frames are.",
            )
        data = neutralised(data, limits)
    dtype = pixels.dtype
    values = correction.applied(pixels) if correction is not None else pixels
    warped = warp_pixels(values, scaled(primary, shape), band, matrix, np.nan if values.dtype.kind == "f" else 0)
    if correction is not None and job["radiometry"] == KEPT:
        warped = correction.put_back(warped, (band.width, band.height))
    if warped.dtype != dtype and dtype.kind in "iu":
        limit = np.iinfo(dtype)
        warped = np.clip(np.rint(np.nan_to_num(warped)), limit.min, limit.max)
    warped = warped.astype(dtype, copy=False)
    size = None if shape == (band.width, band.height) else (band.width, band.height, *shape)
    edit = TagEdit(size, job["focal_mm"], job["focal_35mm"])
    if is_jpeg(data):
        subsampling = jpeg.sampling(data)
        flat = warped if subsampling is not None else warped[:, :, 0]
        return jpeg.with_header_of(data, encode_jpeg(flat, subsampling, limits), edit)
    return tiff.encode(data, warped, edit)


def warp_pixels(pixels: npt.NDArray[Any], primary: Lens, band: Lens, matrix: Any, hole: float = 0) -> npt.NDArray[Any]:
    """Sample (h, w, c) once, cubic, at the band's place of every pixel of ``primary``; ``hole`` where it sees none."""
    cv2 = opencv()
    place = sample_places(primary, band, matrix)
    scale = _local_scale(place)
    # A finer band is smoothed to the primary's resolution first, or its detail would alias.
    sigma = blur_sigma(max(scale, 0.5)) * max(1.0, 0.5 / scale) if scale < 1.0 else 0.0
    x, y = place[..., 0].astype(np.float32), place[..., 1].astype(np.float32)
    layers = []
    for channel in range(pixels.shape[2]):
        layer = np.ascontiguousarray(pixels[:, :, channel])
        if layer.dtype.kind + str(layer.dtype.itemsize) not in _REMAPPED:
            layer = layer.astype(np.float64)
        if sigma:
            layer = cv2.GaussianBlur(layer, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101)
        layers.append(cv2.remap(layer, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))
    result = np.stack(layers, axis=2)
    result[~((x >= -0.5) & (x <= band.width - 0.5) & (y >= -0.5) & (y <= band.height - 0.5))] = hole
    return np.asarray(result)


def _local_scale(place: Points) -> float:
    """Output pixels per band pixel in the middle of the frame."""
    h, w = place.shape[0] // 2, place.shape[1] // 2
    step = np.hypot(*(place[h, min(w + 8, place.shape[1] - 1)] - place[h, max(w - 8, 0)]))
    span = min(w + 8, place.shape[1] - 1) - max(w - 8, 0)
    return float(span / max(step, 1e-6))


def _own(job: Mapping[str, Any], primary: Lens, band: Lens, pooled: Any, limits: Thresholds) -> Any:
    """This capture's own matrix where it beats the pooled one on points that neither saw."""
    capture = _Capture(job["primary_source"], from_plain(Lens, job["measure_lenses"][0]), limits)
    measured = from_plain(Lens, job["measure_lenses"][1])
    by_features, by_area = capture.points(job["source"], measured, job["prior"], job["descriptors"])
    points = by_features if job["points"] == "features" else by_area
    lenses = Lenses(primary, band, job["lenses"])
    fitted = Fitted(tuple(pooled.ravel()), job["model"], lenses, 0, 0, 1.0, None, None, ())
    held = held_mask(points, primary, 0)
    own: Optional[Any] = own_matrix(points[~held], fitted, limits)
    if own is None:
        return pooled
    seen = points[held]
    kept = better(
        residual(errors_px(own, lenses, seen), limits), residual(errors_px(pooled, lenses, seen), limits), limits
    )
    return np.asarray(own) if kept else pooled
