"""A solution laid over the ground: one similarity per model, and who anchors it.

The anchor payload alone carries the similarity, so that a payload whose shape
or place is wrong cannot pull the frame of reference towards itself.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import numpy.typing as npt

from ..thresholds import Thresholds
from .enu import enu
from .fit import Similarity, collinear, robust_similarity
from .images import working_size
from .model import AlignCamera, AlignFrame, GcpMark
from .solution import UNPLACED, Array, Solution
from .terrain import Terrain

Rows = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Ground:
    """Measured places of the frames: ``east_north_up`` (N, 3), NaN without position.

    ``sigma`` (N, 2) is the spread in metres, horizontal and vertical, that a
    right model's centres show against them: the receiver's and the free
    network's own. ``vertical`` (N,) says whose altitude is a measurement.
    ``control`` has the places of ground points by id in the same frame,
    ``offsets`` by flight what was taken off its altitudes, ``terrain`` the
    ground by an elevation model. ``origin`` is the frame's zero: latitude,
    longitude, altitude.
    """

    east_north_up: Array
    sigma: Array
    vertical: npt.NDArray[np.bool_]
    control: Mapping[str, Array] = field(default_factory=dict)
    offsets: Mapping[str, float] = field(default_factory=dict)
    terrain: Optional[Terrain] = None
    origin: Optional[Tuple[float, float, float]] = None

    @property
    def known(self) -> npt.NDArray[np.bool_]:
        """Frames with a position."""
        return np.isfinite(self.east_north_up[:, 0])


def ground_of(
    frames: Sequence[AlignFrame],
    cameras: Sequence[AlignCamera],
    max_dim: int,
    limits: Thresholds,
    marks: Sequence[GcpMark] = (),
) -> Ground:
    """Lay the measured positions and ground points on a local metric frame; frames are solved at ``max_dim`` px.

    The network's own spread is a few pixels on the ground at the size it was
    solved at: without it, no block flown with RTK could ever fit. A flight
    whose altitudes are all exactly zero has none: cameras without an altimeter
    write that.
    """
    places = np.full((len(frames), 3), np.nan)
    rows = [i for i, f in enumerate(frames) if f.position is not None]
    measured = np.asarray([p for p in (f.position for f in frames) if p is not None], dtype=float).reshape(-1, 3)
    points: Dict[str, Tuple[float, float, float]] = {}
    for mark in sorted(marks, key=lambda m: (m.point, m.path)):
        points.setdefault(mark.point, (mark.latitude, mark.longitude, mark.altitude_m))
    spots = np.asarray([points[n] for n in points], dtype=float).reshape(-1, 3)
    control: Dict[str, Array] = {}
    zero: Optional[Tuple[float, float, float]] = None
    if rows or points:
        # The median of each coordinate: one wrong position does not tilt the frame.
        origin = np.median(measured if rows else spots, axis=0)
        zero = (float(origin[0]), float(origin[1]), float(origin[2]))
        places[rows] = enu(measured, origin)
        control = dict(zip(points, enu(spots, origin)))
    receiver = np.asarray([f.sigma_m or _default_sigma(limits) for f in frames], dtype=float).reshape(-1, 2)
    floor = np.maximum(receiver, limits.rtk_sigma_floor_m)
    pixels = np.array([limits.network_sigma_horizontal_px, limits.network_sigma_vertical_px])
    sigma = np.hypot(floor, _working_gsd_m(frames, cameras, max_dim, limits)[:, None] * pixels)
    altitude: Dict[str, List[float]] = defaultdict(list)
    for frame in frames:
        if frame.position is not None:
            altitude[frame.flight].append(frame.position[2])
    flat = {flight for flight, values in altitude.items() if all(v == 0.0 for v in values)}
    vertical = np.asarray([f.position is not None and f.flight not in flat for f in frames], dtype=bool)
    return Ground(places, sigma, vertical, control, origin=zero)


def _working_gsd_m(
    frames: Sequence[AlignFrame], cameras: Sequence[AlignCamera], max_dim: int, limits: Thresholds
) -> Array:
    """Ground size in metres of a pixel of each frame as it is solved, shape (N,)."""
    ratio = {(c.profile, c.width, c.height): c.intrinsics.focal_ratio for c in cameras}
    known = [f.height_m for f in frames if f.height_m is not None and f.height_m > 0]
    usual = float(np.median(known)) if known else limits.unknown_footprint_m
    found = []
    for frame in frames:
        height = frame.height_m if frame.height_m is not None and frame.height_m > 0 else usual
        focal = ratio.get((frame.profile, frame.width, frame.height)) or limits.fallback_focal_ratio
        width, _ = working_size(frame.width, frame.height, max_dim)
        found.append(height / (focal * width))
    return np.asarray(found, dtype=float)


def _default_sigma(limits: Thresholds) -> Tuple[float, float]:
    return limits.gps_sigma_horizontal_m, limits.gps_sigma_vertical_m


def choose_anchor(
    frames: Sequence[AlignFrame], solution: Solution, ground: Ground, limits: Thresholds
) -> Optional[str]:
    """Return the payload that the others are judged against.

    One whose own shape fits its positions before one that does not, RTK before
    plain GPS, then the one with most frames in the largest model, then by
    name; ``None`` when no placed frame has a position.
    """
    score: Dict[str, List[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
    for index, frame in enumerate(frames):
        if solution.model[index] == UNPLACED or not ground.known[index]:
            continue
        entry = score[frame.payload]
        entry[0] += frame.rtk
        entry[1] += solution.model[index] == 0
        entry[2] += 1
    if not score:
        return None

    def rank(name: str) -> Tuple[bool, bool, float, float, str]:
        rtk, main, count = score[name]
        return (not _fits_alone(name, frames, solution, ground, limits), 2 * rtk <= count, -main, -count, name)

    return min(score, key=rank)


def _fits_alone(
    name: str, frames: Sequence[AlignFrame], solution: Solution, ground: Ground, limits: Thresholds
) -> bool:
    """Whether the payload's largest piece, fitted alone, stays within the allowed residual in the median."""
    counts: Dict[int, int] = defaultdict(int)
    for index, frame in enumerate(frames):
        if frame.payload == name and solution.model[index] != UNPLACED:
            counts[int(solution.model[index])] += 1
    model = min(counts, key=lambda m: (-counts[m], m))
    rows = rows_of(frames, solution, model, name)
    rows = rows[ground.known[rows]]
    if len(rows) < limits.min_proof_frames:
        return False
    fit = fit_rows(solution, ground, rows)
    if fit is None:
        return False
    miss = fit.points(solution.center[rows]) - ground.east_north_up[rows]
    flat = float(np.median(np.hypot(miss[:, 0], miss[:, 1])))
    return flat <= limits.gps_sigma_factor * float(np.median(ground.sigma[rows, 0]))


def fit_rows(solution: Solution, ground: Ground, rows: Rows) -> Optional[Similarity]:
    """Similarity of one model's frames ``rows`` to their measured places."""
    rows = rows[ground.known[rows]]
    if len(rows) < 3:
        return None
    spread = float(np.median(np.hypot(ground.sigma[rows, 0], ground.sigma[rows, 1])))
    return robust_similarity(solution.center[rows], ground.east_north_up[rows], spread)


def rows_of(frames: Sequence[AlignFrame], solution: Solution, model: int, payload: Optional[str] = None) -> Rows:
    """Indices of the frames of one model, of one payload where given."""
    return np.asarray(
        [i for i, f in enumerate(frames) if solution.model[i] == model and (payload is None or f.payload == payload)],
        dtype=np.int64,
    )


def lay_models(
    frames: Sequence[AlignFrame],
    solution: Solution,
    ground: Ground,
    anchor: Optional[str],
    limits: Thresholds,
    control: Optional[Mapping[int, Similarity]] = None,
) -> Tuple[Tuple[Optional[Similarity], str], ...]:
    """Return each model's similarity and the payload that carried it.

    The anchor carries it where it has enough centres off one line there, else
    the payload with most such frames, else all frames together (then ``""``).
    Scale and tilt of a model in ``control`` are ground control's; only its
    place is then moved onto its carrier's GPS, whose datum may be another.
    """
    laid: List[Tuple[Optional[Similarity], str]] = []
    for model in range(solution.models):
        inside = rows_of(frames, solution, model)
        counts: Dict[str, int] = defaultdict(int)
        for row in inside:
            counts[frames[row].payload] += 1
        order = sorted(counts, key=lambda p: (p != anchor, -counts[p], p))
        chosen: Tuple[Optional[Similarity], str] = (None, "")
        for payload in order:
            rows = rows_of(frames, solution, model, payload)
            rows = rows[ground.known[rows]]
            enough = len(rows) >= limits.min_proof_frames
            if enough and not collinear(solution.center[rows], limits.collinear_ratio):
                fit = fit_rows(solution, ground, rows)
                if fit is not None:
                    chosen = (fit, payload)
                    break
        if chosen[0] is None:
            chosen = (fit_rows(solution, ground, inside), "")
        if control and model in control:
            chosen = shifted(control[model], solution, ground, order, frames, model)
        laid.append(chosen)
    return tuple(laid)


def shifted(
    fit: Similarity, solution: Solution, ground: Ground, order: Sequence[str], frames: Sequence[AlignFrame], model: int
) -> Tuple[Similarity, str]:
    """Return ground control's similarity with its place moved to the first payload that has GPS there, and that one."""
    for payload in order:
        rows = rows_of(frames, solution, model, payload)
        rows = rows[ground.known[rows]]
        if len(rows):
            gap = np.median(ground.east_north_up[rows] - fit.points(solution.center[rows]), axis=0)
            if not ground.vertical[rows].all():
                gap[2] = 0.0
            return replace(fit, translation=fit.translation + gap), payload
    return fit, ""


def laid_centers(solution: Solution, laid: Sequence[Tuple[Optional[Similarity], str]]) -> Array:
    """Return every placed frame's centre in world metres, NaN where it has none."""
    result = np.full_like(solution.center, np.nan)
    for model, (fit, _) in enumerate(laid):
        rows = np.nonzero(solution.model == model)[0]
        if fit is not None and len(rows):
            result[rows] = fit.points(solution.center[rows])
    return result


def laid_points(solution: Solution, laid: Sequence[Tuple[Optional[Similarity], str]], model: int) -> Array:
    """Return one model's points in world metres, empty where the model is not laid."""
    fit = laid[model][0]
    if fit is None:
        return np.zeros((0, 3))
    return fit.points(solution.point_xyz[solution.point_model == model])


def looks_down(solution: Solution, laid: Sequence[Tuple[Optional[Similarity], str]], rows: Rows) -> Optional[float]:
    """Share of the frames whose view points below the horizon once laid; ``None`` without any."""
    found = []
    for row in rows:
        fit = laid[int(solution.model[row])][0] if solution.model[row] >= 0 else None
        if fit is not None:
            found.append(bool(fit.directions(solution.rotation[row][2:3])[0, 2] < 0))
    return float(np.mean(found)) if found else None
