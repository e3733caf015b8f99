"""Which frames one trigger made (pure).

Frames of a rig belong together by the capture id that the camera wrote, as
long as their times agree; where there is none, by the maker's running number
with nearly equal time and place; then by time where it is unique within each
band; last by the file name without its band suffix. What is left joins the one
capture that stands at its time and lacks its band, or is a capture of its own.
"""

from __future__ import annotations

import datetime
import re
from bisect import bisect_left, bisect_right
from collections import defaultdict
from typing import Dict, Iterable, List, Mapping, Optional, Sequence, Set, Tuple

from .frame import Frame
from .geo import distance_m
from .thresholds import Thresholds

# M3M: DJI_20240501120000_0012_MS_G.TIF, the number is shared; P4M: DJI_0012.TIF, the last digit is the band.
_DJI_NUMBER = re.compile(r"^DJI_(?:\d{14}_)?(\d{4,})(?:_|\.)", re.IGNORECASE)
_DJI_PLAIN = re.compile(r"^DJI_(\d{3,})(\d)\.[A-Za-z]{3,4}$", re.IGNORECASE)
_DJI_STAMP = re.compile(r"^(DJI_\d{14}_\d{4,})_", re.IGNORECASE)
_BAND_SUFFIX = re.compile(r"^(.+)[-_](?!\d{3,}\.)[^\W_]+\.[A-Za-z]{3,4}$")
_EPOCH = datetime.datetime(1970, 1, 1)
# A running number that repeats at one time and several places is compared with so many open captures.
_OPEN_CAPTURES = 8

Members = List[Frame]


def seconds(frame: Frame) -> Optional[float]:
    """Capture time in seconds since 1970 (the camera's own clock, no zone), or ``None``."""
    if not frame.time:
        return None
    try:
        moment = datetime.datetime.fromisoformat(frame.time)
    except ValueError:
        return None
    if moment.tzinfo is not None:
        moment = moment.replace(tzinfo=None)
    return None if moment.year < 1990 else (moment - _EPOCH).total_seconds()


def _same_place(a: Frame, b: Frame, limits: Thresholds) -> bool:
    """Nothing in the positions says that the two stand apart."""
    if a.has_gps and b.has_gps:
        assert a.latitude is not None and a.longitude is not None
        assert b.latitude is not None and b.longitude is not None
        return distance_m((a.latitude, a.longitude), (b.latitude, b.longitude)) <= limits.capture_distance_m
    return True


def _folder(frame: Frame) -> str:
    return frame.path.rpartition("/")[0]


class _Grouping:
    """The state of one ``group_captures``: what is known of each frame and where it was put."""

    def __init__(self, frames: Sequence[Frame], band_of: Mapping[str, str], limits: Thresholds) -> None:
        self.frames = sorted(frames, key=lambda f: f.path)
        self.band = band_of
        self.limits = limits
        self.at = {f.path: seconds(f) for f in self.frames}
        self.result: Dict[str, str] = {}

    def near(self, a: Frame, b: Frame) -> bool:
        """The two could be one trigger: same time within the limit, and same place where both say."""
        time_a, time_b = self.at[a.path], self.at[b.path]
        if time_a is None or time_b is None or abs(time_a - time_b) > self.limits.capture_time_s:
            return False
        return _same_place(a, b, self.limits)

    def distinct(self, members: Sequence[Frame]) -> bool:
        """More than one frame and no band twice."""
        bands = {self.band[m.path] for m in members}
        return len(bands) == len(members) > 1

    def rest(self) -> Members:
        """The frames that no rule has placed yet, by path."""
        return [f for f in self.frames if f.path not in self.result]

    def settle(self, groups: Iterable[Members]) -> None:
        """Make captures of the groups that hold each band once; the first path names them."""
        for members in groups:
            if self.distinct(members):
                name = min(m.path for m in members)
                for member in members:
                    self.result[member.path] = name

    # --- by the id that the camera wrote

    def by_id(self) -> None:
        groups: Dict[str, Members] = defaultdict(list)
        for frame in self.frames:
            if frame.capture_id:
                groups[frame.capture_id].append(frame)
        shared = {name: members for name, members in groups.items() if len(members) > 1}
        limit = self._usual_spread(list(shared.values()))
        for name, members in shared.items():
            parts = self._by_time(members, limit)
            # Two parts of one size: nothing says which of them the id is true of.
            largest = max(len(p) for p in parts)
            main = [p for p in parts if len(p) == largest]
            if len(main) == 1 and len(main[0]) > 1:
                for member in main[0]:
                    self.result[member.path] = name
            for part in parts:
                if part is not main[0] or len(main) > 1:
                    self.settle([part])

    def _usual_spread(self, groups: Sequence[Members]) -> Optional[float]:
        """How far times of one id may lie apart: what nine of ten do and a little; ``None`` where clocks disagree.

        An id with a band twice was used twice and does not count.
        """
        spreads: List[float] = []
        for members in groups:
            times = [t for m in members if (t := self.at[m.path]) is not None]
            if len(times) > 1 and self.distinct(members):
                spreads.append(max(times) - min(times))
        if not spreads:
            return self.limits.capture_time_s
        spreads.sort()
        usual = spreads[int(self.limits.capture_usual_share * (len(spreads) - 1))]
        if usual > self.limits.capture_time_s:
            return None
        return min(self.limits.capture_time_s, usual + self.limits.capture_spread_slack_s)

    def _by_time(self, members: Members, limit: Optional[float]) -> List[Members]:
        """Cut frames of one id where their times jump; frames without a time stay with the first part."""
        timed = sorted(((t, m.path, m) for m in members if (t := self.at[m.path]) is not None), key=lambda x: x[:2])
        parts: List[Members] = []
        begin = 0.0
        for moment, _, member in timed:
            if not parts or (limit is not None and moment - begin > limit):
                parts.append([])
                begin = moment
            parts[-1].append(member)
        untimed = [m for m in members if self.at[m.path] is None]
        if untimed:
            parts = parts or [[]]
            max(parts, key=len).extend(untimed)
        return parts

    # --- by number, time, name

    def by_number(self) -> None:
        tens = self._tens_folders()
        numbered: Dict[Tuple[str, int], Members] = defaultdict(list)
        for frame in self.rest():
            match = _DJI_NUMBER.match(frame.name)
            number = int(match.group(1)) if match else frame.sequence
            if number is not None:
                folder = _folder(frame)
                numbered[(folder, number // 10 if folder in tens and match else number)].append(frame)
        for members in numbered.values():
            self.settle(self._near_ones(members))

    def _tens_folders(self) -> Set[str]:
        """Folders where the last digit of DJI's number is the band, as the P4 Multispectral numbers."""
        pairs: Dict[str, Set[Tuple[str, str]]] = defaultdict(set)
        for frame in self.frames:
            match = _DJI_PLAIN.match(frame.name)
            if match:
                pairs[_folder(frame)].add((match.group(2), self.band[frame.path]))
        return {
            folder
            for folder, seen in pairs.items()
            if len(seen) > 1 and len({d for d, _ in seen}) == len({b for _, b in seen}) == len(seen)
        }

    def _near_ones(self, members: Members) -> List[Members]:
        """Parts of the members that stand at one time and place; who has no time stands alone."""
        timed = sorted(((t, m.path, m) for m in members if (t := self.at[m.path]) is not None), key=lambda x: x[:2])
        parts: List[Members] = []
        for _, _, member in timed:
            for part in parts[-_OPEN_CAPTURES:]:
                if self.near(part[0], member):
                    part.append(member)
                    break
            else:
                parts.append([member])
        return parts

    def by_time(self) -> None:
        equal: Dict[float, Members] = defaultdict(list)
        for frame in self.rest():
            moment = self.at[frame.path]
            if moment is not None:
                equal[moment].append(frame)
        self.settle(m for m in equal.values() if all(_same_place(m[0], f, self.limits) for f in m))
        # The second may turn over between two bands: cut where there is a pause instead.
        runs: List[Members] = []
        timed = sorted(((t, f.path, f) for f in self.rest() if (t := self.at[f.path]) is not None), key=lambda x: x[:2])
        last = 0.0
        for moment, _, frame in timed:
            if not runs or moment - last > 0.5 * self.limits.capture_time_s:
                runs.append([])
            runs[-1].append(frame)
            last = moment
        self.settle(m for m in runs if all(self.near(m[0], f) for f in m))

    def by_name(self) -> None:
        stems: Dict[Tuple[str, str], Members] = defaultdict(list)
        for frame in self.rest():
            match = _BAND_SUFFIX.match(frame.name)
            if match:
                stems[(_folder(frame), match.group(1))].append(frame)
        self.settle(m for m in stems.values() if self._no_time_contradicts(m))

    def _no_time_contradicts(self, members: Members) -> bool:
        times = [t for m in members if (t := self.at[m.path]) is not None]
        return not times or max(times) - min(times) <= self.limits.capture_time_s

    # --- what is left over

    def join_strays(self) -> None:
        """A frame on its own (a rig's RGB, a wrong id) joins the capture nearest in time that lacks its band."""
        placed = sorted(
            (t, f.path, f) for f in self.frames if f.path in self.result and (t := self.at[f.path]) is not None
        )
        moments = [t for t, _, _ in placed]
        taken = {(self.result[f.path], self.band[f.path]) for f in self.frames if f.path in self.result}
        wishes: List[Tuple[float, str, str, Frame]] = []
        for frame in self.rest():
            moment = self.at[frame.path]
            if moment is None:
                continue
            low = bisect_left(moments, moment - self.limits.capture_time_s)
            high = min(bisect_right(moments, moment + self.limits.capture_time_s), low + 64)
            gaps: Dict[str, float] = {}
            for other_time, other_path, other in placed[low:high]:
                capture = self.result[other_path]
                if (capture, self.band[frame.path]) not in taken and _same_place(other, frame, self.limits):
                    gap = abs(other_time - moment)
                    gaps[capture] = min(gap, gaps.get(capture, gap))
            ordered = sorted((gap, capture) for capture, gap in gaps.items())
            # Two captures equally near in time: joining either would be a guess.
            if ordered and (len(ordered) == 1 or ordered[0][0] < ordered[1][0]):
                wishes.append((ordered[0][0], frame.path, ordered[0][1], frame))
        for _, path, capture, frame in sorted(wishes, key=lambda w: w[:3]):
            if (capture, self.band[frame.path]) not in taken:
                self.result[path] = capture
                taken.add((capture, self.band[frame.path]))

    def leave_alone(self) -> None:
        """Ids that one frame carries name its capture, unless that name is taken; others are named by the path."""
        names = set(self.result.values())
        for frame in self.rest():
            alone = frame.capture_id and frame.capture_id not in names
            self.result[frame.path] = frame.capture_id if alone else frame.path
            names.add(self.result[frame.path])


def group_captures(frames: Sequence[Frame], band_of: Mapping[str, str], limits: Thresholds) -> Dict[str, str]:
    """Map each path of one rig's frames to its capture's name.

    ``frames`` are those of one make and body family; ``band_of`` tells
    apart what one trigger can hold only once. The capture's name is the id the
    camera wrote, else the first member's path. Every frame gets exactly one
    capture, and the order of ``frames`` changes nothing.
    """
    grouping = _Grouping(frames, band_of, limits)
    grouping.by_id()
    grouping.by_number()
    grouping.by_time()
    grouping.by_name()
    grouping.join_strays()
    grouping.leave_alone()
    return grouping.result


def find_bodies(frames: Sequence[Frame], serial_of: Mapping[str, str]) -> List[Members]:
    """Frames of one flying body together: one make and serial (or model), and whoever shares its captures.

    Combined payloads name their modules differently, and some write a serial
    into one module's frames only; a capture id or a DJI stamp and number that
    two of them share shows the one body.
    """
    parent: Dict[Tuple[str, str], Tuple[str, str]] = {}

    def root(key: Tuple[str, str]) -> Tuple[str, str]:
        while parent[key] != key:
            parent[key] = parent[parent[key]]
            key = parent[key]
        return key

    key_of: Dict[str, Tuple[str, str]] = {}
    first_with: Dict[Tuple[str, str, str], Tuple[str, str]] = {}
    ordered = sorted(frames, key=lambda f: f.path)
    for frame in ordered:
        serial = serial_of[frame.path]
        key = (frame.make, f"serial {serial}" if serial else f"model {frame.model}")
        parent.setdefault(key, key)
        key_of[frame.path] = key
        marks = [("id", frame.make, frame.capture_id)] if frame.capture_id else []
        stamp = _DJI_STAMP.match(frame.name)
        if stamp:
            marks.append((_folder(frame), frame.make, stamp.group(1)))
        for mark in marks:
            low, high = sorted((root(first_with.setdefault(mark, key)), root(key)))
            parent[high] = low
    bodies: Dict[Tuple[str, str], Members] = defaultdict(list)
    for frame in ordered:
        bodies[root(key_of[frame.path])].append(frame)
    return [bodies[key] for key in sorted(bodies)]
