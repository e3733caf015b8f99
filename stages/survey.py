"""The survey: all frames placed with their cameras, captures, flights and payloads.

``build`` strings the pure stages together; its only I/O is the content check of
files that have equal sizes.
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from .areas import find_areas
from .captures import group_captures
from .flights import SURVEY, Height, find_flights, gsd_cm, height_above_ground
from .frame import BrokenFrame, Frame
from .grouping import Sighting, camera_name, clean_serial, group, slug
from .intrinsics import corrected_in_camera, find_row, resolve
from .profile import MULTISPECTRAL, RGB, THERMAL, CameraProfile, Flight, Payload, SurveyFrame
from .read import Scan
from .sensors import Sheet
from .spectrum import Spectrum, classify
from .thresholds import Thresholds


@dataclass(frozen=True)
class Survey:
    """Everything known of the input before any decision. Tuples are ordered by path or id."""

    files: Tuple[Frame, ...]
    frames: Tuple[SurveyFrame, ...]
    profiles: Tuple[CameraProfile, ...]
    flights: Tuple[Flight, ...]
    payloads: Tuple[Payload, ...]
    areas: Tuple[Tuple[str, int], ...] = ()
    broken: Tuple[BrokenFrame, ...] = ()
    ignored: Tuple[Tuple[str, int], ...] = ()

    def file_of(self) -> Dict[str, Frame]:
        """Path -> what its file says."""
        return {f.path: f for f in self.files}

    def profile_of(self) -> Dict[str, CameraProfile]:
        """Id -> profile."""
        return {p.id: p for p in self.profiles}

    def flight_of(self) -> Dict[str, Flight]:
        """Id -> flight."""
        return {f.id: f for f in self.flights}

    def area_of(self) -> Dict[str, int]:
        """Flight id -> number of the area it was flown over, 1 being the largest."""
        return dict(self.areas)


def same_content(frames: Sequence[Frame], open_path: Callable[[str], Path]) -> Dict[str, str]:
    """Path of a duplicate -> path of the file it repeats, byte for byte.

    Only files of equal size are read; the first by path is the original.
    """
    by_size: Dict[int, List[Frame]] = defaultdict(list)
    for frame in frames:
        by_size[frame.size_bytes].append(frame)
    repeats: Dict[str, str] = {}
    for members in by_size.values():
        if len(members) < 2:
            continue
        first_of: Dict[bytes, str] = {}
        for frame in sorted(members, key=lambda f: f.path):
            digest = hashlib.sha256()
            try:
                with open(open_path(frame.path), "rb") as stream:
                    for block in iter(lambda: stream.read(1 << 20), b""):
                        digest.update(block)
            except OSError:
                continue
            original = first_of.setdefault(digest.digest(), frame.path)
            if original != frame.path:
                repeats[frame.path] = original
    return repeats


def _rig_key(profile: CameraProfile) -> Tuple[str, str, str]:
    return (profile.make, profile.model, profile.serial)


def find_payloads(profiles: Sequence[CameraProfile], capture_of: Mapping[str, str]) -> Tuple[Payload, ...]:
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


def _captures(sights: Sequence[Sighting], kinds: Mapping[str, Spectrum], limits: Thresholds) -> Dict[str, str]:
    """Captures per make and model that has more than one band or lens; other frames are captures of their own."""
    bodies: Dict[Tuple[str, str], List[Sighting]] = defaultdict(list)
    for sight in sights:
        # Combined payloads name their modules differently (M3M, M3M-RGB); the body is the make and serial.
        key = clean_serial(sight.frame.serial) or sight.frame.model
        bodies[(sight.frame.make, key)].append(sight)
    result: Dict[str, str] = {}
    for members in bodies.values():
        band_of = {s.frame.path: f"{kinds[s.frame.path].band}/{s.frame.width}/{s.frame.image_source}" for s in members}
        if len(set(band_of.values())) > 1:
            result.update(group_captures([s.frame for s in members], band_of, limits))
        else:
            result.update({s.frame.path: s.frame.path for s in members})
    return result


def build(
    scan: Scan,
    sheet: Sheet,
    limits: Thresholds,
    *,
    ground_m: Optional[float] = None,
    open_path: Callable[[str], Path] = Path,
) -> Survey:
    """Place every frame of a scan. The same frames in any order give the same survey."""
    files = tuple(sorted(scan.frames, key=lambda f: f.path))
    repeats = same_content(files, open_path)
    unique = [f for f in files if f.path not in repeats]
    kinds = {f.path: classify(f, sheet) for f in files}
    sights = []
    for frame in unique:
        kind = kinds[frame.path]
        row = find_row(frame, kind.spectrum, sheet, kind.band)
        sights.append(
            Sighting(
                frame=frame,
                spectrum=kind.spectrum,
                band=kind.band,
                intrinsics=resolve(frame, kind.spectrum, sheet, limits, kind.band),
                corrected_in_camera=corrected_in_camera(frame, row),
                zoom_lens=bool(row is not None and row.zoom),
            )
        )
    intrinsics = {s.frame.path: s.intrinsics for s in sights}
    profiles = group(sights, limits)
    capture_of = _captures(sights, kinds, limits)
    payloads = find_payloads(profiles, capture_of)
    payload_of = {member: p.id for p in payloads for member in p.profiles}
    by_path = {f.path: f for f in files}
    heights: Dict[str, Height] = {f.path: height_above_ground(f, ground_m, limits) for f in files}
    placed: List[SurveyFrame] = []
    flights: List[Flight] = []
    for profile in profiles:
        own, role = find_flights(profile, by_path, heights, limits)
        flights.extend(own)
        for flight in own:
            for path in flight.frames:
                height = heights[path]
                placed.append(
                    SurveyFrame(
                        path=path,
                        profile=profile.id,
                        flight=flight.id,
                        payload=payload_of[profile.id],
                        capture=capture_of[path],
                        spectrum=kinds[path].spectrum,
                        band=kinds[path].band,
                        spectrum_evidence=kinds[path].evidence,
                        role=role[path],
                        intrinsics=intrinsics[path],
                        height_m=height.value_m,
                        height_source=height.source,
                        height_sigma_m=height.sigma_m,
                        gsd_cm=gsd_cm(intrinsics[path], height.value_m, by_path[path].width),
                        excluded=None if role[path] == SURVEY else f"{role[path]}-frame",
                    )
                )
    at = {f.path: f for f in placed}
    for path, original in repeats.items():
        placed.append(replace(at[original], path=path, role="duplicate", excluded="duplicate-file"))
    areas = find_areas(flights, {p.id: p for p in profiles}, by_path, limits)
    return Survey(
        files=files,
        frames=tuple(sorted(placed, key=lambda f: f.path)),
        profiles=profiles,
        flights=tuple(flights),
        payloads=payloads,
        areas=tuple(sorted(areas.items())),
        broken=tuple(sorted(scan.broken, key=lambda b: b.path)),
        ignored=tuple(sorted(scan.ignored.items())),
    )


__all__ = ["MULTISPECTRAL", "RGB", "THERMAL", "Survey", "build", "find_payloads", "same_content"]
