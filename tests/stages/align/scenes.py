"""Synthetic solutions with known truth: cameras over ground, a measured position each, no pixels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
from sensorgate.stages.align.enu import enu
from sensorgate.stages.align.model import AlignCamera, AlignFrame, AlignRequest
from sensorgate.stages.align.prepare import engine_settings
from sensorgate.stages.align.solution import CameraSetting, Job, JobFrame, Solution
from sensorgate.stages.intrinsics import Intrinsics
from sensorgate.stages.thresholds import DEFAULTS

ORIGIN = (46.84, -91.99, 200.0)
SHEET = Intrinsics(
    focal_ratio=0.6,
    focal_source="sheet",
    distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    distortion_source="corrected-in-camera",
)


def geographic(local: np.ndarray) -> List[Tuple[float, float, float]]:
    """East, north, up to latitude, longitude, altitude by two Newton steps on ``enu``."""
    origin = np.asarray(ORIGIN)
    metres = np.array([111320.0 * np.cos(np.radians(ORIGIN[0])), 111132.0])
    rows = np.stack(
        [origin[0] + local[:, 1] / metres[1], origin[1] + local[:, 0] / metres[0], origin[2] + local[:, 2]], axis=1
    )
    for _ in range(4):
        miss = local - enu(rows, origin)
        rows += np.stack([miss[:, 1] / metres[1], miss[:, 0] / metres[0], miss[:, 2]], axis=1)
    return [(float(a), float(b), float(c)) for a, b, c in rows]


def grid(strips: int = 3, per_strip: int = 6, height_m: float = 60.0, step_m: float = 18.0) -> np.ndarray:
    """Camera places of a serpentine, metres, ground at 0."""
    rows = []
    for s in range(strips):
        order = range(per_strip) if s % 2 == 0 else reversed(range(per_strip))
        rows.extend([k * step_m, s * step_m * 1.4, height_m] for k in order)
    places = np.asarray(rows, dtype=float)
    places[:, :2] -= places[:, :2].mean(axis=0)
    return places


def frames(places: np.ndarray, payload: str = "a", start_s: float = 0.0, **more: Any) -> List[AlignFrame]:
    """One frame per place, its true position as its measured one."""
    return [
        AlignFrame(
            path=f"{payload}/{i:03d}.jpg",
            file=f"/nowhere/{payload}/{i:03d}.jpg",
            width=4000,
            height=3000,
            profile=payload,
            flight=f"{payload}/1",
            payload=payload,
            capture="",
            time_s=start_s + 2.0 * i,
            position=position,
            height_m=float(place[2]),
            **more,
        )
        for i, (position, place) in enumerate(zip(geographic(places), places))
    ]


def request(*groups: Sequence[AlignFrame], intrinsics: Intrinsics = SHEET) -> AlignRequest:
    """A request of several payloads with one camera each."""
    all_frames = tuple(f for group in groups for f in group)
    shapes = sorted({(f.profile, f.width, f.height) for f in all_frames})
    cameras = tuple(AlignCamera(p, w, h, intrinsics, intrinsics.distortion is not None) for p, w, h in shapes)
    return AlignRequest("block", all_frames, cameras)


def ground_points(count: int = 400, half_m: float = 90.0, relief_m: float = 1.0, seed: int = 1) -> np.ndarray:
    """Scattered ground, metres."""
    gen = np.random.default_rng(seed)
    xy = gen.uniform(-half_m, half_m, (count, 2))
    return np.concatenate([xy, gen.normal(0.0, relief_m / 3.0, (count, 1))], axis=1)


def job_for(asked: AlignRequest) -> Job:
    """The engine's job of a request, as ``prepare`` would make it."""
    shapes = {(c.profile, c.width, c.height): i for i, c in enumerate(asked.cameras)}
    return Job(
        frames=tuple(JobFrame(f.path, f.file, shapes[(f.profile, f.width, f.height)], f.flight) for f in asked.frames),
        cameras=tuple(
            CameraSetting(c.profile, 1200, 900, 0.6, solve_focal=False, solve_distortion=False) for c in asked.cameras
        ),
        pairs=(),
        settings=engine_settings("quick", 1200, 1, DEFAULTS),
    )


def solution(
    asked: AlignRequest,
    places: np.ndarray,
    points: Optional[np.ndarray] = None,
    model: Optional[Sequence[int]] = None,
    pairs: Sequence[Tuple[int, int, int]] = (),
    error_px: float = 0.5,
    gauge: bool = True,
) -> Solution:
    """A solution whose centres are ``places``, moved into an arbitrary gauge; nadir views."""
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]) if gauge else np.eye(3)
    scale, shift = (0.07, np.array([3.0, -2.0, 5.0])) if gauge else (1.0, np.zeros(3))
    ground = ground_points() if points is None else points
    down = np.diag([1.0, -1.0, -1.0])
    count = len(places)
    owner = np.zeros(count, dtype=np.int64) if model is None else np.asarray(model, dtype=np.int64)
    lost = owner < 0
    center = scale * places @ turn.T + shift
    center[lost] = np.nan
    rotation = np.repeat((down @ turn.T)[None], count, axis=0)
    rotation[lost] = np.nan
    return Solution(
        cameras=job_for(asked).cameras,
        model=owner,
        center=center,
        rotation=rotation,
        error_px=np.where(lost, np.nan, error_px),
        observations=np.where(lost, 0, 500),
        point_xyz=scale * ground @ turn.T + shift,
        point_model=np.zeros(len(ground), dtype=np.int64),
        point_id=np.arange(len(ground), dtype=np.int64),
        pairs=np.asarray(pairs, dtype=np.int64).reshape(-1, 3),
        focal_sigma=np.full(len(asked.cameras), np.nan),
    )


def neighbours(count: int, inliers: int = 120, start: int = 0) -> List[Tuple[int, int, int]]:
    """Verified pairs along a sequence."""
    return [(start + i, start + i + 1, inliers) for i in range(count - 1)]


def moved(group: Sequence[AlignFrame], shift: Sequence[float]) -> List[AlignFrame]:
    """The same frames claiming positions that are shifted by east, north, up metres."""
    local = enu(np.asarray([f.position for f in group], dtype=float), np.asarray(ORIGIN))
    return [replace(f, position=p) for f, p in zip(group, geographic(local + np.asarray(shift, dtype=float)))]


def by_payload(report: Any) -> Dict[str, Any]:
    """Payload -> its verdict row."""
    return {p.payload: p for p in report}
