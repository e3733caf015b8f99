"""Pairs of frames that saw the same ground, by position alone (pure).

Headings are not trusted, so ground is compared as discs around the frames'
centres: a disc is the same whichever way the camera was turned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Mapping, Optional, Sequence, Tuple

import numpy as np

from ..captures import seconds
from ..frame import Frame
from ..geo import local_metres
from ..thresholds import Thresholds
from .units import Group


@dataclass(frozen=True)
class Pair:
    """Two frames whose centres lie ``apart`` radii apart; ``gap_s`` is the second's time minus the first's."""

    first: str
    second: str
    apart: float
    gap_s: float


def radius_m(group: Group) -> Optional[float]:
    """Radius of the largest disc of ground inside a nadir frame; ``None`` where the GSD is unknown."""
    if not group.gsd_cm:
        return None
    return group.gsd_cm / 100.0 * min(group.width, group.height) / 2.0


def _placed(group: Group, files: Mapping[str, Frame], limits: Thresholds) -> List[Frame]:
    """Return the frames with a position that look down."""
    return [
        f
        for f in (files[p] for p in group.frames)
        if f.has_gps and (f.pitch_deg is None or abs(90.0 + f.pitch_deg) <= limits.oblique_pitch_deg)
    ]


def _metres(frames: Sequence[Frame], origin: Frame) -> "np.ndarray[Tuple[int, int], np.dtype[np.float64]]":
    fixes = [(f.latitude or 0.0, f.longitude or 0.0) for f in frames]
    return np.asarray(local_metres(fixes, (origin.latitude or 0.0, origin.longitude or 0.0)))


def _gap(first: Frame, second: Frame) -> float:
    a, b = seconds(first), seconds(second)
    return 0.0 if a is None or b is None else b - a


def pairs_between(a: Group, b: Group, files: Mapping[str, Frame], limits: Thresholds) -> Tuple[Pair, ...]:
    """Return the nearest pairs of two groups, each frame used once, at most ``limits.tone_pairs``."""
    radii = (radius_m(a), radius_m(b))
    first, second = _placed(a, files, limits), _placed(b, files, limits)
    if radii[0] is None or radii[1] is None or not first or not second:
        return ()
    reach = min(radii[0], radii[1])
    here, there = _metres(first, first[0]), _metres(second, first[0])
    found: List[Pair] = []
    for index, frame in enumerate(first):
        apart = np.hypot(*(there - here[index]).T) / reach
        for other in np.flatnonzero(apart <= limits.tone_pair_distance):
            mate = second[int(other)]
            found.append(Pair(frame.path, mate.path, float(apart[other]), _gap(frame, mate)))
    return _once(sorted(found, key=lambda p: (p.apart, p.first, p.second)), limits.tone_pairs)


def pairs_within(
    group: Group, files: Mapping[str, Frame], limits: Thresholds
) -> Tuple[Tuple[Pair, ...], Tuple[Pair, ...]]:
    """Return a flight's close pairs and its pairs of neighbouring strips, longest time between them first.

    Of the latter only those that lie about as far apart in time as any do: a
    drift shows in them and drowns among the others.
    """
    reach, frames = radius_m(group), _placed(group, files, limits)
    if reach is None or len(frames) < 2:
        return (), ()
    places = _metres(frames, frames[0])
    close: List[Pair] = []
    strips: List[Pair] = []
    for index, frame in enumerate(frames):
        apart = np.hypot(*(places[index + 1 :] - places[index]).T) / reach
        for other in np.flatnonzero(apart <= limits.light_pair_distance):
            mate = frames[index + 1 + int(other)]
            gap = _gap(frame, mate)
            pair = Pair(frame.path, mate.path, float(apart[other]), gap)
            if gap < 0:
                pair = Pair(mate.path, frame.path, pair.apart, -gap)
            (close if pair.apart <= limits.tone_pair_distance else strips).append(pair)

    def order(pair: Pair) -> Tuple[float, str, str]:
        return (-pair.gap_s, pair.first, pair.second)

    late = 0.5 * max((p.gap_s for p in strips), default=0.0)
    strips = [p for p in strips if p.gap_s >= late]
    return _once(sorted(close, key=order), limits.tone_pairs), _once(sorted(strips, key=order), limits.tone_pairs)


def _once(pairs: Sequence[Pair], most: int) -> Tuple[Pair, ...]:
    used: set[str] = set()
    chosen: List[Pair] = []
    for pair in pairs:
        if len(chosen) == most:
            break
        if pair.first not in used and pair.second not in used:
            chosen.append(pair)
            used.update((pair.first, pair.second))
    return tuple(chosen)
