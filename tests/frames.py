"""Frames made by hand for the tests of pure rules."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, List, Sequence

from sensorgate.stages.frame import Frame
from sensorgate.stages.read import Scan
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import Survey, build
from sensorgate.stages.thresholds import DEFAULTS, Thresholds

REAL = Path(__file__).resolve().parents[1].parent / "shared/data/real_frames"

P4P = Frame(
    path="",
    size_bytes=0,
    format="jpeg",
    width=5472,
    height=3648,
    make="DJI",
    model="FC6310",
    focal_mm=8.8,
    focal_35mm=24.0,
    time="2024-05-01T10:00:00",
    latitude=46.84,
    longitude=-91.99,
    altitude_m=250.0,
    relative_altitude_m=80.0,
    pitch_deg=-90.0,
)


def strip(
    template: Frame = P4P,
    count: int = 12,
    *,
    folder: str = "in",
    prefix: str = "DJI_",
    start: str = "2024-05-01T10:00:00",
    step_s: float = 3.0,
    step_deg: float = 0.0001,
    **changes: Any,
) -> List[Frame]:
    """A straight strip of frames flown north from the template's position; sizes in bytes all differ."""
    import datetime

    begin = datetime.datetime.fromisoformat(start)
    base = replace(template, **changes)
    frames = []
    for i in range(count):
        moment = begin + datetime.timedelta(seconds=step_s * i)
        frames.append(
            replace(
                base,
                path=f"{folder}/{prefix}{i + 1:04d}.JPG",
                size_bytes=1_000_000 + i + 1000 * sum(map(ord, folder + prefix)),
                time=moment.isoformat(),
                latitude=None if base.latitude is None else base.latitude + step_deg * i,
            )
        )
    return frames


def survey_of(frames: Sequence[Frame], limits: Thresholds = DEFAULTS, **options: Any) -> Survey:
    """A survey of frames that exist on no disk."""
    return build(Scan(frames=tuple(frames), broken=(), ignored={}), load_sheet(), limits, **options)
