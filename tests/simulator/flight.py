"""Where a payload flies and what its files will say of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import List, Optional, Tuple

import numpy as np

from .camera import Vector
from .survey import Band, Payload, Reported, Scene, Shot, rng


@dataclass(frozen=True)
class Plan:
    """A lawn-mower block. ``strips`` x ``per_strip`` frames around ``center`` (east, north, m).

    Heights are above the scene's zero level; ``forward`` and ``side`` are
    overlaps at that height. ``cross`` adds that many strips flown across,
    ``oblique_deg`` tilts the gimbal off nadir, ``transit`` puts that many
    climbing frames before the first strip. ``every_s`` sets the trigger's pace;
    0 lets it follow from the speed.
    """

    height_m: float
    strips: int
    per_strip: int
    center: Tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0
    forward: float = 0.75
    side: float = 0.65
    cross: int = 0
    oblique_deg: float = 0.0
    transit: int = 0
    speed_mps: float = 6.0
    every_s: float = 0.0
    start_s: float = 36000.0
    first_number: int = 1
    wobble_deg: float = 1.5
    name: str = ""


@dataclass(frozen=True)
class Receiver:
    """How the drone knows where it is: spread per frame, slow bias, and what it says of that (m).

    ``altitude_bias_m`` is on the absolute altitude only, as a barometer or a
    wrong datum would put it.
    """

    sigma_horizontal_m: float = 0.8
    sigma_vertical_m: float = 1.2
    bias_m: Vector = (0.0, 0.0, 0.0)
    altitude_bias_m: float = 0.0
    relative_sigma_m: float = 0.15
    rtk_flag: Optional[int] = None
    rtk_std_m: Optional[Vector] = None


RTK = Receiver(0.02, 0.03, rtk_flag=50, rtk_std_m=(0.012, 0.011, 0.024), relative_sigma_m=0.05)


def _stations(payload: Payload, plan: Plan) -> List[Tuple[float, float, float, float, float]]:
    """East, north, height, yaw and time of every trigger."""
    camera = payload.bands[0].camera
    ahead = plan.height_m * camera.height / camera.focal_px
    across = plan.height_m / camera.focal_ratio
    step, gap = ahead * (1.0 - plan.forward), across * (1.0 - plan.side)
    found: List[Tuple[float, float, float, float, float]] = []
    clock = plan.start_s

    def strip(offset: float, turn: float, heading: float, count: int) -> None:
        nonlocal clock
        angle = math.radians(heading)
        for k in range(count):
            along = (k - (count - 1) / 2) * step
            a = along if turn > 0 else -along
            east = plan.center[0] + a * math.sin(angle) + offset * math.cos(angle)
            north = plan.center[1] + a * math.cos(angle) - offset * math.sin(angle)
            found.append((east, north, plan.height_m, heading if turn > 0 else heading + 180.0, clock))
            clock += plan.every_s or max(1.0, step / plan.speed_mps)
        clock += 8.0

    for s in range(plan.strips):
        strip((s - (plan.strips - 1) / 2) * gap, 1.0 if s % 2 == 0 else -1.0, plan.heading_deg, plan.per_strip)
    for s in range(plan.cross):
        strip(
            (s - (plan.cross - 1) / 2) * gap * 1.3, 1.0 if s % 2 == 0 else -1.0, plan.heading_deg + 90.0, plan.per_strip
        )
    climb = []
    for k in range(plan.transit):
        share = (k + 1) / (plan.transit + 1)
        e, n, h, yaw, _ = found[0]
        start = plan.start_s - 4.0 * (plan.transit - k)
        climb.append((e - 6.0 * (1 - share), n, 2.0 + (0.45 * h - 2.0) * share, yaw, start))
    return climb + found


def fly(payload: Payload, plan: Plan, scene: Scene, seed: int, receiver: Receiver = Receiver()) -> Tuple[Shot, ...]:
    """All frames of one flight, with what they report, truthfully but for the receiver's noise."""
    gen = rng(seed, "flight", payload.id, plan.name, plan.start_s)
    flight = f"{payload.id}-{plan.name or round(plan.start_s)}"
    shots: List[Shot] = []
    for index, (east, north, up, yaw, clock) in enumerate(_stations(payload, plan)):
        sway = gen.normal(0.0, plan.wobble_deg, 3)
        place = np.array([east, north, up]) + gen.normal(0.0, 0.3, 3)
        noise = gen.normal(0.0, 1.0, 4)
        exposure = float(np.exp(gen.normal(0.0, 0.03)))
        # The survey climbs in roles: a gimbal looks down all the way, only the height tells transit from survey.
        role = "transit" if index < plan.transit else "survey"
        pitch = -90.0 + plan.oblique_deg + sway[1] * 0.4
        number = plan.first_number + index
        course = math.radians(yaw)
        speed = (plan.speed_mps * math.sin(course), plan.speed_mps * math.cos(course))
        capture = f"{payload.id}-{number:04d}"
        for b, band in enumerate(payload.bands):
            shot = Shot(
                path="/".join(p for p in (payload.folder, file_name(payload, number, b)) if p),
                payload=payload.id,
                band=b,
                capture=capture,
                scene=scene.id,
                flight=flight,
                position=(0.0, 0.0, 0.0),
                yaw_deg=float(yaw + sway[0]),
                pitch_deg=float(pitch),
                roll_deg=float(sway[2] * 0.4),
                time_s=clock,
                reported=_report(payload, band, clock, f"{payload.id}{number:06d}", len(payload.bands) > 1),
                role=role,
                exposure=exposure,
                velocity_mps=speed,
            )
            late = np.array([*speed, 0.0]) * band.delay_s
            lens = place + late + shot.rotation(payload).T @ np.array(band.lever_m)
            shots.append(placed(shot, tuple(float(v) for v in lens), place, scene, receiver, noise))
    return tuple(shots)


def beside(shots: Tuple[Shot, ...], payload: Payload, rig: Payload) -> Tuple[Shot, ...]:
    """The frames of a second camera on the same drone, triggered with the first band of ``rig``."""
    band, found = payload.bands[0], []
    for shot in (s for s in shots if s.band == 0):
        late = np.array([*shot.velocity_mps, 0.0]) * band.delay_s
        lens = np.array(shot.position) + late + shot.rotation(rig).T @ np.array(band.lever_m)
        own = _report(payload, band, shot.time_s, "", False)
        kept = {
            name: getattr(shot.reported, name)
            for name in ("latitude", "longitude", "altitude_m", "relative_altitude_m", "yaw_deg", "pitch_deg")
        }
        number = int(shot.capture.rsplit("-", 1)[-1])
        found.append(
            replace(
                shot,
                path="/".join(p for p in (payload.folder, file_name(payload, number, 0)) if p),
                payload=payload.id,
                capture=f"{payload.id}-{number:04d}",
                flight=shot.flight.replace(rig.id, payload.id),
                position=tuple(float(v) for v in lens),
                reported=replace(own, roll_deg=shot.reported.roll_deg, **kept),
            )
        )
    return tuple(found)


def file_name(payload: Payload, number: int, band: int) -> str:
    """The name that the camera gives a frame."""
    return payload.name_pattern.format(number=number, band=band + 1, name=payload.bands[band].suffix)


def _report(payload: Payload, band: Band, clock: float, capture: str, rig: bool) -> Reported:
    silent = bool(payload.options.get("no_focal"))
    width = payload.bands[0].camera.width
    return Reported(
        make=payload.make,
        model=payload.model,
        serial=payload.serial,
        lens=payload.lens,
        software=payload.software,
        time_s=clock + band.delay_s,
        focal_mm=None if silent else payload.focal_mm,
        focal_35mm=None if silent else payload.focal_35mm,
        focal_plane_per_mm=width / payload.sensor_width_mm if payload.focal_plane_unit else None,
        capture_id=capture if rig else "",
        band_name=band.name if rig else "",
    )


def placed(shot: Shot, lens: Vector, body: np.ndarray, scene: Scene, receiver: Receiver, noise: np.ndarray) -> Shot:
    """Put a shot where it is and let the receiver say where it believes to be (``noise``: four unit normals)."""
    felt = body + np.array(receiver.bias_m)
    felt = felt + noise[:3] * np.array(
        [receiver.sigma_horizontal_m, receiver.sigma_horizontal_m, receiver.sigma_vertical_m]
    )
    latitude, longitude, altitude = scene.origin.to_geodetic(*(float(v) for v in felt))
    reported = replace(
        shot.reported,
        latitude=latitude,
        longitude=longitude,
        altitude_m=altitude + receiver.altitude_bias_m,
        relative_altitude_m=float(body[2] + receiver.relative_sigma_m * noise[3]),
        rtk_flag=receiver.rtk_flag,
        rtk_std_m=receiver.rtk_std_m,
        yaw_deg=shot.yaw_deg,
        pitch_deg=shot.pitch_deg,
        roll_deg=shot.roll_deg,
    )
    return replace(shot, position=lens, reported=reported)
