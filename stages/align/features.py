"""Features of each frame, extracted once and kept on disk for every rung and subset.

COLMAP's SIFT on the CPU, one frame at a time from memory: no image file is
written and the result does not depend on other frames or on threads. The key
of a stored frame is everything that its features depend on.
"""

from __future__ import annotations

import hashlib
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Callable, Dict, List, NamedTuple, Sequence, Tuple

import numpy as np
import numpy.typing as npt

from ..record import dumps, write_bytes
from .images import Grey, read_grey, stretch_ranges, to_eight_bits, undecoded_note
from .solution import Array, EngineSettings, Job

# What SIFT holds per million pixels of its first octave, measured, and what all threads together may hold.
_SIFT_MB = 75.0
_EXTRACTION_MB = 1200.0


class Features(NamedTuple):
    """Key points (N, 2) in pixels of the working size, and their descriptors (N, 128) uint8."""

    points: Array
    descriptors: npt.NDArray[np.uint8]


EMPTY = Features(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.uint8))


def load_or_extract(
    job: Job, cache: Path, step: Callable[[str, int, int], None]
) -> Tuple[List[Features], Tuple[str, ...]]:
    """Return the features of every frame of ``job`` in order, and a note per frame that could not be decoded."""
    cache.mkdir(parents=True, exist_ok=True)
    sizes = [(job.cameras[f.camera].width, job.cameras[f.camera].height) for f in job.frames]
    keys = feature_keys(job)
    found: Dict[int, Features] = {}
    for index, key in enumerate(keys):
        path = cache / f"{key}.npz"
        if path.exists():
            try:
                found[index] = _load(path)
            except (OSError, ValueError, KeyError):
                path.unlink()
    missing = [i for i in range(len(job.frames)) if i not in found]
    if not missing:
        return [found[i] for i in range(len(job.frames))], ()
    spans = stretch_ranges(job.frames, sizes)
    notes: Dict[int, str] = {}

    def work(index: int) -> None:
        frame = job.frames[index]
        try:
            grey = to_eight_bits(read_grey(frame.file, sizes[index], frame.luts), spans.get(frame.tone, (0.0, 255.0)))
        except Exception as error:
            notes[index] = undecoded_note(frame.name, error)
            found[index] = EMPTY
            return
        found[index] = extract(grey, job.settings)
        _save(cache / f"{keys[index]}.npz", found[index])

    with ThreadPoolExecutor(max_workers=workers([sizes[i] for i in missing], job.settings)) as pool:
        for done, _ in enumerate(pool.map(work, missing), start=1):
            step("features", done, len(missing))
    return [found[i] for i in range(len(job.frames))], tuple(notes[i] for i in sorted(notes))


def workers(sizes: Sequence[Tuple[int, int]], settings: EngineSettings) -> int:
    """How many frames of ``sizes`` (width, height in px) may be extracted at once: threads, as far as memory goes."""

    def first_octave(size: Tuple[int, int]) -> int:
        return size[0] * size[1] * (4 if max(size) < settings.upsample_below_px else 1)

    each = max((first_octave(s) for s in sizes), default=1) / 1e6 * _SIFT_MB
    return max(1, min(settings.threads, int(_EXTRACTION_MB / max(each, 1.0))))


def extract(grey: Grey, settings: EngineSettings) -> Features:
    """Extract SIFT from an 8-bit grey array; at most ``max_features``, the largest scales first."""
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = 1
    options.max_image_size = max(grey.shape)
    options.sift.max_num_features = settings.max_features
    options.sift.peak_threshold = settings.peak_threshold
    options.sift.first_octave = -1 if max(grey.shape) < settings.upsample_below_px else 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        keypoints, descriptors = pycolmap.Sift(options, pycolmap.Device.cpu).extract(grey)
    points = np.asarray(keypoints, dtype=np.float64)
    if not len(points):
        return EMPTY
    # Largest scales first; a point with two orientations counts once, or ratio tests between twins fail.
    order = np.lexsort((points[:, 3], points[:, 1], points[:, 0], -points[:, 2]))[: settings.max_features]
    # pycolmap hands descriptors out at unit length; COLMAP itself keeps them as bytes of 1/512.
    rows = np.clip(np.rint(np.asarray(descriptors)[order] * 512.0), 0, 255).astype(np.uint8)
    return Features(points[order, :2], rows)


def feature_keys(job: Job) -> List[str]:
    """Return a name per frame for everything that its features depend on."""
    deep: Dict[str, List[str]] = {}
    for frame in job.frames:
        if _deep(frame.file):
            deep.setdefault(frame.tone, []).append(frame.file)
    return [_key(job, index, sorted(deep.get(frame.tone, []))) for index, frame in enumerate(job.frames)]


def _key(job: Job, index: int, tone: Sequence[str]) -> str:
    frame = job.frames[index]
    camera = job.cameras[frame.camera]
    try:
        stat = Path(frame.file).stat()
        stamp: Tuple[int, ...] = (stat.st_size, stat.st_mtime_ns)
    except OSError:
        stamp = (0, 0)
    said: Dict[str, Any] = {
        "file": frame.file,
        "stamp": stamp,
        "size": (camera.width, camera.height),
        "luts": frame.luts,
        "tone": tone if _deep(frame.file) else (),
        "sift": (
            job.settings.max_features,
            job.settings.peak_threshold,
            max(camera.width, camera.height) < job.settings.upsample_below_px,
        ),
    }
    return hashlib.sha256(dumps(said).encode("utf-8")).hexdigest()[:32]


def _deep(file: str) -> bool:
    return file.lower().endswith((".tif", ".tiff"))


def _save(path: Path, features: Features) -> None:
    import io

    stream = io.BytesIO()
    np.savez(stream, points=features.points.astype(np.float32), descriptors=features.descriptors)
    write_bytes(path, stream.getvalue())


def _load(path: Path) -> Features:
    with np.load(path, allow_pickle=False) as data:
        return Features(data["points"].astype(np.float64), data["descriptors"])


def all_descriptors(features: Sequence[Features]) -> List[npt.NDArray[np.uint8]]:
    """Return the descriptors alone, in order."""
    return [f.descriptors for f in features]
