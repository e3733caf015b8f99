"""The map of the survey: frames by payload, flights as lines, what was left out, ground control.

A survey may hold several sites; each gets a panel with its own scale bar, so
that one stray position does not shrink the rest to a dot.
"""

from __future__ import annotations

import html
import math
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Sequence, Set, Tuple

from . import svg
from .plane import Plane, Size, has_position
from .sites import Site, Spot, split_sites
from .view import View, listing, plural

MOST_SITES = 6
LEAST_SPOTS = 3
MARGIN = 46.0
WHOLE: Size = (960.0, 240.0, 560.0)
PANEL: Size = (480.0, 340.0, 340.0)
MOST_MARKS = 200
MOST_NAMES = 40
Frame = Mapping[str, Any]
Room = Tuple[float, float, float, float]


@dataclass(frozen=True)
class SiteMap:
    """One panel and what it leaves unsaid."""

    drawing: str
    caption: str


@dataclass(frozen=True)
class SurveyMap:
    """All panels, and in one sentence what no panel shows (empty where all is drawn)."""

    panels: Tuple[SiteMap, ...] = ()
    note: str = ""


def survey_map(view: View) -> SurveyMap:
    """One panel per site, the site with most frames first; at most ``MOST_SITES``."""
    placed = [f for f in view.report["frames"] if has_position(f)]
    anchors = [f for f in placed if not f["reason"]] or placed
    if not anchors:
        return SurveyMap()
    sites = [[anchors[i] for i in site] for site in split_sites([_spot(f) for f in anchors])]
    others = [f for f in placed if f["reason"]] if anchors is not placed else []
    drawn = [s for n, s in enumerate(sites) if not n or len({_spot(f) for f in s}) >= LEAST_SPOTS][:MOST_SITES]
    lone = [s for s in sites if all(s is not d for d in drawn)]
    anchor = _site(sites[0])
    covered: Set[str] = set()
    panels = []
    for number, site in enumerate(drawn):
        around = _site(site)
        near = [f for f in others if f["path"] not in covered and _spot(f) in around]
        covered.update(f["path"] for f in (*site, *near))
        name = f"Site {number + 1}" if len(sites) > 1 else "Survey"
        where = f", {around.words_from(anchor)} of site 1" if number else ""
        panels.append(_draw(view, site, near, f"{name}{where}", PANEL if len(drawn) > 1 else WHOLE))
    notes = [f"{plural(len(s), 'frame')} {_site(s).words_from(anchor)} of site 1" for s in lone[:MOST_SITES]]
    lacking = len(view.report["frames"]) - len(placed)
    away = len(placed) - len(covered) - sum(len(s) for s in lone[:MOST_SITES])
    notes += [f"{plural(away, 'frame')} far away from the rest"] if away else []
    notes += [f"{plural(lacking, 'frame')} without a position"] if lacking else []
    return SurveyMap(tuple(panels), f"Not drawn: {listing(notes, len(notes))}." if notes else "")


def _site(frames: Sequence[Frame]) -> Site:
    return Site([_spot(f) for f in frames])


def _spot(frame: Frame) -> Spot:
    return float(frame["latitude"]), float(frame["longitude"])


def _draw(view: View, used: Sequence[Frame], left: Sequence[Frame], name: str, size: Size) -> SiteMap:
    project = Plane([_spot(f) for f in used], size, MARGIN)
    here = {f["path"]: project(_spot(f)) for f in (*used, *left)}
    radius = max(1.4, min(5.0, 0.22 * math.sqrt(project.width * project.height / max(1, len(used)))))
    body = [svg.rectangle(0, 0, project.width, project.height, "ground")]
    ways: Dict[str, List[str]] = {}
    leads = {p["primary"]: (i, p["id"]) for i, p in enumerate(view.report["payloads"])}
    for flight in view.report["flights"]:
        if flight["profile"] in leads:
            way = [here[p] for p in flight["frames"] if p in here and project.inside(here[p])]
            index, payload = leads[flight["profile"]]
            ways.setdefault(payload, []).append(svg.polyline(way, f"way {svg.colour_class(index)}"))
    spots: Dict[str, List[svg.Point]] = {}
    for frame in used:
        spots.setdefault(frame["payload"], []).append(here[frame["path"]])
    over: List[str] = []
    for index, payload in enumerate(p["id"] for p in view.report["payloads"]):
        if payload not in spots:
            continue
        # Payloads of one drone stand on one spot: each next one is drawn smaller, as a ring around a dot.
        dots = svg.dots(spots[payload], svg.colour_class(index), 2 * radius * max(0.4, 1.0 - 0.3 * len(over)))
        body.append(f'<g class="layer-{index}">{"".join(ways.get(payload, []))}</g>')
        over.append(f'<g class="layer-{index}"><title>{html.escape(payload)}</title>{dots}</g>')
    body.extend(over)
    body.extend(_marks(view, (*used, *left), here, project))
    body.extend(_control(view, project))
    body.extend(_scale_bar(project))
    caption = f"{name}: {plural(len(used) + len(left), 'frame')} from {plural(len(spots), 'payload')}"
    caption += f", {len(left):,} of them left out (crosses)." if left else "."
    css = "map" if size == WHOLE else "map panel"
    return SiteMap(svg.figure(project.width, project.height, f"Map. {caption} North is up.", body, css), caption)


def _marks(view: View, frames: Sequence[Frame], here: Mapping[str, svg.Point], project: Plane) -> List[str]:
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


def _control(view: View, project: Plane) -> List[str]:
    """Triangles for ground control, diamonds for check points, named where the name finds room."""
    points = [p for p in view.report["inputs"].get("gcp", []) if None not in (p["latitude"], p["longitude"])]
    body = []
    placed = [(p, project((p["latitude"], p["longitude"]))) for p in points]
    placed = [(p, at) for p, at in placed if project.inside(at)][:MOST_MARKS]
    taken = [(x - 9, y - 9, x + 9, y + 6) for _, (x, y) in placed]
    for point, (x, y) in placed:
        shape = f"M{svg.number(x)} {svg.number(y - 9)}l9 15h-18z"
        if point.get("check"):
            shape = f"M{svg.number(x)} {svg.number(y - 9)}l9 9l-9 9l-9 -9z"
        kind = "check point" if point.get("check") else "ground control"
        title = f"<title>{html.escape(str(point['name']))}: {kind}, {plural(point['images'], 'frame')}</title>"
        body.append(f'<g>{title}<path d="{shape}" class="gcp"/></g>')
    for point, (x, y) in placed[:MOST_NAMES]:
        name = svg.shortened(point["name"], 14)
        length = 7.5 * len(name)
        for left, anchor in ((x + 12, "start"), (x - 12 - length, "end")):
            room = (left, y - 7, left + length, y + 7)
            if left > 4 and left + length < project.width - 4 and not any(_meet(room, t) for t in taken):
                taken.append(room)
                body.append(svg.text(x + 12 if anchor == "start" else x - 12, y + 5, name, "gcp-name", anchor))
                break
    return body


def _meet(a: Room, b: Room) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _scale_bar(project: Plane) -> List[str]:
    metres = svg.nice_step(project.width / project.scale / 5.5, 1)
    length, y = metres * project.scale, project.height - 18
    label = f"{metres / 1000:g} km" if metres >= 1000 else f"{metres:g} m"
    x = project.width - 26
    return [
        f'<path d="M18 {svg.number(y - 6)}v6h{svg.number(length)}v-6" class="bar"/>',
        svg.text(18 + length / 2, y - 5, label, "bar-text", "middle"),
        f'<path d="M{svg.number(x)} 14l8 24l-8 -6l-8 6z" class="north"/>',
        svg.text(x, 54, "N", "bar-text", "middle"),
    ]
