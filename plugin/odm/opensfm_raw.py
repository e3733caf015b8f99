"""``reconstruction.json`` and the growth report of OpenSfM as they stand, and how well points fall on observations."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple

import numpy as np
import numpy.typing as npt

from ...stages.thresholds import Thresholds
from .opensfm_cameras import OpenSfmCamera, camera_from_json, project, rotation_matrix
from .opensfm_json import Unreadable, numbers, read_object, read_reconstructions
from .opensfm_tracks import PointIds

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Shot:
    """One placed frame: world to camera as axis-angle and translation, and its camera's id."""

    camera: str
    rotation: Tuple[float, ...]
    translation: Tuple[float, ...]


@dataclass
class RawModel:
    """The cameras, shots and points of ``reconstruction.json`` as they stand; ``entry`` is a shot's reconstruction."""

    cameras: Dict[str, OpenSfmCamera] = field(default_factory=dict)
    shots: Dict[str, Shot] = field(default_factory=dict)
    entry: Dict[str, int] = field(default_factory=dict)
    entries: int = 0
    point_id: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    point_entry: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    point_xyz: Array = field(default_factory=lambda: np.zeros((0, 3)))
    ids: PointIds = field(default_factory=PointIds)
    notes: List[str] = field(default_factory=list)


def read_raw(path: Path, limits: Thresholds) -> RawModel:
    """Read ``reconstruction.json`` piece by piece; what is damaged is left out and said in ``notes``."""
    raw = RawModel()
    numbers_of, entries, places = array("q"), array("q"), array("d")
    bad = 0
    try:
        for index, section, key, value in read_reconstructions(path, limits):
            raw.entries = max(raw.entries, index + 1)
            try:
                if section == "cameras":
                    raw.cameras.setdefault(key, camera_from_json(key, value))
                elif section == "shots":
                    if key not in raw.shots and len(raw.shots) < limits.outcome_max_frames:
                        raw.shots[key] = _shot(value)
                        raw.entry[key] = index
                elif len(numbers_of) < limits.outcome_max_points:
                    place = numbers(value["coordinates"], 3)
                    numbers_of.append(raw.ids.number(key))
                    entries.append(index)
                    places.extend(place)
            except (KeyError, TypeError, ValueError, OverflowError):
                bad += 1
    except Unreadable as error:
        raw.notes.append(str(error))
    if bad:
        raw.notes.append(f"{bad} entries of {path.name} are damaged and were left out")
    lost = sorted(n for n, s in raw.shots.items() if s.camera not in raw.cameras)
    if lost:
        raw.notes.append(f"{len(lost)} placed frames have no camera in {path.name}")
        for name in lost:
            del raw.shots[name], raw.entry[name]
    raw.point_id = np.frombuffer(numbers_of, dtype=np.int64) if numbers_of else raw.point_id
    raw.point_entry = np.frombuffer(entries, dtype=np.int64) if entries else raw.point_entry
    raw.point_xyz = np.frombuffer(places, dtype=np.float64).reshape(-1, 3) if places else raw.point_xyz
    return raw


def _shot(value: Mapping[str, Any]) -> Shot:
    return Shot(str(value["camera"]), tuple(numbers(value["rotation"], 3)), tuple(numbers(value["translation"], 3)))


def grown_components(path: Path, limits: Thresholds) -> Optional[Dict[str, int]]:
    """Return frame -> piece by ``reports/reconstruction.json``, ``None`` where it does not say.

    A piece is an entry that grew: its first two frames and those of its steps.
    """
    try:
        report = read_object(path, limits)
    except (FileNotFoundError, Unreadable):
        return None
    found: Dict[str, int] = {}
    rows = report.get("reconstructions")
    number = 0
    for entry in rows if isinstance(rows, list) else []:
        if not isinstance(entry, dict) or not isinstance(entry.get("grow"), dict):
            continue
        bootstrap = entry.get("bootstrap")
        names = list(bootstrap.get("image_pair") or []) if isinstance(bootstrap, dict) else []
        steps = entry["grow"].get("steps")
        for step in steps if isinstance(steps, list) else []:
            if isinstance(step, dict) and isinstance(step.get("images"), list):
                names.extend(step["images"])
        for name in names:
            if isinstance(name, str):
                found.setdefault(name, number)
        number += 1
    return found or None


class Geometry:
    """Errors of observations against points, vectorised by camera."""

    def __init__(self, raw: RawModel, names: Tuple[str, ...]) -> None:
        self.rotation = np.stack([rotation_matrix(np.asarray(raw.shots[n].rotation)) for n in names])
        self.translation = np.asarray([raw.shots[n].translation for n in names])
        self.cameras = sorted({raw.shots[n].camera for n in names})
        at = {c: i for i, c in enumerate(self.cameras)}
        self.camera = np.asarray([at[raw.shots[n].camera] for n in names], dtype=np.int64)
        self._models = [raw.cameras[c] for c in self.cameras]
        self.known = np.asarray([c.known for c in self._models])

    @property
    def center(self) -> Array:
        """Camera centres (N, 3)."""
        result: Array = -np.einsum("nji,nj->ni", self.rotation, self.translation)
        return result

    def error_px(self, frame: Ints, xy: Array, points: Array) -> Array:
        """Distance in pixels between observed and projected places; NaN where the camera has no formula."""
        found = np.full(len(frame), np.nan)
        seen = np.einsum("nij,nj->ni", self.rotation[frame], points) + self.translation[frame]
        for index, camera in enumerate(self._models):
            mine = np.nonzero(self.camera[frame] == index)[0]
            if not camera.known or not len(mine):
                continue
            miss = (project(camera, seen[mine]) - xy[mine]) * camera.side
            error = np.hypot(miss[:, 0], miss[:, 1])
            if not camera.model.startswith("fisheye"):
                error[seen[mine, 2] <= 0] = np.inf
            found[mine] = error
        return found
