"""Which frames one trigger made (pure).

Frames of a rig belong together by the capture id that the camera wrote; where
there is none, by DJI's running number with nearly equal time and place; then
by a time that is unique within each band; last by the file name without its
band suffix. A frame that joins nobody is a capture of its own.
"""

from __future__ import annotations

import datetime
import re
from collections import defaultdict
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from .frame import Frame
from .geo import distance_m
from .thresholds import Thresholds

_DJI_NUMBER = re.compile(r"^DJI_(?:\d{14}_)?(\d{4})(?:_|\.)", re.IGNORECASE)
_BAND_SUFFIX = re.compile(r"^(.+)[-_]\w+\.[A-Za-z]{3,4}$")


def seconds(frame: Frame) -> Optional[float]:
    """Capture time in seconds since 1970 (the camera's own clock, no zone), or ``None``."""
    if not frame.time:
        return None
    try:
        moment = datetime.datetime.fromisoformat(frame.time)
    except ValueError:
        return None
    epoch = datetime.datetime(1970, 1, 1)
    return None if moment.year < 1990 else (moment.replace(tzinfo=None) - epoch).total_seconds()


def _near(a: Frame, b: Frame, limits: Thresholds) -> bool:
    """The two could be one trigger: same time within the limit, and same place where both say."""
    time_a, time_b = seconds(a), seconds(b)
    if time_a is None or time_b is None or abs(time_a - time_b) > limits.capture_time_s:
        return False
    if a.has_gps and b.has_gps:
        assert a.latitude is not None and a.longitude is not None
        assert b.latitude is not None and b.longitude is not None
        return distance_m((a.latitude, a.longitude), (b.latitude, b.longitude)) <= limits.capture_distance_m
    return True


def _folder(frame: Frame) -> str:
    return frame.path.rsplit("/", 1)[0] if "/" in frame.path else ""


def _distinct_bands(members: Sequence[Frame], band_of: Mapping[str, str]) -> bool:
    bands = [band_of[m.path] for m in members]
    return len(set(bands)) == len(bands) > 1


def group_captures(frames: Sequence[Frame], band_of: Mapping[str, str], limits: Thresholds) -> Dict[str, str]:
    """Map each path of one rig's frames to its capture's name.

    ``frames`` are those of one make and body family; ``band_of`` tells
    apart what one trigger can hold only once. The capture's name is the id the
    camera wrote, else the first member's path.
    """
    result: Dict[str, str] = {}
    rest: List[Frame] = []
    for frame in sorted(frames, key=lambda f: f.path):
        if frame.capture_id:
            result[frame.path] = frame.capture_id
        else:
            rest.append(frame)

    def settle(groups: Mapping[Tuple[object, ...], List[Frame]]) -> None:
        for members in groups.values():
            if _distinct_bands(members, band_of):
                for member in members:
                    result[member.path] = members[0].path

    numbered: Dict[Tuple[object, ...], List[Frame]] = defaultdict(list)
    for frame in rest:
        match = _DJI_NUMBER.match(frame.name)
        number = frame.sequence if frame.sequence is not None else (int(match.group(1)) if match else None)
        if number is None:
            continue
        key_list = [k for k in numbered if k[:2] == (_folder(frame), number)]
        for key in key_list:
            if _near(numbered[key][0], frame, limits):
                numbered[key].append(frame)
                break
        else:
            numbered[(_folder(frame), number, len(key_list))].append(frame)
    settle(numbered)

    timed: Dict[Tuple[object, ...], List[Frame]] = defaultdict(list)
    for frame in rest:
        if frame.path not in result and seconds(frame) is not None:
            timed[(frame.time,)].append(frame)
    settle({k: m for k, m in timed.items() if all(_near(m[0], f, limits) for f in m)})

    stems: Dict[Tuple[object, ...], List[Frame]] = defaultdict(list)
    for frame in rest:
        match = _BAND_SUFFIX.match(frame.name)
        if frame.path not in result and match:
            stems[(_folder(frame), match.group(1))].append(frame)
    settle(stems)

    _join_strays(rest, result, frames, band_of, limits)
    for frame in rest:
        result.setdefault(frame.path, frame.path)
    return result


def _join_strays(
    rest: Sequence[Frame],
    result: Dict[str, str],
    frames: Sequence[Frame],
    band_of: Mapping[str, str],
    limits: Thresholds,
) -> None:
    """A frame without an id (a rig's RGB) joins the one capture that stands at its time and place."""
    by_second: Dict[int, List[Frame]] = defaultdict(list)
    for frame in frames:
        moment = seconds(frame)
        if frame.path in result and moment is not None:
            by_second[int(moment // limits.capture_time_s)].append(frame)
    taken = {(result[f.path], band_of[f.path]) for f in frames if f.path in result}
    for frame in rest:
        moment = seconds(frame)
        if frame.path in result or moment is None:
            continue
        slot = int(moment // limits.capture_time_s)
        near = {result[o.path] for s in (slot - 1, slot, slot + 1) for o in by_second[s] if _near(o, frame, limits)}
        free = [c for c in sorted(near) if (c, band_of[frame.path]) not in taken]
        if len(free) == 1:
            result[frame.path] = free[0]
            taken.add((free[0], band_of[frame.path]))
