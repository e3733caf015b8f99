"""pycolmap's models and ours: cameras both ways, reconstructions to arrays. Used inside the worker process only."""

from __future__ import annotations

from pathlib import Path
from typing import Any, List, Sequence, Tuple

import numpy as np

from .collected import Part, Pose, assembled
from .models import camera_model, read_model
from .solution import Array, CameraSetting, Job, Solution


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
    """pycolmap's camera for a setting."""
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
    """Read models into arrays and store those that count below ``folder``."""
    solution, kept = assembled(job, cameras, [_part(job, cameras, model) for model in models])
    for place, number in enumerate(kept):
        target = folder / f"{place:03d}"
        target.mkdir(parents=True, exist_ok=True)
        models[number].write(str(target))
    return with_changes(solution, stored=str(folder))


def _part(job: Job, cameras: Sequence[CameraSetting], model: Any) -> Part:
    poses = {}
    for image_id in model.reg_image_ids():
        image = model.images[image_id]
        rotation, translation = _pose(image)
        poses[image_id - 1] = Pose(rotation, -rotation.T @ translation, errors_of(model, image))
    return Part(
        poses,
        {i - 1: read_camera(cameras[i - 1], camera) for i, camera in model.cameras.items()},
        {int(i): np.asarray(point.xyz) for i, point in model.points3D.items()},
    )


def _pose(image: Any) -> Tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,), world to camera."""
    pose = image.cam_from_world()
    return pose.rotation.matrix(), np.asarray(pose.translation)


def errors_of(model: Any, image: Any) -> Array:
    """Reprojection errors in px of an image's observations of points."""
    observed, points = [], []
    for point in image.points2D:
        if point.has_point3D():
            observed.append(point.xy)
            points.append(model.points3D[point.point3D_id].xyz)
    if not observed:
        return np.zeros(0)
    rotation, translation = _pose(image)
    camera = model.cameras[image.camera_id]
    local = np.asarray(points) @ rotation.T + translation
    ahead = local[:, 2] > 1e-9
    seen = np.asarray(camera.img_from_cam(local[ahead]))
    offset = seen - np.asarray(observed)[ahead]
    return np.asarray(np.hypot(offset[:, 0], offset[:, 1]))
