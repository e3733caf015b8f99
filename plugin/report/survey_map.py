"""The map of the survey: frames by payload, flights as lines, what was left out, ground control.

A survey may hold several sites; each gets its own drawing, so that one stray
position does not shrink the rest to a dot.
"""

from __future__ import annotations

import html
import math
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Sequence, Set, Tuple

from . import svg
from .view import View, plural

METRES_PER_DEGREE = 111_320.0  # of latitude; a map for the eye needs no ellipsoid
SITE_CELL_M = 2000.0
MOST_SITES = 4
WIDTH, MARGIN, LEAST_HEIGHT = 960.0, 46.0, 240.0
MOST_HEIGHT, MOST_HEIGHT_LATER = 620.0, 340.0
MOST_MARKS = 200
Cell = Tuple[int, int]


@dataclass(frozen=True)
class SiteMap:
    """One drawing and what it leaves unsaid."""

    drawing: str
    caption: str


def has_position(frame: Mapping[str, Any]) -> bool:
    """The frame has a position that is not the 0, 0 of a camera without a fix."""
    latitude, longitude = frame["latitude"], frame["longitude"]
    return latitude is not None and longitude is not None and (abs(latitude) > 1e-6 or abs(longitude) > 1e-6)


def site_maps(view: View) -> List[SiteMap]:
    """One map per site, the site with most frames first; at most ``MOST_SITES``."""
    placed = [f for f in view.report["frames"] if has_position(f)]
    anchors = [f for f in placed if not f["reason"]] or placed
    if not anchors:
        return []
    sites = _sites(anchors)
    drawn = sites[:MOST_SITES]
    covered: Set[str] = set()
    maps = []
    for number, cells in enumerate(drawn, 1):
        here = [f for f in placed if _cell(f) in cells or _near(f, cells)]
        covered.update(f["path"] for f in here)
        height = MOST_HEIGHT if number == 1 else MOST_HEIGHT_LATER
        maps.append(_draw(view, here, f"Site {number}" if len(sites) > 1 else "Survey", height))
    missing = len(view.report["frames"]) - len(placed)
    away = len(placed) - len(covered)
    notes = [
        f"{plural(missing, 'frame')} without a position" if missing else "",
        f"{plural(away, 'frame')} far away" if away else "",
    ]
    said = " and ".join(n for n in notes if n)
    if said:
        maps[0] = SiteMap(maps[0].drawing, f"{maps[0].caption} Not drawn: {said}.")
    return maps


def _cell(frame: Mapping[str, Any]) -> Cell:
    narrow = max(0.01, math.cos(math.radians(frame["latitude"])))
    return (
        math.floor(frame["latitude"] * METRES_PER_DEGREE / SITE_CELL_M),
        math.floor(frame["longitude"] * METRES_PER_DEGREE * narrow / SITE_CELL_M),
    )


def _near(frame: Mapping[str, Any], cells: Set[Cell]) -> bool:
    row, column = _cell(frame)
    return any((row + i, column + j) in cells for i in (-1, 0, 1) for j in (-1, 0, 1))


def _sites(frames: Sequence[Mapping[str, Any]]) -> List[Set[Cell]]:
    """Neighbouring cells joined; a row of cells shifts a little with latitude, which the joining absorbs."""
    counts: Dict[Cell, int] = {}
    for frame in frames:
        cell = _cell(frame)
        counts[cell] = counts.get(cell, 0) + 1
    left = set(counts)
    sites = []
    while left:
        grown: Set[Cell] = set()
        todo = [min(left)]
        while todo:
            cell = todo.pop()
            if cell in left:
                left.discard(cell)
                grown.add(cell)
                todo.extend((cell[0] + i, cell[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1))
        sites.append(grown)
    return sorted(sites, key=lambda s: (-sum(counts[c] for c in s), min(s)))


class _Projection:
    """Degrees to drawing units, north up."""

    def __init__(self, frames: Sequence[Mapping[str, Any]], most_height: float) -> None:
        self.latitude, self.longitude = frames[0]["latitude"], frames[0]["longitude"]
        self.narrow = max(0.01, math.cos(math.radians(self.latitude)))
        metres = [self._metres(f["latitude"], f["longitude"]) for f in frames]
        east, north = [m[0] for m in metres], [m[1] for m in metres]
        width, depth = max(max(east) - min(east), 40.0), max(max(north) - min(north), 20.0)
        self.scale = min((WIDTH - 2 * MARGIN) / width, (most_height - 2 * MARGIN) / depth)
        self.height = max(LEAST_HEIGHT, depth * self.scale + 2 * MARGIN)
        self.middle = ((max(east) + min(east)) / 2, (max(north) + min(north)) / 2)

    def _metres(self, latitude: float, longitude: float) -> Tuple[float, float]:
        turned = (longitude - self.longitude + 540.0) % 360.0 - 180.0
        return turned * METRES_PER_DEGREE * self.narrow, (latitude - self.latitude) * METRES_PER_DEGREE

    def __call__(self, latitude: float, longitude: float) -> svg.Point:
        east, north = self._metres(latitude, longitude)
        return WIDTH / 2 + (east - self.middle[0]) * self.scale, self.height / 2 - (north - self.middle[1]) * self.scale

    def inside(self, at: svg.Point) -> bool:
        return 4 <= at[0] <= WIDTH - 4 and 4 <= at[1] <= self.height - 4


def _draw(view: View, frames: Sequence[Mapping[str, Any]], name: str, most_height: float) -> SiteMap:
    used = [f for f in frames if not f["reason"]] or list(frames)
    project = _Projection(used, most_height)
    order = [p["id"] for p in view.report["payloads"]]
    here = {f["path"]: project(f["latitude"], f["longitude"]) for f in frames}
    radius = max(1.4, min(5.0, 0.22 * math.sqrt(WIDTH * project.height / max(1, len(used)))))
    body = [svg.rectangle(0, 0, WIDTH, project.height, "ground")]
    for index, payload in enumerate(order):
        members = next(p for p in view.report["payloads"] if p["id"] == payload)
        body.append(f'<g class="layer-{index}">')
        for flight in view.report["flights"]:
            if flight["profile"] == members["primary"]:
                way = [here[p] for p in flight["frames"] if p in here and project.inside(here[p])]
                body.append(svg.polyline(way, f"way {svg.colour_class(index)}"))
        body.append("</g>")
    drawn = 0
    for index, payload in enumerate(order):
        spots = [here[f["path"]] for f in used if f["payload"] == payload and project.inside(here[f["path"]])]
        # Payloads of one drone stand on one spot: each next one is drawn smaller, as a ring around a dot.
        size = 2 * radius * max(0.5, 1.0 - 0.15 * drawn)
        drawn += bool(spots)
        body.append(f'<g class="layer-{index}">{svg.dots(spots, svg.colour_class(index), size)}</g>')
    body.extend(_marks(view, frames, here, project))
    body.extend(_control(view, project))
    body.extend(_scale_bar(project))
    left = sum(1 for f in frames if f["reason"])
    caption = f"{name}: {plural(len(frames), 'frame')} from {plural(len({f['payload'] for f in used}), 'payload')}"
    caption += f", {left:,} of them left out (crosses)." if left else "."
    return SiteMap(svg.figure(WIDTH, project.height, f"Map. {caption} North is up.", body, "map"), caption)


def _marks(
    view: View, frames: Sequence[Mapping[str, Any]], here: Mapping[str, svg.Point], project: _Projection
) -> List[str]:
    """Crosses for frames left out, rings for frames that the alignment could not place."""
    lost = {p for s in view.report["subprojects"] for p in (s["alignment"] or {}).get("unregistered", [])}
    body = ['<g class="marks">']
    shown = 0
    for frame in frames:
        at = here[frame["path"]]
        if not project.inside(at) or not (frame["reason"] or frame["path"] in lost):
            continue
        x, y = svg.number(at[0] - 5), svg.number(at[1] - 5)
        shape = (
            f'<path d="M{x} {y}l10 10m0 -10l-10 10" class="cross"/>' if frame["reason"] else svg.circle(at, 8, "lost")
        )
        why = frame["reason"] or "not placed by the alignment"
        label = f"<title>{html.escape(frame['path'])}: {html.escape(why)}</title>" if shown < MOST_MARKS else ""
        body.append(f"<g>{label}{shape}</g>" if label else shape)
        shown += 1
    return [*body, "</g>"] if shown else []


def _control(view: View, project: _Projection) -> List[str]:
    points = view.report["inputs"].get("gcp", [])
    body = []
    for point in points[:MOST_MARKS]:
        x, y = at = project(point["latitude"], point["longitude"])
        if not project.inside(at):
            continue
        body.append(f'<path d="M{svg.number(x)} {svg.number(y - 9)}l9 15h-18z" class="gcp"/>')
        if len(points) <= 30:
            body.append(svg.text(x + 12, y + 5, svg.shortened(point["name"], 14), "gcp-name"))
    return body


def _scale_bar(project: _Projection) -> List[str]:
    metres = svg.nice_step(WIDTH / project.scale / 5.5, 1)
    length, y = metres * project.scale, project.height - 18
    label = f"{metres / 1000:g} km" if metres >= 1000 else f"{metres:g} m"
    x = WIDTH - 26
    return [
        f'<path d="M18 {svg.number(y - 6)}v6h{svg.number(length)}v-6" class="bar"/>',
        svg.text(18 + length / 2, y - 5, label, "bar-text", "middle"),
        f'<path d="M{svg.number(x)} 14l8 24l-8 -6l-8 6z" class="north"/>',
        svg.text(x, 54, "N", "bar-text", "middle"),
    ]
