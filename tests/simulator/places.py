"""Where stories fly, and what all of them are put together from."""

from __future__ import annotations

from typing import Dict, Tuple

from . import catalogue
from .geo import Origin
from .survey import ControlPoint, Payload, Scene, Shot, Survey, rng

HOME = Origin(47.21840, 8.73150, 441.0)
FAR = Origin(47.24480, 8.75320, 436.0)
GROUND = Scene("ground", HOME)
# Control fixes a focal by the heights between its points: flat ground under a nadir block leaves it open.
HILLS = Scene("ground", HOME, key="hills", relief=3.0)


def survey_of(name: str, *flights: Tuple[Payload, Tuple[Shot, ...]], scenes: Tuple[Scene, ...] = (GROUND,)) -> Survey:
    """A survey of flights; a payload may fly more than once."""
    payloads: Dict[str, Payload] = {}
    shots: Tuple[Shot, ...] = ()
    for payload, flown in flights:
        payloads[payload.id] = payload
        shots += flown
    return Survey(name, scenes, tuple(payloads.values()), shots)


def targets(
    seed: int,
    half_m: Tuple[float, float],
    count: int,
    checks: int,
    center: Tuple[float, float] = (0.0, 0.0),
    side: str = "",
) -> Tuple[ControlPoint, ...]:
    """Targets spread over a block: the corners and the middle first, jittered; ``side`` ends their names."""
    gen = rng(seed, "targets", *([side] if side else []))
    grid = [(-1, -1), (1, 1), (-1, 1), (1, -1), (0, 0), (0, 1), (0, -1), (-1, 0), (1, 0)]
    spots = [(x + gen.uniform(-0.12, 0.12), y + gen.uniform(-0.12, 0.12)) for x, y in grid[:count]]
    spots += [(gen.uniform(-0.7, 0.7), gen.uniform(-0.7, 0.7)) for _ in range(checks)]
    return tuple(
        ControlPoint(
            f"gcp{i + 1:02d}{side}" if i < count else f"check{i + 1 - count:02d}{side}",
            GROUND.id,
            center[0] + float(x * half_m[0]),
            center[1] + float(y * half_m[1]),
            "gcp" if i < count else "check",
        )
        for i, (x, y) in enumerate(spots)
    )


def small(payload: Payload) -> Payload:
    """The same payload at half its pixels a side: enough to align, quick to render."""
    return catalogue.with_band_size(payload, 0.5)
