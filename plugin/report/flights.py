"""The flights as rows of a table: the bands of one rig's flight in one row (pure)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Dict, List, Mapping, Optional, Tuple

from .story import HEIGHT_WORDS, gain_words
from .view import View, figure, in_words


@dataclass(frozen=True)
class FlightRow:
    """One flight of one payload, its bands taken together where the same was done to all of them."""

    name: str
    payload: str
    bands: int
    frames: int
    start: str
    height: str
    height_source: str
    gsd: str
    scale: str
    words: str
    gain: str


def flight_rows(view: View) -> List[FlightRow]:
    """In the report's order; a rig's bands stand where its first band stood."""
    actions = {(a["profile"], a["flight"]): a for a in view.report["actions"]}
    rows: Dict[Tuple[Any, ...], List[FlightRow]] = {}
    for flight in view.report["flights"]:
        row = _row(view, flight, actions.get((flight["profile"], flight["id"])))
        profile = view.profiles.get(flight["profile"])
        alone = flight["id"] if profile is None or not profile["band"] or not row.payload else ""
        leg = flight["id"].rpartition(":")[2]
        key = (alone, row.payload, leg, row.start, row.height, row.gsd, row.scale, row.words, row.gain)
        rows.setdefault(key, []).append(row)
    return [_joined(key[2], members) for key, members in rows.items()]


def _joined(leg: str, rows: List[FlightRow]) -> FlightRow:
    first = rows[0]
    if len(rows) == 1:
        return first
    return replace(first, name=f"{first.payload}:{leg}", bands=len(rows), frames=sum(r.frames for r in rows))


def _row(view: View, flight: Mapping[str, Any], action: Optional[Mapping[str, Any]]) -> FlightRow:
    resampled = action is not None and action["scale"] != 1
    gsd = figure(flight["gsd_cm"], 2)
    owner = view.owners.get(flight["id"], ())
    return FlightRow(
        name=flight["id"],
        payload=owner[0] if owner else "",
        bands=1,
        frames=len(flight["frames"]),
        start=(flight["start"] or "–")[:16].replace("T", " "),
        height=figure(flight["height_m"], 0),
        height_source=HEIGHT_WORDS.get(flight["height_source"], ""),
        gsd=f"{gsd} → {figure(action['gsd_after_cm'], 2)}" if action and resampled else gsd,
        scale=f"× {action['scale']:.2f}" if action and resampled else "–",
        words=in_words(_words(action)) if action else "",
        gain=gain_words(action),
    )


def _words(action: Mapping[str, Any]) -> str:
    """What was done to the frames of a flight and why."""
    said = [reason.rstrip(".") for reason in action["reasons"]]
    lut = action["lut"]
    if lut:
        offsets = ", ".join(f"{v:+.0f}" for v in lut["offset_dn"])
        only = "" if lut["written"] else ", for the alignment only"
        said.append(f"brightness matched to {lut['reference']} (offset {offsets} of 255){only}")
    return "; ".join(said)
