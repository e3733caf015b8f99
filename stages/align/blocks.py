"""Parts of a request: sets of payloads over one ground, subsets, pairs to seek by likeness (pure)."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, List, Set, Tuple

from ..thresholds import Thresholds
from .model import AlignRequest
from .pairs import plan_pairs
from .solution import Retrieval


def blocks(request: AlignRequest, limits: Thresholds) -> Tuple[AlignRequest, ...]:
    """Cut a request into sets of payloads that share ground by position, the largest first (pure).

    A payload without any position could lie anywhere: it stays with the
    largest set.
    """
    areas = plan_pairs(request.frames, request.cameras, limits).areas
    payloads = sorted({f.payload for f in request.frames})
    over: Dict[str, Set[int]] = {p: set() for p in payloads}
    for frame, area in zip(request.frames, areas):
        if area >= 0:
            over[frame.payload].add(area)
    sets: List[Tuple[Set[str], Set[int]]] = []
    for payload in payloads:
        if not over[payload]:
            continue
        joined, ground = {payload}, set(over[payload])
        apart = []
        for names, places in sets:
            if places & ground:
                joined, ground = joined | names, ground | places
            else:
                apart.append((names, places))
        sets = [*apart, (joined, ground)]
    size = {p: sum(f.payload == p for f in request.frames) for p in payloads}
    ranked = sorted((names for names, _ in sets), key=lambda names: (-sum(size[p] for p in names), min(names)))
    lost = {p for p in payloads if not over[p]}
    if not ranked:
        ranked = [set()]
    ranked[0] = ranked[0] | lost
    return tuple(subset(request, names) for names in ranked)


def subset(request: AlignRequest, payloads: Set[str]) -> AlignRequest:
    """Return the part of a request that belongs to ``payloads``, under the same name (pure)."""
    return of_frames(request, {f.path for f in request.frames if f.payload in payloads})


def of_frames(request: AlignRequest, paths: Set[str]) -> AlignRequest:
    """Return the part of a request that these frames make, under the same name (pure)."""
    frames = tuple(f for f in request.frames if f.path in paths)
    shapes = {(f.profile, f.width, f.height) for f in frames}
    return replace(
        request,
        frames=frames,
        cameras=tuple(c for c in request.cameras if (c.profile, c.width, c.height) in shapes),
        gcps=tuple(g for g in request.gcps if g.path in paths),
    )


def likeness(request: AlignRequest, payload: str, limits: Thresholds) -> Retrieval:
    """Pairs to find by likeness between a payload and the others of a sorted request (pure)."""
    left = tuple(i for i, f in enumerate(request.frames) if f.payload == payload)
    right = tuple(i for i, f in enumerate(request.frames) if f.payload != payload)
    return Retrieval(left, right, limits.retrieval_pairs)
