"""What harmonizing will do, decided before any pixel moves (pure).

One scale per profile and flight, never per frame; one colour table per profile,
flight and channel; one focal tag per profile. Every action says why.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, Iterator, List, Mapping, Optional, Sequence, Set, Tuple, Union

from ..finding import ERROR, INFO, WARNING, Finding, sort_key
from ..frame import Frame
from ..geo import median
from ..profile import RGB, CameraProfile, Flight, SurveyFrame
from ..thresholds import Thresholds
from .gains import gains_of
from .model import FlightAction, Gain, HarmonizePlan, Lut
from .targets import FINEST, Target, choose, rewritable, taggable
from .units import Group, Key, Unit, find_units, grounds, survey_groups


@dataclass(frozen=True)
class FocalTags:
    """The one focal tag of a profile's copies; ``None`` where the frames already agree."""

    focal_mm: Optional[float] = None
    focal_35mm: Optional[float] = None


def plan(
    frames: Sequence[SurveyFrame],
    files: Mapping[str, Frame],
    profiles: Sequence[CameraProfile],
    flights: Sequence[Flight],
    thresholds: Thresholds,
    *,
    gsd_target: Union[str, float] = FINEST,
    luts: Sequence[Lut] = (),
) -> Tuple[HarmonizePlan, Tuple[Finding, ...]]:
    """Plan scale, colour table and focal tag of every profile and flight.

    ``gsd_target`` is ``finest`` (coarse flights are resampled to the finest of
    their spectrum and ground, within the limits of size), ``coarsest``, or
    centimetres; the latter two are asked for, so they lift those limits and
    the protection of raw multispectral frames. Raises ``UsageError`` for
    another ``gsd_target``.
    """
    groups = survey_groups(frames, files, flights)
    ground_of = grounds(groups, profiles, flights, files, thresholds)
    units = find_units(groups, ground_of, frames)
    targets = choose(units, files, thresholds, gsd_target)
    by_id = {p.id: p for p in profiles}
    tags = {p: _focal_tags(members, files) for p, members in _by_profile(groups).items()}
    planes = _sensor_widths(frames, by_id, files)
    tables = {lut.id: lut for lut in luts}
    sizes = _out_sizes(units, targets, by_id, thresholds)
    gains = gains_of(units, targets, sizes, files, thresholds)
    actions: List[FlightAction] = []
    findings: List[Finding] = []
    for unit in units:
        target = targets[unit.key]
        for group in unit.groups:
            action = _action(group, unit, target, sizes[group.key], tags[group.profile], tables, files)
            width_mm = planes.get(group.profile)
            if width_mm is not None:
                said = f"stale or empty focal-plane tags: the copies say a sensor width of {width_mm:.2f} mm"
                action = replace(action, sensor_width_mm=width_mm, reasons=(*action.reasons, said))
            actions.append(action)
        findings.extend(_unit_findings(unit, target, sizes, gains))
    findings.extend(_unknown(units, targets))
    actions.sort(key=lambda a: (a.profile, a.flight))
    used = {a.lut for a in actions}
    kept = tuple(sorted((t for t in tables.values() if t.id in used), key=lambda t: t.id))
    return HarmonizePlan(tuple(actions), kept, gains), tuple(sorted(findings, key=sort_key))


def has_empty_plane(frame: Frame) -> bool:
    """Whether a focal-plane resolution is written as 0/0: readers that divide by it die."""
    return any(p.startswith("focal-plane-rational-zero") for p in frame.problems)


def _sensor_widths(
    frames: Sequence[SurveyFrame], profiles: Mapping[str, CameraProfile], files: Mapping[str, Frame]
) -> Dict[str, float]:
    """Profile -> the true sensor width in mm, for profiles with frames whose focal-plane tags are stale or 0/0."""
    stale = {f.profile for f in frames if any(n.startswith("stale-focal-plane") for n in f.intrinsics.notes)}
    stale |= {f.profile for f in frames if f.path in files and has_empty_plane(files[f.path])}
    widths: Dict[str, float] = {}
    for name in sorted(stale & set(profiles)):
        known = profiles[name].intrinsics
        if known.sensor_width_mm is not None:
            widths[name] = known.sensor_width_mm
        elif known.focal_mm is not None and known.focal_ratio:
            widths[name] = known.focal_mm / known.focal_ratio
    return widths


def lut_id(profile: str, flight: str) -> str:
    """Name of the table of one profile and flight."""
    return f"{profile}|{flight}"


def scaled_size(width: int, height: int, scale: float) -> Tuple[int, int]:
    """Width rounded, and the height that keeps the shape of that width best."""
    wide = max(1, round(width * scale))
    return wide, max(1, round(height * wide / width))


def _by_profile(groups: Sequence[Group]) -> Dict[str, List[Group]]:
    result: Dict[str, List[Group]] = {}
    for group in groups:
        result.setdefault(group.profile, []).append(group)
    return result


def _focal_tags(groups: Sequence[Group], files: Mapping[str, Frame]) -> FocalTags:
    """Return the profile's median of each tag that its frames do not agree on.

    A tag that some frames lack is a disagreement too: the camera identity that
    is made from it would differ.
    """
    frames = [files[p] for g in groups for p in g.frames]
    if not all(taggable(f) for f in frames):
        return FocalTags()
    return FocalTags(_agreed([f.focal_mm for f in frames]), _agreed([f.focal_35mm for f in frames]))


def _agreed(values: Sequence[Optional[float]]) -> Optional[float]:
    known = [v for v in values if v is not None and v > 0]
    if not known or (len(set(known)) == 1 and len(known) == len(values)):
        return None
    return median(known)


def _out_sizes(
    units: Sequence[Unit], targets: Mapping[Key, Target], profiles: Mapping[str, CameraProfile], limits: Thresholds
) -> Dict[Key, Tuple[int, int]]:
    """Group key -> size written: exact scale, or the size that the same camera has elsewhere if that is near."""
    sizes: Dict[Key, Tuple[int, int]] = {}
    kept: Dict[Tuple[str, str], Set[Tuple[int, int]]] = {}
    for unit in units:
        for group in unit.groups:
            if targets[unit.key].scale == 1.0 and group.profile in profiles:
                profile = profiles[group.profile]
                kept.setdefault((profile.family, profile.serial), set()).add((group.width, group.height))
    for unit in units:
        scale = targets[unit.key].scale
        for group in unit.groups:
            size = scaled_size(group.width, group.height, scale)
            if scale != 1.0 and len(unit.groups) == 1 and group.profile in profiles:
                profile = profiles[group.profile]
                for other in sorted(kept.get((profile.family, profile.serial), ())):
                    shape = other[0] * group.height / (other[1] * group.width)
                    if (
                        abs(shape - 1.0) <= limits.aspect_tolerance
                        and abs(other[0] / size[0] - 1.0) <= limits.size_snap
                    ):
                        size = other
                        break
            sizes[group.key] = size
    return sizes


def _action(
    group: Group,
    unit: Unit,
    target: Target,
    size: Tuple[int, int],
    tags: FocalTags,
    tables: Mapping[str, Lut],
    files: Mapping[str, Frame],
) -> FlightAction:
    reasons: List[str] = []
    scale = 1.0 if target.scale == 1.0 else size[0] / group.width
    if scale != 1.0:
        off = _percent(target.difference(unit.gsd_cm))
        reasons.append(f"{unit.gsd_cm:.2f} cm is {off} from the target of {target.gsd_cm:.2f} cm")
    elif target.kept:
        reasons.append(f"pixels kept: {target.kept}")
    elif target.gsd_cm is None:
        reasons.append("pixels kept: ground resolution unknown")
    else:
        reasons.append("pixels kept: within the trigger of the target")
    lut = tables.get(lut_id(group.profile, group.flight))
    write_lut = False
    if lut is not None:
        writable = [rewritable(files[p]) or ("" if files[p].bits == 8 else "not 8 bits") for p in group.frames]
        write_lut = group.spectrum == RGB and not any(writable)
        worst = max((abs(o) for o in lut.offset_dn), default=0.0)
        where = "written into the copies" if write_lut else "for the alignment only"
        reasons.append(f"colours {worst:.0f} DN off the reference: one table per channel, {where}")
    if tags.focal_mm is not None or tags.focal_35mm is not None:
        reasons.append("focal tags of the profile differ: the copies carry their median")
    return FlightAction(
        profile=group.profile,
        flight=group.flight,
        frames=group.frames,
        gsd_cm=group.gsd_cm,
        target_gsd_cm=target.gsd_cm,
        scale=scale,
        width=group.width,
        height=group.height,
        out_width=size[0],
        out_height=size[1],
        lut=lut.id if lut is not None else None,
        write_lut=write_lut,
        focal_mm=tags.focal_mm,
        focal_35mm=tags.focal_35mm,
        reasons=tuple(reasons),
        radiometric_none=scale != 1.0 and bool(group.radiometry),
    )


def _percent(ratio: Optional[float]) -> str:
    return "?" if ratio is None else f"{100.0 * ratio:.0f} %"


def _unit_findings(
    unit: Unit, target: Target, sizes: Mapping[Key, Tuple[int, int]], gains: Sequence[Gain]
) -> Iterator[Finding]:
    """Say of one unit whether it is resampled, or why not although it should be."""
    off = target.difference(unit.gsd_cm)
    subjects = tuple(sorted({g.flight for g in unit.groups}))
    if off is None or off <= target.trigger or (target.scale == 1.0 and not target.kept):
        return
    frames = sum(len(g.frames) for g in unit.groups)
    gsds = f"{unit.gsd_cm:.2f} cm per pixel are {_percent(off)} off the target of {target.gsd_cm:.2f} cm"
    told = f"{frames} frames at {gsds}"
    if target.kept:
        yield Finding(
            code="gsd-native",
            severity=WARNING,
            subjects=subjects,
            message=f"{told} and keep their pixels: {target.kept}.",
            remedy="Nothing has to be done: the alignment decides whether they fit. --gsd-target sets another target.",
            measured=off,
            threshold=target.trigger,
        )
        return
    share = sum(sizes[g.key][0] * sizes[g.key][1] for g in unit.groups) / sum(g.width * g.height for g in unit.groups)
    own = next(g for g in gains if (g.profile, g.flight) == unit.key)
    brings = "less work"
    if share > 1:
        before, after = own.native.inliers, own.resampled.inliers
        brings = f"{_percent(after)} instead of {_percent(before)} of the matches that equally fine frames have"
        if after <= before:
            brings = "no more matches"
    yield Finding(
        code="gsd-mixed",
        severity=ERROR,
        subjects=subjects,
        message=f"{told}. Resampling brings {brings} and makes {share:.2g} times as many pixels.",
        remedy="sensorgate run resamples them, one scale per flight; the originals stay as they are.",
        measured=off,
        threshold=target.trigger,
    )
    voided = sorted({tag for g in unit.groups for tag in g.radiometry})
    if voided:
        yield Finding(
            code="not-reflectance",
            severity=WARNING,
            subjects=subjects,
            message=f"Resampling voids {', '.join(voided)} of these frames: their values are no reflectance any more.",
            remedy="Leave out --gsd-target to keep these frames as the camera wrote them.",
        )


def _unknown(units: Sequence[Unit], targets: Mapping[Key, Target]) -> Iterator[Finding]:
    """Flights whose ground resolution is unknown; a warning only where another flight saw that ground."""
    for unit in units:
        if targets[unit.key].gsd_cm is not None:
            continue
        others = [u for u in units if u is not unit and (u.spectrum, u.ground) == (unit.spectrum, unit.ground)]
        yield Finding(
            code="gsd-unknown",
            severity=WARNING if others else INFO,
            subjects=tuple(sorted({g.flight for g in unit.groups})),
            message=f"The ground resolution of these frames is unknown: {_missing(unit)}. They keep their pixels.",
            remedy="Give the ground with --ground, or the camera with --calibration.",
        )


def _missing(unit: Unit) -> str:
    heights = [g.height_m for g in unit.groups]
    if all(h is None for h in heights):
        return "there is no relative altitude, and no ground under the GPS altitude is known"
    if all(h is None or h <= 0 for h in heights):
        return "their height above ground is not above 0 m"
    return "no tag and no sheet tells the focal length"
