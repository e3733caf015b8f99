"""ODM projects as ODM 3.6 leaves them, written from a simulated flight's truth.

Observations are projected from what is "reconstructed", so the model is
always consistent in itself; what can be wrong is where it lies.
"""

from __future__ import annotations

import gzip
import json
import pickle
import struct
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from tests.simulator.camera import Camera, project
from tests.simulator.catalogue import phantom4, phantom4pro
from tests.simulator.flight import Plan, fly
from tests.simulator.geo import Origin
from tests.simulator.survey import Payload, Scene

ORIGIN = Origin(46.84, -91.99, 200.0)
MULTIPLE = "Multiple reconstructions detected (%d), this might be an indicator that some areas did not have overlap"
NO_PROJECT = "The program could not process this dataset using the current settings. Check that the images have enough"


@dataclass
class Frame:
    """One frame: the truth, what its file says, and where it was reconstructed."""

    name: str
    payload: Payload
    place: np.ndarray
    rotation: np.ndarray
    gps: Tuple[float, float, float]
    time_s: float
    component: int = 0
    group: str = ""
    placed: bool = True

    @property
    def camera(self) -> Camera:
        return self.payload.bands[0].camera

    @property
    def camera_id(self) -> str:
        c = self.camera
        said = f"v2 {self.payload.make} {self.payload.model} {c.width} {c.height} brown {str(c.focal_ratio)[:6]}"
        return said.lower()


@dataclass
class Block:
    """A reconstruction to write.

    ``noise_px`` is of the observations by payload. Frames of a ``group`` were
    reconstructed, with points of their own, where its ``warps`` puts them;
    ``ties`` are matches between groups that hold them together nevertheless.
    """

    frames: List[Frame]
    points: np.ndarray
    warps: Dict[str, Callable[[np.ndarray], np.ndarray]] = field(default_factory=dict)
    ties: int = 0
    noise_px: Dict[str, float] = field(default_factory=dict)
    outliers: float = 0.0
    start_focal: float = 1.0
    error: Optional[str] = None
    success: bool = True
    messages: Tuple[str, ...] = ()
    extra: Dict[str, Any] = field(default_factory=dict)

    def of(self, payload: str) -> List[Frame]:
        return [f for f in self.frames if f.payload.id == payload]

    def lay(self, rows: np.ndarray, group: str) -> np.ndarray:
        """Where places (N, 3) of a group were reconstructed."""
        warp = self.warps.get(group)
        return rows.copy() if warp is None else warp(rows)

    def center(self, frame: Frame) -> np.ndarray:
        return self.lay(frame.place[None, :], frame.group)[0]

    @property
    def components(self) -> int:
        return len({f.component for f in self.frames if f.placed})


def fly_block(payloads: Sequence[Payload] = (), strips: int = 3, per_strip: int = 5, seed: int = 7) -> Block:
    """Two cameras over the same ground by default; everything reconstructed where it is."""
    scene = Scene("site", ORIGIN)
    frames: List[Frame] = []
    for number, payload in enumerate(payloads or (phantom4pro(), phantom4())):
        plan = Plan(height_m=60.0, strips=strips, per_strip=per_strip, start_s=36000.0 + 3000.0 * number)
        gen = np.random.default_rng([seed, number])
        for index, shot in enumerate(fly(payload, plan, scene, seed)):
            place = np.asarray(shot.position)
            believed = place + gen.normal(0.0, 0.8, 3)
            frames.append(
                Frame(
                    name=f"{payload.id.upper()}_{index:04d}.JPG",
                    payload=payload,
                    place=place,
                    rotation=np.asarray(shot.rotation(payload)),
                    gps=ORIGIN.to_geodetic(*believed),
                    time_s=1.7e9 + shot.time_s,
                )
            )
    gen = np.random.default_rng(seed)
    reach = np.abs([f.place[:2] for f in frames]).max(axis=0) + 30.0
    points = np.column_stack([gen.uniform(-reach, reach, (1500, 2)), gen.normal(0.0, 0.5, 1500)])
    return Block(frames, points)


def write_project(block: Block, root: Path) -> Path:
    """Write the project folder and return it."""
    opensfm = root / "opensfm"
    for name in ("matches", "reports", "stats"):
        (opensfm / name).mkdir(parents=True)
    placed = [f for f in block.frames if f.placed]
    seen = _observations(block, placed)
    shared = _shared(seen)
    _tie(block, placed, shared)
    _json(root / "images.json", [_photo(f) for f in block.frames])
    (opensfm / "image_list.txt").write_text("".join(f"/data/images/{f.name}\n" for f in block.frames))
    (opensfm / "config.yaml").write_text("feature_process_size: 1000\nfeature_type: DSPSIFT\n")
    _json(opensfm / "camera_models.json", {f.camera_id: _camera(f.camera, block.start_focal) for f in block.frames})
    model = _reconstruction(block, placed)
    if placed:
        _json(opensfm / "reconstruction.topocentric.json", [model])
        _json(opensfm / "reconstruction.json", [model])
        write_tracks(opensfm / "tracks.csv", seen)
        _reports(block, placed, shared, opensfm)
        _json(root / "odm_report" / "shots.geojson", _shots(block, placed))
    write_matches(opensfm / "matches", [f.name for f in block.frames], shared)
    _json(root / "log.json", _log(block))
    return root


def write_split(block: Block, root: Path, overlap: int = 3) -> Path:
    """A split run of two parts that share ``overlap`` frames of each payload: the whole has no model of its own."""
    write_project(replace(block, frames=[replace(f, placed=False) for f in block.frames]), root)
    payloads = [block.of(p) for p in sorted({f.payload.id for f in block.frames})]
    for number in range(2):
        mine = []
        for frames in payloads:
            half = len(frames) // 2
            mine += frames[: half + overlap] if number == 0 else frames[half:]
        write_project(replace(block, frames=mine), root / f"submodels/submodel_{number:04d}")
    (root / "submodels/opensfm").mkdir()
    return root


_CONTROL = ((-20.0, -20.0), (20.0, -20.0), (-20.0, 20.0), (20.0, 20.0), (0.0, 0.0), (10.0, -5.0))


def write_control(block: Block, root: Path) -> Path:
    """Put a ground control list into a project: true coordinates, marked where each frame's model shows the point."""
    rows = ["EPSG:4326"]
    for number, (east, north) in enumerate(_CONTROL):
        true = np.asarray([east, north, 0.5 * (number % 3)])
        latitude, longitude, altitude = ORIGIN.to_geodetic(*true)
        for frame in block.frames:
            place = block.lay(true[None, :], frame.group)
            x, y = project(place, frame.camera, frame.rotation, block.center(frame))[0]
            if 0 < x < frame.camera.width and 0 < y < frame.camera.height:
                rows.append(f"{longitude:.9f} {latitude:.9f} {altitude:.4f} {x:.3f} {y:.3f} {frame.name} g{number}")
    (root / "gcp_list.txt").write_text("\n".join(rows) + "\n")
    return root


def _json(path: Path, value: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=4), encoding="utf-8")


Seen = List[Tuple[str, int, float, float]]


def _observations(block: Block, placed: Sequence[Frame]) -> Seen:
    """Frame, track and image coordinates of every point that a frame of its component sees."""
    gen = np.random.default_rng(3)
    found: Seen = []
    count = len(block.points)
    for frame in placed:
        camera = frame.camera
        pixels = project(block.lay(block.points, frame.group), camera, frame.rotation, block.center(frame))
        inside = (
            (pixels[:, 0] > 0) & (pixels[:, 0] < camera.width) & (pixels[:, 1] > 0) & (pixels[:, 1] < camera.height)
        )
        for index in np.nonzero(inside)[0]:
            xy = pixels[index] + gen.normal(0.0, block.noise_px.get(frame.payload.id, 0.6), 2)
            if gen.uniform() < block.outliers:
                xy = xy + gen.uniform(50, 200, 2)
            x = (xy[0] - (camera.width - 1) / 2) / max(camera.width, camera.height)
            y = (xy[1] - (camera.height - 1) / 2) / max(camera.width, camera.height)
            found.append((frame.name, int(index) + count * _point_set(block, frame), float(x), float(y)))
    return found


def _point_set(block: Block, frame: Frame) -> int:
    """Frames of another group or component have points of their own."""
    return sorted({(f.component, f.group) for f in block.frames if f.placed}).index((frame.component, frame.group))


def _shared(seen: Seen) -> Dict[Tuple[str, str], List[int]]:
    by_track: Dict[int, List[str]] = {}
    for name, track, _, _ in seen:
        by_track.setdefault(track, []).append(name)
    found: Dict[Tuple[str, str], List[int]] = {}
    for track, names in by_track.items():
        for i, a in enumerate(names):
            for b in names[i + 1 :]:
                found.setdefault((a, b), []).append(track)
    return found


def _tie(block: Block, placed: Sequence[Frame], shared: Dict[Tuple[str, str], List[int]]) -> None:
    """Matches between groups, each frame with the nearest two of another."""
    for frame in placed if block.ties else ():
        others = [f for f in placed if f.group != frame.group]
        for other in sorted(others, key=lambda f: float(np.linalg.norm(f.place - frame.place)))[:2]:
            shared[(frame.name, other.name)] = list(range(block.ties))


def write_tracks(path: Path, seen: Seen) -> None:
    """Binary tracks, version 102."""
    with open(path, "wb") as stream:
        stream.write(b"OPENSFM_TRACKS_VERSION_v102\n")
        for name, track, x, y in seen:
            image, number = name.encode(), str(track).encode()
            stream.write(struct.pack("<HH", len(image), len(number)) + image + number)
            stream.write(struct.pack("<ifffBBBx", track, x, y, 0.004, 1, 2, 3))


def write_matches(folder: Path, names: Sequence[str], shared: Dict[Tuple[str, str], List[int]]) -> None:
    """One pickle per frame; a pair stands in one of its two files."""
    for name in names:
        mine = {b: rows for (a, b), rows in shared.items() if a == name}
        pairs: Dict[str, Any] = {b: np.asarray([[t, t] for t in rows], dtype=int) for b, rows in mine.items()}
        pairs["TRIED_AND_FAILED.JPG"] = np.asarray([])
        with gzip.open(folder / f"{name}_matches.pkl.gz", "wb") as stream:
            pickle.dump(pairs, stream)


def _photo(frame: Frame) -> Dict[str, Any]:
    camera = frame.camera
    return {
        "filename": frame.name,
        "width": camera.width,
        "height": camera.height,
        "camera_make": frame.payload.make,
        "camera_model": frame.payload.model,
        "latitude": frame.gps[0],
        "longitude": frame.gps[1],
        "altitude": frame.gps[2],
        "band_name": "RGB",
        "capture_uuid": None,
        "utc_time": frame.time_s * 1000.0,
        "gps_xy_stddev": None,
        "camera_projection": "brown",
        "focal_ratio": camera.focal_ratio,
    }


def _camera(camera: Camera, focal: float = 1.0) -> Dict[str, Any]:
    k1, k2, p1, p2, k3 = camera.distortion
    side = max(camera.width, camera.height)
    return {
        "projection_type": "brown",
        "width": camera.width,
        "height": camera.height,
        "focal_x": camera.focal_ratio * camera.width / side * focal,
        "focal_y": camera.focal_ratio * camera.width / side * focal,
        "c_x": camera.center_px[0] / side,
        "c_y": camera.center_px[1] / side,
        "k1": k1,
        "k2": k2,
        "p1": p1,
        "p2": p2,
        "k3": k3,
    }


def axis_angle(rotation: np.ndarray) -> List[float]:
    """Axis-angle vector of a rotation matrix, also near half a turn."""
    cosine = float(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0))
    angle = float(np.arccos(cosine))
    values, vectors = np.linalg.eig(rotation)
    axis = np.real(vectors[:, int(np.argmin(np.abs(values - 1.0)))])
    axis = axis / np.linalg.norm(axis)
    skew = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    if float(axis @ skew) < 0:
        axis = -axis
    return [float(v) for v in axis * angle]


def _reconstruction(block: Block, placed: Sequence[Frame]) -> Dict[str, Any]:
    count = len(block.points)
    points: Dict[str, Any] = {}
    for frame in placed:
        base = count * _point_set(block, frame)
        if str(base) not in points:
            for i, place in enumerate(block.lay(block.points, frame.group)):
                points[str(base + i)] = {"color": [1.0, 2.0, 3.0], "coordinates": [float(v) for v in place]}
    return {
        "cameras": {f.camera_id: _camera(f.camera) for f in placed},
        "shots": {
            f.name: {
                "rotation": axis_angle(f.rotation),
                "translation": [float(v) for v in -f.rotation @ block.center(f)],
                "camera": f.camera_id,
                "capture_time": f.time_s,
                "gps_dop": 10.0,
                "vertices": [],
            }
            for f in placed
        },
        "points": points,
        "biases": {f.camera_id: {"rotation": [0.0, 0.0, 0.0], "scale": 1.0} for f in placed},
        "rig_instances": {f.name: {"translation": [0.0, 0.0, 0.0], "rig_camera_ids": {f.name: "c"}} for f in placed},
        "reference_lla": {"latitude": ORIGIN.latitude, "longitude": ORIGIN.longitude, "altitude": 0.0},
    }


def _reports(block: Block, placed: Sequence[Frame], shared: Dict[Tuple[str, str], List[int]], opensfm: Path) -> None:
    rows: List[Dict[str, Any]] = [
        {"bootstrap": {"image_pair": ["A", "B"], "decision": "Initial reconstruction failed"}}
    ]
    for component in sorted({f.component for f in placed}):
        names = [f.name for f in placed if f.component == component]
        steps = [{"images": [n], "resection": {"num_inliers": 200, "shots": [n]}} for n in names[2:]]
        rows.append({"bootstrap": {"image_pair": names[:2], "decision": "Success"}, "grow": {"steps": steps}})
    _json(opensfm / "reports/reconstruction.json", {"not_reconstructed_images": [], "reconstructions": rows})
    _json(opensfm / "reports/tracks.json", {"view_graph": [[a, b, len(t)] for (a, b), t in sorted(shared.items())]})
    stats = {
        "reconstruction_statistics": {
            "components": 1,
            "initial_shots_count": len(block.frames),
            "reconstructed_shots_count": len(placed),
            "reprojection_error_pixels": 0.75,
        },
        "gps_errors": {"average_error": 1.2},
        **block.extra,
    }
    _json(opensfm / "stats/stats.json", stats)
    _json(opensfm.parent / "odm_report/stats.json", stats)


def _shots(block: Block, placed: Sequence[Frame]) -> Dict[str, Any]:
    features = [
        {
            "type": "Feature",
            "properties": {
                "filename": f.name,
                "camera": f.camera_id,
                "focal": f.camera.focal_ratio,
                "width": f.camera.width,
                "height": f.camera.height,
                "translation": [float(v) for v in np.add(block.center(f), (576705.0, 5188170.0, 0.0))],
                "rotation": axis_angle(f.rotation),
            },
            "geometry": {"type": "Point", "coordinates": [0.0, 0.0, 0.0]},
        }
        for f in placed
    ]
    return {"type": "FeatureCollection", "features": features}


def _log(block: Block) -> Dict[str, Any]:
    said: List[Any] = ["Running opensfm stage", ["a list", "of settings"], *block.messages]
    if block.components > 1:
        said.append(MULTIPLE % block.components)
    log: Dict[str, Any] = {
        "odmVersion": "3.6.0",
        "images": len(block.frames),
        "options": {"use_fixed_camera_params": False},
        "stages": [
            {"name": "dataset", "messages": [{"message": "Running dataset stage", "type": "info"}]},
            {"name": "opensfm", "messages": [{"message": m, "type": "info"} for m in said]},
        ],
        "processes": [{"command": "opensfm", "exitCode": 0, "output": ["fine"]}],
        "success": block.success and block.error is None,
    }
    if block.error is not None:
        log["error"] = {"code": 1, "message": block.error}
    return log
