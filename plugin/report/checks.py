"""What an alignment proved, in figures with their limits and, where one is off, in words (pure)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from .view import View, figure, give_or_take, plural

GOOD = "good"
BAD = "bad"
NOTE = "note"
# What each figure says, once for the whole page.
READING = (
    ("Reprojection error", "how far points land from where the model puts them; a wrong model can pass it"),
    ("GPS fit", "how far the solved cameras lie from their GPS; this tells a right model from a wrong one"),
    ("Bowing", "how far the block's middle lies above or below its edge; ± is one standard error, the limit three"),
    ("Matches per pair", "median of verified matches between two frames"),
    ("Ground control", "how far the points miss after laying the free model on them, level / height"),
    ("Check points", "the same for points that moved nothing: the honest figure"),
)
RUNG_WORDS = {
    "quick": "quick settings",
    "alone": "each payload alone",
    "reference": "reference settings",
    "mixed": "settings for mixed blocks",
    "pairwise": "payload by payload",
}


@dataclass(frozen=True)
class Check:
    """One figure of an alignment with its limit. ``state`` is ``good``, ``bad`` or ``note``; ``words`` may be empty."""

    name: str
    value: str
    limit: str
    state: str
    words: str = ""


@dataclass(frozen=True)
class Part:
    """How one payload fared in a model of several."""

    payload: str
    state: str
    placed: str
    matches: str
    error: str
    level: str
    height: str
    bowing: str


@dataclass(frozen=True)
class ControlRow:
    """What one ground point missed, metres."""

    point: str
    kind: str
    images: int
    east: str
    north: str
    up: str
    distance: str
    outlier: bool


def alignment_checks(view: View, project: Mapping[str, Any]) -> List[Check]:
    """The figures of one sub-project's alignment, each with its limit."""
    found = project["alignment"]
    if found is None:
        return []
    limit = view.threshold
    checks: List[Optional[Check]] = [_registered(found, limit, project["route"] != "unproven")]
    if found["components"]:  # without a model there is nothing else to judge
        checks += [_reprojection(found, limit), *_gps(found), *_control(found), _height(found), _bowing(found, limit)]
    return [c for c in (*checks, _inliers(found, limit)) if c]


def in_main(found: Mapping[str, Any]) -> int:
    """Frames in the largest model: what ODM would keep."""
    known = [p["in_main_component"] for p in found.get("payloads", []) if "in_main_component" in p]
    return min(sum(known), int(found["registered"])) if known else int(found["registered"])


def _registered(found: Mapping[str, Any], limit: Mapping[str, float], accepted: bool) -> Check:
    total, placed, models = found["frames"], in_main(found), found["components"]
    enough = total > 0 and placed / total >= limit.get("min_registered_share", 0.5) and models > 0
    state = GOOD if enough and models == 1 else NOTE if enough and accepted else BAD
    outside = plural(total - placed, "frame")
    words = (
        ""
        if models == 1 and placed == total
        else f"{outside} found no place; the rest hang together."
        if models == 1
        else "No model could be built."
        if models == 0
        else f"The frames fall apart into {models} models; ODM would keep the largest, without {outside}."
    )
    return Check("Frames placed", f"{placed:,} of {total:,}", "in one model", state, words)


def _reprojection(found: Mapping[str, Any], limit: Mapping[str, float]) -> Check:
    error, most = found["mean_reproj_error_px"], limit.get("max_reproj_error_px", 2.0)
    state = BAD if error is None or error > most else GOOD
    return Check("Reprojection error", figure(error, 2, "px"), f"≤ {most:.1f} px", state)


def _gps(found: Mapping[str, Any]) -> List[Check]:
    checks = []
    for key, name in (("horizontal", "GPS fit, level"), ("vertical", "GPS fit, height")):
        value, most = found.get(f"gps_{key}_m"), found.get(f"gps_limit_{key}_m")
        if value is None:
            continue
        state = NOTE if most is None else GOOD if value <= most else BAD
        checks.append(Check(name, figure(value, 2, "m"), f"≤ {most:.1f} m" if most is not None else "", state))
    if not checks:
        value = found["gps_rmse_m"]
        words = "" if value is not None else "There is no GPS to hold the model against."
        checks.append(Check("GPS fit", figure(value, 2, "m"), "", NOTE, words))
    return checks


def _control(found: Mapping[str, Any]) -> List[Check]:
    control = found.get("control")
    if not control:
        return []
    state = {"pass": GOOD, "fail": BAD}.get(control["verdict"], NOTE)
    most = control.get("limit_m")
    limit = f"≤ {most:.2f} m" if most is not None else ""
    value = _two(control["horizontal_m"], control["vertical_m"])
    checks = [Check("Ground control", value, limit, state, "" if state == GOOD else control["text"])]
    if control["check_points"]:
        value = _two(control.get("check_horizontal_m"), control.get("check_vertical_m"))
        checks.append(Check("Check points", value, "", NOTE))
    return checks


def _two(level: Optional[float], height: Optional[float]) -> str:
    """A level and a height residual in one cell."""
    return "–" if level is None or height is None else f"{level:.2f} / {height:.2f} m"


def _height(found: Mapping[str, Any]) -> Optional[Check]:
    if found["height_m"] is None:
        return None
    flown = [p["flown_height_m"] for p in found.get("payloads", []) if p.get("flown_height_m") is not None]
    solved = [p["height_m"] for p in found.get("payloads", []) if p.get("height_m") is not None]
    if len(flown) == 1 and len(solved) == 1:
        return Check("Flying height", figure(solved[0], 1, "m"), f"flown {flown[0]:.1f} m", NOTE)
    return Check("Flying height", figure(found["height_m"], 1, "m"), "", NOTE)


def _bowing(found: Mapping[str, Any], limit: Mapping[str, float]) -> Optional[Check]:
    bow, error = found["bowing_m"], found["bowing_se_m"]
    if bow is None:
        return None
    value = f"{bow:+.2f} m" + (f" ± {error:.2f}" if error is not None else "")
    needed = limit.get("bowing_sigma", 3.0)
    if error is None or abs(bow) <= needed * error:
        within = f"± {needed * error:.2f} m" if error is not None else ""
        return Check("Bowing", value, within, GOOD)
    words = (
        f"The block bends: its middle lies {abs(bow):.2f} m {'low' if bow > 0 else 'high'} against its edge. "
        "Cross strips, obliques or ground control points cure it."
    )
    return Check("Bowing", value, f"± {needed * error:.2f} m", NOTE, words)


def _inliers(found: Mapping[str, Any], limit: Mapping[str, float]) -> Optional[Check]:
    value, least = found.get("median_inliers"), limit.get("min_inliers", 30)
    if value is None:
        return None
    return Check("Matches per pair", figure(value, 0), f"≥ {least:g}", GOOD if value >= least else BAD)


def parts(found: Mapping[str, Any]) -> List[Part]:
    """One row per payload where a model holds several."""
    payloads = found.get("payloads", [])
    return [_part(p) for p in payloads] if len(payloads) > 1 else []


def _part(payload: Mapping[str, Any]) -> Part:
    together, alone = payload.get("together") or {}, payload.get("alone") or {}
    bowing = payload.get("bowing") or {}
    crossed = payload.get("cross_pairs", 0)
    return Part(
        payload=payload["payload"],
        state={"pass": GOOD, "fail": BAD}.get(str(payload.get("verdict")), NOTE),
        placed=f"{payload['registered']:,} of {payload['frames']:,}",
        matches=f"{figure(payload.get('cross_inliers'), 0)} in {plural(crossed, 'pair')}" if crossed else "–",
        error=figure(payload.get("mean_reproj_error_px"), 2),
        level=_beside(together.get("horizontal_m"), alone.get("horizontal_m")),
        height=_beside(together.get("vertical_m"), alone.get("vertical_m")),
        bowing=give_or_take(bowing.get("bowing_m"), bowing.get("se_m")),
    )


def _beside(together: Optional[float], alone: Optional[float]) -> str:
    return figure(together, 2) if alone is None else f"{figure(together, 2)} ({alone:.2f})"


def why(view: View, project: Mapping[str, Any]) -> List[str]:
    """Why a project takes its route, without what the tables of its figures say already."""
    found = project["alignment"] or {}
    tabled: Set[str] = set()
    for payload in found.get("payloads", []):
        if payload.get("verdict") == "pass":
            for reason in payload.get("reasons", []):
                tabled.update((reason, f"{payload['payload']}: {reason}"))
    reasons = [r for r in project["reasons"] if r not in tabled]
    least = view.threshold.get("min_inliers", 30)
    return [*reasons, *(w for w in cross_words(found, least, project["reasons"]) if w not in tabled)]


def cross_words(found: Mapping[str, Any], least: float, told: Sequence[str] = ()) -> List[str]:
    """What joins no two payloads, what was said of each payload and not yet told, and shifts of their GPS."""
    lines = []
    for pair in found.get("pairs", []):
        inliers = pair["inliers_median"]
        if pair["a"] == pair["b"] or (inliers is not None and inliers >= least):
            continue
        tried = plural(pair["pairs"], "pair")
        lines.append(
            f"{pair['a']} and {pair['b']}: {figure(inliers, 0)} matches per pair over {tried}, "
            f"too few to join them ({least:g} needed)."
        )
    for payload in found.get("payloads", []):
        for reason in payload.get("reasons", []):
            named = f"{payload['payload']}: {reason}"
            if reason not in told and named not in told:
                lines.append(named)
        offset = payload.get("gps_offset_m")
        if offset:
            shift = ", ".join(f"{v:+.1f} m {way}" for v, way in zip(offset, ("east", "north", "up")) if v is not None)
            lines.append(f"{payload['payload']}: its geometry fits, but its GPS is shifted by {shift}.")
    return lines


def control_table(found: Mapping[str, Any]) -> Optional[Dict[str, Any]]:
    """Every ground point with what it missed, and what they say together; ``None`` where none is marked."""
    control = found.get("control")
    if not control:
        return None
    outliers = set(control.get("outliers") or ())
    rows = [
        ControlRow(
            point=p["point"],
            kind="check point" if p["check"] else "control",
            images=p["images"],
            east=_signed(p["residual_m"][0]),
            north=_signed(p["residual_m"][1]),
            up=_signed(p["residual_m"][2]),
            distance=f"{_length(p['residual_m']):.2f}",
            outlier=p["point"] in outliers,
        )
        for p in sorted(control.get("points_m") or (), key=lambda p: (p["check"], p["point"]))
    ]
    offset = control.get("gps_offset_m")
    notes = [control["text"]] if control["text"] and control["verdict"] != "pass" else []
    unseen = sorted(outliers - {r.point for r in rows})
    if unseen:
        notes.append(f"left out, the others contradict it: {', '.join(unseen)}")
    if offset:
        ways = zip(offset, ("east", "north", "up"))
        notes.append(f"GPS puts the cameras {', '.join(f'{v:+.2f} m {way}' for v, way in ways)} of ground control")
    parts_say = [
        f"{p['payload']}: {p['control']['text']}"
        for p in found.get("payloads", [])
        if (p.get("control") or {}).get("verdict") == "fail"
    ]
    return {
        "rows": rows,
        "held": control["held"],
        "state": {"pass": GOOD, "fail": BAD}.get(control["verdict"], NOTE),
        "verdict": {
            "pass": "Ground control proves this model.",
            "fail": "Ground control contradicts this model.",
        }.get(control["verdict"], "Too few points to prove anything."),
        "notes": [*notes, *parts_say],
        "sums": _sums(control),
    }


def _signed(value: float) -> str:
    """With its sign, but no sign on what rounds to nothing."""
    shown = f"{value:+.2f}"
    return shown[1:] if float(shown) == 0.0 else shown


def _length(miss: Sequence[float]) -> float:
    return float(sum(v * v for v in miss) ** 0.5)


def _sums(control: Mapping[str, Any]) -> List[Tuple[str, str, str]]:
    """(what, level, height) of the RMS figures that are known."""
    known = [(f"{plural(control['points'], 'control point')}", control["horizontal_m"], control["vertical_m"])]
    if control["check_points"]:
        known.append(
            (
                plural(control["check_points"], "check point"),
                control.get("check_horizontal_m"),
                control.get("check_vertical_m"),
            )
        )
    return [(name, f"{level:.2f} m", f"{height:.2f} m") for name, level, height in known if None not in (level, height)]
