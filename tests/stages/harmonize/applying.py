"""Small surveys and plans to apply, for the tests of harmonizing."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Dict

from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize import FlightAction, HarmonizePlan, Lut, apply
from sensorgate.stages.thresholds import DEFAULTS

from .samples import exif_block, jpeg_bytes

ROOT = Path(__file__).resolve().parents[3]


PLUS_TEN = tuple(min(255, i + 10) for i in range(256))


def survey(folder: Path, count: int = 3, *, width: int = 320, height: int = 240) -> Dict[str, Frame]:
    folder.mkdir(parents=True, exist_ok=True)
    frames = {}
    for index in range(count):
        focal = (8800 + index, 1000)
        data = jpeg_bytes(width, height, exif=exif_block(width, height, FocalLength=focal))
        name = f"IMG_{index:03d}.JPG"
        (folder / name).write_bytes(data + bytes(index))
        frames[name] = Frame(
            name,
            len(data) + index,
            "jpeg",
            width,
            height,
            focal_mm=focal[0] / 1000,
            focal_35mm=24.0,
            focal_plane_unit=4,
        )
    return frames


def action(frames: Dict[str, Frame], **changes) -> FlightAction:
    first = next(iter(frames.values()))
    size = (first.width, first.height)
    values = {
        "profile": "p",
        "flight": "p:1",
        "frames": tuple(frames),
        "gsd_cm": 2.0,
        "target_gsd_cm": 2.0,
        "scale": 1.0,
    }
    values.update(width=size[0], height=size[1], out_width=size[0], out_height=size[1])
    values.update(changes)
    return FlightAction(**values)


def shrunk(frames: Dict[str, Frame], **more) -> HarmonizePlan:
    lut = Lut("p|p:1", (PLUS_TEN,) * 3, (-10.0,) * 3, "q|q:1", 6)
    return HarmonizePlan(
        (action(frames, scale=0.8, out_width=256, out_height=192, lut=lut.id, write_lut=True, **more),), (lut,)
    )


def run(plan, frames, source: Path, out: Path, **options):
    return apply(
        plan,
        frames,
        {n: source / n for n in frames},
        {n: out / n for n in frames},
        thresholds=options.pop("thresholds", DEFAULTS),
        **options,
    )


def digests(folder: Path) -> Dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}


def survey_again(folder: Path, width: int = 320, height: int = 240) -> Dict[str, Frame]:
    return {
        p.name: Frame(p.name, p.stat().st_size, "jpeg", width, height, focal_mm=8.8, focal_35mm=24.0)
        for p in sorted(folder.iterdir())
    }
