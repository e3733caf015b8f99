"""Trying calibrations on a solved block: one profile at a time, the others standing still."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from ..progress import Cancel, Progress, check
from ..thresholds import Thresholds
from . import worker
from .calibrate import as_candidates, choose
from .control import Lay, holds_of, lays_of
from .fit import surface_bow
from .held import HOLDING
from .model import AlignCamera, AlignFrame, AlignRequest, Bowing, Candidate, LockDecision
from .prepare import holdable
from .solution import UNPLACED, AdjustJob, Array, CameraSetting, Job, Solution, in_frame
from .trials import HEIGHTS, Outcome, Trial, frozen, trials_by_heights, trials_for
from .tried import Bench, camera_index, camera_of, error_of, geometry_of
from .world import Ground, Rows, fit_rows

# Putting a focal right moves the distortion that goes with it: the second round leaves a tenth of the error.
HEIGHT_ROUNDS = 2


@dataclass(frozen=True)
class Calibrated:
    """The solution under the chosen calibrations, what was tried and decided, and the cameras with what may move."""

    solution: Solution
    candidates: Tuple[Candidate, ...]
    decisions: Tuple[LockDecision, ...]
    moving: Tuple[CameraSetting, ...]


def calibrate(
    request: AlignRequest,
    job: Job,
    solution: Solution,
    ground: Ground,
    engine: str,
    folder: Path,
    limits: Thresholds,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Calibrated:
    """Try every profile's candidates and return the solution under the chosen ones.

    Profiles with most frames go first. With several, a second pass repeats
    each under the others' final cameras; its candidates are the ones told.
    Where ground control can be held, a solved focal is solved with it held.
    """
    order = _profiles(request, job, solution)
    current = tuple(frozen(c) for c in solution.cameras)
    base = solution
    told: Dict[str, Tuple[Candidate, ...]] = {}
    decided: Dict[str, LockDecision] = {}
    stood: Dict[str, Tuple[CameraSetting, ...]] = {}
    free: Dict[str, Tuple[bool, bool, bool]] = {}
    lays = lays_of(request, job, solution, ground, limits)
    holds = holds_of(request, job, solution, ground, lays) if engine in HOLDING else ()
    for lap in range(2 if len(order) > 1 else 1):
        for profile in order:
            check(cancel)
            others = tuple(c for c in current if c.profile != profile)
            if profile in stood and _alike(stood[profile], others, limits):
                continue
            stood[profile] = others
            camera = _main_camera(request, job, solution, profile)
            rows = _rows(request, solution, profile)
            model = int(solution.model[rows[0]])
            mapped = geometry_of(request, solution, ground, rows, limits, lays.get(model))
            tilted = mapped.tilted(limits)
            place = folder / f"calibrate-{lap}-{order.index(profile):02d}"
            held = tuple(h for h in holds if h.model == model)
            bench = Bench(request, job, solution, ground, engine, place, limits, model in lays, progress, cancel)
            tried = bench.attempt(trials_for(camera), current, profile, rows, tilted, 1)
            free_one = tried[-1]
            geometry = geometry_of(request, free_one.solution, ground, rows, limits, free_one.lay)
            # What cannot be held fixes no focal: the candidates are then the free network's.
            geometry = replace(geometry, control=bool(held))
            for round_ in range(1, 1 + HEIGHT_ROUNDS):
                more = trials_by_heights([t.outcome for t in tried], geometry, limits)
                if not more:
                    break
                known = [t for t in tried if t.trial.focal_source != HEIGHTS]
                first = 1 + len(known) + (round_ - 1) * len(more)
                tried = known + bench.attempt(more, current, profile, rows, tilted, first)
            trials = tuple(t.trial for t in tried)
            variants = tuple(t.variant for t in tried)
            solved = tuple(t.solution for t in tried)
            laid = [t.lay for t in tried]
            outcomes = tuple(t.outcome for t in tried)
            surfaces = _surfaces(solved, ground, rows, laid)
            if held:
                task = AdjustJob(
                    solution.stored, job, tuple(loosened(v, t, profile, free) for v, t in zip(variants, trials)), held
                )
                fixed = worker.adjust(task, engine, place / "control", progress, cancel)
                outcomes = tuple(_under_control(o, s, job, rows, profile) for o, s in zip(outcomes, fixed))
            flown = [h for h in (flown_height(request.frames[i], limits) for i in rows) if h is not None]
            height = float(np.median(flown)) if flown else None
            chosen, decision, veto = choose(outcomes, surfaces, camera, geometry, height, limits)
            told[profile] = as_candidates(outcomes, chosen, decision, veto)
            decided[profile] = decision
            bent = trials[chosen].distortion is None
            solved_whole = bent and trials[chosen].focal is None
            free[profile] = (trials[chosen].focal is None, bent, (bent and tilted) or (bool(held) and solved_whole))
            base = solved[chosen]
            current = tuple(frozen(c) for c in (fixed[chosen] if held else base).cameras)
    final = replace(
        base,
        cameras=tuple(
            replace(c, solve_focal=not decided[c.profile].hold, solve_distortion=not decided[c.profile].hold)
            if c.profile in decided
            else c
            for c in base.cameras
        ),
        pairs=solution.pairs,
        notes=solution.notes,
        features=solution.features,
    )
    return Calibrated(
        solution=final,
        candidates=tuple(c for p in sorted(told) for c in told[p]),
        decisions=tuple(decided[p] for p in sorted(decided)),
        moving=tuple(
            replace(c, solve_focal=focal, solve_distortion=bend, solve_center=center)
            for c, (focal, bend, center) in zip(current, (free.get(c.profile, (False,) * 3) for c in current))
        ),
    )


def flown_height(frame: AlignFrame, limits: Thresholds) -> Optional[float]:
    """The height that a candidate may be held against; one of a plain GPS altitude rules nothing out."""
    known = frame.height_sigma_m is None or frame.height_sigma_m <= limits.height_veto_sigma_m
    return frame.height_m if known else None


def _under_control(outcome: Outcome, solution: Solution, job: Job, rows: Rows, profile: str) -> Outcome:
    """The outcome with its camera, error and focal's spread as they are with ground control held.

    Its bow and GPS fit stay the free network's: held, it fits by force.
    """
    kept = rows[solution.model[rows] != UNPLACED]
    camera = camera_of(solution, job, kept, profile)
    sigma = float(solution.focal_sigma[camera_index(job, kept)]) if len(kept) else float("nan")
    return replace(
        outcome,
        error_px=error_of(solution, kept),
        solved_focal=camera.focal_ratio,
        solved_center=camera.center_ratio,
        solved_distortion=camera.distortion,
        solved_aspect=camera.aspect_ratio,
        focal_sigma=sigma if np.isfinite(sigma) else None,
    )


def loosened(
    variant: Sequence[CameraSetting], trial: Trial, profile: str, free: Mapping[str, Tuple[bool, bool, bool]]
) -> Tuple[CameraSetting, ...]:
    """The cameras of a trial as they move with ground control held (pure); ``free`` says what decided profiles solve.

    Control fixes where the cameras stand, so a shifted principal point shows; left at the middle, it bends the focal.
    Another profile whose focal is solved as well moves along: standing still at a wrong focal it would
    pass its error on, and with it the look of being certain. Only where the trial itself solves all: a
    camera that moves at all moves in all that any camera solves.
    """
    if trial.focal is not None or trial.distortion is not None:
        return tuple(variant)
    moves = {name: whole[0] and whole[1] for name, whole in free.items()}
    return tuple(
        replace(c, solve_focal=True, solve_distortion=True, solve_center=True)
        if c.profile == profile or moves.get(c.profile, True)
        else c
        for c in variant
    )


def _alike(before: Sequence[CameraSetting], now: Sequence[CameraSetting], limits: Thresholds) -> bool:
    """Whether the other cameras stand as they stood: a second lap would find the same."""
    for a, b in zip(before, now):
        bend = max(abs(x - y) for x, y in zip(a.distortion, b.distortion))
        if abs(a.focal_ratio / b.focal_ratio - 1.0) > limits.camera_moved or bend > limits.camera_moved:
            return False
    return True


def as_mapped(request: AlignRequest, solution: Solution) -> Tuple[LockDecision, ...]:
    """Decisions where nothing was tried: trusted calibrations are held, the rest is as it was solved."""
    found: Dict[str, LockDecision] = {}
    for index, camera in enumerate(request.cameras):
        setting = in_frame(solution.cameras[index])
        hold = holdable(camera)
        given = camera.intrinsics
        found.setdefault(
            camera.profile,
            LockDecision(
                profile=camera.profile,
                hold=hold,
                focal_ratio=round(setting.focal_ratio, 6),
                center_ratio=setting.center_ratio,
                distortion=tuple(round(v, 6) for v in setting.distortion),
                source=f"focal {given.focal_source}, distortion {given.distortion_source}" if hold else "focal solved",
                reason="trusted calibration, held as asked" if hold else "no calibration that may be held",
                aspect_ratio=round(setting.aspect_ratio, 6),
            ),
        )
    return tuple(found[p] for p in sorted(found))


def _profiles(request: AlignRequest, job: Job, solution: Solution) -> List[str]:
    count: Dict[str, int] = defaultdict(int)
    for index, frame in enumerate(request.frames):
        if solution.model[index] != UNPLACED:
            count[frame.profile] += 1
    return sorted(count, key=lambda p: (-count[p], p))


def _rows(request: AlignRequest, solution: Solution, profile: str) -> Rows:
    """The profile's frames in the model that holds most of them."""
    count: Dict[int, int] = defaultdict(int)
    for index, frame in enumerate(request.frames):
        if frame.profile == profile and solution.model[index] != UNPLACED:
            count[int(solution.model[index])] += 1
    best = min(count, key=lambda m: (-count[m], m))
    return np.asarray(
        [i for i, f in enumerate(request.frames) if f.profile == profile and solution.model[i] == best], dtype=np.int64
    )


def _main_camera(request: AlignRequest, job: Job, solution: Solution, profile: str) -> AlignCamera:
    count = [0] * len(request.cameras)
    for index, frame in enumerate(job.frames):
        count[frame.camera] += solution.model[index] != UNPLACED
    options = [i for i, c in enumerate(request.cameras) if c.profile == profile]
    return request.cameras[min(options, key=lambda i: (-count[i], i))]


def _surfaces(
    solved: Sequence[Solution], ground: Ground, rows: Rows, lays: Sequence[Optional[Lay]]
) -> Dict[Tuple[int, int], Bowing]:
    """Bow of every two candidates' surfaces, point by point, each laid on the same positions."""
    laid: List[Optional[Dict[int, Array]]] = []
    for solution, lay in zip(solved, lays):
        kept = rows[solution.model[rows] != UNPLACED]
        known = kept[ground.known[kept]]
        fit = fit_rows(solution, ground, known) if len(known) >= 3 else None
        if lay is not None and lay.holds:
            fit = lay.similarity
        if fit is None or not len(kept):
            laid.append(None)
            continue
        inside = solution.point_model == solution.model[kept[0]]
        places = fit.points(solution.point_xyz[inside])
        laid.append(dict(zip(solution.point_id[inside].tolist(), places)))
    found: Dict[Tuple[int, int], Bowing] = {}
    for i in range(len(laid)):
        for j in range(i + 1, len(laid)):
            first, second = laid[i], laid[j]
            if first is None or second is None:
                continue
            both = sorted(set(first) & set(second))
            if both:
                a = np.asarray([first[p] for p in both])
                b = np.asarray([second[p] for p in both])
                found[(i, j)] = surface_bow(a, b, len(rows))
    return found
