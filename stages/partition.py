"""Why a set of payloads that aligns is still not one project: locks that exclude each other, models apart (pure)."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, List, Optional, Sequence, Set, Tuple

import numpy as np
import numpy.typing as npt

from .align.model import AlignRequest, LockDecision
from .align.solution import UNPLACED

Ints = npt.NDArray[np.int64]


def lock_sides(request: AlignRequest, decisions: Sequence[LockDecision]) -> Optional[Tuple[Set[str], Set[str]]]:
    """Return payloads that can be held beside those that cannot, where some must be; else ``None``.

    A lock is for all cameras of a project at once. A profile that must be held
    can share it with one whose own self-calibration the block supports: that
    is no guess, and may be held as well. With one that has neither a trusted
    source nor such support it cannot.
    """
    must = {d.profile for d in decisions if d.hold}
    cannot = {d.profile for d in decisions if not d.hold and not d.supported}
    if not must or not cannot:
        return None
    profiles: Dict[str, Set[str]] = {}
    for frame in request.frames:
        profiles.setdefault(frame.payload, set()).add(frame.profile)
    free = {p for p, own in profiles.items() if own & cannot}
    able = set(profiles) - free
    if not any(profiles[p] & must for p in able):
        return None
    return able, free


def held_together(decisions: Sequence[LockDecision]) -> Tuple[LockDecision, ...]:
    """The decisions of one project: where one must be held and all can be, all are."""
    if not any(d.hold for d in decisions) or not all(d.hold or d.supported for d in decisions):
        return tuple(decisions)
    why = "held at what the block solved: a camera beside it must be held, and a lock is for all"
    return tuple(d if d.hold else replace(d, hold=True, reason=f"{d.reason}; {why}") for d in decisions)


def why_apart(decisions: Sequence[LockDecision], payloads_held: bool) -> str:
    """Why a side of ``lock_sides`` stands alone, naming the profiles of the other."""
    if payloads_held:
        others = ", ".join(sorted(d.profile for d in decisions if not d.hold and not d.supported))
        return (
            f"its cameras must be held, and {others} has nothing that could be: a lock is for all cameras of a project"
        )
    others = ", ".join(sorted(d.profile for d in decisions if d.hold))
    return f"it has no calibration that could be held, and {others} must be: a lock is for all cameras of a project"


def stray_models(
    request: AlignRequest, models: Ints, areas: Sequence[int], least: int = 1
) -> Tuple[Tuple[str, ...], ...]:
    """Return the frames of each model of ``least`` frames or more that stands beside the main one of its ground.

    By position these frames could have joined it; no match does. What is in
    no model stays with the main one.
    """
    count: Dict[int, Dict[int, int]] = {}
    for model, area in zip(models.tolist(), areas):
        if model != UNPLACED:
            per = count.setdefault(max(area, 0), {})
            per[model] = per.get(model, 0) + 1
    main = {min(per, key=lambda m: (-per[m], m)) for per in count.values()}
    paths: Dict[int, List[str]] = {}
    for frame, model in zip(request.frames, models.tolist()):
        if model != UNPLACED and model not in main:
            paths.setdefault(model, []).append(frame.path)
    return tuple(tuple(sorted(paths[m])) for m in sorted(paths) if len(paths[m]) >= least)
