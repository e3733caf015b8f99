"""The survey: all frames placed with their cameras, captures, flights and payloads.

``build`` strings the pure stages together; its only I/O is the content check of
files that have equal sizes.
"""

from __future__ import annotations

import functools
import hashlib
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Dict, Hashable, List, Mapping, Optional, Sequence, Tuple

from .areas import find_areas
from .calibrations import Entry, Key, with_stored
from .captures import find_bodies, group_captures
from .elevation import Elevation, ElevationSource
from .flights import (
    SURVEY,
    Height,
    find_flights,
    find_sessions,
    gsd_cm,
    height_above_ground,
    one_role_per_capture,
    roles,
)
from .frame import BrokenFrame, Frame
from .grouping import Sighting, camera_name, clean_serial, group, slug
from .intrinsics import Intrinsics, corrected_in_camera, find_row, resolve
from .profile import MULTISPECTRAL, RGB, THERMAL, CameraProfile, Flight, Payload, SurveyFrame
from .read import Scan
from .relief import Ground, over_relief
from .sensors import Sheet, SheetRow
from .spectrum import Spectrum, classify
from .thresholds import Thresholds

_SAMPLE_BYTES = 65536


@dataclass(frozen=True)
class Survey:
    """Everything known of the input before any decision. Tuples are ordered by path or id.

    ``elevation_file`` is where the elevation model lies, ``""`` without one.
    """

    files: Tuple[Frame, ...]
    frames: Tuple[SurveyFrame, ...]
    profiles: Tuple[CameraProfile, ...]
    flights: Tuple[Flight, ...]
    payloads: Tuple[Payload, ...]
    areas: Tuple[Tuple[str, int], ...] = ()
    broken: Tuple[BrokenFrame, ...] = ()
    ignored: Tuple[Tuple[str, int], ...] = ()
    elevation: Optional[ElevationSource] = None
    elevation_file: str = ""

    @functools.cached_property
    def _file_of(self) -> Dict[str, Frame]:
        return {f.path: f for f in self.files}

    @functools.cached_property
    def _profile_of(self) -> Dict[str, CameraProfile]:
        return {p.id: p for p in self.profiles}

    @functools.cached_property
    def usable(self) -> Tuple[SurveyFrame, ...]:
        """The frames that are survey and not left out, by path."""
        return tuple(f for f in self.frames if f.excluded is None)

    @functools.cached_property
    def _usable_of(self) -> Dict[str, List[SurveyFrame]]:
        result: Dict[str, List[SurveyFrame]] = defaultdict(list)
        for frame in self.usable:
            result[frame.payload].append(frame)
        return dict(result)

    def usable_of(self, payload: str) -> Sequence[SurveyFrame]:
        """The usable frames of one payload, by path."""
        return self._usable_of.get(payload, ())

    def file_of(self) -> Dict[str, Frame]:
        """Path -> what its file says."""
        return self._file_of

    def profile_of(self) -> Dict[str, CameraProfile]:
        """Id -> profile."""
        return self._profile_of

    def area_of(self) -> Dict[str, int]:
        """Flight id -> number of the area it was flown over, 1 being the largest."""
        return dict(self.areas)


def _digest(file: Path, offset: int, length: int) -> bytes:
    """SHA-256 of a part of a file, ``b""`` where it cannot be read."""
    digest = hashlib.sha256()
    try:
        with open(file, "rb") as stream:
            stream.seek(offset)
            while length > 0:
                block = stream.read(min(length, 1 << 20))
                if not block:
                    break
                digest.update(block)
                length -= len(block)
    except OSError:
        return b""
    return digest.digest()


def same_content(frames: Sequence[Frame], open_path: Callable[[str], Path]) -> Dict[str, str]:
    """Path of a duplicate -> path of the file it repeats, byte for byte.

    Equal bytes say equal things of themselves, so only files of equal size and
    metadata are read, and whole only where their middles agree; the first by
    path is the original.
    """
    alike: Dict[Hashable, List[Frame]] = defaultdict(list)
    for frame in sorted(frames, key=lambda f: f.path):
        alike[(frame.size_bytes, frame.time, frame.capture_id, frame.bands, frame.exposure_s, frame.iso)].append(frame)
    repeats: Dict[str, str] = {}
    for members in alike.values():
        if len(members) < 2:
            continue
        size = members[0].size_bytes
        middles: Dict[bytes, List[str]] = defaultdict(list)
        for frame in members:
            start = max(0, size // 2 - _SAMPLE_BYTES // 2)
            middles[_digest(open_path(frame.path), start, _SAMPLE_BYTES)].append(frame.path)
        for middle, paths in middles.items():
            if not middle or len(paths) < 2:
                continue
            first_of: Dict[bytes, str] = {}
            for path in paths:
                whole = _digest(open_path(path), 0, size)
                if whole and first_of.setdefault(whole, path) != path:
                    repeats[path] = first_of[whole]
    return repeats


def _rig_key(profile: CameraProfile) -> Tuple[str, str, str]:
    return (profile.make, profile.model, profile.serial)


def find_payloads(profiles: Sequence[CameraProfile]) -> Tuple[Payload, ...]:
    """Payloads: single cameras, and rigs made of the bands that share captures.

    The bands of one multispectral body are one payload, its long-wave band
    included; its RGB camera is another. A band set that never shares a capture
    is still one body's and stays together by make, model and serial. The
    primary is green, then the band with most frames, as ODM prefers.
    """
    rigs: Dict[Tuple[str, str, str], List[CameraProfile]] = defaultdict(list)
    rest: List[CameraProfile] = []
    multi = {_rig_key(p) for p in profiles if p.spectrum == MULTISPECTRAL}
    for profile in profiles:
        if profile.spectrum == MULTISPECTRAL or (profile.spectrum == THERMAL and _rig_key(profile) in multi):
            rigs[_rig_key(profile)].append(profile)
        else:
            rest.append(profile)
    payloads = [Payload(p.id, p.spectrum, (p.id,), p.id, (p.band,)) for p in rest]
    many = Counter((make, model) for make, model, _ in rigs)
    for (make, model, serial), members in sorted(rigs.items()):
        ordered = sorted(members, key=lambda p: p.id)
        preferred = [p for p in ordered if p.band == "green"] or [p for p in ordered if p.band == "blue"] or ordered
        primary = max(preferred, key=lambda p: (p.spectrum == MULTISPECTRAL, len(p.frames)))
        name = slug(camera_name(make, model))
        if many[(make, model)] > 1 and serial:
            name += f"@sn{slug(serial)}"
        payloads.append(
            Payload(
                id=f"{name}/rig" if len(ordered) > 1 else ordered[0].id,
                spectrum=MULTISPECTRAL,
                profiles=tuple(p.id for p in ordered),
                primary=primary.id,
                bands=tuple(sorted({p.band for p in ordered})),
            )
        )
    return tuple(sorted(payloads, key=lambda p: p.id))


class _RememberingSheet(Sheet):
    """A sheet that answers the same question once: all frames of a camera ask it."""

    @functools.cached_property
    def _answers(self) -> Dict[Hashable, Tuple[SheetRow, ...]]:
        return {}

    def candidates(self, *asked: Any, **named: Any) -> Tuple[SheetRow, ...]:
        """As ``Sheet.candidates``."""
        key = (asked, tuple(named.items()))
        if key not in self._answers:
            self._answers[key] = super().candidates(*asked, **named)
        return self._answers[key]


def _captures(sights: Sequence[Sighting], kinds: Mapping[str, Spectrum], limits: Thresholds) -> Dict[str, str]:
    """Captures per body that has more than one band or lens; other frames are captures of their own."""
    result: Dict[str, str] = {}
    frames = [s.frame for s in sights]
    for members in find_bodies(frames, {f.path: clean_serial(f.serial) for f in frames}):
        band_of = {f.path: f"{kinds[f.path].band}/{f.width}/{f.image_source}" for f in members}
        if len(set(band_of.values())) > 1:
            result.update(group_captures(members, band_of, limits))
        else:
            result.update({f.path: f.path for f in members})
    return result


def _roles(
    sessions: Mapping[str, Sequence[Sequence[Frame]]],
    profiles: Sequence[CameraProfile],
    payloads: Sequence[Payload],
    capture_of: Mapping[str, str],
    heights: Mapping[str, Height],
    limits: Thresholds,
) -> Dict[str, str]:
    """The role of every frame; all bands of a rig's capture have one."""
    role: Dict[str, str] = {}
    for profile in profiles:
        for session in sessions[profile.id]:
            role.update(roles(session, heights, limits, rig=profile.spectrum == MULTISPECTRAL))
    frames_of = {p.id: p.frames for p in profiles}
    for payload in payloads:
        if len(payload.profiles) > 1:
            captures: Dict[str, List[str]] = defaultdict(list)
            for member in payload.profiles:
                for path in frames_of[member]:
                    captures[capture_of[path]].append(path)
            primary = {capture_of[path]: path for path in frames_of[payload.primary]}
            role = one_role_per_capture(role, captures, primary)
    return role


def _ground(files: Sequence[Frame], elevation: Optional[Elevation], limits: Thresholds) -> Optional[Ground]:
    """The ground under every frame with a position, read in one go."""
    if elevation is None:
        return None
    at = {f.path: (f.latitude, f.longitude) for f in files if f.latitude is not None and f.longitude is not None}
    points = {f.path: (lat or 0.0, lon or 0.0) for f in files if f.has_gps for lat, lon in [at[f.path]]}
    told = {path: m for path, m in zip(points, elevation.sample(list(points.values()))) if m is not None}
    inside = sorted(points[path] for path in told)
    spacing = elevation.spacing_m(inside[len(inside) // 2]) if inside else None
    return Ground(told, max(limits.dem_sigma_floor_m, limits.dem_sigma_share * (spacing or 0.0)))


def _heights(
    files: Sequence[Frame], ground_m: Optional[float], ground: Optional[Ground], limits: Thresholds
) -> Dict[str, Height]:
    if ground is None:
        return {f.path: height_above_ground(f, ground_m, limits) for f in files}
    sigma = ground.sigma_m
    return {
        f.path: height_above_ground(f, ground.under.get(f.path), limits, source="dem", ground_sigma_m=sigma)
        for f in files
    }


def _relief_m(flight: Flight, role: Mapping[str, str], ground: Optional[Ground]) -> Optional[float]:
    under = [ground.under[p] for p in flight.frames if role[p] == SURVEY and p in ground.under] if ground else []
    return max(under) - min(under) if under else None


def build(
    scan: Scan,
    sheet: Sheet,
    limits: Thresholds,
    *,
    ground_m: Optional[float] = None,
    elevation: Optional[Elevation] = None,
    stored: Optional[Mapping[Key, Entry]] = None,
    open_path: Callable[[str], Path] = Path,
) -> Survey:
    """Place every frame of a scan. The same frames in any order give the same survey.

    The ground is ``ground_m`` everywhere, or what ``elevation`` says under each frame.
    ``stored`` are calibrations that earlier surveys proved.
    """
    files = tuple(sorted(scan.frames, key=lambda f: f.path))
    sheet = _RememberingSheet(sheet.rows, sheet.thresholds)
    repeats = same_content(files, open_path)
    unique = [f for f in files if f.path not in repeats]
    kinds = {f.path: classify(f, sheet) for f in files}
    known: Dict[Intrinsics, Intrinsics] = {}
    sights = []
    for frame in unique:
        kind = kinds[frame.path]
        row = find_row(frame, kind.spectrum, sheet, kind.band)
        intrinsics = resolve(frame, kind.spectrum, sheet, limits, kind.band)
        sights.append(
            Sighting(
                frame=frame,
                spectrum=kind.spectrum,
                band=kind.band,
                intrinsics=known.setdefault(intrinsics, intrinsics),
                corrected_in_camera=corrected_in_camera(frame, row),
                zoom_lens=bool(row is not None and row.zoom),
            )
        )
    intrinsics_of = {s.frame.path: s.intrinsics for s in sights}
    profiles = group(sights, limits)
    if stored:
        profiles, intrinsics_of = with_stored(profiles, intrinsics_of, stored, limits)
    capture_of = _captures(sights, kinds, limits)
    payloads = find_payloads(profiles)
    payload_of = {member: p.id for p in payloads for member in p.profiles}
    by_path = {f.path: f for f in files}
    ground = _ground(files, elevation, limits)
    heights = _heights(files, ground_m, ground, limits)
    sessions = {p.id: find_sessions(p, by_path, limits) for p in profiles}
    role = _roles(sessions, profiles, payloads, capture_of, heights, limits)
    if ground is not None:
        for of_profile in sessions.values():
            for session in of_profile:
                heights.update(over_relief(session, role, heights, ground, limits))
    placed: Dict[str, SurveyFrame] = {}
    flights: List[Flight] = []
    for profile in profiles:
        own = find_flights(profile, sessions[profile.id], role, heights, limits)
        own = tuple(replace(f, relief_m=_relief_m(f, role, ground)) for f in own)
        flights.extend(own)
        for flight in own:
            for path in flight.frames:
                height = heights[path]
                placed[path] = SurveyFrame(
                    path=path,
                    profile=profile.id,
                    flight=flight.id,
                    payload=payload_of[profile.id],
                    capture=capture_of[path],
                    spectrum=kinds[path].spectrum,
                    band=kinds[path].band,
                    spectrum_evidence=kinds[path].evidence,
                    role=role[path],
                    intrinsics=intrinsics_of[path],
                    height_m=height.value_m,
                    height_source=height.source,
                    height_sigma_m=height.sigma_m,
                    gsd_cm=gsd_cm(intrinsics_of[path], height.value_m, by_path[path].width),
                    excluded=None if role[path] == SURVEY else f"{role[path]}-frame",
                    ground_m=ground.under.get(path) if ground is not None else None,
                )
    for path, original in repeats.items():
        placed[path] = replace(placed[original], path=path, role="duplicate", excluded="duplicate-file")
    areas = find_areas(flights, {p.id: p for p in profiles}, by_path, limits)
    return Survey(
        files=files,
        frames=tuple(placed[f.path] for f in files),
        profiles=profiles,
        flights=tuple(flights),
        payloads=payloads,
        areas=tuple(sorted(areas.items())),
        broken=tuple(sorted(scan.broken, key=lambda b: b.path)),
        ignored=tuple(sorted(scan.ignored.items())),
        elevation=elevation.source if elevation is not None else None,
        elevation_file=str(elevation.file) if elevation is not None else "",
    )


__all__ = ["MULTISPECTRAL", "RGB", "THERMAL", "Survey", "build", "find_payloads", "same_content"]
