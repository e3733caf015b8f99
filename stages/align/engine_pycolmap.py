"""The pycolmap engine: features, matches, verified pairs, incremental models, bundle adjustments.

Runs inside the worker process only. Works with pycolmap 3.13 to 4.2; where
their names differ, the one that exists is used. Every random part gets the
job's seed and a fixed order.
"""

from __future__ import annotations

import hashlib
import io
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..record import write_bytes
from .features import Features, all_descriptors, feature_keys, load_or_extract
from .matching import Descriptors, Matches, match, unit
from .models import camera_model, read_model
from .retrieval import retrieved
from .solution import UNPLACED, AdjustJob, Array, CameraSetting, Hold, Job, Solution

Step = Callable[[str, int, int], None]
Pair = Tuple[int, int]

# Fewer matches than this say nothing of two views' geometry (COLMAP's own limit).
VERIFIED = 15
# Observations per image that an adjustment keeps.
_ENOUGH = 400


def solve(job: Job, folder: Path, cache: Path, step: Step) -> Solution:
    """Extract, match, verify and map; models are stored under ``folder``."""
    import pycolmap

    _quiet(pycolmap)
    pycolmap.set_random_seed(job.settings.seed)
    features, notes = load_or_extract(job, cache / "features", step)
    pairs = sorted(set(job.pairs) | set(retrieved(job, all_descriptors(features))))
    verified = _verify_all(pycolmap, job, features, pairs, cache / "matches", step)
    step("mapping", 0, 1)
    models = _map(pycolmap, job, features, verified, folder)
    step("mapping", 1, 1)
    inliers = {pair: len(geometry.inlier_matches) for pair, geometry in verified.items()}
    solution = _read_back(job, models, folder, inliers, pairs, notes)
    return _with(solution, features=np.asarray([len(f.points) for f in features], dtype=np.int64))


def adjust(task: AdjustJob, step: Step) -> Tuple[Solution, ...]:
    """Adjust a copy of the stored models for each variant of the cameras, all from the same start."""
    import pycolmap

    _quiet(pycolmap)
    results = []
    for number, cameras in enumerate(task.variants, start=1):
        models = [pycolmap.Reconstruction(str(path)) for path in _stored(Path(task.models))]
        sigmas: Dict[int, float] = {}
        for model in models:
            _thin(model)
        held = {h.model: h for h in task.holds}
        for place, model in enumerate(models):
            sigma = _adjust_model(pycolmap, model, cameras, held.get(place))
            sigmas = {**sigma, **sigmas}
        kind = "h" if task.holds else "v"
        folder = Path(task.models).parent / f"{Path(task.models).name}-{kind}{number:02d}"
        solution = _collect(task.job, cameras, models, folder)
        spread = np.asarray([sigmas.get(i + 1, math.nan) for i in range(len(cameras))])
        results.append(_with(solution, focal_sigma=spread))
        step("calibration", number, len(task.variants))
    return tuple(results)


def _quiet(pycolmap: Any) -> None:
    try:
        pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    except AttributeError:
        pycolmap.logging.minloglevel = 2


def _with(solution: Solution, **changes: Any) -> Solution:
    import dataclasses

    return dataclasses.replace(solution, **changes)


def _verify_all(
    pycolmap: Any, job: Job, features: Sequence[Features], pairs: Sequence[Pair], cache: Path, step: Step
) -> Dict[Pair, Any]:
    """Match and verify every pair; raw matches are kept on disk, so that a subset of the frames costs nothing."""
    cache.mkdir(parents=True, exist_ok=True)
    keys = feature_keys(job)
    units: Dict[int, Descriptors] = {}
    cameras = [_camera(pycolmap, index + 1, c) for index, c in enumerate(job.cameras)]
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = job.settings.seed
    options.ransac.max_error = job.settings.verify_error_px
    options.min_num_inliers = VERIFIED
    options.compute_relative_pose = False

    def raw(pair: Pair) -> Matches:
        said = f"{keys[pair[0]]} {keys[pair[1]]} {job.settings.max_ratio!r}"
        path = cache / f"{hashlib.sha256(said.encode('ascii')).hexdigest()[:32]}.npy"
        try:
            kept: Matches = np.load(path, allow_pickle=False)
            return kept
        except (OSError, ValueError):
            pass
        for index in pair:
            if index not in units:
                units[index] = unit(features[index].descriptors)
        found = match(units[pair[0]], units[pair[1]], job.settings.max_ratio)
        stream = io.BytesIO()
        np.save(stream, found)
        write_bytes(path, stream.getvalue())
        return found

    def work(pair: Pair) -> Any:
        a, b = pair
        matches = raw(pair)
        if len(matches) < VERIFIED:
            return None
        return pycolmap.estimate_two_view_geometry(
            cameras[job.frames[a].camera],
            features[a].points,
            cameras[job.frames[b].camera],
            features[b].points,
            matches,
            options,
        )

    verified: Dict[Pair, Any] = {}
    with ThreadPoolExecutor(max_workers=max(1, job.settings.threads)) as pool:
        for done, (pair, geometry) in enumerate(zip(pairs, pool.map(work, pairs)), start=1):
            if geometry is not None and len(geometry.inlier_matches) >= VERIFIED:
                verified[pair] = geometry
            step("pairs", done, len(pairs))
    return verified


def _camera(pycolmap: Any, camera_id: int, setting: CameraSetting) -> Any:
    model, params = camera_model(setting)
    camera = pycolmap.Camera(
        camera_id=camera_id, model=model, width=setting.width, height=setting.height, params=params
    )
    camera.has_prior_focal_length = setting.prior
    return camera


def _read_camera(setting: CameraSetting, camera: Any) -> CameraSetting:
    name = camera.model_name if hasattr(camera, "model_name") else camera.model.name
    return read_model(setting, name, [float(v) for v in camera.params])


def _map(pycolmap: Any, job: Job, features: Sequence[Features], verified: Dict[Pair, Any], folder: Path) -> List[Any]:
    folder.mkdir(parents=True, exist_ok=True)
    database = folder / "database.db"
    if database.exists():
        database.unlink()
    _fill(pycolmap, database, job, features, verified)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = job.settings.seed
    options.mapper.random_seed = job.settings.seed
    options.mapper.num_threads = 1
    options.triangulation.random_seed = job.settings.seed
    options.min_model_size = job.settings.min_model_frames
    options.extract_colors = False
    options.mapper.filter_max_reproj_error = job.settings.filter_max_reproj_error_px
    options.ba_refine_principal_point = False
    # The verdict needs no polished model on the way; the calibration adjusts it to the end.
    options.ba_global_frames_ratio = options.ba_global_points_ratio = 1.3
    options.ba_global_max_num_iterations, options.ba_global_max_refinements = 25, 2
    options.ba_local_max_num_iterations, options.ba_local_max_refinements = 15, 1
    options.constant_cameras = {i + 1 for i, c in enumerate(job.cameras) if c.held}
    for name in ("structure_less_registration_fallback",):
        if hasattr(options, name):
            # It places frames without a triangulated point: such a pose proves nothing.
            setattr(options, name, False)
    arguments: Dict[str, Any] = {}
    if job.start is not None:
        options.fix_existing_frames = True
        arguments["input_path"] = str(_stored(Path(job.start))[0])
    output = folder / "mapper"
    output.mkdir(exist_ok=True)
    found = pycolmap.incremental_mapping(str(database), str(folder), str(output), options=options, **arguments)
    models = [found[key] for key in sorted(found)]
    database.unlink()
    return models


def _fill(pycolmap: Any, path: Path, job: Job, features: Sequence[Features], verified: Dict[Pair, Any]) -> None:
    opened = pycolmap.Database.open(str(path))
    try:
        for index, setting in enumerate(job.cameras):
            camera = _camera(pycolmap, index + 1, setting)
            opened.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=index + 1)
            rig.add_ref_sensor(camera.sensor_id)
            opened.write_rig(rig, use_rig_id=True)
        for index, frame in enumerate(job.frames):
            image = pycolmap.Image(name=f"{index:06d}", camera_id=frame.camera + 1, image_id=index + 1)
            image.frame_id = index + 1
            shot = pycolmap.Frame()
            shot.frame_id = index + 1
            shot.rig_id = frame.camera + 1
            shot.add_data_id(image.data_id)
            opened.write_frame(shot, use_frame_id=True)
            opened.write_image(image, use_image_id=True)
            opened.write_keypoints(index + 1, features[index].points.astype(np.float32))
        for (a, b), geometry in sorted(verified.items()):
            opened.write_matches(a + 1, b + 1, np.asarray(geometry.inlier_matches, dtype=np.uint32))
            opened.write_two_view_geometry(a + 1, b + 1, geometry)
    finally:
        opened.close()


def _read_back(
    job: Job,
    models: Sequence[Any],
    folder: Path,
    inliers: Dict[Pair, int],
    pairs: Sequence[Pair],
    notes: Tuple[str, ...],
) -> Solution:
    ranked = sorted(models, key=lambda m: (-m.num_reg_images(), -m.num_points3D(), min(m.reg_image_ids(), default=0)))
    solution = _collect(job, job.cameras, ranked, folder / "models")
    rows = [(a, b, inliers.get((a, b), 0)) for a, b in pairs]
    return _with(
        solution, pairs=np.asarray(rows, dtype=np.int64).reshape(-1, 3), notes=notes, stored=str(folder / "models")
    )


def _stored(folder: Path) -> List[Path]:
    return sorted(p for p in folder.iterdir() if p.is_dir())


def _collect(job: Job, cameras: Sequence[CameraSetting], models: Sequence[Any], folder: Path) -> Solution:
    """Read models into arrays and store them; a frame in two models counts in the larger one."""
    count = len(job.frames)
    placed = np.full(count, UNPLACED, dtype=np.int64)
    center = np.full((count, 3), np.nan)
    rotation = np.full((count, 3, 3), np.nan)
    error = np.full(count, np.nan)
    seen = np.zeros(count, dtype=np.int64)
    xyz: List[Array] = []
    owner: List[int] = []
    ids: List[int] = []
    solved = list(cameras)
    told: set[int] = set()
    kept = 0
    for model in models:
        rows = [i - 1 for i in sorted(model.reg_image_ids()) if placed[i - 1] == UNPLACED]
        if len(rows) < job.settings.min_model_frames:
            continue
        target = folder / f"{kept:03d}"
        target.mkdir(parents=True, exist_ok=True)
        model.write(str(target))
        for row in rows:
            image = model.images[row + 1]
            pose = image.cam_from_world
            pose = pose() if callable(pose) else pose
            placed[row] = kept
            rotation[row] = pose.rotation.matrix()
            center[row] = -rotation[row].T @ np.asarray(pose.translation)
            errors = _errors(model, image)
            seen[row] = len(errors)
            error[row] = float(np.mean(errors)) if len(errors) else math.nan
        for index in sorted({job.frames[r].camera for r in rows}):
            if index not in told and (index + 1) in model.cameras:
                solved[index] = _read_camera(cameras[index], model.cameras[index + 1])
                told.add(index)
        for point_id in sorted(model.points3D):
            point = model.points3D[point_id]
            xyz.append(np.asarray(point.xyz))
            owner.append(kept)
            ids.append(int(point_id))
        kept += 1
    return Solution(
        cameras=tuple(solved),
        model=placed,
        center=center,
        rotation=rotation,
        error_px=error,
        observations=seen,
        point_xyz=np.asarray(xyz, dtype=float).reshape(-1, 3),
        point_model=np.asarray(owner, dtype=np.int64),
        point_id=np.asarray(ids, dtype=np.int64),
        pairs=np.zeros((0, 3), dtype=np.int64),
        focal_sigma=np.full(len(cameras), np.nan),
        stored=str(folder),
    )


def _errors(model: Any, image: Any) -> Array:
    observed, points = [], []
    for point in image.points2D:
        if point.has_point3D():
            observed.append(point.xy)
            points.append(model.points3D[point.point3D_id].xyz)
    if not observed:
        return np.zeros(0)
    pose = image.cam_from_world
    pose = pose() if callable(pose) else pose
    camera = model.cameras[image.camera_id]
    local = np.asarray(points) @ pose.rotation.matrix().T + np.asarray(pose.translation)
    ahead = local[:, 2] > 1e-9
    seen = np.asarray(camera.img_from_cam(local[ahead]))
    offset = seen - np.asarray(observed)[ahead]
    return np.asarray(np.hypot(offset[:, 0], offset[:, 1]))


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
        fresh = _camera(pycolmap, camera_id, setting)
        camera = model.cameras[camera_id]
        camera.model = fresh.model
        camera.params = fresh.params
        if not setting.held:
            moving.append(setting)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = any(s.solve_focal for s in moving)
    options.refine_extra_params = any(s.solve_distortion for s in moving)
    options.refine_principal_point = False
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
            _errors(model, model.images[i]) for i in model.reg_image_ids() if model.images[i].camera_id == camera_id
        ]
        pixels = np.concatenate(errors) if errors else np.zeros(0)
        if block is None or not len(pixels) or not block[0, 0] > 0:
            continue
        rms = math.sqrt(float((pixels**2).mean()) / 2.0)
        found[camera_id] = math.sqrt(float(block[0, 0])) * rms / max(setting.width, setting.height)
    return found
