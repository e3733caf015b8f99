"""What OpenSfM reconstructed, out of its files: poses, points, true components, errors.

ODM merges all partial reconstructions into one before it counts them, so
``components`` is 1 in its own report however broken the block is. The pieces
are told apart again by the growth report, or by the points that frames share.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, Tuple

import numpy as np
import numpy.typing as npt

from ...stages.thresholds import Thresholds
from .opensfm_cameras import OpenSfmCamera, camera_from_json, project, rotation_matrix
from .opensfm_errors import ErrorTable
from .opensfm_json import Unreadable, numbers, read_object, read_reconstructions
from .opensfm_tracks import Observations, PointIds, read_tracks

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Pairs = Dict[Tuple[str, str], int]

_MOST_CELLS = 50_000_000
_MOST_SHARED = 20_000_000
_LONGEST_TRACK = 40
_FAR_PX = 50.0


@dataclass(frozen=True)
class Shot:
    """One placed frame: world to camera as axis-angle and translation, and its camera's id."""

    camera: str
    rotation: Tuple[float, ...]
    translation: Tuple[float, ...]


@dataclass
class RawModel:
    """The cameras, shots and points of ``reconstruction.json`` as they stand; ``entry`` is a shot's reconstruction."""

    cameras: Dict[str, OpenSfmCamera] = field(default_factory=dict)
    shots: Dict[str, Shot] = field(default_factory=dict)
    entry: Dict[str, int] = field(default_factory=dict)
    entries: int = 0
    point_id: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    point_entry: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    point_xyz: Array = field(default_factory=lambda: np.zeros((0, 3)))
    ids: PointIds = field(default_factory=PointIds)
    notes: List[str] = field(default_factory=list)


@dataclass(frozen=True)
class OdmModel:
    """A reconstruction with its pieces told apart.

    ``names`` are the placed frames, sorted; arrays are in their order.
    ``model`` (N,) is each frame's piece, 0 the largest; ``rotation`` (N, 3, 3)
    is world to camera. ``errors`` is ``None`` where there are no tracks.
    ``shared`` counts the points that two frames both see well, where that had
    to be counted. ``damaged`` says that files ended early or hold damaged entries.
    """

    names: Tuple[str, ...]
    cameras: Mapping[str, OpenSfmCamera]
    camera_of: Tuple[str, ...]
    model: Ints
    center: Array
    rotation: Array
    point_xyz: Array
    point_model: Ints
    point_id: Ints
    errors: Optional[ErrorTable]
    shared: Optional[Pairs]
    counted_by: str
    notes: Tuple[str, ...]
    damaged: bool = False

    @property
    def sizes(self) -> Tuple[int, ...]:
        """Frames of each piece, the largest first."""
        return tuple(int(n) for n in np.bincount(self.model)) if len(self.model) else ()


def read_raw(path: Path, limits: Thresholds) -> RawModel:
    """Read ``reconstruction.json`` piece by piece; what is damaged is left out and said in ``notes``."""
    raw = RawModel()
    numbers_of, entries, places = array("q"), array("q"), array("d")
    bad = 0
    try:
        for index, section, key, value in read_reconstructions(path, limits):
            raw.entries = max(raw.entries, index + 1)
            try:
                if section == "cameras":
                    raw.cameras.setdefault(key, camera_from_json(key, value))
                elif section == "shots":
                    if key not in raw.shots and len(raw.shots) < limits.outcome_max_frames:
                        raw.shots[key] = _shot(value)
                        raw.entry[key] = index
                elif len(numbers_of) < limits.outcome_max_points:
                    place = numbers(value["coordinates"], 3)
                    numbers_of.append(raw.ids.number(key))
                    entries.append(index)
                    places.extend(place)
            except (KeyError, TypeError, ValueError, OverflowError):
                bad += 1
    except Unreadable as error:
        raw.notes.append(str(error))
    if bad:
        raw.notes.append(f"{bad} entries of {path.name} are damaged and were left out")
    lost = sorted(n for n, s in raw.shots.items() if s.camera not in raw.cameras)
    if lost:
        raw.notes.append(f"{len(lost)} placed frames have no camera in {path.name}")
        for name in lost:
            del raw.shots[name], raw.entry[name]
    raw.point_id = np.frombuffer(numbers_of, dtype=np.int64) if numbers_of else raw.point_id
    raw.point_entry = np.frombuffer(entries, dtype=np.int64) if entries else raw.point_entry
    raw.point_xyz = np.frombuffer(places, dtype=np.float64).reshape(-1, 3) if places else raw.point_xyz
    return raw


def _shot(value: Mapping[str, Any]) -> Shot:
    return Shot(str(value["camera"]), tuple(numbers(value["rotation"], 3)), tuple(numbers(value["translation"], 3)))


def grown_components(path: Path, limits: Thresholds) -> Optional[Dict[str, int]]:
    """Return frame -> piece by ``reports/reconstruction.json``, ``None`` where it does not say.

    A piece is an entry that grew: its first two frames and those of its steps.
    """
    try:
        report = read_object(path, limits)
    except (FileNotFoundError, Unreadable):
        return None
    found: Dict[str, int] = {}
    rows = report.get("reconstructions")
    number = 0
    for entry in rows if isinstance(rows, list) else []:
        if not isinstance(entry, dict) or not isinstance(entry.get("grow"), dict):
            continue
        bootstrap = entry.get("bootstrap")
        names = list(bootstrap.get("image_pair") or []) if isinstance(bootstrap, dict) else []
        steps = entry["grow"].get("steps")
        for step in steps if isinstance(steps, list) else []:
            if isinstance(step, dict) and isinstance(step.get("images"), list):
                names.extend(step["images"])
        for name in names:
            if isinstance(name, str):
                found.setdefault(name, number)
        number += 1
    return found or None


class _Geometry:
    """Errors of observations against points, vectorised by camera."""

    def __init__(self, raw: RawModel, names: Tuple[str, ...]) -> None:
        self.rotation = np.stack([rotation_matrix(np.asarray(raw.shots[n].rotation)) for n in names])
        self.translation = np.asarray([raw.shots[n].translation for n in names])
        self.cameras = sorted({raw.shots[n].camera for n in names})
        at = {c: i for i, c in enumerate(self.cameras)}
        self.camera = np.asarray([at[raw.shots[n].camera] for n in names], dtype=np.int64)
        self._models = [raw.cameras[c] for c in self.cameras]
        self.known = np.asarray([c.known for c in self._models])

    @property
    def center(self) -> Array:
        """Camera centres (N, 3)."""
        result: Array = -np.einsum("nji,nj->ni", self.rotation, self.translation)
        return result

    def error_px(self, frame: Ints, xy: Array, points: Array) -> Array:
        """Distance in pixels between observed and projected places; NaN where the camera has no formula."""
        found = np.full(len(frame), np.nan)
        seen = np.einsum("nij,nj->ni", self.rotation[frame], points) + self.translation[frame]
        for index, camera in enumerate(self._models):
            mine = np.nonzero(self.camera[frame] == index)[0]
            if not camera.known or not len(mine):
                continue
            miss = (project(camera, seen[mine]) - xy[mine]) * camera.side
            error = np.hypot(miss[:, 0], miss[:, 1])
            if not camera.model.startswith("fisheye"):
                error[seen[mine, 2] <= 0] = np.inf
            found[mine] = error
        return found


def build_model(folder: Path, reconstruction: Path, limits: Thresholds, count_shared: bool) -> Optional[OdmModel]:
    """Read the model of an OpenSfM ``folder``; ``None`` where no frame was placed.

    ``count_shared`` asks for the points that pairs of frames share (where the
    matches are gone); they are counted as well where nothing else tells the
    pieces apart.
    """
    raw = read_raw(reconstruction, limits)
    names = tuple(sorted(raw.shots))
    if not names:
        return None
    notes = list(raw.notes)
    geometry = _Geometry(raw, names)
    rows = {n: i for i, n in enumerate(names)}
    tracks = folder / "tracks.csv"

    def batches() -> Iterator[Observations]:
        if tracks.is_file():
            try:
                yield from read_tracks(tracks, rows, raw.ids, limits.outcome_max_observations)
            except Unreadable as error:
                if str(error) not in notes:
                    notes.append(str(error))

    grown = grown_components(folder / "reports" / "reconstruction.json", limits)
    piece, counted_by = _pieces(names, raw, grown)
    point_piece = raw.point_entry
    if raw.entries <= 1 and int(piece.max()) > 0:
        point_piece = _point_pieces(raw, geometry, piece, batches())
    order = np.lexsort((raw.point_id, point_piece))
    table = _Points(raw.point_id[order], point_piece[order], raw.point_xyz[order])
    errors = ErrorTable(len(names), limits.outcome_outlier_px)
    count_shared = count_shared or (not counted_by and tracks.is_file())
    shared = _Shared() if count_shared else None
    for batch in batches():
        frame, at = table.find(batch, piece)
        if not len(frame.frame):
            continue
        error = geometry.error_px(frame.frame, frame.xy, table.xyz[at])
        usable = geometry.known[geometry.camera[frame.frame]]
        errors.add(frame.frame[usable], error[usable])
        if shared is not None:
            good = np.nan_to_num(error, nan=0.0) <= limits.outcome_outlier_px
            shared.add(frame.frame[good], at[good])
    pairs = shared.pairs(names) if shared is not None else None
    if not counted_by and pairs is not None and tracks.is_file() and len(raw.point_id):
        piece, counted_by = _by_shared(names, pairs, limits.outcome_tie_points), "shared points"
        table = _Points(table.ids, _points_by_frames(shared, piece, len(table.ids)), table.xyz)
    damaged = bool(notes)
    unknown = sorted({c for c, ok in zip(geometry.cameras, geometry.known) if not ok})
    notes += [f"no reprojection error for {c}: its camera model has no formula here" for c in unknown]
    rank = _by_size(piece)
    return OdmModel(
        names=names,
        cameras=raw.cameras,
        camera_of=tuple(raw.shots[n].camera for n in names),
        model=rank[piece],
        center=geometry.center,
        rotation=geometry.rotation,
        point_xyz=table.xyz,
        point_model=np.where(table.piece >= 0, rank[np.maximum(table.piece, 0)], -1),
        point_id=table.ids,
        errors=errors if tracks.is_file() else None,
        shared=pairs,
        counted_by=counted_by,
        notes=tuple(notes),
        damaged=damaged,
    )


@dataclass(frozen=True)
class _Points:
    """Points sorted by piece and id, for look-up."""

    ids: Ints
    piece: Ints
    xyz: Array

    def find(self, batch: Observations, piece: Ints) -> Tuple[Observations, Ints]:
        """The observations of points that lie in the frame's own piece, with the points' rows."""
        placed = np.nonzero(batch.frame >= 0)[0]
        wanted = piece[batch.frame[placed]]
        at = np.full(len(placed), -1, dtype=np.int64)
        for number in np.unique(wanted):
            low, high = np.searchsorted(self.piece, [number, number + 1])
            mine = np.nonzero(wanted == number)[0]
            if low == high:
                continue
            spot = low + np.searchsorted(self.ids[low:high], batch.track[placed[mine]])
            hit = (spot < high) & (self.ids[np.minimum(spot, high - 1)] == batch.track[placed[mine]])
            at[mine[hit]] = spot[hit]
        good = at >= 0
        kept = placed[good]
        return Observations(batch.frame[kept], batch.track[kept], batch.xy[kept]), at[good]


def _pieces(names: Tuple[str, ...], raw: RawModel, grown: Optional[Mapping[str, int]]) -> Tuple[Ints, str]:
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


def _by_size(piece: Ints) -> Ints:
    """Piece -> rank, the piece with most frames first."""
    count = np.bincount(piece)
    order = np.argsort(-count, kind="stable")
    rank = np.empty(len(count), dtype=np.int64)
    rank[order] = np.arange(len(count))
    return rank


def _point_pieces(raw: RawModel, geometry: _Geometry, piece: Ints, batches: Iterator[Observations]) -> Ints:
    """The piece that each point of a merged model came from: the one whose frames see it where it is.

    A track can run through frames of two pieces; the merged model keeps one
    place for it, which is wrong for the other piece's frames.
    """
    pieces = int(piece.max()) + 1
    kept = max(1, min(pieces, _MOST_CELLS // max(len(raw.point_id), 1)))
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


class _Shared:
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


def _by_shared(names: Tuple[str, ...], pairs: Pairs, enough: int) -> Ints:
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


def _points_by_frames(shared: Optional[_Shared], piece: Ints, points: int) -> Ints:
    """Each point's piece by the frames that see it well; -1 for one that none does."""
    result = np.full(points, -1, dtype=np.int64)
    if shared is not None:
        frame, point = shared.rows
        result[point[::-1]] = piece[frame[::-1]]
    return result
