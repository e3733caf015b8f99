"""What is flown, with what, and what the files will claim: plain data, before any pixel.

A lie is a function over these records. ``Shot`` holds the truth, its
``reported`` what the header says; the two start out consistent.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, replace
from typing import Any, Callable, Dict, FrozenSet, Mapping, Optional, Tuple

import numpy as np

from .camera import Camera, Vector, look, tilt
from .geo import Origin

RGB = "rgb"
MULTISPECTRAL = "multispectral"
THERMAL = "thermal"


def rng(seed: int, *keys: object) -> np.random.Generator:
    """A generator that depends on the seed and on what it is for, on nothing else."""
    return np.random.default_rng([seed & 0xFFFFFFFF, *(zlib.crc32(str(k).encode()) for k in keys)])


@dataclass(frozen=True)
class Band:
    """One lens of a payload. ``channels`` name the world's layers that it sees.

    ``lever_m`` is its place in the payload's camera axes (m), ``tilt_deg`` its
    mounting rotation about them, ``suffix`` what a file name may say of it.
    ``delay_s`` is how much later than the rig's trigger it looks, ``readout_s``
    how long its rows take from the first to the last (0 = global shutter); both
    show while the drone moves.
    """

    name: str
    camera: Camera
    channels: Tuple[str, ...] = ("red", "green", "blue")
    wavelength_nm: Optional[float] = None
    fwhm_nm: Optional[float] = None
    lever_m: Vector = (0.0, 0.0, 0.0)
    tilt_deg: Vector = (0.0, 0.0, 0.0)
    rig_index: int = 0
    suffix: str = ""
    delay_s: float = 0.0
    readout_s: float = 0.0


@dataclass(frozen=True)
class Payload:
    """One physical payload: its truth, its look and the dialect of its files.

    ``sensor_width_mm`` and ``focal_mm`` are physical; ``focal_35mm`` and
    ``focal_plane_unit`` (EXIF 41488) say which tags the camera writes.
    ``calibration`` is ``""``, ``dewarp`` or ``calibrated`` (DJI XMP).
    ``route`` and ``project`` are what a right answer says: the route and the
    label that payloads of one project share.
    """

    id: str
    dialect: str
    spectrum: str
    make: str
    model: str
    bands: Tuple[Band, ...]
    sensor_width_mm: float
    focal_mm: float
    focal_35mm: Optional[float] = None
    focal_plane_unit: Optional[int] = None
    serial: str = ""
    lens: str = ""
    software: str = "1.0.0"
    folder: str = ""
    name_pattern: str = "DJI_{number:04d}.JPG"
    calibration: str = ""
    corrected_in_camera: bool = False
    gain: float = 1.0
    offset_dn: float = 0.0
    noise_dn: float = 1.6
    blur_px: float = 0.3
    vignette: float = 0.18
    jpeg_quality: int = 92
    route: str = "proceed"
    project: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)

    def profile(self, band: Band) -> str:
        """The truth's name of the true camera that made a frame."""
        return self.id if len(self.bands) == 1 else f"{self.id}/{band.name.lower().replace(' ', '-')}"


@dataclass(frozen=True)
class Reported:
    """What the header says. ``drop`` names groups of tags that are not written, ``undefined`` those written as 0/0."""

    make: str
    model: str
    serial: str
    lens: str
    software: str
    time_s: float
    focal_mm: Optional[float]
    focal_35mm: Optional[float]
    focal_plane_per_mm: Optional[float]
    latitude: Optional[float] = None
    longitude: Optional[float] = None
    altitude_m: Optional[float] = None
    relative_altitude_m: Optional[float] = None
    rtk_flag: Optional[int] = None
    rtk_std_m: Optional[Vector] = None
    yaw_deg: float = 0.0
    pitch_deg: float = -90.0
    roll_deg: float = 0.0
    speed_mps: Vector = (0.0, 0.0, 0.0)
    capture_id: str = ""
    band_name: str = ""
    digital_zoom: float = 1.0
    drop: FrozenSet[str] = frozenset()
    undefined: FrozenSet[str] = frozenset()


@dataclass(frozen=True)
class Shot:
    """One frame: which lens, from where, over which scene, and what its file will claim.

    ``position`` is the lens' centre in the scene's east, north, up (m).
    ``role`` is ``survey``, ``transit`` or ``panel``. ``velocity_mps`` is east and north.
    """

    path: str
    payload: str
    band: int
    capture: str
    scene: str
    flight: str
    position: Vector
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    time_s: float
    reported: Reported
    role: str = "survey"
    exposure: float = 1.0
    camera: Optional[Camera] = None
    lies: Tuple[str, ...] = ()
    velocity_mps: Tuple[float, float] = (0.0, 0.0)

    def drift_m(self, payload: "Payload") -> Tuple[float, float]:
        """How far the lens moves east and north from the first row read to the last."""
        readout = payload.bands[self.band].readout_s
        return self.velocity_mps[0] * readout, self.velocity_mps[1] * readout

    def rotation(self, payload: Payload) -> np.ndarray:
        """World-to-camera rotation of this lens."""
        return tilt(payload.bands[self.band].tilt_deg) @ look(self.yaw_deg, self.pitch_deg, self.roll_deg)

    def optics(self, payload: Payload) -> Camera:
        """The lens that really made the frame."""
        return self.camera or payload.bands[self.band].camera


@dataclass(frozen=True)
class Scene:
    """A piece of ground. ``origin`` is where it lies; ``relief`` scales its heights."""

    id: str
    origin: Origin
    key: str = "ground"
    relief: float = 1.0
    buildings: float = 1.0


@dataclass(frozen=True)
class ControlPoint:
    """A painted target. ``role`` is ``gcp`` or ``check`` (named so in the GCP file: held out)."""

    id: str
    scene: str
    east: float
    north: float
    role: str = "gcp"


@dataclass(frozen=True)
class FileLie:
    """Something that happens to a finished file: see ``filelies.KINDS``."""

    path: str
    kind: str
    arguments: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Survey:
    """All there is to render. ``extra_files`` are written as they are (path -> bytes)."""

    name: str
    scenes: Tuple[Scene, ...]
    payloads: Tuple[Payload, ...]
    shots: Tuple[Shot, ...]
    points: Tuple[ControlPoint, ...] = ()
    file_lies: Tuple[FileLie, ...] = ()
    extra_files: Mapping[str, bytes] = field(default_factory=dict)
    gcp_header: str = "utm"

    def payload(self, name: str) -> Payload:
        return next(p for p in self.payloads if p.id == name)

    def scene(self, name: str) -> Scene:
        return next(s for s in self.scenes if s.id == name)


Lie = Callable[[Survey], Survey]


def change_shots(survey: Survey, change: Callable[[Shot, int], Shot], payload: Optional[str] = None) -> Survey:
    """Apply ``change(shot, index)`` to the shots (of one payload, counted from 0)."""
    count: Dict[str, int] = {}
    shots = []
    for shot in survey.shots:
        if payload is None or shot.payload == payload:
            index = count.get(shot.payload, 0)
            count[shot.payload] = index + 1
            shots.append(change(shot, index))
        else:
            shots.append(shot)
    return replace(survey, shots=tuple(shots))


def scaled(survey: Survey, factor: float) -> Survey:
    """The same survey with every frame at ``factor`` times its pixels, tags kept true."""
    if factor == 1.0:
        return survey
    payloads = tuple(
        replace(p, bands=tuple(replace(b, camera=b.camera.scaled(factor)) for b in p.bands)) for p in survey.payloads
    )
    widths = {(p.id, i): b.camera.width for p in survey.payloads for i, b in enumerate(p.bands)}
    after = {p.id: p for p in payloads}

    def change(shot: Shot, _: int) -> Shot:
        camera = shot.camera.scaled(factor) if shot.camera else None
        now = (camera or after[shot.payload].bands[shot.band].camera).width
        before = shot.camera.width if shot.camera else widths[shot.payload, shot.band]
        density = shot.reported.focal_plane_per_mm
        density = density * now / before if density else None
        return replace(shot, camera=camera, reported=replace(shot.reported, focal_plane_per_mm=density))

    return change_shots(replace(survey, payloads=payloads), change)
