"""Which frames may share a project, as requests to the solver (pure).

Spectra never share one; all bands of one rig do, entered by their primary
band; frames over different places do not; two kinds of multispectral rig do
not, because ODM sorts bands by name over a whole project.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Set, Tuple

from .align.model import AlignCamera, AlignFrame, AlignRequest, GcpMark
from .captures import seconds
from .flights import PANEL, TRANSIT
from .frame import ELLIPSOID, Frame
from .gate import cut_short, gps_outliers, incomplete_captures, is_rtk_fixed, kept_bands, rig_kind
from .geo import median
from .harmonize.model import HarmonizedFrame
from .profile import MULTISPECTRAL, CameraProfile, Payload, SurveyFrame
from .survey import Survey
from .thresholds import Thresholds


@dataclass(frozen=True)
class Group:
    """Frames that may share one project: one spectrum, one area, and one kind of rig where there are bands.

    ``frames`` are all paths of the group, ``solver_frames`` those that the
    solver sees (the primary band), both sorted. ``lone_band`` names the band
    where the group is one that could not be laid on its rig's primary.
    """

    name: str
    spectrum: str
    area: int
    payloads: Tuple[str, ...]
    frames: Tuple[str, ...]
    solver_frames: Tuple[str, ...]
    lone_band: str = ""


def left_out(survey: Survey) -> Dict[str, str]:
    """Path -> finding code of survey frames that no project can take (cut files, incomplete captures, lost bands)."""
    out: Dict[str, str] = dict.fromkeys(cut_short(survey), "picture-cut-short")
    for payload in survey.payloads:
        if len(payload.profiles) > 1:
            kept = set(kept_bands(survey, payload))
            band = {f.path: f.band for f in survey.frames}
            for path in incomplete_captures(survey, payload):
                out[path] = "capture-incomplete" if band[path] in kept else "band-mostly-missing"
    return out


def primary_of(survey: Survey, payload: Payload) -> str:
    """The profile whose frames the solver sees: the payload's primary, or another where its band was given up."""
    profiles = survey.profile_of()
    kept = kept_bands(survey, payload) if len(payload.profiles) > 1 else payload.bands
    if profiles[payload.primary].band in kept:
        return payload.primary
    return next((p for p in payload.profiles if profiles[p].band in kept), payload.primary)


def groups_of(survey: Survey, refused: Optional[Mapping[str, Sequence[str]]] = None) -> Tuple[Group, ...]:
    """Cut the usable frames into groups, each a candidate for one project.

    ``refused`` is payload -> profiles of a rig that could not be laid on its
    primary: each becomes a group of its own, and the rig is of the kind that
    its other bands make.
    """
    refused = refused or {}
    dropped = left_out(survey)
    area = survey.area_of()
    profiles = survey.profile_of()
    payloads = {p.id: p for p in survey.payloads}
    primary = {p.id: primary_of(survey, p) for p in survey.payloads}
    rig_area: Dict[Tuple[str, str], int] = {}
    usable = [f for f in survey.frames if f.excluded is None and f.path not in dropped]
    for frame in usable:
        if frame.profile == primary[frame.payload]:
            rig_area[(frame.payload, frame.capture)] = area[frame.flight]
    members: Dict[Tuple[str, Tuple[str, ...], int], List[SurveyFrame]] = defaultdict(list)
    for frame in usable:
        payload = payloads[frame.payload]
        alone = refused.get(payload.id, ())
        kind: Tuple[str, ...] = ()
        if payload.spectrum == MULTISPECTRAL:
            make, model, bands = rig_kind(payload, survey)
            gone = {profiles[p].band for p in alone}
            kind = ("rig", make, model, *(b for b in bands if b not in gone))
            if frame.profile in alone:
                kind = ("single band", make, model, frame.band)
        place = rig_area.get((frame.payload, frame.capture), area[frame.flight])
        members[(payload.spectrum, kind, place)].append(frame)
    by_spectrum: Dict[str, int] = defaultdict(int)
    result: List[Group] = []
    for key in sorted(members, key=lambda k: (k[0], k[2], k[1])):
        spectrum, _, place = key
        by_spectrum[spectrum] += 1
        number = by_spectrum[spectrum]
        frames = members[key]
        lone = {f.profile for f in frames if f.profile in refused.get(f.payload, ())}
        result.append(
            Group(
                name=spectrum if number == 1 else f"{spectrum}-{number}",
                spectrum=spectrum,
                area=place,
                payloads=tuple(sorted({f.payload for f in frames})),
                frames=tuple(sorted(f.path for f in frames)),
                solver_frames=tuple(sorted(f.path for f in frames if f.profile in (primary[f.payload], *lone))),
                lone_band=frames[0].band if lone else "",
            )
        )
    return tuple(result)


def kin_of(survey: Survey, limits: Thresholds) -> Dict[str, str]:
    """Payload -> payload of the same camera in another picture size, for the solver to judge as one.

    A body that wrote a few frames of another size (scaled, not cut: same
    aspect and field of view) is one camera still; alone, those frames would be
    too few to prove anything.
    """
    single = {p.primary: p.id for p in survey.payloads if len(p.profiles) == 1}
    families: Dict[Tuple[str, str, str], List[CameraProfile]] = defaultdict(list)
    for profile in survey.profiles:
        if profile.id in single and profile.intrinsics.focal_ratio:
            families[(profile.family, profile.serial, profile.mode)].append(profile)
    kin: Dict[str, str] = {}
    for members in families.values():
        ordered = sorted(members, key=lambda p: (-len(p.frames), p.id))
        for profile in ordered[1:]:
            for main in ordered:
                if main is profile or single[main.id] in kin:
                    break
                aspect = profile.width * main.height / (profile.height * main.width)
                field = (profile.intrinsics.focal_ratio or 0.0) / (main.intrinsics.focal_ratio or 1.0)
                if abs(aspect - 1.0) <= limits.aspect_tolerance and abs(field - 1.0) <= limits.solved_focal_gap:
                    kin[single[profile.id]] = single[main.id]
                    break
    return kin


def gps_sigma_of(frame: Frame, limits: Thresholds) -> Tuple[float, float]:
    """Standard deviation of a frame's position, horizontal and vertical, m: RTK's own when fixed, else plain GPS."""
    if is_rtk_fixed(frame.rtk_flag) and frame.rtk_std_m is not None:
        lon, lat, up = frame.rtk_std_m
        floor = limits.rtk_sigma_floor_m
        return max(floor, (lon * lon + lat * lat) ** 0.5), max(floor, up)
    return limits.gps_sigma_horizontal_m, limits.gps_sigma_vertical_m


def level_of(frames: Sequence[str], survey: Survey, limits: Thresholds) -> Optional[Tuple[float, float]]:
    """How far the zero of these frames' altitudes lies above the elevation model's, m, and the spread of that.

    ``None`` where nothing says: only RTK altitudes count from one zero all
    along, and they must say that it is the ellipsoid's, as the model does, or
    a frame from the take-off must show it.
    """
    if survey.elevation is None:
        return None
    files, placed = survey.file_of(), {f.path: f for f in survey.frames}
    if not frames or not all(is_rtk_fixed(files[p].rtk_flag) for p in frames):
        return None
    above = all(files[p].altitude_zero == ELLIPSOID for p in frames)
    if above and "ellipsoid" in survey.elevation.vertical.lower():
        return 0.0, 0.0
    flights = {placed[p].flight for p in frames}
    shown: List[float] = []
    for where in survey.frames:
        file = files[where.path]
        near = file.relative_altitude_m is not None and abs(file.relative_altitude_m) <= limits.panel_height_m
        if not near or where.flight not in flights or where.role not in (PANEL, TRANSIT):
            continue
        if is_rtk_fixed(file.rtk_flag) and file.altitude_m is not None and where.ground_m is not None:
            shown.append(file.altitude_m - (file.relative_altitude_m or 0.0) - where.ground_m)
    if not shown or max(shown) - min(shown) > 2.0 * limits.takeoff_level_m:
        return None
    return round(median(shown), 3), limits.takeoff_level_m


def request_of(
    group: Group,
    survey: Survey,
    copies: Mapping[str, HarmonizedFrame],
    limits: Thresholds,
    marks: Sequence[GcpMark] = (),
    accuracies: Optional[Mapping[str, Tuple[float, float]]] = None,
) -> AlignRequest:
    """The solver's request for one group; ``copies`` says where each frame's pixels are and how large."""
    files = survey.file_of()
    profiles = survey.profile_of()
    placed = {f.path: f for f in survey.frames}
    wild = set(gps_outliers(survey, limits))
    kin = kin_of(survey, limits)
    frames: List[AlignFrame] = []
    shapes: Set[Tuple[str, int, int]] = set()
    for path in group.solver_frames:
        file, where, copy = files[path], placed[path], copies[path]
        position = None
        if file.has_gps and path not in wild and file.latitude is not None and file.longitude is not None:
            position = (file.latitude, file.longitude, file.altitude_m if file.altitude_m is not None else 0.0)
        sigma = (accuracies or {}).get(path) or gps_sigma_of(file, limits)
        shapes.add((where.profile, copy.width, copy.height))
        frames.append(
            AlignFrame(
                path=path,
                file=copy.file,
                width=copy.width,
                height=copy.height,
                profile=where.profile,
                flight=where.flight,
                payload=kin.get(where.payload, where.payload),
                capture=where.capture,
                time_s=seconds(file),
                position=position,
                sigma_m=sigma if position else None,
                height_m=where.height_m,
                height_sigma_m=where.height_sigma_m,
                yaw_deg=file.yaw_deg,
                pitch_deg=file.pitch_deg,
                rtk=is_rtk_fixed(file.rtk_flag),
            )
        )
    cameras = tuple(
        AlignCamera(
            profile=profile,
            width=width,
            height=height,
            intrinsics=profiles[profile].intrinsics,
            corrected_in_camera=profiles[profile].corrected_in_camera,
            focal_variance=profiles[profile].focal_variance,
        )
        for profile, width, height in sorted(shapes)
    )
    seen = set(group.solver_frames)
    return AlignRequest(
        group.name,
        tuple(frames),
        cameras,
        tuple(m for m in marks if m.path in seen),
        elevation=survey.elevation_file,
        elevation_level_m=level_of(group.solver_frames, survey, limits),
    )
