"""The true pieces of a model that ODM merged: by the growth report, or by the points that frames share."""

from __future__ import annotations

from typing import Dict, Iterator, List, Mapping, Optional, Tuple

import numpy as np

from .opensfm_raw import Geometry, Ints, RawModel
from .opensfm_tracks import Observations

Pairs = Dict[Tuple[str, str], int]

_MOST_CELLS = 50_000_000
_MOST_SHARED = 20_000_000
_LONGEST_TRACK = 40
_FAR_PX = 50.0


def pieces(names: Tuple[str, ...], raw: RawModel, grown: Optional[Mapping[str, int]]) -> Tuple[Ints, str]:
    """Each placed frame's piece and what told it; ``""`` where nothing did."""
    if raw.entries > 1:
        return np.asarray([raw.entry[n] for n in names], dtype=np.int64), "reconstruction.json"
    if grown is None:
        return np.zeros(len(names), dtype=np.int64), ""
    found = np.asarray([grown.get(n, -1) for n in names], dtype=np.int64)
    seen = found[found >= 0]
    # A frame that no step speaks of was put in with its piece; the largest is the likeliest.
    found[found < 0] = int(np.argmax(np.bincount(seen))) if len(seen) else 0
    return np.unique(found, return_inverse=True)[1].reshape(-1).astype(np.int64), "the growth report"


def by_size(piece: Ints) -> Ints:
    """Piece -> rank, the piece with most frames first."""
    count = np.bincount(piece)
    order = np.argsort(-count, kind="stable")
    rank = np.empty(len(count), dtype=np.int64)
    rank[order] = np.arange(len(count))
    return rank


def point_pieces(raw: RawModel, geometry: Geometry, piece: Ints, batches: Iterator[Observations]) -> Ints:
    """The piece that each point of a merged model came from: the one whose frames see it where it is.

    A track can run through frames of two pieces; the merged model keeps one
    place for it, which is wrong for the other piece's frames.
    """
    number = int(piece.max()) + 1
    kept = max(1, min(number, _MOST_CELLS // max(len(raw.point_id), 1)))
    order = np.argsort(raw.point_id, kind="stable")
    ids = raw.point_id[order]
    total = np.zeros((len(ids), kept), dtype=np.float32)
    count = np.zeros((len(ids), kept), dtype=np.int32)
    for batch in batches:
        spot = np.minimum(np.searchsorted(ids, batch.track), max(len(ids) - 1, 0))
        use = (batch.frame >= 0) & (len(ids) > 0)
        use[use] = (ids[spot[use]] == batch.track[use]) & (piece[batch.frame[use]] < kept)
        frame, at = batch.frame[use], spot[use]
        error = np.minimum(np.nan_to_num(geometry.error_px(frame, batch.xy[use], raw.point_xyz[order[at]])), _FAR_PX)
        cell = (at, piece[frame])
        np.add.at(total, cell, error.astype(np.float32))
        np.add.at(count, cell, 1)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.float32(2 * _FAR_PX))
    mean = np.where(count == 1, mean + np.float32(_FAR_PX), mean)
    result = np.empty(len(ids), dtype=np.int64)
    result[order] = np.argmin(mean, axis=1)
    return result


class Shared:
    """Which points each frame sees well, for counting what frames share."""

    def __init__(self) -> None:
        self._frame: List[Ints] = []
        self._point: List[Ints] = []
        self._total = 0

    def add(self, frame: Ints, point: Ints) -> None:
        """Add observations; beyond a bound they are no longer kept."""
        if self._total < _MOST_SHARED:
            self._frame.append(frame.astype(np.int32))
            self._point.append(point.astype(np.int32))
            self._total += len(frame)

    @property
    def rows(self) -> Tuple[Ints, Ints]:
        """Frames and points of all observations."""
        if not self._frame:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        return np.concatenate(self._frame).astype(np.int64), np.concatenate(self._point).astype(np.int64)

    def pairs(self, names: Tuple[str, ...]) -> Pairs:
        """(frame, frame) -> points that both see; of very long tracks the first frames only."""
        frame, point = self.rows
        order = np.lexsort((frame, point))
        frame, point = frame[order], point[order]
        found: Dict[int, int] = {}
        for step in range(1, _LONGEST_TRACK):
            same = point[step:] == point[:-step] if len(point) > step else np.zeros(0, dtype=bool)
            if not same.any():
                break
            key = frame[:-step][same] * len(names) + frame[step:][same]
            for pair, count in zip(*np.unique(key, return_counts=True)):
                found[int(pair)] = found.get(int(pair), 0) + int(count)
        return {(names[k // len(names)], names[k % len(names)]): v for k, v in sorted(found.items())}


def by_shared(names: Tuple[str, ...], pairs: Pairs, enough: int) -> Ints:
    """Pieces of frames held together by pairs that share ``enough`` points."""
    root = list(range(len(names)))

    def top(i: int) -> int:
        while root[i] != i:
            root[i] = root[root[i]]
            i = root[i]
        return i

    at = {n: i for i, n in enumerate(names)}
    for (a, b), count in pairs.items():
        if count >= enough:
            first, second = sorted((top(at[a]), top(at[b])))
            root[second] = first
    return np.unique([top(i) for i in range(len(names))], return_inverse=True)[1].reshape(-1).astype(np.int64)


def points_by_frames(shared: Optional[Shared], piece: Ints, points: int) -> Ints:
    """Each point's piece by the frames that see it well; -1 for one that none does."""
    result = np.full(points, -1, dtype=np.int64)
    if shared is not None:
        frame, point = shared.rows
        result[point[::-1]] = piece[frame[::-1]]
    return result
