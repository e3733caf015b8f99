"""A ground control list as text: read, bound to frames, and check points held out of it.

The form is ODM's ``gcp_list.txt``, which most tools can write: a header with
the coordinate system, then per line ``geo_x geo_y geo_z px py image [name]
[extras]``, parted by blanks or tabs. Points are told apart by their
coordinates. Pixels count from the centre of the first one.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, FrozenSet, List, Mapping, Optional, Sequence, Set, Tuple, Union

from .align.model import AlignFrame, GcpMark
from .errors import UsageError
from .geo import hull_area_m2, local_metres
from .srs import Srs, parse_srs, to_lonlat
from .thresholds import DEFAULTS, Thresholds

_COLUMNS = 6
CHECK_NAME = "check"
Point = Tuple[float, float, float]


@dataclass(frozen=True)
class GcpLine:
    """One mark: the numbers as spelled, the image as named, the rest untouched."""

    number: int
    x: str
    y: str
    z: str
    px: str
    py: str
    image: str
    extras: str = ""

    @property
    def point(self) -> Point:
        """The coordinates, by which points are told apart; an unknown height is ``math.nan`` itself."""
        height = float(self.z)
        return float(self.x), float(self.y), math.nan if math.isnan(height) else height

    @property
    def name(self) -> str:
        """The point's name where the line has one."""
        return self.extras.split()[0] if self.extras.split() else ""

    @property
    def label(self) -> str:
        """The point's name where the line has one, else its coordinates."""
        return self.name or f"{self.x} {self.y} {self.z}"


@dataclass(frozen=True)
class BadLine:
    """A line that cannot be used: ``short`` of columns, or with a word where a number must stand."""

    number: int
    row: str
    short: bool


@dataclass(frozen=True)
class GcpText:
    """A list as it was written: coordinate system, usable lines, and the others."""

    srs: Srs
    lines: Tuple[GcpLine, ...]
    bad: Tuple[BadLine, ...] = ()


def read_text(file: Path) -> str:
    """The file's text, UTF-8 with or without a mark; ``UsageError`` where it is something else."""
    try:
        if file.stat().st_size > DEFAULTS.max_text_bytes:
            raise UsageError(
                f"{file.name} is larger than {DEFAULTS.max_text_bytes // 1024**2} MB; that is no such list."
            )
        return file.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"{file.name} cannot be read: {error.strerror or error}.") from None
    except UnicodeDecodeError:
        raise UsageError(f"{file.name} is not UTF-8 text, ODM would stop on it. Save it again as UTF-8.") from None


def split_lines(text: str) -> List[Tuple[int, str]]:
    """(line number, stripped line); the first is the header. Comments and empty lines are out."""
    rows = text.replace("\ufeff", "").strip().split("\n")
    kept = [(1, rows[0].strip())]
    return kept + [(i, r.strip()) for i, r in enumerate(rows[1:], start=2) if r.strip() and r.strip()[0] != "#"]


def _fields(row: str) -> List[str]:
    """Six columns and the rest. A row with tabs is cut at them, so that names with blanks survive."""
    by_tab = [p.strip() for p in row.split("\t")]
    if len(by_tab) >= _COLUMNS and all(by_tab[:_COLUMNS]):
        return [*by_tab[:_COLUMNS], " ".join(" ".join(by_tab[_COLUMNS:]).split())]
    words = row.split()
    return [*words[:_COLUMNS], " ".join(words[_COLUMNS:])] if len(words) >= _COLUMNS else words


def is_number(text: str, allow_nan: bool = False) -> bool:
    """Whether ``text`` is a number that means something."""
    try:
        value = float(text)
    except ValueError:
        return False
    return "_" not in text and (math.isfinite(value) or (allow_nan and math.isnan(value)))


def parse_gcp(text: str) -> GcpText:
    """Read a ground control list; ``UsageError`` for a header that means nothing."""
    rows = split_lines(text)
    srs = parse_srs(rows[0][1])
    lines: List[GcpLine] = []
    bad: List[BadLine] = []
    for number, row in rows[1:]:
        parts = _fields(row)
        if len(parts) < _COLUMNS:
            bad.append(BadLine(number, row, True))
        elif not all(is_number(p, allow_nan=i == 2) for i, p in enumerate(parts[:5])):
            bad.append(BadLine(number, row, False))
        else:
            lines.append(GcpLine(number, *parts))
    return GcpText(srs, tuple(lines), tuple(bad))


@dataclass(frozen=True)
class ToldTwice:
    """Marks of one point on one image that stand there more than once, by the lines' numbers.

    ``repeated`` say what an earlier line said; of ``contradicting`` ones (each
    group is all lines of one point on one image) nobody knows which is right.
    """

    repeated: Tuple[int, ...] = ()
    contradicting: Tuple[Tuple[int, ...], ...] = ()

    @property
    def unusable(self) -> FrozenSet[int]:
        """Lines that must be left out."""
        return frozenset(self.repeated).union(*self.contradicting)


def told_twice(marks: Sequence[Tuple[GcpLine, str]], limits: Thresholds = DEFAULTS) -> ToldTwice:
    """Find marks of one point that stand on one image (its path) twice; OpenSfM would take each for a sighting."""
    groups: Dict[Tuple[Point, str], List[GcpLine]] = defaultdict(list)
    for line, path in marks:
        groups[line.point, path].append(line)
    repeated: List[int] = []
    contradicting: List[Tuple[int, ...]] = []
    for lines in groups.values():
        first = lines[0]
        apart = [math.hypot(float(g.px) - float(first.px), float(g.py) - float(first.py)) for g in lines[1:]]
        if any(gap > limits.gcp_same_mark_px for gap in apart):
            contradicting.append(tuple(g.number for g in lines))
        else:
            repeated += [g.number for g in lines[1:]]
    return ToldTwice(tuple(sorted(repeated)), tuple(sorted(contradicting)))


def marks_from_file(
    file: Union[str, Path], frames: Sequence[AlignFrame], check_points: Optional[str] = None
) -> Tuple[GcpMark, ...]:
    """The marks of a list that stand on ``frames``, whose pixels they must count.

    A frame is found by its file name, in another case too where only one has
    it. Lines of other frames are left out, and so is a mark that stands there
    twice or contradicts another. Raises ``UsageError`` where the file cannot
    be read.
    """
    text = parse_gcp(read_text(Path(file)))
    exact: Dict[str, List[AlignFrame]] = defaultdict(list)
    folded: Dict[str, List[AlignFrame]] = defaultdict(list)
    for frame in frames:
        name = frame.path.rsplit("/", 1)[-1]
        exact[name].append(frame)
        folded[name.lower()].append(frame)
    points = list(dict.fromkeys(line.point for line in text.lines))
    places = dict(zip(points, to_lonlat(text.srs, [(p[0], p[1]) for p in points])))
    ids = {point: f"gcp-{i:04d}" for i, point in enumerate(points)}
    names = {line.point: line.label for line in text.lines}
    where = {p: (places[p][1], places[p][0]) for p in points}
    images: Dict[Point, Set[str]] = defaultdict(set)
    found: List[Tuple[GcpLine, AlignFrame]] = []
    for line in text.lines:
        image = line.image.replace("\\", "/").rsplit("/", 1)[-1]
        fits = exact.get(image) or folded.get(image.lower()) or []
        if len(fits) == 1 and math.isfinite(line.point[2]):
            found.append((line, fits[0]))
    left_out = told_twice([(line, frame.path) for line, frame in found]).unusable
    found = [(line, frame) for line, frame in found if line.number not in left_out]
    for line, frame in found:
        images[line.point].add(frame.path)
    checks = choose_check_points(names, where, {p: len(images[p]) for p in points}, check_points)
    return tuple(
        GcpMark(
            point=ids[line.point],
            path=frame.path,
            x_px=float(line.px),
            y_px=float(line.py),
            latitude=where[line.point][0],
            longitude=where[line.point][1],
            altitude_m=line.point[2],
            name=line.label,
            check=line.point in checks,
        )
        for line, frame in found
    )


def choose_check_points(
    names: Mapping[Point, str],
    places: Mapping[Point, Tuple[float, float]],
    images: Mapping[Point, int],
    wanted: Optional[str],
) -> FrozenSet[Point]:
    """Which points are held out: those whose name starts with "check", and those that were asked for.

    ``wanted`` is names, parted by commas, or a number: then so many of the
    points seen in enough frames, those first without which the others still
    span the most ground. ``places`` are latitude and longitude, ``images`` the
    number of frames that a point is marked on. ``UsageError`` for a name that
    no point has, or a number that leaves too few.
    """
    out = {p for p, name in names.items() if name.lower().startswith(CHECK_NAME)}
    text = (wanted or "").strip()
    if not text:
        return frozenset(out)
    if not text.isdigit():
        asked = {n.strip() for n in text.split(",") if n.strip()}
        missing = sorted(asked - set(names.values()))
        if missing:
            raise UsageError(
                f"--check-points: no ground control point is named {', '.join(missing)}. "
                f"Its names: {', '.join(sorted(set(names.values())))[:200]}."
            )
        return frozenset(out | {p for p, name in names.items() if name in asked})
    left = [p for p in sorted(names, key=lambda p: (names[p], p)) if p not in out]
    able = [p for p in left if images.get(p, 0) >= DEFAULTS.gcp_min_images]
    count = int(text)
    if count > len(able) - DEFAULTS.gcp_min_points:
        raise UsageError(
            f"--check-points {count}: of {len(able)} points on {DEFAULTS.gcp_min_images} frames or more, "
            f"{DEFAULTS.gcp_min_points} must be left to hold the block."
        )
    for _ in range(count):
        taken = max(able, key=lambda p: _span(places, [q for q in left if q != p]))
        able.remove(taken)
        left.remove(taken)
        out.add(taken)
    return frozenset(out)


def _span(places: Mapping[Point, Tuple[float, float]], points: Sequence[Point]) -> float:
    """Area in square metres that points span, rounded so that equal spans are equal."""
    return round(hull_area_m2(local_metres([places[p] for p in points], places[points[0]])), 3)
