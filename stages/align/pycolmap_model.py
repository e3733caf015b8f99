"""pycolmap's models and ours: cameras both ways, reconstructions to arrays. Used inside the worker process only."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, List, Sequence

import numpy as np

from .models import camera_model, read_model
from .solution import UNPLACED, Array, CameraSetting, Job, Solution


def quiet(pycolmap: Any) -> None:
    """Errors alone reach the log."""
    try:
        pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    except AttributeError:
        pycolmap.logging.minloglevel = 2


def with_changes(solution: Solution, **changes: Any) -> Solution:
    """The solution with some of its fields replaced."""
    import dataclasses

    return dataclasses.replace(solution, **changes)


def camera_of(pycolmap: Any, camera_id: int, setting: CameraSetting) -> Any:
    """pycolmap\'s camera for a setting."""
    model, params = camera_model(setting)
    camera = pycolmap.Camera(
        camera_id=camera_id, model=model, width=setting.width, height=setting.height, params=params
    )
    camera.has_prior_focal_length = setting.prior
    return camera


def read_camera(setting: CameraSetting, camera: Any) -> CameraSetting:
    """The setting with what pycolmap solved."""
    name = camera.model_name if hasattr(camera, "model_name") else camera.model.name
    return read_model(setting, name, [float(v) for v in camera.params])


def stored_models(folder: Path) -> List[Path]:
    """Folders of stored models, the largest model first."""
    return sorted(p for p in folder.iterdir() if p.is_dir())


def collect(job: Job, cameras: Sequence[CameraSetting], models: Sequence[Any], folder: Path) -> Solution:
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
            errors = errors_of(model, image)
            seen[row] = len(errors)
            error[row] = float(np.mean(errors)) if len(errors) else math.nan
        for index in sorted({job.frames[r].camera for r in rows}):
            if index not in told and (index + 1) in model.cameras:
                solved[index] = read_camera(cameras[index], model.cameras[index + 1])
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


def errors_of(model: Any, image: Any) -> Array:
    """Reprojection errors in px of an image\'s observations of points."""
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
