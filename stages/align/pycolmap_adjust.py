"""Bundle adjustments with pycolmap: variants of the cameras from one start, ground control held where there is any."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from .pycolmap_model import camera_of, collect, errors_of, quiet, stored_models, with_changes
from .solution import AdjustJob, CameraSetting, Hold, Solution

Step = Callable[[str, int, int], None]

# Observations per image that an adjustment keeps.
_ENOUGH = 400


def adjust(task: AdjustJob, step: Step) -> Tuple[Solution, ...]:
    """Adjust a copy of the stored models for each variant of the cameras, all from the same start."""
    import pycolmap

    quiet(pycolmap)
    results = []
    for number, cameras in enumerate(task.variants, start=task.first):
        models = [pycolmap.Reconstruction(str(path)) for path in stored_models(Path(task.models))]
        sigmas: Dict[int, float] = {}
        for model in models:
            _thin(model)
        held = {h.model: h for h in task.holds}
        for place, model in enumerate(models):
            sigma = _adjust_model(pycolmap, model, cameras, held.get(place))
            sigmas = {**sigma, **sigmas}
        kind = "h" if task.holds else "v"
        folder = Path(task.models).parent / f"{Path(task.models).name}-{kind}{number:02d}"
        solution = collect(task.job, cameras, models, folder)
        spread = np.asarray([sigmas.get(i + 1, math.nan) for i in range(len(cameras))])
        results.append(with_changes(solution, focal_sigma=spread))
        step("calibration", number - task.first + 1, len(task.variants))
    return tuple(results)


def _hold_points(pycolmap: Any, model: Any, hold: Hold) -> List[int]:
    """Lay a model on the ground and add its control points as tracks; returns their ids."""
    rotation = pycolmap.Rotation3d(np.asarray(hold.rotation, dtype=float).reshape(3, 3))
    model.transform(pycolmap.Sim3d(hold.scale, rotation, np.asarray(hold.translation, dtype=float)))
    placed = set(model.reg_image_ids())
    ids = []
    for point in hold.points:
        track = pycolmap.Track()
        for row, x, y in point.marks:
            if row + 1 in placed:
                seen = model.images[row + 1].points2D
                seen.append(pycolmap.Point2D(np.array([x, y])))
                track.add_element(row + 1, len(seen) - 1)
        ids.append(model.add_point3D(np.asarray(point.place, dtype=float), track))
    return ids


def _drop_points(model: Any, hold: Hold, ids: Sequence[int]) -> None:
    """Take the control tracks out again: a model that is extended later must match its features row by row."""
    for point_id in ids:
        model.delete_point3D(point_id)
    placed = set(model.reg_image_ids())
    for point in hold.points:
        for row, _, _ in point.marks:
            if row + 1 in placed:
                model.images[row + 1].points2D.pop()


def _adjust_model(
    pycolmap: Any, model: Any, cameras: Sequence[CameraSetting], hold: Optional[Hold] = None
) -> Dict[int, float]:
    """Adjust one model in place; returns camera id -> standard error of its solved focal ratio."""
    moving = []
    for camera_id in sorted(model.cameras):
        setting = cameras[camera_id - 1]
        fresh = camera_of(pycolmap, camera_id, setting)
        camera = model.cameras[camera_id]
        camera.model = fresh.model
        camera.params = fresh.params
        if not setting.held:
            moving.append(setting)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = any(s.solve_focal for s in moving)
    options.refine_extra_params = any(s.solve_distortion for s in moving)
    # For all moving cameras or for none: one whose views cannot fix it must not follow another.
    options.refine_principal_point = bool(moving) and all(s.solve_center for s in moving)
    options.print_summary = False
    solver = (options.ceres if hasattr(options, "ceres") else options).solver_options
    solver.num_threads = 1
    solver.max_num_iterations = 60
    solver.function_tolerance = 1e-6
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in sorted(model.reg_image_ids()):
        config.add_image(image_id)
    for camera_id in sorted(model.cameras):
        if cameras[camera_id - 1].held:
            config.set_constant_cam_intrinsics(camera_id)
    fixed: List[int] = []
    if hold is None:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    else:
        fixed = _hold_points(pycolmap, model, hold)
        for point_id in fixed:
            config.add_constant_point(point_id)
    make = getattr(pycolmap, "create_default_ceres_bundle_adjuster", pycolmap.create_default_bundle_adjuster)
    adjuster = make(options, config, model)
    adjuster.solve()
    model.update_point_3d_errors()
    sigmas = _focal_sigmas(pycolmap, model, cameras, adjuster) if options.refine_focal_length else {}
    if hold is not None:
        _drop_points(model, hold, fixed)
    return sigmas


def _thin(model: Any) -> None:
    """Keep the longest tracks until every image has enough: adjustments cost by the point and gain by the track."""
    count = dict.fromkeys(model.reg_image_ids(), 0)
    order = sorted(model.points3D, key=lambda p: (-model.points3D[p].track.length(), p))
    for point_id in order:
        images = {e.image_id for e in model.points3D[point_id].track.elements}
        if all(count[i] >= _ENOUGH for i in images):
            model.delete_point3D(point_id)
            continue
        for image_id in images:
            count[image_id] += 1


def _focal_sigmas(pycolmap: Any, model: Any, cameras: Sequence[CameraSetting], adjuster: Any) -> Dict[int, float]:
    """Standard errors from the adjustment's covariance, scaled by the residuals that were left."""
    wanted = pycolmap.BACovarianceOptions()
    wanted.params = pycolmap.BACovarianceOptionsParams.ALL
    covariance = pycolmap.estimate_ba_covariance(wanted, model, adjuster)
    if covariance is None:
        return {}
    found: Dict[int, float] = {}
    for camera_id in sorted(model.cameras):
        setting = cameras[camera_id - 1]
        if not setting.solve_focal:
            continue
        block = covariance.get_other_params_cov(model.cameras[camera_id].params)
        errors = [
            errors_of(model, model.images[i]) for i in model.reg_image_ids() if model.images[i].camera_id == camera_id
        ]
        pixels = np.concatenate(errors) if errors else np.zeros(0)
        if block is None or not len(pixels) or not block[0, 0] > 0:
            continue
        rms = math.sqrt(float((pixels**2).mean()) / 2.0)
        found[camera_id] = math.sqrt(float(block[0, 0])) * rms / max(setting.width, setting.height)
    return found
