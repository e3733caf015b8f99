"""The sizes at which ODM would work on a project's frames, and what they leave of mixed ground resolutions.

ODM takes one feature size for a project from its largest photo and only ever
shrinks to it: the fine frames lose resolution, small ones keep theirs. Up to
that reduction a mix of resolutions costs ODM nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.harmonize.gains import interpolated, restored_share
from ...stages.harmonize.model import Gain, Outcome
from ...stages.thresholds import Thresholds

Key = Tuple[str, str]

# ODM 3.6: share of the largest photo's longer side by feature-quality and pc-quality, and their bounds in pixels.
FEATURE_QUALITY = {"ultra": 1.0, "high": 0.5, "medium": 0.25, "low": 0.125, "lowest": 0.0675}
POINT_QUALITY = {"ultra": 0.5, "high": 0.25, "medium": 0.125, "low": 0.0675, "lowest": 0.03375}
_FEATURE_BOUNDS_PX = (320, 4480)
_DEPTHMAP_LEAST_PX = 320
_SMALL_MP, _POINTS_SMALL_MP, _LARGE_MP = 2.0, 6.0, 42.0
# Its defaults for orthophoto-resolution, and the margin that it adds to the mean ground resolution.
_ORTHOPHOTO_CM = 5.0
_GSD_MARGIN = 1.5


@dataclass(frozen=True)
class OdmLoad:
    """What ODM makes of one flight's frames beside the others of their project, at its default options.

    ``feature_px`` and ``undistorted_px`` are longer sides for the whole
    project; ``inliers`` is the expected share of matches with the finest
    frames, of those at equal ground resolution.
    """

    feature_px: int
    undistorted_px: int
    inliers: float


def feature_px(width: int, height: int, quality: str = "high") -> int:
    """Longer side to which ODM shrinks larger frames before it extracts features, from the largest photo."""
    megapixels = width * height / 1e6
    factor = 2.0 if megapixels < _SMALL_MP else 0.5 if megapixels > _LARGE_MP else 1.0
    side = int(max(width, height) * min(1.0, FEATURE_QUALITY[quality] * factor))
    return min(_FEATURE_BOUNDS_PX[1], max(_FEATURE_BOUNDS_PX[0], side))


def depthmap_px(width: int, height: int, quality: str = "medium") -> int:
    """Longer side of ODM's depth maps, from the largest photo."""
    megapixels = width * height / 1e6
    factor = 2.0 if megapixels < _POINTS_SMALL_MP else 0.5 if megapixels > _LARGE_MP else 1.0
    return max(_DEPTHMAP_LEAST_PX, int(max(width, height) * POINT_QUALITY[quality] * factor))


def undistorted_px(width: int, height: int, gsd_cm: Optional[float], orthophoto_cm: float = _ORTHOPHOTO_CM) -> int:
    """Longer side of ODM's undistorted frames: halved while the mean ground resolution stays fine enough."""
    scale = 1.0
    if gsd_cm is not None and gsd_cm > 0:
        needed = min(1.0, gsd_cm * _GSD_MARGIN / orthophoto_cm)
        while scale / 2.0 >= needed:
            scale /= 2.0
    return max(math.ceil(max(width, height) * scale), depthmap_px(width, height))


def loads(gains: Sequence[Gain], limits: Thresholds) -> Dict[Key, Tuple[OdmLoad, OdmLoad]]:
    """(profile, flight) -> ODM's load with all frames as they are, and with this flight resampled.

    Flights of one spectrum and ground count as one project. In the second the
    other flights are as the plan leaves them.
    """
    pools: Dict[Tuple[str, str], List[Gain]] = {}
    for gain in gains:
        pools.setdefault((gain.spectrum, gain.ground), []).append(gain)
    result: Dict[Key, Tuple[OdmLoad, OdmLoad]] = {}
    for pool in pools.values():
        native = {_key(g): g.native for g in pool}
        planned = {_key(g): g.resampled if g.chosen else g.native for g in pool}
        finest = _key(min(pool, key=lambda g: (g.ratio, g.profile, g.flight)))
        frames = {_key(g): g.frames for g in pool}
        for gain in pool:
            key = _key(gain)
            after = {**planned, key: gain.resampled}
            result[key] = (
                _load(key, finest, native, native, frames, limits),
                _load(key, finest, native, after, frames, limits),
            )
    return result


def _key(gain: Gain) -> Key:
    return (gain.profile, gain.flight)


def _load(
    key: Key,
    finest: Key,
    native: Mapping[Key, Outcome],
    state: Mapping[Key, Outcome],
    frames: Mapping[Key, int],
    limits: Thresholds,
) -> OdmLoad:
    largest = _largest(state)
    side = feature_px(largest.width, largest.height)
    known = [(frames[k], o.gsd_cm) for k, o in sorted(state.items()) if o.gsd_cm is not None]
    mean = sum(n * gsd for n, gsd in known) / sum(n for n, _ in known) if known else None
    # The coarser of the two that meet decides, held against what ODM sees of the finest frames as they are.
    before = _largest(native)
    sharp = _seen_cm(native[finest], feature_px(before.width, before.height))
    own, best = (_seen_cm(state[k], side) for k in (key, finest))
    ratio = max(own, best) / sharp if sharp else 1.0
    # Interpolated pixels show no more ground than those they were made of.
    enlarged = (native[key].gsd_cm or own) / own if own else 1.0
    share = interpolated(
        ((limits.odm_hold_ratio, 1.0), (1.5, limits.odm_share_1_5x), (4.0, limits.match_share_4x)), ratio
    ) * restored_share(enlarged, limits)
    return OdmLoad(side, undistorted_px(largest.width, largest.height, mean), share)


def _largest(state: Mapping[Key, Outcome]) -> Outcome:
    return max(state.values(), key=lambda o: (o.width * o.height, o.width))


def _seen_cm(outcome: Outcome, side_px: int) -> float:
    """Ground resolution of a frame after ODM shrank it for its features."""
    return (outcome.gsd_cm or 0.0) * max(1.0, max(outcome.width, outcome.height) / side_px)
