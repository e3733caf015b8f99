"""Small charts of one alignment: who matches whom, GPS residuals, bowing."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from . import svg
from .plane import Plane, has_position
from .view import View, figure

WIDTH = 340.0
MOST_NODES = 12
MOST_POINTS = 1500
MOST_LINES = 600
STRONG_INLIERS = 400.0
Colours = Mapping[str, int]


def colours(view: View) -> Dict[str, int]:
    """Payload id to its colour's number, the same on the whole page."""
    return {p["id"]: i for i, p in enumerate(view.report["payloads"])}


def match_graph(found: Mapping[str, Any], least: float, colour: Colours) -> str:
    """Payloads as circles, verified matches between them as lines; empty when there is nothing to compare."""
    pairs = found.get("pairs", [])
    nodes = sorted({p[end] for p in pairs for end in ("a", "b")})
    if not 2 <= len(nodes) <= MOST_NODES:
        return ""
    height = 124.0 if len(nodes) == 2 else 280.0
    middle, reach = (WIDTH / 2, height / 2 - 8), (98.0 if len(nodes) < 4 else 112.0, height / 2 - 50)
    turn = math.pi if len(nodes) == 2 else -math.pi / 2
    at = {
        node: (
            middle[0] + reach[0] * math.cos(turn + 2 * math.pi * i / len(nodes)),
            middle[1] + reach[1] * math.sin(turn + 2 * math.pi * i / len(nodes)),
        )
        for i, node in enumerate(nodes)
    }
    body: List[str] = []
    words = []
    for pair in pairs:
        if pair["a"] == pair["b"]:
            continue
        inliers = pair["inliers_median"]
        strong = inliers is not None and inliers >= least
        a, b = at[pair["a"]], at[pair["b"]]
        width = 1.5 + 6.5 * min(1.0, (inliers or 0.0) / STRONG_INLIERS)
        body.append(
            f'<path d="M{svg.number(a[0])} {svg.number(a[1])}L{svg.number(b[0])} {svg.number(b[1])}" '
            f'class="edge{"" if strong else " weak"}" stroke-width="{svg.number(width)}"/>'
        )
        spot = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
        body.append(svg.rectangle(spot[0] - 22, spot[1] - 11, 44, 22, "plate"))
        body.append(
            svg.text(spot[0], spot[1] + 4.5, figure(inliers, 0), "strong" if strong else "strong bad", "middle")
        )
        words.append(f"{pair['a']} to {pair['b']}: {figure(inliers, 0)}")
    own = {p["a"]: p["inliers_median"] for p in pairs if p["a"] == p["b"]}
    for node in nodes:
        x, y = at[node]
        body.append(svg.circle((x, y), 25, f"node {svg.colour_class(colour.get(node, 7))}"))
        body.append(svg.text(x, y + 4.5, figure(own.get(node), 0), "strong", "middle"))
        body.append(svg.text(min(max(x, 60), WIDTH - 60), y + 41, svg.shortened(node, 19), "label", "middle"))
    return svg.figure(WIDTH, height, f"Median verified matches per pair of frames. {'; '.join(words)}.", body)


def gps_chart(found: Mapping[str, Any], colour: Colours) -> str:
    """Residuals per payload, together (dot) and alone (ring), against what they had to stay below."""
    rows: List[Tuple[str, str, Optional[float], Optional[float], Optional[float]]] = []
    for payload in found.get("payloads", []):
        together, alone = payload.get("together") or {}, payload.get("alone") or {}
        for axis, word in (("horizontal", "level"), ("vertical", "height")):
            limit = found.get(f"gps_limit_{axis}_m")
            rows.append((payload["payload"], word, together.get(f"{axis}_m"), alone.get(f"{axis}_m"), limit))
    values = [v for row in rows for v in row[2:] if v is not None]
    if not rows or not any(row[2] is not None or row[3] is not None for row in rows) or len(rows) > 2 * MOST_NODES:
        return ""
    left, right, step = 52.0, WIDTH - 12.0, 19.0
    top = max(values) * 1.08 or 1.0

    def place(value: float) -> float:
        return left + (right - left) * value / top

    body: List[str] = []
    y = -4.0
    words = []
    for name, word, together, alone, limit in rows:
        if word == "level":
            y += 20
            body.append(svg.text(2, y, svg.shortened(name, 40), "label"))
        y += step
        css = svg.colour_class(colour.get(name, 7))
        body.append(svg.text(left - 8, y + 1, word, "tick", "end"))
        body.append(svg.line((left, y - 3), (right, y - 3), "track"))
        if limit is not None:
            body.append(svg.line((place(limit), y - 11), (place(limit), y + 5), "limit"))
        if alone is not None:
            body.append(svg.circle((place(alone), y - 3), 5.5, f"ring {css}"))
        if together is not None:
            body.append(svg.circle((place(together), y - 3), 4.2, f"dot {css}"))
        words.append(
            f"{name} {word}: {figure(together, 2)} m together, {figure(alone, 2)} m alone, limit {figure(limit, 1)} m"
        )
    body.extend(_axis(place, top, left, y + 12, "m"))
    return svg.figure(WIDTH, y + 32, f"GPS residual per payload. {'; '.join(words)}.", body)


def _axis(place: Any, top: float, left: float, y: float, unit: str) -> List[str]:
    body = []
    for value in svg.ticks(0.0, top, 5):
        body.append(svg.line((place(value), y - 4), (place(value), y), "axis"))
        body.append(svg.text(place(value), y + 13, f"{value:g}{' ' + unit if value == 0 else ''}", "tick", "middle"))
    return body


def residual_chart(view: View, found: Mapping[str, Any], colour: Colours) -> str:
    """Camera centre minus GPS, seen from above, one dot per frame, the limit as a circle."""
    known = [r for r in found.get("residuals", []) if r["east_m"] is not None and r["north_m"] is not None]
    if len(known) < 3:
        return ""
    lengths = sorted(math.hypot(r["east_m"], r["north_m"]) for r in known)
    limit = found.get("gps_limit_horizontal_m")
    reach = 1.12 * max(lengths[int(0.98 * (len(lengths) - 1))], limit or 0.0, 0.01)
    height, radius = 220.0, 96.0
    middle = (WIDTH / 2, 106.0)
    scale = radius / reach
    body = [
        svg.line((middle[0] - radius, middle[1]), (middle[0] + radius, middle[1]), "track"),
        svg.line((middle[0], middle[1] - radius), (middle[0], middle[1] + radius), "track"),
    ]
    if limit is not None:
        body.append(svg.circle(middle, limit * scale, "limit-circle"))
        body.append(
            svg.text(
                middle[0] + limit * scale * 0.71 + 4, middle[1] + limit * scale * 0.71 + 10, f"{limit:.1f} m", "tick"
            )
        )
    body.append(svg.text(middle[0] + 4, middle[1] - radius + 9, "N", "tick"))
    spots: Dict[int, List[svg.Point]] = {}
    stride = max(1, math.ceil(len(known) / MOST_POINTS))
    for residual in known[::stride]:
        east, north = residual["east_m"], residual["north_m"]
        pull = min(1.0, reach / max(1e-9, math.hypot(east, north)))
        frame = view.frames.get(residual["path"])
        number = colour.get(frame["payload"], 7) if frame else 7
        spots.setdefault(number, []).append((middle[0] + east * pull * scale, middle[1] - north * pull * scale))
    body.extend(svg.dots(spots[n], svg.colour_class(n), 4.0) for n in sorted(spots))
    median = lengths[len(lengths) // 2]
    figures = f"{len(known):,} frames, median {median:.2f} m, largest {lengths[-1]:.2f} m"
    title = f"Camera positions against GPS from above: {figures}."
    return svg.figure(WIDTH, height, title, body)


def residual_map(view: View, found: Mapping[str, Any], colour: Colours) -> str:
    """From each GPS position a line to where the model puts the camera, lengthened so that a pattern shows."""
    known = [
        (view.frames[r["path"]], (float(r["east_m"]), float(r["north_m"])))
        for r in found.get("residuals", [])
        if r["path"] in view.frames and None not in (r["east_m"], r["north_m"]) and has_position(view.frames[r["path"]])
    ]
    if len(known) < 6:
        return ""
    known = known[:: max(1, math.ceil(len(known) / MOST_LINES))]
    plane = Plane([(f["latitude"], f["longitude"]) for f, _ in known], (WIDTH, 150.0, 240.0), 30.0)
    lengths = sorted(math.hypot(*miss) for _, miss in known)
    typical = max(lengths[int(0.9 * (len(lengths) - 1))], 1e-3)
    shown = svg.nice_step(typical, 1)
    stretch = 30.0 / shown
    dots: Dict[int, List[svg.Point]] = {}
    lines: Dict[int, List[str]] = {}
    for frame, (east, north) in known:
        at = plane((frame["latitude"], frame["longitude"]))
        # One wild residual must not cross the picture: it is cut at four times the key's length.
        cut = min(1.0, 4.0 * shown / max(1e-9, math.hypot(east, north)))
        number = colour.get(frame["payload"], 7)
        dots.setdefault(number, []).append(at)
        step = f"l{svg.number(east * cut * stretch)} {svg.number(-north * cut * stretch)}"
        lines.setdefault(number, []).append(f"M{svg.number(at[0])} {svg.number(at[1])}{step}")
    body = [f'<path d="{"".join(lines[n])}" class="miss {svg.colour_class(n)}"/>' for n in sorted(lines)]
    body += [svg.dots(dots[n], svg.colour_class(n), 3.6) for n in sorted(dots)]
    base = plane.height + 10
    body += [
        f'<path d="M6 {svg.number(base)}h30" class="miss key-line"/>',
        svg.text(42, base + 4, f"{shown:g} m off", "tick"),
        svg.text(WIDTH - 4, base + 4, "north is up", "tick", "end"),
    ]
    title = f"Where the model puts each camera against its GPS, {len(known):,} frames; the key line is {shown:g} m."
    return svg.figure(WIDTH, plane.height + 20, title, body)


def bowing_chart(found: Mapping[str, Any], sigma: float) -> str:
    """The block's bend as a cross-section, centre to edges, with what could not be told from flat as a band."""
    bow, error = found["bowing_m"], found["bowing_se_m"]
    if bow is None:
        return ""
    band = sigma * error if error is not None else 0.0
    top = 1.15 * max(abs(bow), band, 0.02)
    left, right, middle, half = 44.0, WIDTH - 12.0, 66.0, 46.0
    radius = found.get("bowing_radius_m")

    def curve(amount: float) -> Sequence[svg.Point]:
        steps = [i / 20 - 1 for i in range(41)]
        return [(left + (right - left) * (s + 1) / 2, middle - half * amount * s * s / top) for s in steps]

    body = []
    if band:
        outline = [*curve(band), *reversed(curve(-band))]
        body.append(f'<path d="M{"L".join(f"{svg.number(x)} {svg.number(y)}" for x, y in outline)}z" class="band"/>')
    body.append(svg.line((left, middle), (right, middle), "track"))
    body.append(svg.polyline(curve(bow), "bend" if abs(bow) <= band or not band else "bend called"))
    for value in (-top / 1.15, 0.0, top / 1.15):
        body.append(
            svg.text(left - 6, middle - half * value / top + 4, f"{value:+.2f}" if value else "0 m", "tick", "end")
        )
    ends = f"{radius:.0f} m" if radius else "edge"
    body.append(svg.text(left, 128, ends, "tick"))
    body.append(svg.text((left + right) / 2, 128, "centre", "tick", "middle"))
    body.append(svg.text(right, 128, ends, "tick", "end"))
    where = "within" if band and abs(bow) <= band else "beyond"
    title = f"Bowing {bow:+.2f} m from centre to edge, {where} {sigma:g} standard errors (± {band:.2f} m)."
    return svg.figure(WIDTH, 136, title, body)
