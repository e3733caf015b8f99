"""What is resampled as one, and which of it sees the same ground (pure).

A unit is a profile's flight; the bands of one multispectral or thermal rig are
one unit per session, because frames of one capture must keep their relation.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from ..areas import find_areas
from ..frame import Frame
from ..geo import median
from ..profile import MULTISPECTRAL, RGB, THERMAL, CameraProfile, Flight, SurveyFrame
from ..thresholds import Thresholds

Key = Tuple[str, str]


@dataclass(frozen=True)
class Group:
    """The survey frames of one profile and flight, by path, with their medians."""

    profile: str
    flight: str
    spectrum: str
    band: str
    frames: Tuple[str, ...]
    width: int
    height: int
    gsd_cm: Optional[float]
    height_m: Optional[float]
    sigma_m: Optional[float]
    radiometry: Tuple[str, ...] = ()

    @property
    def key(self) -> Key:
        """Profile and flight."""
        return (self.profile, self.flight)

    def relative_sigma(self) -> float:
        """Standard deviation of the height over the height: that of the GSD."""
        if self.height_m is None or self.sigma_m is None or self.height_m <= 0:
            return 0.0
        return self.sigma_m / self.height_m


@dataclass(frozen=True)
class Unit:
    """Groups that share one scale. ``gsd_cm`` is that of the finest band."""

    spectrum: str
    ground: str
    groups: Tuple[Group, ...]
    gsd_cm: Optional[float]
    relative_sigma: float

    @property
    def key(self) -> Key:
        """Key of the first group: units sort by it."""
        return self.groups[0].key


def survey_groups(
    frames: Sequence[SurveyFrame], files: Mapping[str, Frame], flights: Sequence[Flight]
) -> Tuple[Group, ...]:
    """Group survey frames by profile and flight; other roles and excluded frames are left out."""
    members: Dict[Key, List[SurveyFrame]] = defaultdict(list)
    for frame in sorted(frames, key=lambda f: f.path):
        if frame.role == "survey" and frame.excluded is None and frame.path in files:
            members[(frame.profile, frame.flight)].append(frame)
    by_id = {f.id: f for f in flights}
    groups = []
    for key in sorted(members):
        part = members[key]
        flight = by_id.get(key[1])
        sizes = Counter((files[f.path].width, files[f.path].height) for f in part)
        size = min(sizes, key=lambda s: (-sizes[s], s))
        gsds = [f.gsd_cm for f in part if f.gsd_cm]
        heights = [f.height_m for f in part if f.height_m]
        sigmas = [f.height_sigma_m for f in part if f.height_sigma_m]
        groups.append(
            Group(
                profile=key[0],
                flight=key[1],
                spectrum=part[0].spectrum,
                band=part[0].band,
                frames=tuple(f.path for f in part),
                width=size[0],
                height=size[1],
                gsd_cm=median(gsds) if gsds else (flight.gsd_cm if flight else None),
                height_m=median(heights) if heights else (flight.height_m if flight else None),
                sigma_m=median(sigmas) if sigmas else (flight.height_sigma_m if flight else None),
                radiometry=tuple(sorted({tag for f in part for tag in files[f.path].radiometry})),
            )
        )
    return tuple(groups)


def grounds(
    groups: Sequence[Group],
    profiles: Sequence[CameraProfile],
    flights: Sequence[Flight],
    files: Mapping[str, Frame],
    limits: Thresholds,
) -> Dict[str, str]:
    """Flight id -> name of the ground it was flown over.

    By positions and footprints; flights without any position lie on the ground
    of the flights in their folder.
    """
    wanted = {g.flight for g in groups}
    by_profile = {p.id: p for p in profiles}
    known = [f for f in flights if f.id in wanted and f.profile in by_profile]
    placed = [f for f in known if any(files[p].has_gps for p in f.frames if p in files)]
    areas = find_areas(placed, by_profile, files, limits) if placed else {}
    result = {flight: f"area {number}" for flight, number in areas.items()}
    folder_of = {g.flight: _folder(g.frames[0]) for g in groups}
    ground_of_folder: Dict[str, str] = {}
    for group in sorted(groups, key=lambda g: (result.get(g.flight, "~"), g.flight)):
        if group.flight in result:
            ground_of_folder.setdefault(folder_of[group.flight], result[group.flight])
    for group in groups:
        if group.flight not in result:
            folder = folder_of[group.flight]
            result[group.flight] = ground_of_folder.get(folder, f"folder {folder}")
    return result


def _folder(path: str) -> str:
    return path.rpartition("/")[0]


def find_units(
    groups: Sequence[Group], ground_of: Mapping[str, str], frames: Sequence[SurveyFrame]
) -> Tuple[Unit, ...]:
    """Join the bands of a rig's session (one payload, shared captures); every other group stands alone."""
    parent = {g.key: g.key for g in groups}

    def root(key: Key) -> Key:
        while parent[key] != key:
            key = parent[key]
        return key

    first_of: Dict[Tuple[str, str], Key] = {}
    for frame in sorted(frames, key=lambda f: f.path):
        key = (frame.profile, frame.flight)
        if key in parent and frame.spectrum != RGB and frame.capture:
            other = first_of.setdefault((frame.payload, frame.capture), key)
            low, high = sorted((root(other), root(key)))
            parent[high] = low
    joined: Dict[Key, List[Group]] = defaultdict(list)
    for group in groups:
        joined[root(group.key)].append(group)
    units = []
    for key in sorted(joined):
        part = joined[key]
        known = [g for g in part if g.gsd_cm]
        finest = min(known, key=lambda g: (g.gsd_cm or 0.0, g.key)) if known else None
        spectra = {g.spectrum for g in part}
        units.append(
            Unit(
                spectrum=next((s for s in (MULTISPECTRAL, THERMAL, RGB) if s in spectra), part[0].spectrum),
                ground=ground_of[part[0].flight],
                groups=tuple(part),
                gsd_cm=finest.gsd_cm if finest else None,
                relative_sigma=finest.relative_sigma() if finest else 0.0,
            )
        )
    return tuple(units)
