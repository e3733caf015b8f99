"""Which flights can have seen the same ground, by position alone (pure)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from .frame import Frame
from .geo import distance_m, metres_per_degree
from .profile import CameraProfile, Flight
from .thresholds import Thresholds


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
            item = parent[item]
        return item

    for i, first in enumerate(ordered):
        for second in ordered[i + 1 :]:
            a, b = prints[first.id], prints[second.id]
            if a and b and gap_m(a, b) <= a.reach_m + b.reach_m:
                parent[root(second.id)] = root(first.id)
    placed = [f for f in ordered if prints[f.id]]
    roots = sorted({root(f.id) for f in placed})
    for flight in ordered:
        if prints[flight.id]:
            continue
        own = sorted({root(f.id) for f in placed if f.profile == flight.profile})
        if own:
            parent[flight.id] = own[0]
        elif len(roots) == 1:
            parent[flight.id] = roots[0]
        else:
            blind = next((f.id for f in ordered if not prints[f.id] and f.id != flight.id and root(f.id) == f.id), None)
            if blind and blind < flight.id:
                parent[flight.id] = blind
    weight: Dict[str, int] = {}
    for flight in ordered:
        weight[root(flight.id)] = weight.get(root(flight.id), 0) + len(flight.frames)
    rank: List[str] = sorted(weight, key=lambda r: (-weight[r], r))
    return {f.id: rank.index(root(f.id)) + 1 for f in ordered}
