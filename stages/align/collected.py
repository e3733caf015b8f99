"""Models as an engine gives them, brought into the arrays of a ``Solution`` (pure)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Mapping, Sequence, Set, Tuple

import numpy as np

from .solution import UNPLACED, Array, CameraSetting, Job, Solution


@dataclass(frozen=True)
class Pose:
    """One placed frame: rotation (3, 3) world to camera, centre (3,) in the world, errors in px of what it sees."""

    rotation: Array
    center: Array
    errors_px: Array


@dataclass(frozen=True)
class Part:
    """One model: frame row -> pose, camera index -> as solved, point id -> place (3,)."""

    poses: Mapping[int, Pose]
    cameras: Mapping[int, CameraSetting]
    points: Mapping[int, Array]


def assembled(job: Job, cameras: Sequence[CameraSetting], parts: Sequence[Part]) -> Tuple[Solution, Tuple[int, ...]]:
    """Return the solution and which ``parts`` are its models, in their order.

    A frame in two models counts in the first; a model that is left with fewer
    frames than the job asks for is none, and of a camera in two the first speaks.
    """
    count = len(job.frames)
    model = np.full(count, UNPLACED, dtype=np.int64)
    center, rotation = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    error, seen = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
    solved = dict(enumerate(cameras))
    told: Set[int] = set()
    kept: List[int] = []
    for number, part in enumerate(parts):
        rows = [row for row in sorted(part.poses) if model[row] == UNPLACED]
        if len(rows) < job.settings.min_model_frames:
            continue
        for row in rows:
            pose = part.poses[row]
            model[row], rotation[row], center[row] = len(kept), pose.rotation, pose.center
            seen[row] = len(pose.errors_px)
            error[row] = float(np.mean(pose.errors_px)) if len(pose.errors_px) else math.nan
        for index in {job.frames[row].camera for row in rows} & set(part.cameras) - told:
            solved[index] = part.cameras[index]
            told.add(index)
        kept.append(number)
    points = [
        (place, i, parts[number].points[i]) for place, number in enumerate(kept) for i in sorted(parts[number].points)
    ]
    solution = Solution(
        cameras=tuple(solved[index] for index in range(len(cameras))),
        model=model,
        center=center,
        rotation=rotation,
        error_px=error,
        observations=seen,
        point_xyz=np.asarray([xyz for _, _, xyz in points], dtype=float).reshape(-1, 3),
        point_model=np.asarray([place for place, _, _ in points], dtype=np.int64),
        point_id=np.asarray([i for _, i, _ in points], dtype=np.int64),
        pairs=np.zeros((0, 3), dtype=np.int64),
        focal_sigma=np.full(len(cameras), np.nan),
    )
    return solution, tuple(kept)
