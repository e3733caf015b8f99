"""Large blocks are judged by samples: dense patches of ground, small enough to solve at any block size (pure).

A payload cannot be thinned out, for neighbours must overlap; but a patch of it
shows whether its camera, its positions and its ties to the others are right.
The first sample lies where most payloads meet. A payload that is not seen
there is sampled together with one that is, where those two meet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence, Set, Tuple

import numpy as np
import numpy.typing as npt

from ..thresholds import Thresholds
from .blocks import subset
from .model import AlignFrame, AlignRequest
from .pairs import Footprint, footprints

Array = npt.NDArray[np.float64]
# Places that are tried as the middle of a patch; more find no better one.
_MIDDLES = 256


@dataclass(frozen=True)
class Sample:
    """A part of a request for the solver; ``joins`` names the payload that it ties to those sampled before."""

    request: AlignRequest
    joins: str = ""


class _Places:
    """Footprints of a request's frames, by payload."""

    def __init__(self, request: AlignRequest, limits: Thresholds) -> None:
        prints = footprints(request.frames, request.cameras, limits)
        self.frames: Dict[str, List[AlignFrame]] = {}
        self.spots: Dict[str, Array] = {}
        rows: Dict[str, List[Tuple[AlignFrame, Optional[Footprint]]]] = {}
        for frame, seen in sorted(zip(request.frames, prints), key=lambda pair: pair[0].path):
            rows.setdefault(frame.payload, []).append((frame, seen))
        for payload in sorted(rows):
            placed = [(f, p) for f, p in rows[payload] if p is not None]
            if placed:
                self.frames[payload] = [f for f, _ in placed]
                self.spots[payload] = np.array([[p.east, p.north, p.radius_m] for _, p in placed])
            else:
                order = sorted((f for f, _ in rows[payload]), key=lambda f: (_time(f), f.path))
                self.frames[payload] = order

    def seen_from(self, payload: str, middles: Array) -> npt.NDArray[np.bool_]:
        """Whether some frame of the payload sees each of the middles, shape (M,)."""
        spots = self.spots[payload]
        found = np.zeros(len(middles), dtype=bool)
        for row in spots:
            found |= np.hypot(middles[:, 0] - row[0], middles[:, 1] - row[1]) <= row[2]
        return found

    def reach(self, payload: str, middles: Array, count: int) -> Array:
        """Radius around each middle that holds ``count`` of the payload's frames, shape (M,)."""
        away = np.hypot(
            middles[:, None, 0] - self.spots[payload][None, :, 0], middles[:, None, 1] - self.spots[payload][None, :, 1]
        )
        last = min(count, away.shape[1]) - 1
        result: Array = np.partition(away, last, axis=1)[:, last]
        return result

    def nearest(self, payload: str, middle: Array, count: int) -> List[AlignFrame]:
        """The payload's frames next to ``middle``; of one without positions, as many in a row from its middle."""
        frames = self.frames[payload]
        if payload not in self.spots:
            start = max(0, (len(frames) - count) // 2)
            return frames[start : start + count]
        away = np.hypot(self.spots[payload][:, 0] - middle[0], self.spots[payload][:, 1] - middle[1])
        order = sorted(range(len(frames)), key=lambda i: (round(float(away[i]), 3), frames[i].path))
        return [frames[i] for i in order[:count]]

    def middles(self, payloads: Sequence[str]) -> Array:
        """Positions of some frames of the payloads, spread evenly over them."""
        spots = np.concatenate([self.spots[p][:, :2] for p in payloads])
        if len(spots) > _MIDDLES:
            spots = spots[(2 * np.arange(_MIDDLES) + 1) * len(spots) // (2 * _MIDDLES)]
        return np.asarray(spots)


def _time(frame: AlignFrame) -> float:
    return frame.time_s if frame.time_s is not None else math.inf


def samples(request: AlignRequest, limits: Thresholds) -> Tuple[Sample, ...]:
    """Return the request whole where it is small, else its samples, the one that most payloads share first.

    Each sample has at most ``sample_frames`` per pair of payloads, in equal
    parts. Every payload is in one sample at least.
    """
    if len(request.frames) <= limits.sample_above:
        return (Sample(request),)
    places = _Places(request, limits)
    share = int(limits.sample_frames) // (2 if len(places.frames) > 1 else 1)
    located = sorted(places.spots)
    lost = sorted(set(places.frames) - set(located))
    core, middle = _meeting(places, located, share) if located else ([], np.zeros(2))
    found = [Sample(_patch(request, places, [*core, *lost], middle, share))]
    done: Set[str] = {*core, *lost}
    while len(done) < len(places.frames):
        payload, partner, middle = _next(places, sorted(done & set(located)), sorted(set(located) - done), share)
        if partner is None:
            found.append(Sample(_patch(request, places, [payload], middle, int(limits.sample_frames))))
        else:
            found.append(Sample(_patch(request, places, [payload, partner], middle, share), payload))
        done.add(payload)
    return tuple(found)


def _meeting(places: _Places, payloads: Sequence[str], share: int) -> Tuple[List[str], Array]:
    """Where most payloads see one place: those payloads, and the middle of the densest such place."""
    middles = places.middles(payloads)
    seen = np.stack([places.seen_from(p, middles) for p in payloads])
    count = seen.sum(axis=0)
    best = np.flatnonzero(count == count.max())
    spread = np.zeros(len(best))
    for row, payload in zip(seen, payloads):
        here = row[best]
        spread[here] = np.maximum(spread[here], places.reach(payload, middles[best][here], share))
    off = np.hypot(*(middles[best] - np.median(middles[best], axis=0)).T)
    order = sorted(
        range(len(best)),
        key=lambda i: (round(float(spread[i]), 1), round(float(off[i]), 1), *map(float, middles[best[i]])),
    )
    chosen = int(best[order[0]])
    return [p for p, row in zip(payloads, seen) if row[chosen]], middles[chosen]


def _next(places: _Places, done: Sequence[str], left: Sequence[str], share: int) -> Tuple[str, Optional[str], Array]:
    """The next payload to tie on, to whom, and where they meet; without a meeting it is sampled by itself."""
    tries: List[Tuple[Tuple[int, float, str, str], str, Optional[str], Array]] = []
    for payload in left:
        for partner in done:
            both, middle = _meeting(places, [payload, partner], share)
            if len(both) == 2:
                size = float(np.max(places.reach(partner, middle[None, :], share)))
                tries.append(((0, round(size, 3), payload, partner), payload, partner, middle))
        _, own = _meeting(places, [payload], share)
        tries.append(((1, 0.0, payload, ""), payload, None, own))
    _, payload, other, middle = min(tries, key=lambda t: t[0])
    return payload, other, middle


def _patch(request: AlignRequest, places: _Places, payloads: Sequence[str], middle: Array, share: int) -> AlignRequest:
    paths = {f.path for p in payloads for f in places.nearest(p, middle, share)}
    part = subset(request, set(payloads))
    frames = tuple(f for f in part.frames if f.path in paths)
    shapes = {(f.profile, f.width, f.height) for f in frames}
    return replace(
        part,
        frames=frames,
        cameras=tuple(c for c in part.cameras if (c.profile, c.width, c.height) in shapes),
        gcps=tuple(g for g in part.gcps if g.path in paths),
    )
