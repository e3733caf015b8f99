"""The report as at most 25 lines of plain text for a terminal."""

from __future__ import annotations

import textwrap
import unicodedata
from typing import Any, Callable, Dict, List, Mapping, Sequence, Tuple

from . import story, svg
from .checks import in_main
from .view import SHORT_SOURCES, PayloadRow, View, figure, plural

# With the line that names the report's file, 25 lines.
MOST_LINES = 23
# What each part gets before any part gets more: payloads, resampling, findings, projects.
LEAST_ROWS = (4, 1, 4, 4)
LEAST_WIDTH = 40
INDENT = 8
SPECTRA = {"rgb": "rgb", "multispectral": "multi", "thermal": "thermal"}
PAINT = {"error": "31;1", "warning": "33", "info": "36", "good": "32;1", "bold": "1", "quiet": "2"}
ROUTE_PAINT = {"proceed": "good", "pairwise": "info", "isolate": "warning", "unproven": "warning"}
VERDICT_PAINT = {"consistent": "good", "inconsistent": "warning", "blocked": "error"}

# Heading, right-aligned, narrowest width before the column is dropped, cell. Dropped from the end of DROPPED first.
Paint = Callable[[str, str], str]
Column = Tuple[str, bool, int, Callable[[PayloadRow], str]]
COLUMNS: Tuple[Column, ...] = (
    ("payload", False, 22, lambda r: r.id),
    ("camera", False, 8, lambda r: r.camera),
    ("spectrum", False, 8, lambda r: SPECTRA[r.spectrum] + (f" x{len(r.bands)}" if len(r.bands) > 1 else "")),
    ("frames", True, 7, lambda r: f"{r.used}" if r.used == r.frames else f"{r.used}/{r.frames}"),
    ("focal mm", False, 14, lambda r: focal_cell(r)),
    ("GSD cm", True, 9, lambda r: gsd_cell(r)),
    ("height", True, 6, lambda r: figure(r.height_m, 0, "m")),
    ("project", False, 14, lambda r: "+".join(r.projects) or "none"),
)
DROPPED = ("height", "spectrum", "GSD cm", "focal mm", "project")


def lines(report: Mapping[str, Any], width: int = 100, colour: bool = False, out: str = "DIR") -> List[str]:
    """The story of ``report``, no line wider than ``width`` columns (at least ``LEAST_WIDTH``).

    ``colour`` adds ANSI colours. ``out`` is the output folder named in the next
    command; it stands in no report.
    """
    width = max(LEAST_WIDTH, width)
    view = View(dict(report))
    paint = _painter(colour)
    headline, detail = story.verdict(view)
    told = [paint(part, VERDICT_PAINT[view.report["verdict"]]) for part in _wrapped(headline, width)]
    told.extend(_wrapped(detail, width))
    following = _next(view, out)
    ending = ["", *_wrapped(f"Next: {following}", width)] if following else []
    sections = (_table, _gains, _findings, _projects)
    # The longest that each part would be, its heading aside.
    wishes = [len(section(view, width, paint, MOST_LINES)) for section in sections]
    around = [2 if wish else 0 for wish in wishes]  # an empty line and a heading; findings have none
    around[2] = min(1, around[2])
    free = MOST_LINES - len(told) - len(ending) - sum(around)
    wishes = [wish + 1 - margin if wish else 0 for wish, margin in zip(wishes, around)]
    for section, rows in zip(sections, _shared(free, wishes)):
        part = section(view, width, paint, rows)
        if part:
            told.extend(["", *part])
    return told + ending


def _shared(free: int, wishes: Sequence[int]) -> List[int]:
    """Lines for each part: the least first, then one by one until nothing is free or wished for."""
    rows = [min(wish, least) for wish, least in zip(wishes, LEAST_ROWS)]
    free -= sum(rows)
    while free > 0 and any(wish > row for wish, row in zip(wishes, rows)):
        for index in (3, 0, 2, 1):
            if free > 0 and wishes[index] > rows[index]:
                rows[index] += 1
                free -= 1
    return rows


def _capped(items: Sequence[str], rows: int, what: str) -> List[str]:
    """At most ``rows`` lines; the last one counts what is not shown."""
    if len(items) <= rows:
        return list(items)
    left = len(items) - max(0, rows - 1)
    return [*items[: max(0, rows - 1)], f"and {plural(left, f'more {what}')} in the report"]


def columns_of(text: str) -> int:
    """Columns that ``text`` takes: wide East Asian characters two, combining marks none."""
    return sum(
        0 if unicodedata.combining(c) else 2 if unicodedata.east_asian_width(c) in ("W", "F") else 1 for c in text
    )


def focal_cell(row: PayloadRow) -> str:
    """``8.80 sheet``: the value and where it came from; ``x0.667`` is a ratio to the width."""
    value = figure(row.focal_mm, 2) if row.focal_mm is not None else f"x{figure(row.focal_ratio, 3)}"
    if row.focal_mm is None and row.focal_ratio is None:
        return "unknown"
    return f"{value} {SHORT_SOURCES.get(row.focal_source, row.focal_source)}"


def gsd_cell(row: PayloadRow) -> str:
    """``3.25>2.12`` where the copies were resampled."""
    before, after = row.gsd_cm, row.gsd_after_cm
    if before and after and abs(after / before - 1.0) > 0.005:
        return f"{before:.2f}>{after:.2f}"
    return figure(before, 2)


def _painter(colour: bool) -> Paint:
    return lambda text, name: f"\x1b[{PAINT[name]}m{text}\x1b[0m" if colour and text else text


def _cut(text: str, most: int) -> str:
    if columns_of(text) <= most:
        return text
    kept = ""
    for c in text:
        if columns_of(kept + c) > most - 1:
            break
        kept += c
    return kept + "…"


def _pad(text: str, size: int, right: bool) -> str:
    gap = " " * max(0, size - columns_of(text))
    return gap + text if right else text + gap


def _wrapped(text: str, width: int) -> List[str]:
    # textwrap counts characters; a line of wide ones is cut to the columns.
    return [_cut(part, width) for part in textwrap.wrap(text, width, break_on_hyphens=False)]


def _table(view: View, width: int, paint: Paint, most: int) -> List[str]:
    shown = view.payload_rows()
    if not shown:
        return []
    cells: Dict[str, List[str]] = {head: [cell(r) for r in shown] for head, _, _, cell in COLUMNS}
    sizes = {h: max(columns_of(h), *(columns_of(c) for c in cells[h])) for h in cells}
    least = {head: min(sizes[head], least) for head, _, least, _ in COLUMNS}
    kept = [c for c in COLUMNS if view.report["subprojects"] or c[0] != "project"]
    if sum(sizes[c[0]] for c in kept) + 2 * (len(kept) - 1) > width:
        kept = [c for c in kept if c[0] != "camera"]  # a payload's whole name tells more
    for head in DROPPED:
        if sum(least[c[0]] for c in kept) + 2 * (len(kept) - 1) <= width:
            break
        kept = [c for c in kept if c[0] != head]
    names = [c[0] for c in kept]
    while sum(sizes[h] for h in names) + 2 * (len(names) - 1) > width:
        widest = max((h for h in names if sizes[h] > least[h]), key=lambda h: (sizes[h] - least[h], h), default=None)
        if widest is None:
            break
        sizes[widest] -= 1
    heading = paint("  ".join(_pad(h, sizes[h], right) for h, right, _, _ in kept).rstrip(), "bold")
    told = []
    for index in range(len(shown)):
        parts = []
        for head, right, _, _ in kept:
            parts.append(_pad(_cut(svg.shortened(cells[head][index], sizes[head]), sizes[head]), sizes[head], right))
        told.append("  ".join(parts).rstrip())
    return [heading, *_capped(told, most, "payload")]


def _gains(view: View, width: int, paint: Paint, most: int) -> List[str]:
    """What resampling brings and costs, coarsest flights first; nothing once it was done."""
    if view.written:
        return []
    actions = sorted(
        (a for a in view.report["actions"] if story.gain_words(a)),
        key=lambda a: (-a["gain"]["ratio"], a["profile"], a["flight"]),
    )
    told = [_cut(f"  {a['flight']}: {story.gain_words(a)}", width) for a in actions]
    return [paint("Resampling", "bold"), *_capped(told, most, "flight")] if told else []


def _findings(view: View, width: int, paint: Paint, most: int) -> List[str]:
    """One line each, worst first; two where there is room."""
    groups = view.finding_groups()
    bodies = []
    for group in groups:
        times = f" (x{group.count:,})" if group.count > 1 else ""
        bodies.append(_wrapped(f"{group.code}{times}: {group.message}", width - INDENT))
    shown = len(groups) if len(groups) <= most else max(0, most - 1)
    room = most - shown - (1 if shown < len(groups) else 0)
    told = []
    for group, body in zip(groups[:shown], bodies):
        full = min(len(body), 2 if room > 0 else 1)
        room -= full - 1
        if full < len(body):
            body = [*body[: full - 1], _cut(f"{body[full - 1]} …", width - INDENT)]
        told.append(paint(group.severity, group.severity) + " " * (INDENT - len(group.severity)) + body[0])
        told.extend(" " * INDENT + part for part in body[1:])
    if shown < len(groups):
        told.append(" " * INDENT + f"and {plural(len(groups) - shown, 'more kind')} in the report")
    return told


def _projects(view: View, width: int, paint: Paint, most: int) -> List[str]:
    told = []
    for project in view.report["subprojects"]:
        where = f"projects/{project['name']}" if view.written else project["name"]
        text = f"  {where}: {plural(len(project['frames']), 'frame')}, {project['route']}{_figures(project)}"
        route = paint(project["route"], ROUTE_PAINT[project["route"]])
        told.append(_cut(text, width).replace(f" {project['route']}", f" {route}", 1))
    head = "Written" if view.written else "Proposed"
    return [paint(head, "bold"), *_capped(told, most, "project")] if told else []


def _figures(project: Mapping[str, Any]) -> str:
    found = project["alignment"]
    if found is None:
        return "" if not project["reasons"] else f"; {project['reasons'][0]}"
    parts = [f"{in_main(found)}/{found['frames']} placed"]
    if found["mean_reproj_error_px"] is not None:
        parts.append(f"{found['mean_reproj_error_px']:.2f} px")
    if found["gps_rmse_m"] is not None:
        parts.append(f"GPS {found['gps_rmse_m']:.1f} m")
    return f" ({', '.join(parts)})"


def _next(view: View, out: str) -> str:
    """The command that follows, or nothing where none helps."""
    report = view.report
    if report["verdict"] == "blocked" or not report["frames"]:
        return ""
    if not view.written:
        paths: Sequence[str] = report["inputs"]["paths"]
        return f"sensorgate run {' '.join(story.quoted(p) for p in paths)} --out {story.quoted(out)}"
    ready = [s["name"] for s in report["subprojects"] if s["route"] != "unproven"]
    asked = "" if ready else " --include-unproven"
    ready = ready or [s["name"] for s in report["subprojects"]]
    script = story.quoted(f"{out}/projects/{ready[0]}/sensorgate/odm.sh")
    return f"sensorgate submit {story.quoted(out)} --node URL{asked}, or {script}"
