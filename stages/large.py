"""A large block's proof from samples of it: what was proven of a patch holds for the frames around it."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from .align.enu import local_frame
from .align.model import AlignFrame, AlignmentReport, AlignRequest
from .align.sample import Sample, samples
from .ladder import Ladder
from .proven import PAIRWISE, PROCEED, ROUTES, ProvenGroup
from .thresholds import Thresholds


def climb_sampled(ladder: Ladder, block: AlignRequest, limits: Thresholds) -> List[ProvenGroup]:
    """Prove a block of any size; beyond ``sample_above`` frames by samples, then every frame joins its sample's group.

    A payload that the first sample does not see is tied on through a payload
    that it meets elsewhere.
    """
    parts = samples(block, limits)
    groups = ladder.climb(parts[0].request, PROCEED)
    for part in parts[1:]:
        groups = tied(groups, ladder.climb(part.request, PROCEED), part)
    seen = sum(len(g.frames) for g in groups)
    return groups if seen == len(block.frames) else expanded(block, groups)


def tied(groups: Sequence[ProvenGroup], found: Sequence[ProvenGroup], part: Sample) -> List[ProvenGroup]:
    """Join what a further sample proved to the groups before it (pure).

    ``part.joins`` is the payload in question. Where it stands with its partner,
    it enters the partner's group; else it is a group of its own. The partner's
    frames stay where they are.
    """
    if not part.joins:
        return [*groups, *found]
    own = {f.path for f in part.request.frames if f.payload == part.joins}
    result = list(groups)
    for group in found:
        frames = tuple(p for p in group.frames if p in own)
        if not frames:
            continue
        partners = [p for p in group.payloads if p != part.joins]
        home = next((i for i, g in enumerate(result) if set(partners) & set(g.payloads)), None)
        if home is None or group.route not in (PROCEED, PAIRWISE):
            reasons = group.reasons if not partners else (f"sampled with {', '.join(partners)}", *group.reasons)
            result.append(replace(group, payloads=(part.joins,), frames=frames, reasons=reasons))
        else:
            result[home] = _merged(result[home], group, part.joins, frames)
    return result


def _merged(target: ProvenGroup, group: ProvenGroup, payload: str, frames: Sequence[str]) -> ProvenGroup:
    solved = {d.profile for d in target.locked}
    partners = ", ".join(p for p in group.payloads if p != payload)
    return replace(
        target,
        payloads=tuple(sorted({*target.payloads, payload})),
        frames=tuple(sorted({*target.frames, *frames})),
        route=max(target.route, group.route, key=ROUTES.index),
        reasons=(
            *target.reasons,
            f"{payload} was tied on where it meets {partners}",
            *(r for r in group.reasons if r.startswith(f"{payload}:")),
        ),
        alignment=_joint(target.alignment, group.alignment, payload, set(frames)),
        locked=(*target.locked, *(d for d in group.locked if d.profile not in solved)),
    )


def _joint(
    first: Optional[AlignmentReport], second: Optional[AlignmentReport], payload: str, frames: "set[str]"
) -> Optional[AlignmentReport]:
    """The first report with what the second one says of a payload and its frames."""
    if first is None or second is None:
        return first
    known = {c.profile for c in first.cameras}
    more = tuple(f for f in second.frames if f.path in frames)
    return replace(
        first,
        frames=tuple(sorted((*first.frames, *more), key=lambda f: f.path)),
        registered=first.registered + sum(f.registered for f in more),
        payloads=(*first.payloads, *(p for p in second.payloads if p.payload == payload)),
        cameras=(*first.cameras, *(c for c in second.cameras if c.profile not in known)),
        candidates=(*first.candidates, *(c for c in second.candidates if c.profile not in known)),
        decisions=(*first.decisions, *(d for d in second.decisions if d.profile not in known)),
        pairs=tuple(sorted({*first.pairs, *second.pairs}, key=lambda p: (p.a, p.b))),
        pairs_tried=first.pairs_tried + second.pairs_tried,
    )


def expanded(block: AlignRequest, groups: Sequence[ProvenGroup]) -> List[ProvenGroup]:
    """Give every frame of the block to the group of the nearest sampled frame of its payload and flight (pure)."""
    home = {path: i for i, g in enumerate(groups) for path in g.frames}
    members: List[List[str]] = [list(g.frames) for g in groups]
    by_payload: Dict[str, List[AlignFrame]] = {}
    for frame in block.frames:
        by_payload.setdefault(frame.payload, []).append(frame)
    for payload in sorted(by_payload):
        frames = by_payload[payload]
        sampled = [f for f in frames if f.path in home]
        homes = sorted({home[f.path] for f in sampled})
        for frame in (f for f in frames if f.path not in home):
            flown = [f for f in sampled if f.flight == frame.flight] or sampled
            where = homes[0] if len(homes) == 1 else home[_nearest(frame, flown).path]
            members[where].append(frame.path)
    result = []
    for group, paths in zip(groups, members):
        told = f"judged by a sample: {len(group.frames):,} of {len(paths):,} frames"
        reasons = group.reasons if len(paths) == len(group.frames) else (told, *group.reasons)
        result.append(replace(group, frames=tuple(sorted(paths)), reasons=reasons))
    return result


def _nearest(frame: AlignFrame, sampled: Sequence[AlignFrame]) -> AlignFrame:
    """The sampled frame that was taken next to this one: by place, without places by time."""
    placed = [f for f in sampled if f.position is not None]
    if frame.position is None or not placed:
        moment = frame.time_s or 0.0
        return min(sampled, key=lambda f: (abs((f.time_s or 0.0) - moment), f.path))
    spots = local_frame([frame.position, *(f.position for f in placed if f.position is not None)])
    away = np.hypot(spots[1:, 0] - spots[0, 0], spots[1:, 1] - spots[0, 1])
    order: List[Tuple[float, str, AlignFrame]] = [(round(float(a), 3), f.path, f) for a, f in zip(away, placed)]
    return min(order, key=lambda o: o[:2])[2]
