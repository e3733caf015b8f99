"""What is really so, written beside the frames as ``truth.json``."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Dict, Mapping, Optional, Tuple


@dataclass(frozen=True)
class TrueCamera:
    """Optics: ``focal_ratio`` = focal px / width, centre in px from the image centre, k1, k2, p1, p2, k3."""

    width: int
    height: int
    focal_ratio: float
    center_px: Tuple[float, float]
    distortion: Tuple[float, ...]
    sensor_width_mm: float
    focal_mm: float
    fisheye: Tuple[float, ...] = ()


@dataclass(frozen=True)
class TrueFrame:
    """One file. ``center_m`` is east, north, up in its scene, ``rotation`` world to camera (row by row).

    ``height_m`` is above the ground right below, ``mean_height_m`` above the
    mean of what the frame sees. ``lies`` name what is wrong with the file.
    """

    path: str
    payload: str
    profile: str
    spectrum: str
    band: str
    capture: str
    flight: str
    scene: str
    role: str
    camera: TrueCamera
    center_m: Tuple[float, float, float]
    rotation: Tuple[Tuple[float, ...], ...]
    latitude: float
    longitude: float
    altitude_m: float
    height_m: float
    mean_height_m: float
    gsd_cm: float
    lies: Tuple[str, ...] = ()


@dataclass(frozen=True)
class TrueMark:
    """A control point in one frame, pixels (0, 0 = centre of the first)."""

    path: str
    x_px: float
    y_px: float


@dataclass(frozen=True)
class TruePoint:
    """A painted target: ``role`` is ``gcp`` or ``check`` (its name in gcp_list.txt says that it is held out)."""

    id: str
    role: str
    scene: str
    east_m: float
    north_m: float
    up_m: float
    latitude: float
    longitude: float
    altitude_m: float
    marks: Tuple[TrueMark, ...]


@dataclass(frozen=True)
class TruePayload:
    """``route`` is the right answer, ``project`` the label that payloads of one project share."""

    id: str
    make: str
    model: str
    spectrum: str
    profiles: Tuple[str, ...]
    route: str
    project: str
    frames: int


@dataclass(frozen=True)
class TrueScene:
    """A piece of ground: origin of its east, north, up, and what samples it again."""

    id: str
    key: str
    latitude: float
    longitude: float
    altitude_m: float
    bounds_m: Tuple[float, float, float, float]
    texel_m: float
    relief: float
    buildings: float
    height_min_m: float
    height_max_m: float


@dataclass(frozen=True)
class Truth:
    """Everything about one rendered survey. ``images`` is the folder of the frames below the output folder."""

    story: str
    seed: int
    images: str
    gcp_file: Optional[str]
    scenes: Tuple[TrueScene, ...]
    payloads: Tuple[TruePayload, ...]
    points: Tuple[TruePoint, ...]
    frames: Tuple[TrueFrame, ...]
    extra: Mapping[str, str]
    folder: str = ""

    def frame(self, path: str) -> TrueFrame:
        return next(f for f in self.frames if f.path == path)

    def of(self, payload: str) -> Tuple[TrueFrame, ...]:
        return tuple(f for f in self.frames if f.payload == payload)

    @property
    def image_dir(self) -> Path:
        return Path(self.folder) / self.images

    def plain(self) -> Dict[str, Any]:
        """JSON values; where the folder lies is not part of the truth."""
        value = asdict(self)
        del value["folder"]
        return value

    def dumps(self) -> str:
        return json.dumps(self.plain(), indent=1) + "\n"


def load(folder: Path) -> Dict[str, Any]:
    """The plain values of a ``truth.json`` written before."""
    value: Dict[str, Any] = json.loads((Path(folder) / "truth.json").read_text(encoding="utf-8"))
    return value
