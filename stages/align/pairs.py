"""Which frames are worth matching, from positions, time, heights and footprints (pure).

A pair needs ground that both can see. Each frame gets the nearest ones of its
own flight, but first those of other cameras and flights over the same ground
and of the neighbouring strips: without them, payloads look falsely apart.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Set, Tuple

import numpy as np
import numpy.typing as npt

from ..thresholds import Thresholds
from .enu import local_frame
from .model import AlignCamera, AlignFrame

Array = npt.NDArray[np.float64]
Pair = Tuple[int, int]

_STEEPEST_DEG = 75.0
_STRIP_TURN_DEG = 40.0
_FLAT_TURN_M = 1.0


@dataclass(frozen=True)
class Footprint:
    """Where a frame looks: middle (east, north) and radius in metres, and its position's spread."""

    east: float
    north: float
    radius_m: float
    sigma_m: float


@dataclass(frozen=True)
class PairPlan:
    """Pairs by metadata, sorted; ``blind`` are the frames whose pairs must be found by likeness."""

    pairs: Tuple[Pair, ...]
    blind: Tuple[int, ...]
    areas: Tuple[int, ...]
    dropped: int


def footprints(
    frames: Sequence[AlignFrame], cameras: Sequence[AlignCamera], limits: Thresholds
) -> List[Optional[Footprint]]:
    """Return each frame's footprint, ``None`` where it has no position.

    A nadir footprint is a circle of the half-diagonal height * diagonal / (2 *
    focal). An oblique one reaches from its near to its far edge, at most 75
    degrees off nadir, displaced along the heading where that is known. Without
    a height the radius is the stated ``unknown_footprint_m``.
    """
    ratio = {(c.profile, c.width, c.height): c.intrinsics.focal_ratio for c in cameras}
    placed = [f for f in frames if f.position is not None]
    local = iter(local_frame([f.position for f in placed if f.position is not None]))
    result: List[Optional[Footprint]] = []
    for frame in frames:
        if frame.position is None:
            result.append(None)
            continue
        east, north, _ = next(local)
        sigma = frame.sigma_m[0] if frame.sigma_m else limits.gps_sigma_horizontal_m
        focal = ratio.get((frame.profile, frame.width, frame.height)) or limits.fallback_focal_ratio
        if frame.height_m is None or frame.height_m <= 0:
            result.append(Footprint(float(east), float(north), limits.unknown_footprint_m, sigma))
            continue
        half = math.atan(math.hypot(frame.width, frame.height) / (2.0 * focal * frame.width))
        tilt = math.radians(90.0 + frame.pitch_deg) if frame.pitch_deg is not None else 0.0
        tilt = abs(tilt) if math.degrees(abs(tilt)) > 10.0 else 0.0
        steepest = math.radians(_STEEPEST_DEG)
        far = math.tan(min(tilt + half, steepest)) * frame.height_m
        near = math.tan(max(min(tilt - half, steepest), -steepest)) * frame.height_m
        if tilt and frame.yaw_deg is not None:
            yaw, middle = math.radians(frame.yaw_deg), (far + near) / 2.0
            east, north = east + middle * math.sin(yaw), north + middle * math.cos(yaw)
            radius = max((far - near) / 2.0, math.tan(half) * frame.height_m)
        else:
            radius = far
        result.append(Footprint(float(east), float(north), radius, sigma))
    return result


def can_overlap(a: Footprint, b: Footprint, sigma_factor: float) -> bool:
    """Whether two footprints can share ground."""
    away = math.hypot(a.east - b.east, a.north - b.north)
    return round(away, 3) <= round(a.radius_m + b.radius_m + sigma_factor * math.hypot(a.sigma_m, b.sigma_m), 3)


def strips(frames: Sequence[AlignFrame], prints: Sequence[Optional[Footprint]]) -> List[Tuple[str, int]]:
    """Return (flight, strip number) of each frame: a strip ends where the track turns by more than 40 degrees."""
    by_flight: Dict[str, List[int]] = defaultdict(list)
    for index, frame in enumerate(frames):
        by_flight[frame.flight].append(index)
    result: List[Tuple[str, int]] = [(f.flight, 0) for f in frames]
    for flight in sorted(by_flight):
        order = sorted(by_flight[flight], key=lambda i: (_time(frames[i]), frames[i].path))
        order = [i for i in order if prints[i] is not None]
        number, heading = 0, None
        for before, now in zip(order, order[1:]):
            a, b = prints[before], prints[now]
            assert a is not None and b is not None
            east, north = b.east - a.east, b.north - a.north
            if math.hypot(east, north) >= _FLAT_TURN_M:
                course = math.degrees(math.atan2(east, north))
                if heading is not None and abs((course - heading + 180.0) % 360.0 - 180.0) > _STRIP_TURN_DEG:
                    number += 1
                    heading = None
                else:
                    heading = course
            result[now] = (flight, number)
    return result


def _time(frame: AlignFrame) -> float:
    return frame.time_s if frame.time_s is not None else math.inf


def plan_pairs(frames: Sequence[AlignFrame], cameras: Sequence[AlignCamera], limits: Thresholds) -> PairPlan:
    """Choose the pairs to match, by index into ``frames``.

    With positions: at most ``pairs_per_frame`` each, ``pairs_cross`` of them to
    other profiles or flights and ``pairs_strip`` to other strips as far as
    there are any, the rest to the nearest. Without: every pair up to
    ``all_pairs_limit`` frames, beyond that neighbours in time, and the frame is
    ``blind``. Frames of one capture are never paired.
    """
    prints = footprints(frames, cameras, limits)
    lines = strips(frames, prints)
    overlap = _Overlap(prints, limits.overlap_sigma_factor)
    reach = _candidates(frames, prints, overlap)
    degree = [0] * len(frames)
    taken: Set[Pair] = set()

    def take(wishes: Sequence[Sequence[int]], quota: int, cap: int) -> None:
        wanted = [set(w) for w in wishes]
        got = [0] * len(frames)
        for a, b in taken:
            got[a] += b in wanted[a]
            got[b] += a in wanted[b]
        for rank in range(max((len(w) for w in wishes), default=0)):
            for i, wish in enumerate(wishes):
                if rank >= len(wish) or got[i] >= quota or degree[i] >= cap:
                    continue
                j = wish[rank]
                pair = (min(i, j), max(i, j))
                if pair in taken or degree[j] >= cap:
                    continue
                taken.add(pair)
                degree[i] += 1
                degree[j] += 1
                got[i] += 1
                got[j] += i in wanted[j]

    own_line = [[j for j in reach[i] if lines[j] == lines[i]] for i in range(len(frames))]
    other_line = [
        [j for j in reach[i] if lines[j][0] == lines[i][0] and lines[j][1] != lines[i][1]] for i in range(len(frames))
    ]
    cross = [
        [j for j in reach[i] if frames[j].flight != frames[i].flight or frames[j].profile != frames[i].profile]
        for i in range(len(frames))
    ]
    full = limits.pairs_per_frame
    # The chain along the strip first: it alone keeps a flight in one piece.
    take(own_line, 2, full)
    take(cross, limits.pairs_cross, max(full - limits.pairs_strip - 2, limits.pairs_cross))
    take(other_line, limits.pairs_strip, full)
    take(reach, full, full)
    blind = tuple(i for i in range(len(frames)) if prints[i] is None)
    if blind:
        taken |= _blind_pairs(blind, frames, limits)
    seen = [p for p in prints if p is not None]
    return PairPlan(
        pairs=tuple(sorted(taken)),
        blind=blind if len(frames) > limits.all_pairs_limit else (),
        areas=_areas(prints, overlap),
        dropped=len(seen) * (len(seen) - 1) // 2 - sum(len(r) for r in reach) // 2,
    )


class _Overlap:
    """``can_overlap`` of one footprint with all others at once, for surveys of thousands of frames."""

    def __init__(self, prints: Sequence[Optional[Footprint]], sigma_factor: float) -> None:
        rows = [(p.east, p.north, p.radius_m, p.sigma_m) if p else (math.nan,) * 4 for p in prints]
        self.east, self.north, self.radius, self.sigma = np.asarray(rows, dtype=float).reshape(-1, 4).T
        self.factor = sigma_factor

    def of(self, i: int) -> Tuple[Array, npt.NDArray[np.bool_]]:
        """Distances of all footprints from footprint ``i`` (m, rounded to mm) and whether they can share ground."""
        away = np.round(np.hypot(self.east - self.east[i], self.north - self.north[i]), 3)
        reach = np.round(self.radius + self.radius[i] + self.factor * np.hypot(self.sigma, self.sigma[i]), 3)
        return away, away <= reach


def _candidates(
    frames: Sequence[AlignFrame], prints: Sequence[Optional[Footprint]], overlap: _Overlap
) -> List[List[int]]:
    """Per frame, those that can share ground with it, nearest first, ties by path."""
    place = {path: rank for rank, path in enumerate(sorted(f.path for f in frames))}
    rank = np.asarray([place[f.path] for f in frames], dtype=np.int64)
    names: Dict[str, int] = {}
    capture = np.asarray([names.setdefault(f.capture, len(names)) if f.capture else -1 for f in frames], dtype=np.int64)
    found: List[List[int]] = []
    for i, own in enumerate(prints):
        if own is None:
            found.append([])
            continue
        away, can = overlap.of(i)
        can[i] = False
        if capture[i] >= 0:
            can &= capture != capture[i]
        rows = np.nonzero(can)[0]
        found.append([int(j) for j in rows[np.lexsort((rank[rows], away[rows]))]])
    return found


def _same_capture(a: AlignFrame, b: AlignFrame) -> bool:
    return bool(a.capture) and a.capture == b.capture


def _blind_pairs(blind: Sequence[int], frames: Sequence[AlignFrame], limits: Thresholds) -> Set[Pair]:
    found: Set[Pair] = set()
    if len(frames) <= limits.all_pairs_limit:
        for i in blind:
            for j in range(len(frames)):
                if j != i and not _same_capture(frames[i], frames[j]):
                    found.add((min(i, j), max(i, j)))
        return found
    by_flight: Dict[str, List[int]] = defaultdict(list)
    for i in blind:
        by_flight[frames[i].flight].append(i)
    for flight in sorted(by_flight):
        order = sorted(by_flight[flight], key=lambda i: (_time(frames[i]), frames[i].path))
        for place, i in enumerate(order):
            for j in order[place + 1 : place + 1 + limits.pairs_per_frame // 4]:
                if not _same_capture(frames[i], frames[j]):
                    found.add((min(i, j), max(i, j)))
    return found


def _areas(prints: Sequence[Optional[Footprint]], overlap: _Overlap) -> Tuple[int, ...]:
    """Number the pieces of ground: frames joined by possible overlaps share one; frames without position are -1.

    Area 0 holds the most frames.
    """
    label = np.full(len(prints), -1, dtype=np.int64)
    count = 0
    for start, own in enumerate(prints):
        if label[start] >= 0 or own is None:
            continue
        label[start], stack = count, [start]
        while stack:
            _, can = overlap.of(stack.pop())
            fresh = np.nonzero(can & (label < 0))[0]
            label[fresh] = count
            stack.extend(int(j) for j in fresh)
        count += 1
    sizes = {n: int((label == n).sum()) for n in range(count)}
    order = {n: place for place, n in enumerate(sorted(sizes, key=lambda n: (-sizes[n], n)))}
    return tuple(order.get(int(n), -1) for n in label)
