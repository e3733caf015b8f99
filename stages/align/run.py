"""One alignment from request to report: the edges around the pure parts."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import List, Mapping, Optional, Sequence, Tuple

import numpy as np

from ..errors import UsageError
from ..progress import Cancel, Progress, check
from ..record import dumps
from ..thresholds import Thresholds
from . import worker
from .candidates import as_mapped, calibrate
from .control import Controlled
from .fit import Similarity
from .heights import levelled
from .held import hold_control
from .judge import FAIL, PASS, judge, overall, untied
from .measure import Measured, measure
from .model import (
    AlignedFrame,
    AlignmentReport,
    AlignRequest,
    Candidate,
    GpsFit,
    LockDecision,
    PairInliers,
    SolvedCamera,
)
from .pairs import PairPlan, plan_pairs
from .prepare import build_job, focal_over_side, rung_max_dim, sorted_request
from .solution import UNPLACED, Job, Retrieval, Solution, in_frame
from .terrain import terrain_of
from .trials import frozen
from .world import Ground, ground_of

ENGINES = ("pycolmap", "colmap")


@dataclass(frozen=True)
class Aligned:
    """A report with what it was made from, for the next rung."""

    report: AlignmentReport
    request: AlignRequest
    job: Job
    solution: Solution
    measured: Measured
    plan: PairPlan
    ground: Ground
    control: Controlled


def align_once(
    request: AlignRequest,
    workspace: Path,
    *,
    thresholds: Thresholds,
    engine: str = "pycolmap",
    rung: str = "quick",
    max_dim: Optional[int] = None,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    lock: bool = False,
    extra: Sequence[Retrieval] = (),
    start: Optional[Aligned] = None,
) -> Aligned:
    """Run one alignment; ``extra`` are pairs to find by likeness, ``start`` a model to extend."""
    if engine not in ENGINES:
        raise UsageError(f"There is no engine {engine!r}; known: {', '.join(ENGINES)}.")
    check(cancel)
    request = extended(start.request, sorted_request(request)) if start else sorted_request(request)
    if not request.frames:
        raise UsageError(f"{request.name}: there is no frame to align.")
    side = max_dim or rung_max_dim(rung, thresholds)
    ground = ground_of(request.frames, request.cameras, side, thresholds, request.gcps)
    ground = replace(ground, terrain=terrain_of(request, ground.origin, thresholds))
    plan = plan_pairs(request.frames, request.cameras, thresholds)
    job = build_job(request, plan, rung, side, thread_count(), thresholds, extra)
    if start is not None:
        held = tuple(replace(c, solve_focal=False, solve_distortion=False) for c in start.solution.cameras)
        job = replace(
            job,
            cameras=held + job.cameras[len(held) :],
            start=start.solution.stored,
            start_frames=tuple(range(len(start.request.frames))),
        )
    folder = workspace / _folder(request, rung, side, engine, extra, start)
    solution = worker.solve(job, engine, folder, workspace, progress, cancel)
    positions = ground
    ground = levelled(request.frames, solution, positions, thresholds)
    candidates: Tuple[Candidate, ...] = ()
    decisions = as_mapped(request, solution)
    cameras = tuple(frozen(c) for c in solution.cameras)
    if not lock and start is None and solution.models and not _parted(request, solution, ground, plan, thresholds):
        done = calibrate(request, job, solution, ground, engine, folder, thresholds, progress, cancel)
        solution, candidates, decisions, cameras = done.solution, done.candidates, done.decisions, done.moving
        ground = levelled(request.frames, solution, positions, thresholds)
    solution, control = hold_control(
        request, job, solution, cameras, ground, engine, folder, thresholds, progress, cancel
    )
    measured = measure(request.frames, solution, ground, plan.areas, thresholds, control)
    report = assemble_report(request, rung, engine, job, solution, measured, ground, candidates, thresholds)
    report = replace(report, control=measured.control)
    report = replace(report, decisions=_as_held(decisions, report))
    return Aligned(report, request, job, solution, measured, plan, ground, control)


def _parted(request: AlignRequest, solution: Solution, ground: Ground, plan: PairPlan, limits: Thresholds) -> bool:
    """Whether payloads fail by their ties alone: no calibration mends that, so none is tried.

    Somebody must pass as it is: where nobody does, the calibration decides who.
    """
    found = judge(measure(request.frames, solution, ground, plan.areas, limits), limits)
    failed = [p for p in found if p.verdict == FAIL]
    return bool(failed) and any(p.verdict == PASS for p in found) and all(untied(p, limits) for p in failed)


def judged_again(
    aligned: Aligned, solution: Solution, laid: Mapping[int, Similarity], tied: Sequence[str], limits: Thresholds
) -> Aligned:
    """The alignment with ``solution`` in place of its own, models laid as given, and payloads that control ties."""
    request = aligned.request
    control = replace(aligned.control, laid=laid or aligned.control.laid)
    measured = measure(request.frames, solution, aligned.ground, aligned.plan.areas, limits, control)
    was = aligned.report
    report = assemble_report(
        request, was.rung, was.engine, aligned.job, solution, measured, aligned.ground, was.candidates, limits, tied
    )
    report = replace(report, decisions=was.decisions, control=measured.control)
    return replace(aligned, report=report, solution=solution, measured=measured, control=control)


def _as_held(decisions: Sequence[LockDecision], report: AlignmentReport) -> Tuple[LockDecision, ...]:
    """Where control was held, a camera that was left to be solved is what came out with it."""
    if report.control is None or not report.control.held:
        return tuple(decisions)
    solved = {c.profile: c for c in report.cameras}
    return tuple(
        replace(
            d,
            focal_ratio=solved[d.profile].focal_ratio,
            center_ratio=solved[d.profile].center_ratio,
            distortion=solved[d.profile].distortion,
            aspect_ratio=solved[d.profile].aspect_ratio,
        )
        if not d.hold and d.profile in solved
        else d
        for d in decisions
    )


def extended(first: AlignRequest, whole: AlignRequest) -> AlignRequest:
    """Return ``whole`` with the frames and cameras of ``first`` in front, in the order that its model knows."""
    frames = {f.path for f in first.frames}
    cameras = {(c.profile, c.width, c.height) for c in first.cameras}
    return replace(
        whole,
        frames=first.frames + tuple(f for f in whole.frames if f.path not in frames),
        cameras=first.cameras + tuple(c for c in whole.cameras if (c.profile, c.width, c.height) not in cameras),
    )


def thread_count() -> int:
    """Threads that a solver may use."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(8, count or 1))


def _folder(
    request: AlignRequest,
    rung: str,
    side: int,
    engine: str,
    extra: Sequence[Retrieval],
    start: Optional[Aligned],
) -> str:
    said = dumps([[f.path for f in request.frames], rung, side, engine, extra, start and start.solution.stored])
    return f"{rung}-{hashlib.sha256(said.encode('utf-8')).hexdigest()[:12]}"


def assemble_report(
    request: AlignRequest,
    rung: str,
    engine: str,
    job: Job,
    solution: Solution,
    measured: Measured,
    ground: Ground,
    candidates: Tuple[Candidate, ...],
    limits: Thresholds,
    tied: Sequence[str] = (),
) -> AlignmentReport:
    """Put figures and verdicts into the report (pure); ``tied`` are payloads that ground control joins to the rest."""
    payloads = judge(measured, limits, tied)
    placed = solution.model != UNPLACED
    weight = solution.observations[placed].astype(float)
    error = None
    if weight.sum() > 0:
        error = round(float(np.average(np.nan_to_num(solution.error_px[placed]), weights=weight)), 4)
    good = solution.pairs[solution.pairs[:, 2] > 0]
    anchor = next((p for p in payloads if p.payload == measured.anchor), None)
    # Without any GPS ground control alone may lay the block: then its largest payload speaks for it.
    speaker = anchor or max(payloads, key=lambda p: (p.height_m is not None, p.registered))
    frames: List[AlignedFrame] = []
    for index, frame in enumerate(request.frames):
        miss = measured.centers[index] - ground.east_north_up[index]
        known = bool(np.isfinite(miss).all())
        frames.append(
            AlignedFrame(
                path=frame.path,
                registered=bool(placed[index]),
                component=int(solution.model[index]) if placed[index] else None,
                mean_reproj_error_px=_number(solution.error_px[index], 4),
                gps_residual_m=(
                    (round(float(miss[0]), 3), round(float(miss[1]), 3), round(float(miss[2]), 3)) if known else None
                ),
            )
        )
    return AlignmentReport(
        name=request.name,
        engine=engine,
        rung=rung,
        frames=tuple(sorted(frames, key=lambda f: f.path)),
        registered=int(placed.sum()),
        components=measured.components,
        mean_reproj_error_px=error,
        anchor=measured.anchor,
        gps=anchor.together if anchor else GpsFit(0),
        height_m=speaker.height_m,
        bowing=speaker.bowing,
        payloads=payloads,
        cameras=solved_cameras(request, job, solution),
        candidates=candidates,
        pairs=tuple(
            sorted(
                (_pair(request, a, b, n) for a, b, n in good.tolist()),
                key=lambda p: (p.a, p.b),
            )
        ),
        pairs_tried=len(solution.pairs),
        median_inliers=int(np.median(good[:, 2])) if len(good) else None,
        notes=solution.notes,
        areas=measured.areas,
        verdict=overall(payloads),
    )


def _pair(request: AlignRequest, a: int, b: int, inliers: int) -> PairInliers:
    first, second = sorted((request.frames[a].path, request.frames[b].path))
    return PairInliers(first, second, inliers)


def _number(value: float, digits: int) -> Optional[float]:
    return round(float(value), digits) if np.isfinite(value) else None


def solved_cameras(request: AlignRequest, job: Job, solution: Solution) -> Tuple[SolvedCamera, ...]:
    """Each profile's camera as solved, from the size that has most placed frames."""
    count = [0] * len(solution.cameras)
    for index, frame in enumerate(job.frames):
        count[frame.camera] += solution.model[index] != UNPLACED
    result: List[SolvedCamera] = []
    for profile in sorted({c.profile for c in request.cameras}):
        options = [i for i, c in enumerate(request.cameras) if c.profile == profile]
        best = min(options, key=lambda i: (-count[i], i))
        camera = in_frame(solution.cameras[best])
        rows = np.asarray(
            [i for i, f in enumerate(job.frames) if f.camera in options and solution.model[i] != UNPLACED], dtype=int
        )
        weight = solution.observations[rows].astype(float)
        error = float(np.average(solution.error_px[rows], weights=weight)) if weight.sum() > 0 else float("nan")
        prior = focal_over_side(request.cameras[best])
        result.append(
            SolvedCamera(
                profile=profile,
                focal_ratio=round(camera.focal_ratio, 6),
                center_ratio=(round(camera.center_ratio[0], 6), round(camera.center_ratio[1], 6)),
                distortion=tuple(round(v, 6) for v in camera.distortion),
                held=camera.held,
                frames=len(rows),
                mean_reproj_error_px=_number(error, 4),
                focal_sigma=_number(float(solution.focal_sigma[best]), 6),
                prior_change=round(camera.focal_ratio / prior - 1.0, 5) if prior else None,
                aspect_ratio=round(camera.aspect_ratio, 6),
            )
        )
    return tuple(result)


def with_report(aligned: Aligned, report: AlignmentReport) -> Aligned:
    """Return ``aligned`` under another report."""
    return replace(aligned, report=report)
