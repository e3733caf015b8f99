"""How ground resolution and focal length spread over payloads."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from typing import Any, Dict, List, Mapping, Tuple

from . import svg
from .charts import Colours
from .view import View

WIDTH = 460.0
BINS = 72
MOST_ROWS = 24


def gsd_chart(view: View, colour: Colours) -> str:
    """One histogram per payload on one logarithmic axis; the written copies below the line."""
    rows: List[Tuple[str, List[float], List[float]]] = []
    for payload in view.report["payloads"]:
        frames = [f for f in view.report["frames"] if f["payload"] == payload["id"] and not f["reason"]]
        before = [f["gsd_cm"] for f in frames if f["gsd_cm"]]
        after = [f["gsd_after_cm"] for f in frames if f.get("gsd_after_cm")]
        if before:
            rows.append((payload["id"], before, after))
    if not rows or len(rows) > MOST_ROWS:
        return ""
    values = [v for _, before, after in rows for v in (*before, *after)]
    low, high = math.log(min(values) / 1.15), math.log(max(values) * 1.15)
    left, right = 8.0, WIDTH - 8.0

    def place(gsd_cm: float) -> float:
        return left + (right - left) * (math.log(gsd_cm) - low) / (high - low)

    body: List[str] = []
    y = 0.0
    words = []
    for name, before, after in rows:
        css = svg.colour_class(colour.get(name, 7))
        middle = statistics.median(before)
        written = statistics.median(after) if after else middle
        changed = abs(written / middle - 1.0) > 0.005
        y += 16
        body.append(svg.text(left, y, svg.shortened(name, 44), "label"))
        said = f"{middle:.2f} → {written:.2f} cm" if changed else f"{middle:.2f} cm"
        body.append(svg.text(right, y, said, "label strong", "end"))
        y += 26
        body.append(svg.line((left, y), (right, y), "track"))
        body.append(_bars({place(v): n for v, n in Counter(before).items()}, left, right, y, -22.0, css))
        if changed:
            body.append(_bars({place(v): n for v, n in Counter(after).items()}, left, right, y, 16.0, f"after {css}"))
            y += 16
        words.append(f"{name}: {middle:.2f} cm" + (f", written at {written:.2f} cm" if changed else ""))
        y += 4
    y += 8
    for value in _log_ticks(math.exp(low), math.exp(high)):
        body.append(svg.line((place(value), y - 4), (place(value), y), "axis"))
        body.append(svg.text(place(value), y + 14, f"{value:g} cm", "tick", "middle"))
    return svg.figure(WIDTH, y + 20, f"Ground resolution, cm per pixel. {'; '.join(words)}.", body)


def _bars(places: Mapping[float, int], left: float, right: float, y: float, height: float, css: str) -> str:
    """A histogram of place -> count as one path, its tallest bar ``height`` high (negative: upwards)."""
    step = (right - left) / BINS
    counts: Dict[int, int] = {}
    for x, count in sorted(places.items()):
        index = min(BINS - 1, max(0, int((x - left) / step)))
        counts[index] = counts.get(index, 0) + count
    most = max(counts.values())
    bars = "".join(
        f"M{svg.number(left + i * step)} {svg.number(y)}v{svg.number(height * math.sqrt(counts[i] / most))}"
        f"h{svg.number(step - 1)}V{svg.number(y)}z"
        for i in sorted(counts)
    )
    return f'<path d="{bars}" class="bars {css}"/>'


def _log_ticks(low: float, high: float) -> List[float]:
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    steps = (1.0, 2.0, 5.0) if high / low > 2.5 else (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
    found = [m * 10.0**e for e in range(first, last + 1) for m in steps]
    return [v for v in found if low <= v <= high]


def focal_chart(view: View, colour: Colours) -> str:
    """One histogram per camera whose focal tags are not all equal, as per cent off their mean."""
    limit = view.threshold.get("focal_variance", 0.03)
    owner = {p: i["id"] for i in view.report["payloads"] for p in i["profiles"]}
    rows: List[Tuple[Mapping[str, Any], Dict[float, int], float]] = []
    tags: Dict[str, Dict[float, int]] = {}
    for frame in view.report["frames"]:
        # Copies carry one tag per camera; what the camera wrote is kept beside it.
        tag = (frame.get("original_tags") or {}).get("focal_mm") or frame["focal_mm"]
        if tag and frame["profile"]:
            counts = tags.setdefault(frame["profile"], {})
            counts[tag] = counts.get(tag, 0) + 1
    for profile in view.report["profiles"]:
        counts = tags.get(profile["id"], {})
        if len(counts) > 1:
            mean = sum(v * n for v, n in counts.items()) / sum(counts.values())
            rows.append((profile, {v / mean - 1.0: n for v, n in counts.items()}, mean))
    if not rows or len(rows) > MOST_ROWS:
        return ""
    reach = 1.2 * max(limit / 2, max(abs(d) for _, counts, _ in rows for d in counts))
    left, right = 14.0, WIDTH - 14.0

    def place(deviation: float) -> float:
        return left + (right - left) * (deviation + reach) / (2 * reach)

    body: List[str] = []
    y = 4.0
    words = []
    for profile, counts, mean in rows:
        y += 16
        spread = max(counts) - min(counts)
        said = f"{profile['id']}: {100 * spread:.1f} % about {mean:.2f} mm"
        body.append(svg.text(left - 6, y, svg.shortened(said, 58), "label"))
        y += 28
        body.append(svg.rectangle(place(-limit / 2), y - 22, place(limit / 2) - place(-limit / 2), 22, "band"))
        body.append(svg.line((left, y), (right, y), "track"))
        css = svg.colour_class(colour.get(owner.get(profile["id"], ""), 7))
        body.append(_bars({place(d): n for d, n in counts.items()}, left, right, y, -22.0, css))
        words.append(said)
        y += 6
    y += 8
    for value in svg.ticks(-100 * reach, 100 * reach, 5):
        body.append(svg.line((place(value / 100), y - 4), (place(value / 100), y), "axis"))
        body.append(
            svg.text(place(value / 100), y + 14, f"{value:+g} %" if abs(value) > 1e-9 else "mean", "tick", "middle")
        )
    return svg.figure(WIDTH, y + 20, f"Focal tags around their mean. {'; '.join(words)}.", body)
