"""What resampling brings and costs, said before any pixel moves (pure).

Expected matches are shares of those between frames of equal ground resolution.
They come from measurements at a few ratios (``thresholds``); between them the
logarithm of the share runs straight over the logarithm of the ratio, beyond the
last it goes on with the last slope, so a larger ratio never promises more.
"""

from __future__ import annotations

import math
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from ..frame import Frame
from ..thresholds import Thresholds
from .model import Gain, Outcome
from .targets import Target
from .units import Group, Key, Unit

Point = Tuple[float, float]


def interpolated(points: Sequence[Point], ratio: float) -> float:
    """A share at ``ratio`` from (ratio, share) points, straight in logarithms; before the first point its share.

    Shares that rise, or points out of order, are passed over: the result never
    rises with the ratio.
    """
    kept = [points[0]]
    for x, y in points[1:]:
        if x > kept[-1][0] and 0.0 < y <= kept[-1][1]:
            kept.append((x, y))
    if ratio <= kept[0][0] or len(kept) == 1:
        return kept[0][1]
    pairs = list(zip(kept, kept[1:]))
    (x0, y0), (x1, y1) = next((p for p in pairs if ratio <= p[1][0]), pairs[-1])
    slope = math.log(y1 / y0) / math.log(x1 / x0)
    share: float = y0 * (ratio / x0) ** slope
    return share


def mixed_share(ratio: float, limits: Thresholds) -> float:
    """Matches between frames whose ground resolutions differ by ``ratio``, as they are."""
    return interpolated(
        ((limits.match_hold_ratio, 1.0), (2.0, limits.match_share_2x), (4.0, limits.match_share_4x)), ratio
    )


def restored_share(scale: float, limits: Thresholds) -> float:
    """Matches of frames that were enlarged by ``scale``, with frames that are as fine by nature."""
    return interpolated(
        ((limits.match_hold_ratio, 1.0), (2.0, limits.restored_share_2x), (4.0, limits.restored_share_4x)), scale
    )


def expected_share(ratio: float, scale: float, limits: Thresholds) -> float:
    """Matches with the finest frames, ``ratio`` times finer, after resizing by ``scale``.

    Reduced frames match as badly as coarse ones: pixels lost are matches lost.
    """
    if scale < 1.0:
        return mixed_share(ratio / scale, limits)
    return restored_share(min(scale, ratio), limits) * mixed_share(max(1.0, ratio / scale), limits)


def gains_of(
    units: Sequence[Unit],
    targets: Mapping[Key, Target],
    sizes: Mapping[Key, Tuple[int, int]],
    files: Mapping[str, Frame],
    limits: Thresholds,
) -> Tuple[Gain, ...]:
    """One gain per profile and flight of known ground resolution, by profile and flight.

    ``sizes`` are those that the plan writes. A flight that keeps its pixels
    gets what bringing it to the finest would have brought and cost.
    """
    finest: Dict[Tuple[str, str], float] = {}
    for unit in units:
        if unit.gsd_cm:
            pool = (unit.spectrum, unit.ground)
            finest[pool] = min(unit.gsd_cm, finest.get(pool, unit.gsd_cm))
    gains: List[Gain] = []
    for unit in units:
        if not unit.gsd_cm:
            continue
        ratio = unit.gsd_cm / finest[(unit.spectrum, unit.ground)]
        target = targets[unit.key]
        chosen = target.scale != 1.0
        for group in unit.groups:
            if chosen:
                size = sizes[group.key]
            else:
                size = (max(1, round(group.width * ratio)), max(1, round(group.height * ratio)))
            gains.append(
                Gain(
                    profile=group.profile,
                    flight=group.flight,
                    spectrum=unit.spectrum,
                    ground=unit.ground,
                    frames=len(group.frames),
                    ratio=ratio,
                    trigger=target.trigger,
                    chosen=chosen,
                    native=_outcome(group, (group.width, group.height), ratio, files, limits),
                    resampled=_outcome(group, size, ratio, files, limits),
                )
            )
    return tuple(sorted(gains, key=lambda g: (g.profile, g.flight)))


def _outcome(
    group: Group, size: Tuple[int, int], ratio: float, files: Mapping[str, Frame], limits: Thresholds
) -> Outcome:
    scale = size[0] / group.width
    return Outcome(
        scale=scale,
        width=size[0],
        height=size[1],
        gsd_cm=_over(group.gsd_cm, scale),
        inliers=expected_share(ratio, scale, limits),
        megapixels=len(group.frames) * size[0] * size[1] / 1e6,
        size_bytes=sum(_bytes(files[p], scale, limits) for p in group.frames),
    )


def _over(gsd_cm: Optional[float], scale: float) -> Optional[float]:
    return None if gsd_cm is None else gsd_cm / scale


def _bytes(frame: Frame, scale: float, limits: Thresholds) -> int:
    """Size of a frame's copy: by pixels, but interpolated pixels compress to less."""
    compressed = frame.format in ("jpeg", "mpo") and scale > 1.0
    growth: float = scale ** (limits.jpeg_growth if compressed else 2.0)
    return round(frame.size_bytes * growth)
