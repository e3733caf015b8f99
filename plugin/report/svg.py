"""Small pieces of SVG. Every text that goes in is escaped here."""

from __future__ import annotations

import html
import math
from typing import Iterable, List, Sequence, Tuple

Point = Tuple[float, float]
PALETTE_SIZE = 12


def number(value: float) -> str:
    """One decimal, no trailing zero: a drawing of 10,000 frames stays small."""
    shown = f"{value:.1f}"
    return shown[:-2] if shown.endswith(".0") else shown


def colour_class(index: int) -> str:
    """The CSS class of the n-th payload's colour; the palette repeats."""
    return f"c{index % PALETTE_SIZE}"


def shortened(text: str, most: int) -> str:
    """At most ``most`` characters, the middle left out."""
    if len(text) <= most:
        return text
    head = (most - 1) // 2
    return f"{text[:head]}…{text[-(most - 1 - head) :]}"


def text(x: float, y: float, content: str, css: str = "", anchor: str = "start") -> str:
    """A text element."""
    return f'<text x="{number(x)}" y="{number(y)}" class="{css}" text-anchor="{anchor}">{html.escape(content)}</text>'


def line(a: Point, b: Point, css: str) -> str:
    """A straight line."""
    return f'<line x1="{number(a[0])}" y1="{number(a[1])}" x2="{number(b[0])}" y2="{number(b[1])}" class="{css}"/>'


def circle(at: Point, radius: float, css: str) -> str:
    """A circle."""
    return f'<circle cx="{number(at[0])}" cy="{number(at[1])}" r="{number(radius)}" class="{css}"/>'


def rectangle(x: float, y: float, width: float, height: float, css: str) -> str:
    """A rectangle."""
    return f'<rect x="{number(x)}" y="{number(y)}" width="{number(width)}" height="{number(height)}" class="{css}"/>'


def dots(points: Iterable[Point], css: str, width: float) -> str:
    """Many round dots as one path: about ten bytes each. Equal positions are drawn once."""
    unique = sorted({(number(x), number(y)) for x, y in points})
    path = "".join(f"M{x} {y}h0" for x, y in unique)
    return f'<path d="{path}" class="dots {css}" stroke-width="{number(width)}"/>' if path else ""


def polyline(points: Sequence[Point], css: str) -> str:
    """An open line through the points."""
    if len(points) < 2:
        return ""
    return f'<path d="M{"L".join(f"{number(x)} {number(y)}" for x, y in points)}" class="{css}"/>'


def figure(width: float, height: float, title: str, body: Iterable[str], css: str = "chart") -> str:
    """An accessible drawing: ``title`` says in words what the picture shows."""
    return (
        f'<svg class="{css}" viewBox="0 0 {number(width)} {number(height)}" role="img">'
        f"<title>{html.escape(title)}</title>{''.join(body)}</svg>"
    )


def nice_step(span: float, parts: int) -> float:
    """1, 2 or 5 times a power of ten, so that ``span`` takes about ``parts`` of them."""
    if not (span > 0 and math.isfinite(span)):
        return 1.0
    raw = span / max(1, parts)
    power: float = 10.0 ** math.floor(math.log10(raw))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw * 0.999)


def ticks(low: float, high: float, parts: int) -> List[float]:
    """Round values inside ``low``..``high``."""
    step = nice_step(high - low, parts)
    first = math.ceil(low / step - 1e-9)
    return [n * step for n in range(first, math.floor(high / step + 1e-9) + 1)]
