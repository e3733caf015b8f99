"""Frames to small 8-bit grey arrays for the solver.

JPEGs are decoded at a fraction of their size where libjpeg can. Deeper pixels
(16-bit TIFF, float thermal) are stretched by one range per flight: a range per
frame would give the same ground another tone in every frame.
"""

from __future__ import annotations

from typing import Dict, List, Sequence, Tuple

import numpy as np
import numpy.typing as npt

from .solution import JobFrame

Grey = npt.NDArray[np.uint8]
Deep = npt.NDArray[np.float32]

_STRETCH_PERCENT = (0.5, 99.5)
_STRETCH_SAMPLES = 24


UNDECODED = "pixels cannot be decoded"


def undecoded_note(name: str, error: Exception) -> str:
    """What a solution notes of a frame whose picture is damaged; ``undecoded`` finds it again."""
    return f"{name}: {UNDECODED} ({type(error).__name__})"


def undecoded(names: Sequence[str], notes: Sequence[str]) -> Tuple[str, ...]:
    """Those of ``names`` whose picture no engine could decode."""
    told = {note.rpartition(f": {UNDECODED}")[0] for note in notes}
    return tuple(n for n in names if n in told)


def working_size(width: int, height: int, max_dim: int) -> Tuple[int, int]:
    """Return the size a frame is solved at: the longer side at most ``max_dim``, never enlarged."""
    side = max(width, height)
    if side <= max_dim:
        return width, height
    return max(1, round(width * max_dim / side)), max(1, round(height * max_dim / side))


def read_grey(file: str, size: Tuple[int, int], luts: Sequence[Sequence[int]] = ()) -> npt.NDArray[np.generic]:
    """Decode ``file`` to grey at ``size``: uint8 for 8-bit frames, float32 for deeper ones.

    Raises ``OSError`` or ``ValueError`` when the pixels cannot be decoded.
    """
    from PIL import Image

    with Image.open(file) as image:
        if image.format in ("JPEG", "MPO"):
            image.draft(image.mode if luts else "L", size)
        if image.mode in ("I", "F") or image.mode.startswith("I;"):
            return _shrink_deep(np.asarray(image, dtype=np.float32), size)
        if luts and image.mode == "RGB" and len(luts) == 3:
            image = image.point([v for table in luts for v in table])
        elif luts and image.mode == "L" and len(luts) == 1:
            image = image.point(list(luts[0]))
        grey = image if image.mode == "L" else image.convert("RGB").convert("L")
        if grey.size != size:
            grey = grey.resize(size, Image.Resampling.BOX if grey.size[0] >= 2 * size[0] else Image.Resampling.BICUBIC)
        return np.ascontiguousarray(np.asarray(grey, dtype=np.uint8))


def _shrink_deep(pixels: Deep, size: Tuple[int, int]) -> Deep:
    from PIL import Image

    if pixels.ndim == 3:
        pixels = pixels.mean(axis=2)
    pixels = np.nan_to_num(pixels)
    if (pixels.shape[1], pixels.shape[0]) == size:
        return pixels
    small = Image.fromarray(pixels).resize(size, Image.Resampling.BICUBIC)
    return np.asarray(small, dtype=np.float32)


def stretch_ranges(frames: Sequence[JobFrame], sizes: Sequence[Tuple[int, int]]) -> Dict[str, Tuple[float, float]]:
    """Return per tone group the value range that becomes 0..255, from frames spread over the flight.

    Groups of 8-bit frames are absent. The range is the median of the sampled
    frames' percentiles, so that one frame of sky or panel does not set it.
    """
    groups: Dict[str, List[int]] = {}
    for index, frame in enumerate(frames):
        groups.setdefault(frame.tone, []).append(index)
    ranges: Dict[str, Tuple[float, float]] = {}
    for tone in sorted(groups):
        members = groups[tone]
        step = max(1, len(members) // _STRETCH_SAMPLES)
        found = []
        for index in members[::step]:
            try:
                pixels = read_grey(frames[index].file, sizes[index])
            except (OSError, ValueError):
                continue
            if pixels.dtype == np.uint8:
                break
            found.append(np.percentile(np.asarray(pixels, dtype=np.float32), _STRETCH_PERCENT))
        if found:
            low, high = np.median(np.asarray(found), axis=0)
            ranges[tone] = (float(low), float(max(high, low + 1e-6)))
    return ranges


def to_eight_bits(pixels: npt.NDArray[np.generic], span: Tuple[float, float]) -> Grey:
    """Map ``span`` to 0..255 with a square root, which lifts the dark part where most ground lies."""
    if pixels.dtype == np.uint8:
        return np.ascontiguousarray(pixels.astype(np.uint8))
    low, high = span
    unit = np.clip((pixels.astype(np.float32) - low) / (high - low), 0.0, 1.0)
    return np.ascontiguousarray(np.rint(np.sqrt(unit) * 255.0).astype(np.uint8))
