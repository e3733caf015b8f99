"""What OpenSfM reconstructed, out of its files: poses, points, true components, errors.

ODM merges all partial reconstructions into one before it counts them, so
``components`` is 1 in its own report however broken the block is. The pieces
are told apart again by the growth report, or by the points that frames share.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Iterator, Mapping, Optional, Tuple

import numpy as np

from ...stages.thresholds import Thresholds
from .opensfm_cameras import OpenSfmCamera
from .opensfm_errors import ErrorTable
from .opensfm_json import Unreadable
from .opensfm_pieces import Pairs, Shared, by_shared, by_size, pieces, point_pieces, points_by_frames
from .opensfm_raw import Array, Geometry, Ints, grown_components, read_raw
from .opensfm_tracks import Observations, read_tracks


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
    geometry = Geometry(raw, names)
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
    piece, counted_by = pieces(names, raw, grown)
    point_piece = raw.point_entry
    if raw.entries <= 1 and int(piece.max()) > 0:
        point_piece = point_pieces(raw, geometry, piece, batches())
    order = np.lexsort((raw.point_id, point_piece))
    table = _Points(raw.point_id[order], point_piece[order], raw.point_xyz[order])
    errors = ErrorTable(len(names), limits.outcome_outlier_px)
    count_shared = count_shared or (not counted_by and tracks.is_file())
    shared = Shared() if count_shared else None
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
        piece, counted_by = by_shared(names, pairs, limits.outcome_tie_points), "shared points"
        table = _Points(table.ids, points_by_frames(shared, piece, len(table.ids)), table.xyz)
    damaged = bool(notes)
    unknown = sorted({c for c, ok in zip(geometry.cameras, geometry.known) if not ok})
    notes += [f"no reprojection error for {c}: its camera model has no formula here" for c in unknown]
    rank = by_size(piece)
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
