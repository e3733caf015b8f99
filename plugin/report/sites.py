"""Which positions lie together: the sites of a survey, so that each is drawn at its own scale (pure)."""

from __future__ import annotations

import math
from typing import Dict, List, Sequence, Tuple

METRES_PER_DEGREE = 111_320.0  # of latitude; a map for the eye needs no ellipsoid
CELL_M = 100.0
LEAST_GAP_M = 300.0
MOST_GROUPS = 64
_WINDS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
Spot = Tuple[float, float]  # latitude, longitude in degrees
Box = Tuple[float, float, float, float]  # south, west, north, east
Cell = Tuple[int, int]


def narrowing(latitude: float) -> float:
    """Length of a degree of longitude over one of latitude."""
    return max(0.01, math.cos(math.radians(latitude)))


def turned(longitude: float, origin: float) -> float:
    """Degrees east of ``origin``, -180 to 180."""
    return (longitude - origin + 540.0) % 360.0 - 180.0


def split_sites(spots: Sequence[Spot]) -> List[List[int]]:
    """Indexes of the spots by site, the site with most spots first.

    Two groups of spots are two sites where the gap between them is wider than
    the larger group is long: on one map, neither would show.
    """
    if not spots:
        return []
    origin = spots[0][1]
    groups = [(g, _box([spots[i] for i in g], origin)) for g in _groups(spots, origin)]
    merged = True
    while merged:
        merged = False
        for a in range(len(groups)):
            for b in range(len(groups) - 1, a, -1):
                reach = max(LEAST_GAP_M, _length(groups[a][1]), _length(groups[b][1]))
                if _gap(groups[a][1], groups[b][1]) <= reach:
                    members = sorted(groups[a][0] + groups.pop(b)[0])
                    groups[a] = (members, _box([spots[i] for i in members], origin))
                    merged = True
    return sorted((g for g, _ in groups), key=lambda g: (-len(g), g[0]))


class Site:
    """The positions of one site as a box, to ask what lies near it."""

    def __init__(self, spots: Sequence[Spot]) -> None:
        self._origin = spots[0][1]
        self._box = _box(spots, self._origin)
        self._reach_m = max(LEAST_GAP_M, _length(self._box))

    def __contains__(self, spot: Spot) -> bool:
        """The spot is no farther from the site than two parts of one site may be."""
        return _gap(_box([spot], self._origin), self._box) <= self._reach_m

    def words_from(self, start: "Site") -> str:
        """``3.1 km north-east``: where the middle of this site lies from the middle of another."""
        (south, west), (north, east) = _middle(start._box), _middle(self._box)
        up = (north - south) * METRES_PER_DEGREE
        right = turned(self._origin + east, start._origin + west) * METRES_PER_DEGREE * narrowing((south + north) / 2)
        metres = math.hypot(up, right)
        wind = _WINDS[round(math.degrees(math.atan2(right, up)) / 45.0) % 8]
        if metres < 1000:
            return f"{metres:.0f} m {wind}"
        return f"{metres / 1000:,.{1 if metres < 100_000 else 0}f} km {wind}"


def _groups(spots: Sequence[Spot], origin: float) -> List[List[int]]:
    """Spots in neighbouring cells joined; the cells grow until there are few groups to compare."""
    size = CELL_M
    while True:
        cells: Dict[Cell, List[int]] = {}
        for index, (latitude, longitude) in enumerate(spots):
            row = math.floor(latitude * METRES_PER_DEGREE / size)
            across = narrowing((row + 0.5) * size / METRES_PER_DEGREE)
            column = math.floor(turned(longitude, origin) * METRES_PER_DEGREE * across / size)
            cells.setdefault((row, column), []).append(index)
        groups = []
        while cells:
            todo, members = [min(cells)], []
            while todo:
                cell = todo.pop()
                if cell in cells:
                    members.extend(cells.pop(cell))
                    todo.extend((cell[0] + i, cell[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1))
            groups.append(sorted(members))
        if len(groups) <= MOST_GROUPS:
            return sorted(groups)
        size *= 2.0


def _box(spots: Sequence[Spot], origin: float) -> Box:
    rows, columns = [s[0] for s in spots], [turned(s[1], origin) for s in spots]
    return min(rows), min(columns), max(rows), max(columns)


def _middle(box: Box) -> Spot:
    return (box[0] + box[2]) / 2, (box[1] + box[3]) / 2


def _length(box: Box) -> float:
    across = narrowing(_middle(box)[0])
    return METRES_PER_DEGREE * math.hypot(box[2] - box[0], (box[3] - box[1]) * across)


def _gap(a: Box, b: Box) -> float:
    """Metres between two boxes, 0 where they touch."""
    up = max(0.0, a[0] - b[2], b[0] - a[2])
    right = max(0.0, a[1] - b[3], b[1] - a[3]) * narrowing((_middle(a)[0] + _middle(b)[0]) / 2)
    return METRES_PER_DEGREE * math.hypot(up, right)
