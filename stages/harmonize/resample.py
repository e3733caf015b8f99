"""Pixels to another size: uniform scale, no crop, depth kept.

Filters were chosen by fidelity to a windowed-sinc (Lanczos) resize in floating
point and to the frame's own spectrum, on real frames and on noise (see
``benchmarks/resample_fidelity.py``). Upwards deep pixels go through Lanczos over
four lobes: 1 to 2 dB nearer to either than a cubic kernel, 7 to 9 dB than a
linear one. 8-bit pixels, JPEGs nearly always, go through the cubic kernel: after
encoding at quality 95 it is 0.2 dB behind (1 dB against the spectrum), at a
tenth of the time. Down to one half it is a cubic kernel with a light Gaussian
before it, so that detail finer than the new grid does not alias; further down
the area mean.
"""

from __future__ import annotations

import io
from typing import Any, Optional, Sequence, Tuple

import numpy as np
import numpy.typing as npt

from ..errors import FrameError, MissingDependency
from ..thresholds import Thresholds

Pixels = npt.NDArray[Any]
Tables = Tuple[Tuple[int, ...], ...]

_AREA_BELOW = 0.5
_OPENCV_CHANNELS = 4
_SUBSAMPLINGS = {(1, 1): "444", (2, 1): "422", (2, 2): "420", (1, 2): "440", (4, 1): "411"}


def missing_opencv() -> MissingDependency:
    """Return the error that says how to get OpenCV."""
    return MissingDependency("OpenCV", "resampling and colour matching", "pip install 'sensorgate[imaging]'")


def opencv() -> Any:
    """OpenCV, or the error that says how to get it."""
    try:
        import cv2
    except ImportError:
        raise missing_opencv() from None
    cv2.setNumThreads(1)
    return cv2


def blur_sigma(scale: float) -> float:
    """Sigma in source pixels of the Gaussian before a cubic reduction by ``scale`` (0.5 to 1).

    A line through the compromise between real frames and noise at 0.9 to 0.5:
    it brings the kernel's pass band down to the new Nyquist limit.
    """
    return 0.95 - 0.665 * scale


def resize(pixels: Pixels, size: Tuple[int, int]) -> Pixels:
    """Resample (height, width[, channels]) of uint8, uint16, int16 or float to ``size`` = (width, height).

    NaN in floats marks no data: it neither spreads nor vanishes.
    """
    cv2 = opencv()
    if (pixels.shape[1], pixels.shape[0]) == size:
        return pixels
    if pixels.dtype.kind == "f" and bool(np.isnan(pixels).any()):
        return _resize_holes(pixels, size)
    if pixels.ndim == 3 and pixels.shape[2] > _OPENCV_CHANNELS:
        parts = [
            resize(np.ascontiguousarray(pixels[:, :, first : first + _OPENCV_CHANNELS]), size)
            for first in range(0, pixels.shape[2], _OPENCV_CHANNELS)
        ]
        return np.concatenate([p if p.ndim == 3 else p[:, :, None] for p in parts], axis=2)
    scale = max(size[0] / pixels.shape[1], size[1] / pixels.shape[0])
    if scale < _AREA_BELOW:
        result = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    elif scale < 1.0:
        sigma = blur_sigma(scale)
        pixels = cv2.GaussianBlur(pixels, (3, 3) if sigma < 0.5 else (5, 5), sigma, borderType=cv2.BORDER_REFLECT_101)
        result = cv2.resize(pixels, size, interpolation=cv2.INTER_CUBIC)
    else:
        kernel = cv2.INTER_CUBIC if pixels.dtype == np.uint8 else cv2.INTER_LANCZOS4
        result = cv2.resize(pixels, size, interpolation=kernel)
    return np.asarray(result)


def _resize_holes(pixels: Pixels, size: Tuple[int, int]) -> Pixels:
    holes = np.isnan(pixels)
    weight = resize((~holes).astype(pixels.dtype), size)
    filled = resize(np.where(holes, pixels.dtype.type(0), pixels), size)
    known = weight > 0.5
    return np.asarray(np.where(known, filled / np.where(known, weight, 1), np.nan).astype(pixels.dtype))


def resize_mask(pixels: Pixels, size: Tuple[int, int]) -> Pixels:
    """Resample a mask: every value of the result is a value of the source."""
    cv2 = opencv()
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_NEAREST))


def recolour(pixels: Pixels, tables: Sequence[Sequence[int]], *, reverse: bool) -> Pixels:
    """Put 8-bit pixels through one table per channel; ``reverse`` where channels stand as blue, green, red."""
    cv2 = opencv()
    ordered = list(reversed(tables)) if reverse else list(tables)
    table = np.asarray(ordered, np.uint8)
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if table.shape != (channels, 256) or pixels.dtype != np.uint8:
        raise FrameError("pixels-not-supported", "The colour tables do not fit the channels of this frame.")
    lookup = np.ascontiguousarray(table.T.reshape(256, 1, channels))
    return np.asarray(cv2.LUT(pixels, lookup))


def transform(pixels: Pixels, size: Tuple[int, int], tables: Sequence[Sequence[int]], *, reverse: bool) -> Pixels:
    """Resize and recolour; the tables are applied on whichever side has fewer pixels."""
    shrinks = size[0] * size[1] <= pixels.shape[0] * pixels.shape[1]
    if tables and not shrinks:
        pixels = recolour(pixels, tables, reverse=reverse)
    pixels = resize(pixels, size)
    if tables and shrinks:
        pixels = recolour(pixels, tables, reverse=reverse)
    return pixels


def decode_jpeg(data: bytes, grey: bool) -> Pixels:
    """Decode to (h, w) grey or (h, w, 3) blue-green-red, as stored: the orientation tag is not applied."""
    cv2 = opencv()
    flags = (cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR) | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise FrameError("pixels-broken", "The picture of this JPEG does not decode.")
    return np.asarray(pixels)


def encode_jpeg(pixels: Pixels, subsampling: Optional[Tuple[int, int]], limits: Thresholds) -> bytes:
    """Encode at ``limits.jpeg_quality`` with the chroma subsampling of the original, (2, 1) being 4:2:2."""
    cv2 = opencv()
    options = [cv2.IMWRITE_JPEG_QUALITY, int(limits.jpeg_quality)]
    if pixels.ndim == 3:
        name = _SUBSAMPLINGS.get(subsampling or (2, 2), "444")
        factor = getattr(cv2, f"IMWRITE_JPEG_SAMPLING_FACTOR_{name}", None)
        if factor is None:
            return _encode_by_pillow(pixels, name, limits)
        options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, factor]
    done, encoded = cv2.imencode(".jpg", pixels, options)
    if not done:
        raise FrameError("pixels-not-supported", "This frame could not be written as a JPEG.")
    return bytes(encoded.tobytes())


def _encode_by_pillow(pixels: Pixels, name: str, limits: Thresholds) -> bytes:
    """Encode colour where OpenCV is too old to be told the subsampling; rare kinds then keep all their chroma."""
    from PIL import Image

    out = io.BytesIO()
    subsampling = {"444": 0, "422": 1, "420": 2}.get(name, 0)
    image = Image.fromarray(np.ascontiguousarray(pixels[:, :, ::-1]))
    image.save(out, "JPEG", quality=int(limits.jpeg_quality), subsampling=subsampling)
    return out.getvalue()
