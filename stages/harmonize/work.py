"""One frame's work, done inside a worker process: read, rewrite, put."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Dict, Mapping, Optional, Tuple

from ..errors import FrameError
from ..thresholds import Thresholds
from . import jpeg, tiff
from .exif import TagEdit
from .metadata import is_jpeg, is_tiff, retag
from .resample import decode_jpeg, encode_jpeg, opencv, resize_mask, transform
from .worker import put_once, read_source

# Raised whenever the same input would give other bytes than before.
RECIPE = 3
RETAG, REWRITE, MASK = "retag", "rewrite", "mask"


@dataclass(frozen=True)
class FrameJob:
    """Everything that one frame's bytes depend on, and where it goes.

    ``what`` is ``retag`` (header only), ``rewrite`` (new pixels) or ``mask``.
    ``tables`` are per channel, empty for none. ``known`` is (key, digest of
    the output) of an earlier run, empty for none.
    """

    path: str
    source: str
    target: str
    what: str
    size_bytes: int
    width: int
    height: int
    out_width: int
    out_height: int
    tables: Tuple[Tuple[int, ...], ...] = ()
    focal_mm: Optional[float] = None
    focal_35mm: Optional[float] = None
    sensor_width_mm: Optional[float] = None
    known: Tuple[str, ...] = ()

    def edit(self) -> TagEdit:
        """Return what changes in the tags."""
        same = (self.width, self.height) == (self.out_width, self.out_height)
        size = None if same else (self.width, self.height, self.out_width, self.out_height)
        plane = None if self.sensor_width_mm is None else (self.out_width, self.out_height, self.sensor_width_mm)
        return TagEdit(size, self.focal_mm, self.focal_35mm, plane)


def key_of(job: FrameJob, source_digest: str, limits: Thresholds) -> str:
    """Digest of the source and of all that its output depends on."""
    settings: Dict[str, Any] = asdict(job)
    for name in ("path", "source", "target", "known"):
        del settings[name]
    settings["suffix"] = Path(job.target).suffix.lower() if job.what == MASK else ""
    settings.update(recipe=RECIPE, source=source_digest, quality=limits.jpeg_quality)
    settings["engine"] = "" if job.what == RETAG else str(opencv().__version__)
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def rewrite(data: bytes, job: FrameJob, limits: Thresholds) -> bytes:
    """Return the bytes of the frame as ``job`` wants them; pure but for the codecs."""
    if job.what == RETAG:
        return retag(data, job.edit())
    size = (job.out_width, job.out_height)
    if job.width * job.height > limits.max_input_megapixels * 1e6:
        raise FrameError("frame-too-large", f"{job.width}x{job.height} pixels are more than can be worked on.")
    if job.what == MASK:
        return _rewrite_mask(data, job, size)
    if is_jpeg(data):
        if not jpeg.complete(data):
            raise FrameError("truncated-image", "The picture data breaks off: the file was not copied whole.")
        subsampling = jpeg.sampling(data)
        pixels = decode_jpeg(data, grey=subsampling is None)
        _check_size(pixels.shape, job)
        pixels = transform(pixels, size, job.tables, reverse=True)
        return jpeg.with_header_of(data, encode_jpeg(pixels, subsampling, limits), job.edit())
    if is_tiff(data):
        pixels = tiff.decode(data, limits)
        _check_size(pixels.shape, job)
        channels = pixels.shape[2]
        pixels = transform(pixels, size, job.tables, reverse=False)
        return tiff.encode(data, pixels.reshape(size[1], size[0], channels), job.edit())
    raise FrameError("pixels-not-supported", "Only JPEG and TIFF frames are resampled.")


def _check_size(shape: Tuple[int, ...], job: FrameJob) -> None:
    if (shape[1], shape[0]) != (job.width, job.height):
        raise FrameError(
            "frame-changed", f"The picture is {shape[1]}x{shape[0]}, its header said {job.width}x{job.height}."
        )


def _rewrite_mask(data: bytes, job: FrameJob, size: Tuple[int, int]) -> bytes:
    import numpy as np

    cv2 = opencv()
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None or (pixels.shape[1], pixels.shape[0]) != (job.width, job.height):
        raise FrameError("mask-unusable", "The mask does not decode or has another size than its frame.")
    done, encoded = cv2.imencode(Path(job.target).suffix, resize_mask(pixels, size))
    if not done:
        raise FrameError("mask-unusable", "The mask could not be written in the format of its name.")
    return bytes(encoded.tobytes())


def perform(plain: Mapping[str, Any], limits: Thresholds) -> Dict[str, Any]:
    """Do one job as it came from JSON; returns key and digest of what stands at its target now."""
    job = job_from_plain(plain)
    data = read_source(job.source, None if job.what == MASK else job.size_bytes)
    key = key_of(job, hashlib.sha256(data).hexdigest(), limits)
    return put_once(job.target, key, job.known, lambda: rewrite(data, job, limits))


def job_from_plain(plain: Mapping[str, Any]) -> FrameJob:
    """Turn a job that came as JSON back into itself."""
    fields = dict(plain)
    fields["tables"] = tuple(tuple(t) for t in fields.get("tables", ()))
    fields["known"] = tuple(fields.get("known", ()))
    return FrameJob(**fields)
