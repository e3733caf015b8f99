"""Candidate calibrations adjusted on a solved block, and what each of them shows."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..progress import Cancel, Progress
from ..thresholds import Thresholds
from . import worker
from .control import Lay, lay_by_control
from .fit import bowing, height_above_ground, residual_fit
from .model import AlignCamera, AlignRequest, Bowing
from .prepare import center_over_side, focal_over_side
from .solution import UNPLACED, AdjustJob, Array, CameraSetting, Job, Solution, in_frame, in_work
from .trials import Geometry, Outcome, Trial, setting_for
from .vertical import FLYING, MODEL, vertical_scale
from .world import Ground, Rows, fit_rows


@dataclass(frozen=True)
class Tried:
    """One candidate with its adjustment and what that showed."""

    trial: Trial
    variant: Tuple[CameraSetting, ...]
    solution: Solution
    lay: Optional[Lay]
    outcome: Outcome


@dataclass(frozen=True)
class Bench:
    """What every trial on one solved block starts from; ``controlled`` where ground control lays the model."""

    request: AlignRequest
    job: Job
    solution: Solution
    ground: Ground
    engine: str
    folder: Path
    limits: Thresholds
    controlled: bool = False
    progress: Optional[Progress] = None
    cancel: Optional[Cancel] = None

    def attempt(
        self,
        trials: Sequence[Trial],
        current: Sequence[CameraSetting],
        profile: str,
        rows: Rows,
        tilted: bool,
        first: int,
    ) -> List[Tried]:
        """Adjust the block once per trial of ``profile``, the cameras else as they stand; ``first`` numbers them."""
        request, job, ground, limits = self.request, self.job, self.ground, self.limits
        variants = tuple(variant_of(request, current, profile, t, tilted) for t in trials)
        task = AdjustJob(self.solution.stored, job, variants, first=first)
        model = int(self.solution.model[rows[0]])
        result = []
        found = worker.adjust(task, self.engine, self.folder, self.progress, self.cancel)
        for trial, variant, solved in zip(trials, variants, found):
            lay = lay_by_control(request, job, solved, ground, model, limits) if self.controlled else None
            outcome = outcome_of(trial, request, solved, ground, rows, profile, job, limits, lay)
            result.append(Tried(trial, variant, solved, lay, outcome))
        return result


def error_of(solution: Solution, kept: Rows) -> Optional[float]:
    """Mean reprojection error over the observations of some frames, ``None`` without any."""
    weight = solution.observations[kept].astype(float)
    if weight.sum() <= 0 or not np.isfinite(solution.error_px[kept][weight > 0]).all():
        return None
    return round(float(np.average(np.nan_to_num(solution.error_px[kept]), weights=weight)), 5)


def variant_of(
    request: AlignRequest, current: Sequence[CameraSetting], profile: str, trial: Trial, tilted: bool
) -> Tuple[CameraSetting, ...]:
    """The cameras of one trial: the profile's set up for it, the others standing still."""
    return tuple(
        setting_for(trial, _restart(request.cameras[i], c), tilted) if c.profile == profile else c
        for i, c in enumerate(current)
    )


def _restart(camera: AlignCamera, setting: CameraSetting) -> CameraSetting:
    """A solved focal starts from what the mapping found, or from the trusted one; centre and aspect from what is known.

    A distortion that is solved without its centre has one focal (RADIAL): the known aspect is put back here.
    """
    known = focal_over_side(camera) if camera.intrinsics.focal_trusted else None
    setting = replace(setting, center_ratio=center_over_side(camera.intrinsics))
    if known is None:
        return setting
    return in_work(replace(setting, focal_ratio=known, aspect_ratio=camera.intrinsics.aspect_ratio))


def outcome_of(
    trial: Trial,
    request: AlignRequest,
    solution: Solution,
    ground: Ground,
    rows: Rows,
    profile: str,
    job: Job,
    limits: Thresholds,
    lay: Optional[Lay] = None,
) -> Outcome:
    """Measure one adjusted trial against positions, heights and control."""
    kept = rows[solution.model[rows] != UNPLACED]
    error = error_of(solution, kept)
    camera = camera_of(solution, job, kept, profile)
    known = kept[ground.known[kept]]
    fit = fit_rows(solution, ground, known) if len(known) >= limits.min_proof_frames else None
    focal_sigma = float(solution.focal_sigma[camera_index(job, kept)]) if len(kept) else float("nan")
    plain = Outcome(
        trial=trial,
        error_px=error,
        gps_horizontal_m=None,
        gps_vertical_m=None,
        misfit=None,
        height_m=None,
        relief_m=None,
        bowing=Bowing(),
        solved_focal=camera.focal_ratio,
        solved_center=camera.center_ratio,
        solved_distortion=camera.distortion,
        solved_aspect=camera.aspect_ratio,
        scale=vertical_scale(request.frames, solution, ground, kept, limits),
        focal_sigma=focal_sigma if np.isfinite(focal_sigma) else None,
    )
    control = lay.similarity if lay is not None and lay.holds else None
    if lay is not None and control is not None:
        ground_m = control.points(points_of(solution, kept))
        height, relief = height_above_ground(control.points(solution.center[kept]), ground_m)
        plain = replace(plain, height_m=height, relief_m=relief, bowing=lay.fit.bowing)
    if fit is None:
        return plain
    centers = fit.points(solution.center[known])
    vertical = bool(ground.vertical[known].all())
    across, up = np.sqrt(np.mean(ground.sigma[known] ** 2, axis=0))
    sigma = (float(across), float(up))
    gps = residual_fit(centers - ground.east_north_up[known], sigma, len(known), False, vertical)
    if control is None:
        height, relief = height_above_ground(centers, fit.points(points_of(solution, kept)))
        plain = replace(plain, height_m=height, relief_m=relief)
    bow = plain.bowing
    if bow.bowing_m is None and vertical:
        bow = bowing(centers, ground.east_north_up[known], [request.frames[i].flight for i in known])
    misfit = None
    if gps.horizontal_m is not None:
        misfit = gps.horizontal_m / (limits.gps_sigma_factor * sigma[0])
        if gps.vertical_m is not None:
            misfit = max(misfit, gps.vertical_m / (limits.gps_sigma_factor * sigma[1]))
    return replace(
        plain,
        gps_horizontal_m=gps.horizontal_m,
        gps_vertical_m=gps.vertical_m,
        misfit=None if misfit is None else round(misfit, 4),
        bowing=bow,
    )


def points_of(solution: Solution, rows: Rows) -> Array:
    """The points of the model that holds these frames, in its gauge."""
    model = solution.model[rows[0]]
    found: Array = solution.point_xyz[solution.point_model == model]
    return found


def camera_index(job: Job, rows: Rows) -> int:
    """The camera of most of these frames."""
    count: Dict[int, int] = defaultdict(int)
    for row in rows:
        count[job.frames[int(row)].camera] += 1
    return min(count, key=lambda c: (-count[c], c))


def camera_of(solution: Solution, job: Job, rows: Rows, profile: str) -> CameraSetting:
    """A profile's camera as solved, in the frame's terms, from the size that most of these frames have."""
    if len(rows):
        return in_frame(solution.cameras[camera_index(job, rows)])
    return in_frame(next(c for c in solution.cameras if c.profile == profile))


def geometry_of(
    request: AlignRequest,
    solution: Solution,
    ground: Ground,
    rows: Rows,
    limits: Thresholds,
    lay: Optional[Lay] = None,
) -> Geometry:
    """Measure what supports a self-calibration: view tilts and measured heights of the profile's frames, control."""
    kept = rows[(solution.model[rows] != UNPLACED)]
    known = kept[ground.known[kept]]
    fit = fit_rows(solution, ground, known) if len(known) >= limits.min_proof_frames else None
    control = lay is not None and lay.holds
    if lay is not None and control:
        fit = lay.similarity
    if fit is None or not len(kept):
        return Geometry(0.0, control)
    views = fit.directions(solution.rotation[kept, 2])
    tilt = np.degrees(np.arccos(np.clip(-views[:, 2], -1.0, 1.0)))
    oblique = float((tilt > limits.oblique_view_deg).mean())
    scale = vertical_scale(request.frames, solution, ground, kept, limits)
    if scale is None:
        return Geometry(round(oblique, 4), control, None, MODEL if ground.terrain is not None else FLYING)
    return Geometry(round(oblique, 4), control, scale.sigma, scale.by)
