"""An ODM reconstruction under the alignment's own measures and verdicts.

The model is handed to the same functions that judge a pycolmap solution:
similarity to GPS by the anchor, residuals together and alone, ties, capture
gaps, bowing. What an incomplete folder cannot say makes a payload unproven,
never failed and never passed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import numpy.typing as npt

from ...stages.align.heights import levelled
from ...stages.align.judge import FAIL, PASS, UNPROVEN, overall
from ...stages.align.measure import Measured, PayloadFigures, measure
from ...stages.align.model import AlignmentReport, GcpMark, PayloadAlignment
from ...stages.align.pairs import plan_pairs
from ...stages.align.prepare import build_job
from ...stages.align.run import assemble_report
from ...stages.align.solution import UNPLACED, CameraSetting, Job, Solution, in_work
from ...stages.align.world import ground_of
from ...stages.route import PAIRWISE, PROCEED
from ...stages.thresholds import Thresholds
from .opensfm_cameras import OpenSfmCamera
from .opensfm_model import OdmModel
from .opensfm_pieces import Pairs
from .outcome_control import control_of
from .outcome_frames import ProjectFrames

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

_NO_ERROR = f"mean reprojection error {0.0:.2f} px"


@dataclass(frozen=True)
class PlacedFrames:
    """Where ODM placed frames, in one order; ``error_px`` is NaN where it could not be computed.

    ``whole_errors`` is false where the errors are ODM's own figure, cut at 4 px.
    """

    names: Tuple[str, ...]
    camera_of: Tuple[str, ...]
    cameras: Mapping[str, OpenSfmCamera]
    model: Ints
    center: Array
    rotation: Array
    error_px: Array
    observations: Ints
    point_xyz: Array
    point_model: Ints
    whole_errors: bool
    notes: Tuple[str, ...] = ()
    damaged: bool = False


def placed_of(model: OdmModel, limits: Thresholds) -> PlacedFrames:
    """A reconstruction with each frame's error under its camera's own limit."""
    count = len(model.names)
    error, seen = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
    if model.errors is not None:
        for camera in sorted(set(model.camera_of)):
            rows = np.asarray([i for i, c in enumerate(model.camera_of) if c == camera], dtype=np.int64)
            error[rows], seen[rows] = model.errors.per_frame(rows, limits)
    step = max(1, -(-len(model.point_xyz) // limits.outcome_ground_points))
    return PlacedFrames(
        names=model.names,
        camera_of=model.camera_of,
        cameras=model.cameras,
        model=model.model,
        center=model.center,
        rotation=model.rotation,
        error_px=error,
        observations=seen,
        point_xyz=model.point_xyz[::step],
        point_model=model.point_model[::step],
        whole_errors=model.errors is not None,
        notes=model.notes,
        damaged=model.damaged,
    )


def judge_project(
    project: ProjectFrames,
    placed: Optional[PlacedFrames],
    pairs: Optional[Pairs],
    *,
    engine: str,
    feature_side_px: int,
    held: bool,
    limits: Thresholds,
    marks: Sequence[GcpMark] = (),
    gcp_used: bool = False,
) -> AlignmentReport:
    """Return ODM's reconstruction as an alignment report; ``placed`` is ``None`` where there is none.

    ``pairs`` are verified matches by file names, ``None`` where they are
    gone. ``feature_side_px`` is the size that ODM extracted features at.
    ``marks`` are the project's ground control, ``gcp_used`` says whether ODM
    adjusted its model to it.
    """
    request = replace(project.request, gcps=tuple(marks))
    plan = plan_pairs(request.frames, request.cameras, limits)
    job = build_job(request, plan, "quick", feature_side_px, 1, limits)
    ground = ground_of(request.frames, request.cameras, feature_side_px, limits, request.gcps)
    solution = _solution(project, job, placed, pairs, held)
    ground = levelled(request.frames, solution, ground, limits)
    blind = _no_formula(project, placed)
    control = control_of(request, job, solution, ground, blind, gcp_used, limits)
    measured = measure(request.frames, solution, ground, plan.areas, limits, control)
    payloads = [p.payload for p in measured.payloads]
    measured, gaps = _with_gaps(measured, placed, pairs, limits)
    tied = payloads if pairs is None else ()
    report = assemble_report(request, "odm", engine, job, solution, measured, ground, (), limits, tied)
    report = replace(report, control=measured.control)
    # An alignment before the run speaks for ties that are not in the folder, never for a damaged result.
    proven = project.planned in (PROCEED, PAIRWISE) and not (placed is not None and placed.damaged)
    judged = tuple(_open(p, gaps.get(p.payload, ()), proven) for p in report.payloads)
    return replace(report, payloads=judged, verdict=overall(judged))


def _no_formula(project: ProjectFrames, placed: Optional[PlacedFrames]) -> Tuple[str, ...]:
    """Paths of placed frames whose camera is none of Brown's."""
    if placed is None:
        return ()
    lens = {n: placed.cameras[c].model for n, c in zip(placed.names, placed.camera_of)}
    path_of = {name: path for path, name in project.name_of.items()}
    return tuple(path_of[n] for n in placed.names if lens[n] not in ("perspective", "brown"))


def _solution(
    project: ProjectFrames, job: Job, placed: Optional[PlacedFrames], pairs: Optional[Pairs], held: bool
) -> Solution:
    """The reconstruction in the request's order of frames."""
    frames = project.request.frames
    count = len(frames)
    row = {project.name_of[f.path]: i for i, f in enumerate(frames)}
    model = np.full(count, UNPLACED, dtype=np.int64)
    center, rotation = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    error, seen = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
    cameras = list(job.cameras)
    points, point_model = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    if placed is not None:
        at = np.asarray([row[n] for n in placed.names], dtype=np.int64)
        model[at], center[at], rotation[at] = placed.model, placed.center, placed.rotation
        error[at], seen[at] = placed.error_px, placed.observations
        points, point_model = placed.point_xyz, placed.point_model
        cameras = _solved(job, placed, at, held)
    ties = [(row[a], row[b], n) for (a, b), n in sorted((pairs or {}).items()) if a in row and b in row]
    return Solution(
        cameras=tuple(cameras),
        model=model,
        center=center,
        rotation=rotation,
        error_px=error,
        observations=seen,
        point_xyz=points,
        point_model=point_model,
        point_id=np.arange(len(points), dtype=np.int64),
        pairs=np.asarray(ties, dtype=np.int64).reshape(-1, 3),
        focal_sigma=np.full(len(cameras), np.nan),
        notes=placed.notes if placed is not None else (),
    )


def _solved(job: Job, placed: PlacedFrames, at: Ints, held: bool) -> List[CameraSetting]:
    """Each profile's camera as ODM solved it: that of most of its frames."""
    count: Dict[int, Dict[str, int]] = {}
    for index, camera in zip(at, placed.camera_of):
        if placed.cameras[camera].known:
            mine = count.setdefault(job.frames[int(index)].camera, {})
            mine[camera] = mine.get(camera, 0) + 1
    found = []
    for number, setting in enumerate(job.cameras):
        if number in count:
            best = placed.cameras[min(count[number], key=lambda c: (-count[number][c], c))]
            setting = replace(
                setting,
                focal_ratio=best.focal_ratio,
                center_ratio=best.center,
                distortion=best.brown,
                aspect_ratio=best.aspect_ratio,
                solve_focal=not held,
                solve_distortion=not held,
            )
            setting = in_work(setting)
        found.append(setting)
    return found


def _with_gaps(
    measured: Measured, placed: Optional[PlacedFrames], pairs: Optional[Pairs], limits: Thresholds
) -> Tuple[Measured, Dict[str, Tuple[str, ...]]]:
    """Put harmless figures where the folder holds none, and say per payload what is missing."""
    gaps: Dict[str, Tuple[str, ...]] = {}
    figures: List[PayloadFigures] = []
    for p in measured.payloads:
        missing: List[str] = []
        if pairs is None:
            missing.append("the matches between its frames are not in this folder")
            p = replace(p, own_inliers=limits.min_inliers)
        if p.registered and (p.worst_profile_px is None or not np.isfinite(p.worst_profile_px)):
            missing.append("its reprojection error cannot be computed from this folder")
            p = replace(p, worst_profile_px=0.0)
        elif placed is not None and not placed.whole_errors:
            missing.append("its reprojection error is ODM's own mean, which leaves out what lies beyond 4 px")
        if placed is not None and placed.damaged:
            missing.append("files of the reconstruction are damaged: its figures are those of a part")
        gaps[p.payload] = tuple(missing)
        figures.append(p)
    return replace(measured, payloads=tuple(figures)), gaps


def _open(p: PayloadAlignment, gaps: Sequence[str], proven: bool) -> PayloadAlignment:
    """A pass that rests on missing figures is unproven, unless an alignment before the run had proven it."""
    reasons = tuple(r for r in p.reasons if not (gaps and r.startswith(_NO_ERROR)))
    if not gaps or p.verdict == FAIL:
        return replace(p, reasons=reasons)
    if p.verdict == PASS and proven:
        return replace(p, reasons=(*reasons, f"{'; '.join(gaps)}: the alignment before the run had proven it"))
    return replace(p, verdict=UNPROVEN, reasons=(*gaps, *reasons))


def focal_changes(placed: PlacedFrames, start: Mapping[str, OpenSfmCamera]) -> Dict[str, Optional[float]]:
    """ODM camera -> solved over start focal, minus one; ``None`` where either is unknown."""
    found: Dict[str, Optional[float]] = {}
    for camera in sorted(set(placed.camera_of)):
        solved, prior = placed.cameras[camera], start.get(camera)
        known = prior is not None and prior.known and solved.known and prior.focal_ratio > 0
        found[camera] = round(solved.focal_ratio / prior.focal_ratio - 1.0, 5) if known and prior is not None else None
    return found
