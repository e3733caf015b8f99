"""Which ground sampling distance each unit is brought to, and what forbids it (pure)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Dict, List, Mapping, Optional, Sequence, Tuple, Union

from ..errors import UsageError
from ..frame import Frame
from ..profile import RGB, THERMAL
from ..thresholds import Thresholds
from .units import Key, Unit

FINEST, COARSEST = "finest", "coarsest"
_JPEG = ("jpeg", "mpo")
_TIFF = ("tiff",)
_LARGEST_SIDE = 0xFFFF
_MOST_CHANNELS = 10


@dataclass(frozen=True)
class Target:
    """A unit's target with what follows: scale 1.0 keeps the pixels, ``kept`` says why although the GSD differs."""

    gsd_cm: Optional[float]
    scale: float
    trigger: float
    kept: str = ""

    def difference(self, gsd_cm: Optional[float]) -> Optional[float]:
        """How far ``gsd_cm`` is from the target: the larger over the smaller, minus one."""
        if not gsd_cm or not self.gsd_cm:
            return None
        return max(gsd_cm, self.gsd_cm) / min(gsd_cm, self.gsd_cm) - 1.0


def parse_target(gsd_target: Union[str, float]) -> Union[str, float]:
    """``finest``, ``coarsest`` or centimetres as a number; ``UsageError`` otherwise."""
    if gsd_target in (FINEST, COARSEST):
        return gsd_target
    try:
        value = float(gsd_target)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value) or value <= 0:
        raise UsageError(f"--gsd-target takes finest, coarsest or a number of centimetres above 0, not {gsd_target!r}.")
    return value


def rewritable(frame: Frame) -> str:
    """Return why a file's pixels cannot be written anew, ``""`` when they can."""
    if frame.thermal_payload:
        return "radiometric thermal JPEGs are never re-encoded: their raw temperatures would be lost"
    if frame.format in _JPEG:
        if frame.bits != 8 or frame.channels not in (1, 3):
            return f"JPEGs of {frame.bits} bits and {frame.channels} channels are not re-encoded"
        return ""
    if frame.format in _TIFF:
        if frame.pages > 1:
            return "TIFFs of several pages are not re-encoded"
        float_only = frame.bits > 16 and frame.sample_format != "float"
        if frame.channels > _MOST_CHANNELS or frame.bits not in (8, 16, 32, 64) or float_only:
            return f"TIFFs of {frame.channels} channels of {frame.bits} bits ({frame.sample_format}) are not re-encoded"
        return ""
    return f"{frame.format or 'unknown'} files are not re-encoded"


def taggable(frame: Frame) -> bool:
    """Whether a file's focal tags can be rewritten."""
    return frame.format in _JPEG + _TIFF


def _forbidden(unit: Unit, files: Mapping[str, Frame], asked: bool) -> str:
    for group in unit.groups:
        for path in group.frames:
            reason = rewritable(files[path])
            if not reason and group.spectrum == THERMAL and files[path].format in _JPEG:
                reason = "thermal JPEGs are not re-encoded: raw temperatures may be hidden in them"
            if reason:
                return reason
    tags = sorted({tag for group in unit.groups for tag in group.radiometry})
    if tags and unit.spectrum != RGB and not asked:
        return f"resampling would void {', '.join(tags)}; give --gsd-target to resample nevertheless"
    return ""


def _too_large(unit: Unit, scale: float, limits: Thresholds) -> str:
    if max(max(g.width, g.height) for g in unit.groups) * scale > _LARGEST_SIDE:
        return "the result would have more pixels on one side than the format can hold"
    if scale <= 1.0:
        return ""
    if scale > limits.upsample_limit:
        return f"{scale:.1f} times coarser than the target is beyond what interpolation can serve"
    most = max(g.width * g.height for g in unit.groups) * scale * scale / 1e6
    if most > limits.max_megapixels:
        return f"frames of {most:.0f} MP would be larger than {limits.max_megapixels:.0f} MP"
    return ""


def choose(
    units: Sequence[Unit], files: Mapping[str, Frame], limits: Thresholds, gsd_target: Union[str, float]
) -> Dict[Key, Target]:
    """Unit key -> target. Units share one where they have one spectrum and one ground.

    Units too coarse to be brought to the finest keep out of its reach and agree
    on the finest among themselves.
    """
    wanted = parse_target(gsd_target)
    asked = wanted != FINEST
    result: Dict[Key, Target] = {}
    pools: Dict[Tuple[str, str], List[Unit]] = {}
    for unit in units:
        if unit.gsd_cm:
            pools.setdefault((unit.spectrum, unit.ground), []).append(unit)
        else:
            result[unit.key] = Target(None, 1.0, limits.gsd_trigger)
    for pool in pools.values():
        waiting = sorted(pool, key=lambda u: (u.gsd_cm or 0.0, u.key))
        best = _goal(waiting, wanted)
        while waiting:
            goal = _goal(waiting, wanted)
            later = [u for u in waiting if not asked and _too_large(u, _scale(u, goal), limits)]
            for unit in waiting:
                if unit not in later:
                    result[unit.key] = _settle(unit, goal, best, files, limits, asked)
            waiting = later
    return result


def _goal(pool: Sequence[Unit], wanted: Union[str, float]) -> float:
    if isinstance(wanted, float):
        return wanted
    return (pool[-1] if wanted == COARSEST else pool[0]).gsd_cm or 0.0


def _scale(unit: Unit, goal: float) -> float:
    return (unit.gsd_cm or goal) / goal


def _settle(
    unit: Unit, goal: float, best: float, files: Mapping[str, Frame], limits: Thresholds, asked: bool
) -> Target:
    """Scale the unit to ``goal`` where it is off by more than the trigger and nothing forbids it."""
    trigger = max(limits.gsd_trigger, limits.gsd_sigma_factor * unit.relative_sigma)
    scale = _scale(unit, goal)
    off = max(scale, 1.0 / scale) - 1.0 > trigger
    kept = _forbidden(unit, files, asked) if off else ""
    if off and not kept and asked:
        kept = _too_large(unit, scale, replace(limits, upsample_limit=math.inf, max_megapixels=math.inf))
    if off and not kept:
        return Target(goal, scale, trigger)
    return Target(best, 1.0, trigger, kept or _too_large(unit, _scale(unit, best), limits))
