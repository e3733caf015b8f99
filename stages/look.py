"""A look at pixels when asked: could a colour camera have been converted to near infrared?

A converted camera keeps clean colour metadata and is told only by its pixels.
Leaves reflect more green than red and blue light, so on ground seen in visible
light pixels whose green is the *smallest* channel are rare; behind a filter
that lets infrared in, leaves are bright in red and blue and such pink or violet
pixels cover the ground. A camera behind a plain infrared filter shows one red
cast with green and blue alike. Both are a suspicion, never a proof: nothing is
decided by it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Iterator, List, Optional, Sequence, Tuple

import numpy as np
import numpy.typing as npt

from .finding import WARNING, Finding
from .progress import Cancel, check
from .rules.text import named, plural
from .survey import Survey
from .thresholds import Thresholds

RGB8 = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class ColourShares:
    """Shares (0 to 1) of a frame's well-exposed pixels: green largest, green smallest, and one red cast."""

    green: float
    pink: float
    red_cast: float


def shares_of(pixels: RGB8, limits: Thresholds) -> Optional[ColourShares]:
    """Count the kinds of pixels of an H x W x 3 image; ``None`` where it is mostly black or blown out."""
    flat = pixels.reshape(-1, 3).astype(np.float32)
    well = (flat.max(axis=1) >= limits.look_dark_dn) & (flat.max(axis=1) <= 255.0 - limits.look_blown_dn)
    if well.mean() < limits.look_min_exposed:
        return None
    red, green, blue = flat[well].T
    margin = 1.0 + limits.look_margin
    is_green = (green > margin * red) & (green > margin * blue)
    is_pink = (red > margin * green) & (blue > margin * green)
    cast = (red > limits.look_cast * np.maximum(green, blue)) & (
        np.abs(green - blue) <= limits.look_margin * np.maximum(green, blue) + 1.0
    )
    return ColourShares(float(is_green.mean()), float(is_pink.mean()), float(cast.mean()))


def infrared_frames(shares: Sequence[Optional[ColourShares]], limits: Thresholds) -> Tuple[int, int]:
    """How many of the frames look like infrared, and how many could be judged."""
    judged = [s for s in shares if s is not None]
    seen = [
        s
        for s in judged
        if (s.pink >= limits.look_pink_share and s.green <= limits.look_green_share)
        or s.red_cast >= limits.look_cast_share
    ]
    return len(seen), len(judged)


def suspected(shares: Sequence[Optional[ColourShares]], limits: Thresholds) -> bool:
    """Most of at least a few judged frames look like infrared."""
    seen, judged = infrared_frames(shares, limits)
    return judged >= limits.look_min_frames and seen >= limits.look_frames_share * judged


def sample(paths: Sequence[str], most: int) -> Tuple[str, ...]:
    """At most ``most`` of the paths, evenly spread from the first to the last."""
    if len(paths) <= most:
        return tuple(paths)
    return tuple(paths[round(i * (len(paths) - 1) / (most - 1))] for i in range(most))


def thumbnail(file: Path, limits: Thresholds) -> Optional[RGB8]:
    """A small 8-bit RGB picture of a frame, decoded at reduced scale where the format can; ``None`` where it fails."""
    from PIL import Image

    try:
        with Image.open(file) as image:
            if image.width * image.height > limits.max_input_megapixels * 1e6:
                return None
            image.draft("RGB", (limits.look_side_px, limits.look_side_px))
            if image.mode not in ("RGB", "RGBA", "YCbCr", "CMYK"):
                return None
            small: Any = image.convert("RGB")
            small.thumbnail((limits.look_side_px, limits.look_side_px))
            return np.asarray(small, dtype=np.uint8)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def look(
    survey: Survey,
    limits: Thresholds,
    *,
    open_path: Callable[[str], Path] = Path,
    cancel: Optional[Cancel] = None,
) -> Tuple[Finding, ...]:
    """Decode a few frames of every colour profile and say which could be infrared-converted. Nothing else follows."""
    return tuple(_suspicions(survey, limits, open_path, cancel))


def _suspicions(
    survey: Survey, limits: Thresholds, open_path: Callable[[str], Path], cancel: Optional[Cancel]
) -> Iterator[Finding]:
    usable = {f.path for f in survey.usable}
    for profile in survey.profiles:
        if profile.spectrum != "rgb":
            continue
        shares: List[Optional[ColourShares]] = []
        chosen = sample([p for p in profile.frames if p in usable], limits.look_frames)
        for path in chosen:
            check(cancel)
            pixels = thumbnail(open_path(path), limits)
            shares.append(None if pixels is None else shares_of(pixels, limits))
        if suspected(shares, limits):
            seen, judged = infrared_frames(shares, limits)
            yield Finding(
                code="infrared-suspected",
                severity=WARNING,
                subjects=(profile.id,),
                message=f"{profile.id} calls itself a colour camera, but {seen} of {plural(judged)} looked at show the "
                f"colours of a camera converted to near infrared ({named(chosen)}).",
                remedy="If it was converted, keep its frames in a project of their own. If not (heather, red sand, "
                "a filter), nothing has to be done: this changes nothing by itself.",
                measured=float(seen),
                threshold=limits.look_frames_share * judged,
            )
