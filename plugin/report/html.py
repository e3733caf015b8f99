"""The HTML report: one file that carries everything it needs and asks nothing of the network."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence, Tuple

from ...stages.errors import MissingDependency
from ...stages.thresholds import Thresholds
from . import candidates, charts, checks, distributions, story, svg
from .bands import band_tables
from .flights import flight_rows
from .overlays import BAND_AFTER, BAND_BEFORE, MOST_OVERLAYS
from .pictures import MOST_BYTES, preview_key
from .previews import AFTER, BEFORE, MOST_PREVIEWS
from .survey_map import survey_map
from .view import ROUTE_WORDS, SOURCE_WORDS, SPECTRUM_WORDS, FindingGroup, View, figure, in_words, listing, plural

HERE = Path(__file__).resolve().parent
MOST_LISTED = 400
MOST_SUBJECTS = 40
MOST_GROUPS = 120
MOST_ROWS = 300
# As report.css says it, once.
DARK_STYLE = "@media screen and (prefers-color-scheme: dark)"
MATCH_CAPTION = (
    "Lines: median verified matches between frames of two payloads, dashed where fewer than {:g}. "
    "In a circle: within that payload."
)
GPS_CAPTION = "Dot: in the joint model. Ring: that payload alone. Bar: the limit. A dot far from its ring is an offset."
RESIDUAL_CAPTION = "Solved camera minus GPS, one dot per frame, seen from above. The circle is the limit."
PATTERN_CAPTION = "The same where it was flown, lengthened. Lines that agree are a shift or a bend, not noise."
BOWING_CAPTION = "Cross-section of the block's bend, exaggerated. Inside the band it cannot be told from flat."
ROUTE_ADVICE = {
    "proceed": "Queue it: a trial alignment reconstructed it.",
    "pairwise": "Queue it and look at the seams: its payloads were joined step by step.",
    "isolate": "Queue it on its own; sensorgate fuse puts the products on one grid.",
    "unproven": "Nothing proves yet that it reconstructs. It is submitted only when unproven projects are asked for.",
}


_ROUTES = tuple(ROUTE_ADVICE)


def render(report: Mapping[str, Any], previews: Mapping[str, bytes] = {}) -> str:
    """Turn a report into one HTML document.

    ``previews`` are JPEG bytes by ``previews.preview_key(path, BEFORE | AFTER)``,
    of bands by ``BAND_BEFORE | BAND_AFTER``; beyond ``MOST_PREVIEWS`` and
    ``MOST_OVERLAYS`` pairs or ``MOST_BYTES`` each they are left out.
    Raises ``MissingDependency`` where Jinja2 is not installed.
    """
    try:
        import jinja2
    except ImportError as error:
        raise MissingDependency("Jinja2", "the HTML report", "pip install 'sensorgate[report]'") from error
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(str(HERE)),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    view = View(dict(report))
    environment.filters.update(figure=figure, listing=listing, plural=plural, in_words=in_words, csp_hash=_csp_hash)
    environment.globals.update(
        spectrum_words=SPECTRUM_WORDS,
        route_words=ROUTE_WORDS,
        route_advice=ROUTE_ADVICE,
        source_words=SOURCE_WORDS,
        spread=story.spread_words,
    )
    return environment.get_template("report.html").render(
        **_context(view),
        drawing=_drawings(view),
        pictures=_pictures(view, previews),
        rigs=_rigs(view, previews),
        style=_trusted((HERE / "report.css").read_text(encoding="utf-8")),
        most_listed=MOST_LISTED,
        most_subjects=MOST_SUBJECTS,
        most_rows=MOST_ROWS,
    )


def _csp_hash(script: str) -> str:
    """The page's own script by its digest: the browser runs no other."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")


def _trusted(markup: str) -> Any:
    """Mark text of our own as HTML: a file beside this module, or a drawing that escaped what it was given."""
    import markupsafe

    return markupsafe.Markup(markup)


def _context(view: View) -> Dict[str, Any]:
    report = view.report
    headline, detail = story.verdict(view)
    groups = view.finding_groups()
    return {
        "view": view,
        "report": report,
        "headline": headline,
        "detail": detail,
        "comparisons": story.comparisons(view),
        "odm_notes": (report.get("odm") or {}).get("notes", []),
        "rows": view.payload_rows(),
        "colour": {p: svg.colour_class(i) for p, i in charts.colours(view).items()},
        "layer": charts.colours(view),
        "projects": [_project(view, s) for s in sorted(report["subprojects"], key=lambda s: _ROUTES.index(s["route"]))],
        "groups": groups[:MOST_GROUPS],
        "groups_more": len(groups) - len(groups[:MOST_GROUPS]),
        "severities": [(s, sum(g.count for g in groups if g.severity == s)) for s in ("error", "warning", "info")],
        "flights": flight_rows(view),
        "told_of": _told_of(view, groups),
        "reading": checks.READING,
        "points": [{"check": False, **point} for point in report["inputs"].get("gcp", [])],
        "lost": any((s["alignment"] or {}).get("unregistered") for s in report["subprojects"]),
        "excluded": story.excluded_groups(view),
        "reason_words": _reason_words(view),
        "tiles": _tiles(view),
        "thresholds": _thresholds(report),
    }


def _project(view: View, project: Mapping[str, Any]) -> Dict[str, Any]:
    found = project["alignment"] or {}
    return {
        **project,
        "why": checks.why(view, project),
        "checks": checks.alignment_checks(view, project),
        "placed": checks.in_main(found) if found else None,
        "parts": checks.parts(found),
        "control": checks.control_table(found),
        "words": story.option_words(project["options"]),
        "contests": candidates.contests(found, view.threshold.get("bowing_sigma", 3.0)),
        "notes": found.get("notes", []),
        "rung": checks.RUNG_WORDS.get(found.get("rung") or "", found.get("rung") or ""),
    }


def _told_of(view: View, groups: Sequence[FindingGroup]) -> List[Tuple[str, int, int]]:
    """(payload, its number, findings about it) of each payload that a finding is about, for the filter."""
    counts: Dict[str, int] = {}
    for group in groups:
        for line in group.lines:
            for payload in line.payloads:
                counts[payload] = counts.get(payload, 0) + 1
    return [(payload, number, counts[payload]) for payload, number in charts.colours(view).items() if payload in counts]


def _tiles(view: View) -> List[Tuple[str, str]]:
    """The few figures at the top."""
    report = view.report
    left = len(view.excluded())
    return [
        (f"{len(report['frames']):,}", "frames" if len(report["frames"]) != 1 else "frame"),
        (f"{left:,}", "left out"),
        (f"{len(report['profiles']):,}", "true cameras" if len(report["profiles"]) != 1 else "true camera"),
        (f"{len(report['payloads']):,}", "payloads" if len(report["payloads"]) != 1 else "payload"),
        *[(f"{n:,}", "projects" if n != 1 else "project") for n in (len(report["subprojects"]),) if n],
    ]


def _reason_words(view: View) -> Dict[str, str]:
    """What a reason code means, in the words of the first finding that has it."""
    words: Dict[str, str] = {}
    for finding in view.report["findings"]:
        words.setdefault(finding["code"], finding["message"])
    return words


def _thresholds(report: Mapping[str, Any]) -> List[Dict[str, Any]]:
    """Changed ones first, each with its unit and reason."""
    known = Thresholds.describe()
    changed = report["thresholds"]["changed"]
    rows = [
        {
            "name": name,
            "value": value,
            "default": known.get(name, {}).get("default"),
            "unit": known.get(name, {}).get("unit", ""),
            "why": known.get(name, {}).get("why", ""),
            "changed": name in changed,
        }
        for name, value in report["thresholds"]["all"].items()
    ]
    return sorted(rows, key=lambda r: not r["changed"])


def _drawings(view: View) -> Dict[str, Any]:
    colour = charts.colours(view)
    drawn_map = survey_map(view)
    limit = view.threshold
    projects = {}
    for project in view.report["subprojects"]:
        found = project["alignment"]
        if not found:
            continue
        least = limit.get("min_inliers", 30)
        drawn = (
            ("Matches between payloads", MATCH_CAPTION.format(least), charts.match_graph(found, least, colour)),
            ("GPS fit by payload", GPS_CAPTION, charts.gps_chart(found, colour)),
            ("GPS residuals", RESIDUAL_CAPTION, charts.residual_chart(view, found, colour)),
            ("GPS residuals on the map", PATTERN_CAPTION, charts.residual_map(view, found, colour)),
            ("Bowing", BOWING_CAPTION, charts.bowing_chart(found, limit.get("bowing_sigma", 3.0))),
        )
        projects[project["name"]] = [(t, c, _trusted(d)) for t, c, d in drawn if d]
    return {
        "maps": [(_trusted(panel.drawing), panel.caption) for panel in drawn_map.panels],
        "map_note": drawn_map.note,
        "projects": projects,
        "gsd": _trusted(distributions.gsd_chart(view, colour)),
        "focal": _trusted(distributions.focal_chart(view, colour)),
    }


def themed(page: str, theme: str) -> str:
    """A rendered page that is ``dark`` or ``light`` whatever the browser prefers, for a frame inside another page."""
    return page.replace(DARK_STYLE, {"dark": "@media screen", "light": "@media not all"}.get(theme, DARK_STYLE), 1)


def _pictures(view: View, previews: Mapping[str, bytes]) -> List[Dict[str, Any]]:
    """Before and after of changed frames, in the order of their paths."""
    pictures: List[Dict[str, Any]] = []
    for raw in sorted(set(previews)):
        if not raw.startswith(f"{BEFORE}:") or len(pictures) >= MOST_PREVIEWS:
            continue
        path = raw[len(BEFORE) + 1 :]
        frame = view.frames.get(path)
        before, after = previews[raw], previews.get(preview_key(path, AFTER), b"")
        if frame and after and _fits(before, after):
            pictures.append({"frame": frame, "before": data_uri(before), "after": data_uri(after)})
    return pictures


def _rigs(view: View, previews: Mapping[str, bytes]) -> List[Dict[str, Any]]:
    """How the bands of each rig were laid on each other, with a picture of each band where there is one."""
    shown: Dict[str, List[Dict[str, Any]]] = {}
    for raw in sorted(set(previews)):
        frame = view.frames.get(raw[len(BAND_BEFORE) + 1 :]) if raw.startswith(f"{BAND_BEFORE}:") else None
        if frame is None or sum(map(len, shown.values())) >= MOST_OVERLAYS:
            continue
        before, after = previews[raw], previews.get(preview_key(frame["path"], BAND_AFTER), b"")
        if _fits(before, after):
            pair = {"frame": frame, "before": data_uri(before), "after": data_uri(after)}
            shown.setdefault(frame["payload"], []).append(pair)
    tables = band_tables(view.report, MOST_ROWS)
    for rig in tables:
        names = {row["profile"]: row["band"] for row in rig["rows"]}
        rig["pictures"] = [
            {**pair, "band": names.get(pair["frame"]["profile"], pair["frame"]["band"])}
            for pair in shown.get(rig["payload"], [])
        ]
    return tables


def _fits(*images: bytes) -> bool:
    return all(0 < len(i) <= MOST_BYTES and i[:2] == b"\xff\xd8" for i in images)


def data_uri(jpeg: bytes) -> str:
    """A JPEG as text for an ``img`` element."""
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode("ascii")
