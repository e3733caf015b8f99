"""Render a survey: worlds, frames, files, ground control, truth."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Callable, Dict, List, Optional, Set, Tuple, Union

import numpy as np

from . import renderer
from .camera import Camera, project
from .dialects import BLACK_LEVEL, WRITERS, Claim
from .filelies import KINDS
from .geo import utm, utm_zone
from .survey import MULTISPECTRAL, THERMAL, Payload, Scene, Shot, Survey, rng, scaled
from .truth import TrueCamera, TrueFrame, TrueMark, TruePayload, TruePoint, TrueScene, Truth
from .world import World

IMAGES = "images"
MARGIN_M = 3.0
DEEPEST_M = 8.0
EDGE_PX = 8.0
PANEL_HEIGHT_M = 1.3
MOST_TEXELS = 30e6
Progress = Callable[[int, int], None]


def render(
    story: Union[str, Survey],
    out_dir: Union[str, Path],
    seed: int = 0,
    frames_scale: float = 1.0,
    progress: Optional[Progress] = None,
) -> Truth:
    """Render a named story or a survey below ``out_dir``: ``images/``, ``gcp_list.txt``, ``truth.json``."""
    from .stories import build

    survey = scaled(build(story, seed) if isinstance(story, str) else story, frames_scale)
    out = Path(out_dir)
    images = out / IMAGES
    images.mkdir(parents=True, exist_ok=True)
    worlds = {scene.id: world_of(survey, scene, seed) for scene in survey.scenes}
    frames: Dict[str, TrueFrame] = {}
    order = {p.id: i for i, p in enumerate(survey.payloads)}
    # By payload and lens, so that only one spectrum's textures are in memory at a time.
    todo = sorted(survey.shots, key=lambda s: (s.scene, order[s.payload], s.band, s.path))
    for done, shot in enumerate(todo):
        payload = survey.payload(shot.payload)
        world = worlds[shot.scene]
        channels = payload.bands[shot.band].channels
        world.keep_only(channels)
        data, frame = render_shot(world, payload, shot, seed)
        _write(images / shot.path, data)
        frames[shot.path] = frame
        if progress:
            progress(done + 1, len(todo))
    _tell_file_lies(survey, images, frames)
    for path, content in sorted(survey.extra_files.items()):
        _write(images / path, content)
    points = _points(survey, worlds, frames)
    gcp_file = None
    if any(p.role == "gcp" for p in points):
        gcp_file = "gcp_list.txt"
        marked = {s.path for s in survey.shots if _marked_by_hand(survey.payload(s.payload), s.band)}
        _write(out / gcp_file, gcp_text(points, survey.gcp_header, marked).encode("utf-8"))
    truth = Truth(
        story=survey.name,
        seed=seed,
        images=IMAGES,
        gcp_file=gcp_file,
        scenes=tuple(_true_scene(worlds[s.id]) for s in survey.scenes),
        payloads=tuple(_true_payload(p, frames) for p in survey.payloads),
        points=tuple(points),
        frames=tuple(frames[k] for k in sorted(frames)),
        extra={**dict.fromkeys(sorted(survey.extra_files), "extra")},
        folder=str(out),
    )
    _write(out / "truth.json", truth.dumps().encode("utf-8"))
    return truth


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def world_of(survey: Survey, scene: Scene, seed: int) -> World:
    """The ground that the shots of a scene need, fine enough for the finest of them."""
    west = south = math.inf
    east = north = -math.inf
    finest = math.inf
    for shot in survey.shots:
        if shot.scene != scene.id:
            continue
        payload = survey.payload(shot.payload)
        camera = shot.optics(payload)
        x, y = renderer.footprint(camera, shot.rotation(payload), shot.position[2] + DEEPEST_M * scene.relief)
        at = shot.position
        west, east = min(west, at[0] + float(x.min())), max(east, at[0] + float(x.max()))
        south, north = min(south, at[1] + float(y.min())), max(north, at[1] + float(y.max()))
        if shot.role == "survey":
            finest = min(finest, shot.position[2] / camera.focal_px)
    points = [p for p in survey.points if p.scene == scene.id]
    texel = max(finest, math.sqrt((east - west) * (north - south) / MOST_TEXELS))
    bounds = (west - MARGIN_M, south - MARGIN_M, east + MARGIN_M, north + MARGIN_M)
    return World.make(scene, seed, bounds, texel, points)


def render_shot(world: World, payload: Payload, shot: Shot, seed: int) -> Tuple[bytes, TrueFrame]:
    """The bytes of one frame's file and its truth."""
    band, camera = payload.bands[shot.band], shot.optics(payload)
    if shot.role == "panel":
        shot = at_hand(world, shot)
    rotation, center = shot.rotation(payload), np.array(shot.position)
    texture, z = renderer.sample(world, band.channels, camera, rotation, center, shot.drift_m(payload))
    if shot.role == "panel":
        texture = renderer.with_panel(texture)
    gen = rng(seed, "noise", shot.path)
    gain = payload.gain * shot.exposure
    celsius = None
    if payload.spectrum == THERMAL:
        celsius = renderer.expose_thermal(
            texture, gen, payload.noise_dn, payload.blur_px, 8.0 * math.log(shot.exposure)
        )
        pixels = renderer.palette(celsius, *payload.options["range_c"], payload.options["palette"])
    elif payload.spectrum == MULTISPECTRAL:
        pixels = renderer.expose_mono16(
            texture, gen, gain, BLACK_LEVEL, payload.noise_dn, payload.blur_px, payload.vignette
        )
    else:
        pixels = renderer.expose_rgb(
            texture, gen, gain, payload.offset_dn, payload.noise_dn, payload.blur_px, payload.vignette
        )
    name = shot.path.rsplit("/", 1)[-1]
    claim = Claim(payload, band, camera, shot.reported, name, celsius)
    mean_height = float(center[2] - z.mean())
    latitude, longitude, altitude = world.scene.origin.to_geodetic(*shot.position)
    frame = TrueFrame(
        path=shot.path,
        payload=payload.id,
        profile=payload.profile(band),
        spectrum=payload.spectrum,
        band=band.name,
        capture=shot.capture,
        flight=shot.flight,
        scene=shot.scene,
        role=shot.role,
        camera=TrueCamera(
            camera.width,
            camera.height,
            camera.focal_ratio,
            camera.center_px,
            camera.distortion,
            payload.sensor_width_mm,
            camera.focal_ratio * payload.sensor_width_mm,
            camera.fisheye,
        ),
        center_m=shot.position,
        rotation=tuple(tuple(float(v) for v in row) for row in rotation),
        latitude=latitude,
        longitude=longitude,
        altitude_m=altitude,
        height_m=float(center[2] - world.heights(center[0], center[1])),
        mean_height_m=mean_height,
        gsd_cm=100.0 * mean_height / camera.focal_px,
        lies=shot.lies,
    )
    return WRITERS[payload.dialect](claim, pixels), frame


def at_hand(world: World, shot: Shot) -> Shot:
    """A panel capture: held a good metre above the ground where the shot stands, and reported so."""
    east, north, flown = shot.position
    up = float(world.heights(east, north)) + PANEL_HEIGHT_M
    said = shot.reported
    # To the decimetre, so that all lenses of a rig report one place.
    altitude = None if said.altitude_m is None else round(said.altitude_m + up - flown, 1)
    relative = None if said.relative_altitude_m is None else PANEL_HEIGHT_M
    reported = replace(said, altitude_m=altitude, relative_altitude_m=relative)
    return replace(shot, position=(east, north, up), reported=reported)


def _tell_file_lies(survey: Survey, images: Path, frames: Dict[str, TrueFrame]) -> None:
    for lie in survey.file_lies:
        data = KINDS[lie.kind]((images / lie.path).read_bytes(), lie.arguments)
        target = str(lie.arguments.get("to", lie.path))
        _write(images / target, data)
        before = frames[lie.path]
        if lie.kind == "resize":
            before = replace(before, camera=_resized(before.camera, float(lie.arguments.get("factor", 0.5))))
        if lie.kind == "rename":
            (images / lie.path).unlink()
            del frames[lie.path]
        frames[target] = replace(before, path=target, lies=(*before.lies, lie.kind))


def _resized(camera: TrueCamera, factor: float) -> TrueCamera:
    """What is true of a frame that its owner resampled."""
    width, height = round(camera.width * factor), round(camera.height * factor)
    center = (camera.center_px[0] * width / camera.width, camera.center_px[1] * height / camera.height)
    return replace(camera, width=width, height=height, center_px=center)


def _points(survey: Survey, worlds: Dict[str, World], frames: Dict[str, TrueFrame]) -> List[TruePoint]:
    """Control points with their exact marks in every intact frame that sees them."""
    shots = {s.path: s for s in survey.shots}
    broken = {lie.path for lie in survey.file_lies if lie.kind not in ("copy", "rename")}
    found = []
    for planned in survey.points:
        world = worlds[planned.scene]
        point = world.points[planned.id]
        up = float(world.heights(point.east, point.north))
        xyz = np.array([point.east, point.north, up])
        marks = []
        for path in sorted(frames):
            shot = shots.get(path)
            if shot is None or shot.scene != point.scene or path in broken or shot.role != "survey":
                continue
            payload = survey.payload(shot.payload)
            camera, center = shot.optics(payload), np.array(shot.position)
            x, y = seen_at(xyz, camera, shot, payload)
            inside = EDGE_PX <= x < camera.width - EDGE_PX and EDGE_PX <= y < camera.height - EDGE_PX
            if inside and world.visible(xyz, center):
                marks.append(TrueMark(path, float(x), float(y)))
        latitude, longitude, altitude = world.scene.origin.to_geodetic(point.east, point.north, up)
        found.append(
            TruePoint(
                point.id,
                point.role,
                point.scene,
                point.east,
                point.north,
                up,
                latitude,
                longitude,
                altitude,
                tuple(marks),
            )
        )
    return found


def seen_at(xyz: np.ndarray, camera: Camera, shot: Shot, payload: Payload) -> Tuple[float, float]:
    """The pixel of a point; where rows are read one after another, from where the lens is at that row."""
    rotation, center = shot.rotation(payload), np.array(shot.position)
    drift = np.array([*shot.drift_m(payload), 0.0])
    x, y = project(xyz, camera, rotation, center)[0]
    for _ in range(4 if drift.any() else 0):
        share = (y + 0.5) / camera.height - 0.5
        if not np.isfinite(share):
            break
        x, y = project(xyz, camera, rotation, center + drift * share)[0]
    return float(x), float(y)


def _marked_by_hand(payload: Payload, band: int) -> bool:
    """People mark targets in RGB frames and in one band of a rig, hardly ever in thermal ones."""
    if payload.spectrum == MULTISPECTRAL:
        names = [b.name for b in payload.bands]
        return band == (names.index("Green") if "Green" in names else 0)
    return payload.spectrum != THERMAL


def gcp_text(points: List[TruePoint], header: str, marked: Set[str]) -> str:
    """ODM's ``gcp_list.txt``: a line that names the system, then x y z pixel-x pixel-y image name.

    Check points stand in it as well: their names begin with "check". Only the frames in ``marked`` get lines.
    ``header`` is ``utm`` (the words ODM reads), ``epsg`` or ``wgs84``. 0, 0 is the centre of the first pixel, as
    OpenSfM takes it.
    """
    zone = utm_zone(points[0].longitude)
    south = points[0].latitude < 0
    titles = {
        "utm": f"WGS84 UTM {zone}{'S' if south else 'N'}",
        "epsg": f"EPSG:{(32700 if south else 32600) + zone}",
        "wgs84": "EPSG:4326",
    }
    lines = [titles[header]]
    for point in points:
        if header == "wgs84":
            x, y, digits = point.longitude, point.latitude, 9
        else:
            (x, y), digits = utm(point.latitude, point.longitude, zone), 4
        for mark in point.marks:
            if mark.path not in marked:
                continue
            name = mark.path.rsplit("/", 1)[-1]
            place = f"{x:.{digits}f} {y:.{digits}f} {point.altitude_m:.4f}"
            lines.append(f"{place} {mark.x_px:.3f} {mark.y_px:.3f} {name} {point.id}")
    return "\n".join(lines) + "\n"


def _true_scene(world: World) -> TrueScene:
    scene, ground = world.scene, world.ground
    rows, columns = ground.shape
    t = ground.texel_m
    return TrueScene(
        id=scene.id,
        key=scene.key,
        latitude=scene.origin.latitude,
        longitude=scene.origin.longitude,
        altitude_m=scene.origin.altitude_m,
        bounds_m=(world.west, world.north - rows * t, world.west + columns * t, world.north),
        texel_m=t,
        relief=scene.relief,
        buildings=scene.buildings,
        height_min_m=float(ground.height.min()),
        height_max_m=float(ground.height.max()),
    )


def _true_payload(payload: Payload, frames: Dict[str, TrueFrame]) -> TruePayload:
    own = [f for f in frames.values() if f.payload == payload.id]
    return TruePayload(
        id=payload.id,
        make=payload.make,
        model=payload.model,
        spectrum=payload.spectrum,
        profiles=tuple(sorted({f.profile for f in own})),
        route=payload.route,
        project=payload.project or payload.id,
        frames=len(own),
    )
