"""What an engine is told and what it gives back: plain numbers, arrays and names.

``Job`` and ``Solution`` cross a process border: a ``Job`` is JSON, a
``Solution`` is a ``.npz`` without pickled objects. Frames are rows in the
job's order. A model is one connected reconstruction in its own gauge (an
unknown similarity away from the ground).
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Dict, Optional, Tuple, Union

import numpy as np
import numpy.typing as npt

from ..focals import both_focals, mean_and_aspect
from ..record import dumps, from_plain

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

UNPLACED = -1


@dataclass(frozen=True)
class JobFrame:
    """One frame as the engine sees it: its pixels' file, working size, camera and tone group.

    ``camera`` indexes ``Job.cameras``. ``tone`` is the flight whose common
    stretch turns 16-bit or thermal pixels into 8 bits. ``luts`` is empty or
    one table per channel.
    """

    name: str
    file: str
    camera: int
    tone: str
    luts: Tuple[Tuple[int, ...], ...] = ()


@dataclass(frozen=True)
class CameraSetting:
    """A camera as an engine starts or holds it.

    ``focal_ratio`` and ``center_ratio`` are over max(width, height) of the
    working size, the centre as offset from the image centre.
    ``distortion`` is k1, k2, p1, p2, k3 (Brown). ``aspect_ratio`` is focal down
    over focal across (fy / fx), ``focal_ratio`` that of their mean. ``squash``
    is how much more the working size's rounding shrinks the picture down than
    across; see ``in_frame``. ``solve_focal`` and
    ``solve_distortion`` say what the bundle adjustment may move,
    ``solve_center`` that a solved distortion has its principal point and
    decentring too: only tilted views tell these from the tilt and the place
    of each camera.
    """

    profile: str
    width: int
    height: int
    focal_ratio: float
    center_ratio: Tuple[float, float] = (0.0, 0.0)
    distortion: Tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    solve_focal: bool = True
    solve_distortion: bool = True
    prior: bool = True
    solve_center: bool = False
    aspect_ratio: float = 1.0
    squash: float = 1.0

    @property
    def held(self) -> bool:
        """Nothing of it is solved."""
        return not (self.solve_focal or self.solve_distortion)

    @property
    def focal_px(self) -> float:
        """Focal length in pixels of the working size."""
        return self.focal_ratio * max(self.width, self.height)

    @property
    def focals_px(self) -> Tuple[float, float]:
        """Focal lengths across and down (fx, fy) in pixels of the working size."""
        return both_focals(self.focal_px, self.aspect_ratio)

    @property
    def center_px(self) -> Tuple[float, float]:
        """Principal point in pixels of the working size, origin at the corner of the first pixel."""
        side = max(self.width, self.height)
        return self.width / 2.0 + self.center_ratio[0] * side, self.height / 2.0 + self.center_ratio[1] * side


def in_frame(camera: CameraSetting) -> CameraSetting:
    """The focals of a camera in pixels of the working size, as the frame itself has them.

    The longer side is scaled exactly, the other to a whole pixel: a third of a
    pixel of a thousand would be half a pixel at the edge of the frame. A camera
    of one focal is taken for the frame's as it stands.
    """
    return _stretched(camera, 1.0 / camera.squash)


def in_work(camera: CameraSetting) -> CameraSetting:
    """The inverse of ``in_frame``: two focals of the frame in pixels of the working size."""
    return _stretched(camera, camera.squash)


def _stretched(camera: CameraSetting, down_over_across: float) -> CameraSetting:
    if camera.aspect_ratio == 1.0 or camera.squash == 1.0:
        return camera
    across, down = both_focals(camera.focal_ratio, camera.aspect_ratio)
    if camera.width >= camera.height:
        down *= down_over_across
    else:
        across /= down_over_across
    mean, aspect = mean_and_aspect(across, down)
    return replace(camera, focal_ratio=mean, aspect_ratio=aspect)


@dataclass(frozen=True)
class Retrieval:
    """Pairs to be found by likeness of the features: the best ``count`` between ``left`` and ``right``.

    ``per_frame`` > 0 takes that many for every frame of ``left`` instead.
    """

    left: Tuple[int, ...]
    right: Tuple[int, ...]
    count: int = 0
    per_frame: int = 0


@dataclass(frozen=True)
class EngineSettings:
    """The solver's numbers for one rung.

    Frames whose working size is below ``upsample_below_px`` start SIFT from a
    doubled image.
    """

    max_features: int
    peak_threshold: float
    max_ratio: float
    filter_max_reproj_error_px: float
    upsample_below_px: int
    verify_error_px: float
    min_model_frames: int = 3
    threads: int = 1
    seed: int = 0


@dataclass(frozen=True)
class Job:
    """One solve. ``start`` names a stored model to extend, whose cameras and poses stay.

    With ``only_pairs`` the pairs are verified and nothing is mapped.
    """

    frames: Tuple[JobFrame, ...]
    cameras: Tuple[CameraSetting, ...]
    pairs: Tuple[Tuple[int, int], ...]
    settings: EngineSettings
    retrieval: Tuple[Retrieval, ...] = ()
    apart: Tuple[Tuple[int, ...], ...] = ()
    start: Optional[str] = None
    start_frames: Tuple[int, ...] = ()
    only_pairs: bool = False


@dataclass(frozen=True)
class HeldPoint:
    """A control point that an adjustment holds: its place in metres, and marks (frame row, x, y in working px)."""

    place: Tuple[float, float, float]
    marks: Tuple[Tuple[int, float, float], ...]


@dataclass(frozen=True)
class Hold:
    """Control of one model: the similarity that lays it on the ground (row-major rotation), and its points."""

    model: int
    scale: float
    rotation: Tuple[float, ...]
    translation: Tuple[float, float, float]
    points: Tuple[HeldPoint, ...]


@dataclass(frozen=True)
class AdjustJob:
    """Bundle adjustments on copies of stored models: one solution per variant of the cameras.

    A model that ``holds`` speaks of is laid on the ground and adjusted with
    its control points constant; its solution is then in metres. ``first``
    numbers the variants, so that a later task leaves an earlier one's models.
    """

    models: str
    job: Job
    variants: Tuple[Tuple[CameraSetting, ...], ...]
    holds: Tuple[Hold, ...] = ()
    first: int = 1


@dataclass(frozen=True)
class Solution:
    """What was solved.

    ``model`` (N,) is each frame's model, ``UNPLACED`` where it has none; model
    0 holds the most frames. ``center`` (N, 3) and ``rotation`` (N, 3, 3: world
    to camera, x right, y down, z forward) are in the model's gauge, NaN where
    unplaced. ``error_px`` and ``observations`` (N,) are per frame. Points are
    rows of ``point_xyz`` (P, 3) with their ``point_model`` and ``point_id``;
    ids agree between variants of one adjustment. ``pairs`` (M, 3) are frame,
    frame, verified inliers of every pair tried. ``focal_sigma`` (C,) is the
    standard error of each camera's focal ratio, NaN where held or unknown.
    """

    cameras: Tuple[CameraSetting, ...]
    model: Ints
    center: Array
    rotation: Array
    error_px: Array
    observations: Ints
    point_xyz: Array
    point_model: Ints
    point_id: Ints
    pairs: Ints
    focal_sigma: Array
    notes: Tuple[str, ...] = ()
    stored: str = ""
    features: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def models(self) -> int:
        """Number of models."""
        return int(self.model.max()) + 1 if len(self.model) and self.model.max() >= 0 else 0


_ARRAYS = (
    "model",
    "center",
    "rotation",
    "error_px",
    "observations",
    "point_xyz",
    "point_model",
    "point_id",
    "pairs",
    "focal_sigma",
    "features",
)


def save_solution(solution: Solution, path: Union[str, Path]) -> None:
    """Write one solution as ``.npz``; the cameras and notes go in as UTF-8 JSON."""
    arrays: Dict[str, Any] = {name: getattr(solution, name) for name in _ARRAYS}
    head = dumps({"cameras": solution.cameras, "notes": solution.notes, "stored": solution.stored})
    arrays["head"] = np.frombuffer(head.encode("utf-8"), dtype=np.uint8)
    with open(path, "wb") as stream:
        np.savez(stream, **arrays)


def load_solution(path: Union[str, Path]) -> Solution:
    """Read what ``save_solution`` wrote; raises ``ValueError`` or ``OSError`` on a damaged file."""
    with np.load(path, allow_pickle=False) as data:
        head = json.loads(bytes(data["head"]).decode("utf-8"))
        arrays = {name: data[name] for name in _ARRAYS}
    return Solution(
        cameras=tuple(from_plain(CameraSetting, c) for c in head["cameras"]),
        notes=tuple(head["notes"]),
        stored=head["stored"],
        **arrays,
    )
