"""Which flights can have seen the same ground, by position alone (pure)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from .frame import Frame
from .geo import distance_m, metres_per_degree
from .profile import CameraProfile, Flight
from .thresholds import Thresholds

# A degree of latitude is nowhere shorter.
_LEAST_M_PER_DEGREE = 110_000.0


@dataclass(frozen=True)
class Footprint:
    """A flight's box of positions (south, west, north, east in degrees) and how far its frames may see beyond it."""

    box: Tuple[float, float, float, float]
    reach_m: float


def footprint_radius_m(profile: CameraProfile, height_m: Optional[float], limits: Thresholds) -> float:
    """Half the diagonal of a nadir footprint; a stated guess where height or focal are unknown."""
    ratio = profile.intrinsics.focal_ratio
    if height_m is None or height_m <= 0 or not ratio:
        return limits.unknown_footprint_m
    width = height_m / ratio
    return 0.5 * math.hypot(width, width * profile.height / profile.width)


def footprint(
    flight: Flight, profile: CameraProfile, files: Mapping[str, Frame], limits: Thresholds
) -> Optional[Footprint]:
    """Where a flight stood, wild positions left out; ``None`` without any GPS."""
    fixes = [
        (f.latitude, f.longitude)
        for f in (files[p] for p in flight.frames)
        if f.has_gps and f.latitude is not None and f.longitude is not None
    ]
    if not fixes:
        return None
    middle = (sorted(a for a, _ in fixes)[len(fixes) // 2], sorted(b for _, b in fixes)[len(fixes) // 2])
    kept = [p for p in fixes if distance_m(middle, p) <= limits.gps_outlier_m] or [middle]
    box = (min(a for a, _ in kept), min(b for _, b in kept), max(a for a, _ in kept), max(b for _, b in kept))
    reach = footprint_radius_m(profile, flight.height_m, limits)
    return Footprint(box, reach + limits.overlap_sigma_factor * limits.gps_sigma_horizontal_m)


def gap_m(a: Footprint, b: Footprint) -> float:
    """Distance between two boxes in metres, 0 where they touch or overlap."""
    north, east = metres_per_degree((a.box[0] + b.box[0]) / 2.0)
    d_north = max(0.0, a.box[0] - b.box[2], b.box[0] - a.box[2]) * north
    d_east = max(0.0, a.box[1] - b.box[3], b.box[1] - a.box[3]) * east
    return math.hypot(d_north, d_east)


def find_areas(
    flights: Sequence[Flight],
    profiles: Mapping[str, CameraProfile],
    files: Mapping[str, Frame],
    limits: Thresholds,
) -> Dict[str, int]:
    """Flight id -> area number. Areas are numbered from the one with most frames.

    Flights whose footprints can overlap are one area. A flight without GPS
    joins the area of its own profile, else the only area there is, else it is
    an area of its own.
    """
    prints = {f.id: footprint(f, profiles[f.profile], files, limits) for f in flights}
    ordered = sorted(flights, key=lambda f: f.id)
    parent = {f.id: f.id for f in ordered}

    def root(item: str) -> str:
        while parent[item] != item:
            parent[item] = parent[parent[item]]
            item = parent[item]
        return item

    def join(first: str, second: str) -> None:
        low, high = sorted((root(first), root(second)))
        parent[high] = low

    _join_overlapping({k: p for k, p in prints.items() if p is not None}, root, join)
    placed = [f for f in ordered if prints[f.id]]
    own: Dict[str, str] = {}
    for flight in placed:
        own[flight.profile] = min(root(flight.id), own.get(flight.profile, root(flight.id)))
    roots = {root(f.id) for f in placed}
    blind = [f for f in ordered if not prints[f.id]]
    homeless: List[str] = []
    for flight in blind:
        if flight.profile in own:
            parent[flight.id] = own[flight.profile]
        elif len(roots) == 1:
            parent[flight.id] = next(iter(roots))
        else:
            homeless.append(flight.id)
    for other in homeless[1:]:
        parent[other] = homeless[0]
    weight: Dict[str, int] = {}
    for flight in ordered:
        weight[root(flight.id)] = weight.get(root(flight.id), 0) + len(flight.frames)
    rank = {r: n for n, r in enumerate(sorted(weight, key=lambda r: (-weight[r], r)), start=1)}
    return {f.id: rank[root(f.id)] for f in ordered}


def _join_overlapping(
    prints: Mapping[str, Footprint], root: Callable[[str], str], join: Callable[[str, str], None]
) -> None:
    """Sweep from south to north and join what can overlap; only what still reaches this far north is compared."""
    most = max((p.reach_m for p in prints.values()), default=0.0)
    active: List[str] = []
    for name in sorted(prints, key=lambda k: (prints[k].box[0], k)):
        here = prints[name]
        active = [
            k for k in active if prints[k].box[2] + (prints[k].reach_m + most) / _LEAST_M_PER_DEGREE >= here.box[0]
        ]
        for other in active:
            if root(other) != root(name) and gap_m(prints[other], here) <= prints[other].reach_m + here.reach_m:
                join(other, name)
        active.append(name)
