"""Sessions, heights above ground, GSD, and which frames are survey (pure)."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from .captures import seconds
from .frame import Frame
from .geo import distance_m, median
from .intrinsics import Intrinsics, gsd_cm_from_ratio
from .profile import CameraProfile, Flight
from .thresholds import Thresholds

SURVEY, PANEL, TRANSIT, HORIZON = "survey", "panel", "transit", "horizon"


@dataclass(frozen=True)
class Height:
    """Height above ground in metres with its source and standard deviation."""

    value_m: Optional[float] = None
    source: str = "unknown"
    sigma_m: Optional[float] = None


def height_above_ground(
    frame: Frame,
    ground_m: Optional[float],
    limits: Thresholds,
    *,
    source: str = "ground-option",
    ground_sigma_m: float = 0.0,
) -> Height:
    """Relative altitude (above take-off), else GPS altitude minus the ground given, else unknown.

    ``source`` says where the ground is from, ``ground_sigma_m`` its standard deviation.
    """
    if frame.relative_altitude_m is not None and math.isfinite(frame.relative_altitude_m):
        return Height(frame.relative_altitude_m, "relative-altitude", limits.height_sigma_relative_m)
    if ground_m is not None and frame.altitude_m is not None:
        return Height(frame.altitude_m - ground_m, source, math.hypot(limits.height_sigma_gps_m, ground_sigma_m))
    return Height()


def gsd_cm(intrinsics: Intrinsics, height_m: Optional[float], width_px: int) -> Optional[float]:
    """Ground sampling distance in cm by ``gsd_cm_from_ratio``.

    ``None`` where the height is unknown or not positive, or the focal unknown.
    """
    if height_m is None or height_m <= 0 or not intrinsics.focal_ratio or width_px <= 0:
        return None
    return gsd_cm_from_ratio(intrinsics.focal_ratio, height_m, width_px)


def _time_order(frames: Sequence[Frame]) -> List[Frame]:
    def key(frame: Frame) -> Tuple[float, str]:
        moment = seconds(frame)
        return (math.inf if moment is None else moment, frame.path)

    return sorted(frames, key=key)


def _sessions(frames: Sequence[Frame], limits: Thresholds) -> List[List[Frame]]:
    """Cut the time-ordered frames of a profile at pauses and jumps."""
    sessions: List[List[Frame]] = []
    last_fix: Optional[Tuple[float, float]] = None
    for frame in _time_order(frames):
        fix = None
        if frame.has_gps and frame.latitude is not None and frame.longitude is not None:
            fix = (frame.latitude, frame.longitude)
        new = not sessions
        if sessions:
            before, now = seconds(sessions[-1][-1]), seconds(frame)
            if before is None or now is None:
                new = new or (before is None) != (now is None)
            elif now - before > limits.flight_gap_s:
                new = True
            if fix and last_fix and distance_m(last_fix, fix) > limits.flight_gap_m:
                new = True
        if new:
            sessions.append([])
        sessions[-1].append(frame)
        last_fix = fix or last_fix
    return _rejoin_outliers(sessions, limits)


def _rejoin_outliers(sessions: List[List[Frame]], limits: Thresholds) -> List[List[Frame]]:
    """One or two frames with a wild position do not cut their flight in three."""
    joined: List[List[Frame]] = []
    index = 0
    while index < len(sessions):
        current = sessions[index]
        if joined and len(current) <= 2 and index + 1 < len(sessions):
            before, after = seconds(joined[-1][-1]), seconds(sessions[index + 1][0])
            inside = before is not None and after is not None and after - before <= limits.flight_gap_s
            if inside and len(joined[-1]) > 2 and len(sessions[index + 1]) > 2:
                joined[-1] = joined[-1] + current + sessions[index + 1]
                index += 2
                continue
        joined.append(current)
        index += 1
    return joined


def _levels(frames: Sequence[Frame], heights: Mapping[str, Height], limits: Thresholds) -> List[List[Frame]]:
    """Split a session that was flown at clearly different heights; each level is a flight of its own."""
    known = sorted(h for f in frames if (h := heights[f.path].value_m) is not None and h > 0)
    if len(known) < 2 * limits.min_level_frames:
        return [list(frames)]
    cuts: List[float] = []
    run = 1
    for low, high in zip(known, known[1:]):
        if high > low * (1.0 + limits.flight_level_gap) and run >= limits.min_level_frames:
            rest = sum(1 for h in known if h >= high)
            if rest >= limits.min_level_frames:
                cuts.append((low + high) / 2.0)
                run = 0
        run += 1
    if not cuts:
        return [list(frames)]
    levels: Dict[int, List[Frame]] = defaultdict(list)
    for frame in frames:
        height = heights[frame.path].value_m
        levels[sum(1 for c in cuts if height is not None and height > c)].append(frame)
    return [levels[k] for k in sorted(levels)]


def roles(
    frames: Sequence[Frame], heights: Mapping[str, Height], limits: Thresholds, *, rig: bool = False
) -> Dict[str, str]:
    """Class a session's frames (time-ordered): survey, panel, transit, horizon.

    Horizon: the gimbal is up while most of the session looks down. Transit: at
    an end of the session and below half its median height, as long as such
    frames are a small part of it. Panel: the camera said so, or a frame of a
    multispectral ``rig`` that stands at an end of the session near the ground
    (where only GPS altitudes are known: still, and far below the rest).
    """
    result = {f.path: PANEL if f.panel else SURVEY for f in frames}
    tilts = {f.path: 90.0 + f.pitch_deg for f in frames if f.pitch_deg is not None}
    # A flight that looks at the horizon throughout surveys a facade; a few such frames are strays.
    if tilts and median(list(tilts.values())) <= limits.horizon_pitch_deg:
        for path, tilt in tilts.items():
            if result[path] == SURVEY and tilt > limits.horizon_pitch_deg:
                result[path] = HORIZON
    known = [h for f in frames if (h := heights[f.path].value_m) is not None]
    if len(known) >= limits.min_proof_frames:
        low = _low_ends(frames, heights, median(known), limits)
        for frame in low:
            height = heights[frame.path].value_m
            if result[frame.path] == SURVEY:
                ground = rig and height is not None and height <= limits.panel_height_m
                result[frame.path] = PANEL if ground else TRANSIT
    elif rig:
        for frame in _still_ends(frames, limits):
            if result[frame.path] == SURVEY:
                result[frame.path] = PANEL
        for frame in _low_above_panel(frames, result, limits):
            if result[frame.path] == SURVEY:
                result[frame.path] = TRANSIT
    return result


def _low_above_panel(frames: Sequence[Frame], role: Mapping[str, str], limits: Thresholds) -> List[Frame]:
    """Low frames at the ends where only GPS altitudes are known: the panel lay on the ground they rise from."""
    ground = [f.altitude_m for f in frames if role[f.path] == PANEL and f.altitude_m is not None]
    if not ground:
        return []
    zero = median(ground)
    heights = {f.path: Height(None if f.altitude_m is None else f.altitude_m - zero) for f in frames}
    known = [h for f in frames if (h := heights[f.path].value_m) is not None]
    return _low_ends(frames, heights, median(known), limits) if len(known) >= limits.min_proof_frames else []


def _low_ends(
    frames: Sequence[Frame], heights: Mapping[str, Height], usual_m: float, limits: Thresholds
) -> List[Frame]:
    """Frames at either end below half the usual height, where they are few and the flight is no low one itself."""
    if usual_m <= 2.0 * limits.panel_height_m:
        return []
    allowed = max(limits.transit_max_frames, int(limits.transit_max_share * len(frames)))
    found: List[Frame] = []
    for ordered in (list(frames), list(reversed(frames))):
        low: List[Frame] = []
        for frame in ordered:
            height = heights[frame.path].value_m
            if height is None or height >= limits.transit_height_ratio * usual_m:
                break
            low.append(frame)
        if len(low) <= allowed:
            found.extend(low)
    return found


def _still_ends(frames: Sequence[Frame], limits: Thresholds) -> List[Frame]:
    """Bursts at either end that stand at one place, far below the session's median GPS altitude."""
    known = [f.altitude_m for f in frames if f.has_gps and f.altitude_m is not None]
    if len(known) < limits.min_proof_frames:
        return []
    floor = median(known) - limits.panel_drop_m
    allowed = max(limits.transit_max_frames, int(limits.transit_max_share * len(frames)))
    found: List[Frame] = []
    for ordered in (list(frames), list(reversed(frames))):
        still: List[Frame] = []
        for frame in ordered:
            if not frame.has_gps or frame.altitude_m is None or frame.altitude_m > floor:
                break
            if still and not _within(still[0], frame, limits.capture_distance_m):
                break
            still.append(frame)
        if 2 <= len(still) <= allowed:
            found.extend(still)
    return found


def _within(a: Frame, b: Frame, metres: float) -> bool:
    place_a, place_b = (a.latitude or 0.0, a.longitude or 0.0), (b.latitude or 0.0, b.longitude or 0.0)
    return distance_m(place_a, place_b) <= metres


def one_role_per_capture(
    role: Mapping[str, str], captures: Mapping[str, Sequence[str]], primary: Mapping[str, str]
) -> Dict[str, str]:
    """Give all frames of a capture one role.

    ``captures`` maps a rig's capture to its paths, ``primary`` to the path of
    its primary band where that is there: its role counts, else the one that
    most speaks against use (panel, horizon, transit).
    """
    result = dict(role)
    for capture, paths in captures.items():
        chosen = role[primary[capture]] if capture in primary else SURVEY
        if chosen == SURVEY:
            said = {role[p] for p in paths}
            # A panel flag on any band is the camera's own word for the whole trigger.
            if PANEL in said:
                chosen = PANEL
            elif capture not in primary:
                chosen = next((r for r in (HORIZON, TRANSIT) if r in said), SURVEY)
        for path in paths:
            result[path] = chosen
    return result


def find_sessions(profile: CameraProfile, files: Mapping[str, Frame], limits: Thresholds) -> List[List[Frame]]:
    """A profile's frames in time order, cut at pauses and jumps."""
    return _sessions([files[p] for p in profile.frames], limits)


def find_flights(
    profile: CameraProfile,
    sessions: Sequence[Sequence[Frame]],
    role: Mapping[str, str],
    heights: Mapping[str, Height],
    limits: Thresholds,
) -> Tuple[Flight, ...]:
    """A profile's sessions as flights, one per level where it flew at two heights; medians are of survey frames."""
    flights: List[Flight] = []
    parts: List[List[Frame]] = []
    for session in sessions:
        survey = [f for f in session if role[f.path] == SURVEY]
        levels = _levels(survey, heights, limits) if survey else []
        aside = [f for f in session if role[f.path] != SURVEY]
        if levels:
            levels[0] = _time_order(levels[0] + aside)
        parts.extend(levels or [aside])
    for number, part in enumerate(parts, start=1):
        ordered = _time_order(part)
        survey = [f for f in ordered if role[f.path] == SURVEY] or ordered
        known = sorted((h.value_m, h.source, h.sigma_m) for f in survey if (h := heights[f.path]).value_m is not None)
        middle = known[(len(known) - 1) // 2] if known else (None, "unknown", None)
        times = [f.time for f in ordered if f.time]
        flights.append(
            Flight(
                id=f"{profile.id}:{number}",
                profile=profile.id,
                frames=tuple(f.path for f in ordered),
                start=times[0] if times else None,
                end=times[-1] if times else None,
                height_m=middle[0],
                height_source=middle[1],
                height_sigma_m=middle[2],
                gsd_cm=gsd_cm(profile.intrinsics, middle[0], profile.width),
            )
        )
    return tuple(flights)
