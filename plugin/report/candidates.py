"""The calibrations that were tried on the same matches: which won, by how much, and why the others lost (pure)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from .view import SOURCE_WORDS, figure, give_or_take, in_words

SAME_ERROR = 0.01
_FREE = {"solved": "solved", "heights": "from measured heights"}


@dataclass(frozen=True)
class Candidate:
    """One calibration as a row: what was tried, its figures, what became of it."""

    name: str
    focal_ratio: str
    error: str
    level: str
    vertical: str
    height: str
    bowing: str
    outcome: str
    chosen: bool


@dataclass(frozen=True)
class Contest:
    """The candidates of one camera: the winner first, the ruled out last."""

    profile: str
    winner: str
    margin: str
    rows: Tuple[Candidate, ...]


def contests(found: Mapping[str, Any], sigma: float = 3.0) -> List[Contest]:
    """One contest per camera that had candidates; bowing differs beyond ``sigma`` standard errors."""
    tried: Dict[str, List[Mapping[str, Any]]] = {}
    for candidate in found.get("candidates", []):
        tried.setdefault(candidate["profile"], []).append(candidate)
    return [_contest(profile, rows, sigma) for profile, rows in tried.items()]


def _contest(profile: str, rows: Sequence[Mapping[str, Any]], sigma: float) -> Contest:
    ordered = sorted(rows, key=lambda r: (not r["chosen"], bool(r.get("vetoed"))))
    winner = next((r for r in rows if r["chosen"]), None)
    return Contest(
        profile=profile,
        winner=name_of(winner) if winner else "",
        margin=_margin(winner, rows, sigma) if winner else "None was chosen.",
        rows=tuple(_row(r) for r in ordered),
    )


def _row(row: Mapping[str, Any]) -> Candidate:
    bowing = row.get("bowing") or {}
    lost = in_words(row.get("vetoed") or "") or "possible, not needed"
    return Candidate(
        name=name_of(row),
        focal_ratio=figure(row.get("focal_ratio"), 4),
        error=figure(row.get("mean_reproj_error_px"), 2),
        level=figure(row.get("gps_horizontal_m"), 2),
        vertical=figure(row.get("gps_vertical_m"), 2),
        height=figure(row.get("height_m"), 1),
        bowing=give_or_take(bowing.get("bowing_m"), bowing.get("se_m")),
        outcome=("chosen, held fixed" if row["held"] else "chosen, left free") if row["chosen"] else lost,
        chosen=bool(row["chosen"]),
    )


def name_of(row: Mapping[str, Any]) -> str:
    """``focal from the calibration sheet, no distortion``; the trial's own name where its sources are not known."""
    focal, bend = row.get("focal_source"), row.get("distortion_source")
    if not focal or not bend:
        return str(row.get("name", ""))
    first = f"focal {_FREE[focal]}" if focal in _FREE else f"focal from {SOURCE_WORDS.get(focal, focal)}"
    if bend in ("none", "corrected-in-camera"):
        return f"{first}, no distortion"
    return f"{first}, distortion {_FREE[bend] if bend in _FREE else f'from {SOURCE_WORDS.get(bend, bend)}'}"


def _margin(winner: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], sigma: float) -> str:
    """The nearest rival, and where the two differ."""
    rivals = [r for r in rows if not r["chosen"] and not r.get("vetoed") and r.get("mean_reproj_error_px") is not None]
    if not rivals:
        return "Every other candidate was ruled out." if len(rows) > 1 else "It was the only candidate."
    rival = min(rivals, key=lambda r: (r["mean_reproj_error_px"], str(r.get("name"))))
    apart = [words for words in (_errors(winner, rival), _bowings(winner, rival, sigma), _fits(winner, rival)) if words]
    said = "; ".join(apart) if apart else "no figure tells them apart, so the better source decided"
    return f"Nearest rival: {name_of(rival)}; {said}."


def _errors(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    a, b = one.get("mean_reproj_error_px"), other.get("mean_reproj_error_px")
    if a is None or b is None or not b or abs(a / b - 1.0) < SAME_ERROR:
        return ""
    return f"reprojection error {a:.2f} against {b:.2f} px"


def _bowings(one: Mapping[str, Any], other: Mapping[str, Any], sigma: float) -> str:
    a, b = one.get("bowing") or {}, other.get("bowing") or {}
    if None in (a.get("bowing_m"), b.get("bowing_m"), a.get("se_m"), b.get("se_m")):
        return ""
    # Both were fitted to the same cameras: the noise that they share is not in their difference.
    if abs(a["bowing_m"] - b["bowing_m"]) <= sigma * min(a["se_m"], b["se_m"]):
        return ""
    return f"bowing {a['bowing_m']:+.2f} against {b['bowing_m']:+.2f} m"


def _fits(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    a, b = _gps(one), _gps(other)
    if a is None or b is None or not b or abs(a / b - 1.0) < 10 * SAME_ERROR:
        return ""
    return f"GPS fit {a:.2f} against {b:.2f} m"


def _gps(row: Mapping[str, Any]) -> Optional[float]:
    level, vertical = row.get("gps_horizontal_m"), row.get("gps_vertical_m")
    return None if level is None or vertical is None else math.hypot(level, vertical)
