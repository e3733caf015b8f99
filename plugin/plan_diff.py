"""What differs between two plans, in plain words (pure)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from .inspection import argument
from .report.view import listing, plural

INPUT, SETTING, THRESHOLD, VERSION = "input", "setting", "threshold", "version"
DECISION, OPTION, OUTPUT = "decision", "option", "output"
KINDS = (INPUT, SETTING, THRESHOLD, VERSION, DECISION, OPTION, OUTPUT)

Record = Mapping[str, Any]


@dataclass(frozen=True)
class Difference:
    """One thing that is not as it was: what about, on whom, and both values where they fit into a word."""

    about: str
    subjects: Tuple[str, ...]
    message: str
    then: Optional[str] = None
    now: Optional[str] = None


def moved(then: Record, now: Record) -> Dict[str, str]:
    """Name now -> name then, of inputs with equal content that lie elsewhere (each content once on both sides)."""
    before, after = then["inputs"]["files"], now["inputs"]["files"]
    lost = _by_content({n: d for n, d in before.items() if n not in after})
    new = _by_content({n: d for n, d in after.items() if n not in before})
    return {new[d]: lost[d] for d in sorted(lost) if d in new}


def _by_content(files: Mapping[str, Optional[str]]) -> Dict[str, str]:
    found: Dict[str, List[str]] = {}
    for name, digest in files.items():
        if digest is not None:
            found.setdefault(digest, []).append(name)
    return {d: names[0] for d, names in found.items() if len(names) == 1}


def differences(then: Record, now: Record) -> Tuple[Difference, ...]:
    """All that differs between two plans, causes before effects (pure)."""
    return (
        *input_differences(then, now),
        *_settings(then["settings"], now["settings"], then["inputs"], now["inputs"]),
        *_values(THRESHOLD, then["thresholds"]["all"], now["thresholds"]["all"]),
        *_values(VERSION, then["versions"], now["versions"]),
        *_decisions(then, now),
        *_projects(then, now),
    )


def input_differences(then: Record, now: Record) -> Tuple[Difference, ...]:
    """Images that are missing, changed, new or elsewhere."""
    before, after, twin = then["inputs"]["files"], now["inputs"]["files"], moved(then, now)
    found = set(twin.values())
    return _filled(
        INPUT,
        ("{} of the plan {is} missing: {list}.", sorted(set(before) - set(after) - found)),
        ("{} {has} other content than in the plan: {list}.", [n for n in sorted(before) if _changed(before, after, n)]),
        ("{} {is} not in the plan: {list}.", sorted(set(after) - set(before) - set(twin))),
        ("{} {has} the plan's content and another name or folder: {list}.", sorted(twin)),
    )


def _changed(before: Mapping[str, Any], after: Mapping[str, Any], name: str) -> bool:
    return name in after and before[name] != after[name]


def _filled(about: str, *told: Tuple[str, Sequence[str]]) -> Tuple[Difference, ...]:
    """One difference for each sentence that has subjects."""
    return tuple(
        Difference(
            about,
            tuple(subjects),
            text.replace("{is}", "is" if len(subjects) == 1 else "are")
            .replace("{has}", "has" if len(subjects) == 1 else "have")
            .replace("{}", plural(len(subjects), "image"))
            .replace("{list}", listing(subjects)),
        )
        for text, subjects in told
        if subjects
    )


def _values(about: str, then: Record, now: Record) -> List[Difference]:
    found = []
    for name in sorted({*then, *now}):
        a, b = then.get(name), now.get(name)
        if a != b:
            found.append(Difference(about, (name,), _otherwise(name, a, b), _word(a), _word(b)))
    return found


def _otherwise(name: str, then: Any, now: Any) -> str:
    """Both values in a sentence; numbers as short as they still differ."""
    a, b = _word(then) or "none", _word(now) or "none"
    if isinstance(then, float) and isinstance(now, float) and f"{then:.6g}" != f"{now:.6g}":
        a, b = f"{then:.6g}", f"{now:.6g}"
    return f"{name} was {a}, now {b}."


def _word(value: Any) -> Optional[str]:
    return None if value is None else str(value)[:200]


def _settings(then: Record, now: Record, inputs_then: Record, inputs_now: Record) -> List[Difference]:
    found = _values(SETTING, then["options"], now["options"])
    for name in sorted({*then["files"], *now["files"]}):
        a, b = then["files"].get(name, {}), now["files"].get(name, {})
        if a.get("sha256") != b.get("sha256"):
            text = f"{argument(name)}: {b.get('name')} has other content than the plan's {a.get('name')}."
            found.append(Difference(SETTING, (name,), text, _word(a.get("sha256")), _word(b.get("sha256"))))
    if then["stored"] != now["stored"]:
        text = "The calibration store knows other things of these cameras than it did."
        found.append(Difference(SETTING, ("calibrations",), text))
    if inputs_then["paths"] != inputs_now["paths"]:
        a, b = inputs_then["paths"], inputs_now["paths"]
        text = f"The plan was made of {plural(a, 'path')}, this run of {b}."
        found.append(Difference(SETTING, ("paths",), text, str(a), str(b)))
    return found


def _decisions(then: Record, now: Record) -> List[Difference]:
    """What is done to each flight, and which frames are left out; frames that only one side has are no decision."""
    twin, both = moved(then, now), _common(then, now)
    found: List[Difference] = []
    before = {(a["profile"], a["flight"]): a for a in then["harmonize"]["actions"]}
    after = {(a["profile"], a["flight"]): a for a in now["harmonize"]["actions"]}
    for key in sorted({*before, *after}):
        flight, a, b = " / ".join(key), before.get(key), after.get(key)
        if a is None or b is None:
            found.append(Difference(DECISION, key, f"{flight} is {'new' if a is None else 'gone'}."))
            continue
        for name in sorted({*a, *b} - {"profile", "flight", "frames", "reasons"}):
            if a.get(name) != b.get(name):
                text = f"{flight}: {_otherwise(name, a.get(name), b.get(name))}"
                found.append(Difference(DECISION, key, text, _word(a.get(name)), _word(b.get(name))))
        found.extend(_frames(flight, a, b, twin, both))
    luts = {t["id"]: t for t in then["harmonize"]["luts"]}, {t["id"]: t for t in now["harmonize"]["luts"]}
    for name in sorted({*luts[0], *luts[1]}):
        if luts[0].get(name) != luts[1].get(name):
            found.append(Difference(DECISION, (name,), f"The colours of {name} are matched otherwise."))
    out = {twin.get(n, n): r for n, r in now["excluded"].items()}
    for name in sorted(both & {*then["excluded"], *out}):
        a, b = then["excluded"].get(name), out.get(name)
        if a != b:
            text = f"{name}: {f'left out ({a})' if a else 'used'} then, {f'left out ({b})' if b else 'used'} now."
            found.append(Difference(DECISION, (name,), text, a, b))
    return found


def _projects(then: Record, now: Record) -> List[Difference]:
    twin, both = moved(then, now), _common(then, now)
    before, after = ({s["name"]: s for s in r["subprojects"]} for r in (then, now))
    found: List[Difference] = []
    for name in sorted({*before, *after}):
        a, b = before.get(name), after.get(name)
        if a is None or b is None:
            text = f"The project {name} is {'new' if a is None else 'not written any more'}."
            found.append(Difference(DECISION, (name,), text))
            continue
        if a["route"] != b["route"]:
            text = f"{name}: the route was {a['route']}, now {b['route']}."
            found.append(Difference(DECISION, (name,), text, a["route"], b["route"]))
        for part, what in (("payloads", "holds"), ("held", "locks the camera of")):
            if a[part] != b[part]:
                text = f"{name} {what} {listing(b[part]) or 'nothing'}, then {listing(a[part]) or 'nothing'}."
                found.append(Difference(DECISION, (name,), text))
        found.extend(_frames(name, a, b, twin, both))
        found.extend(_options(name, a["options"], b["options"]))
        found.extend(_outputs(name, a["files"], b["files"]))
    return found


def _common(then: Record, now: Record) -> Set[str]:
    """Images that both sides have, by their name then."""
    twin = moved(then, now)
    return set(then["inputs"]["files"]) & {twin.get(n, n) for n in now["inputs"]["files"]}


def _frames(name: str, then: Record, now: Record, twin: Mapping[str, str], both: Set[str]) -> List[Difference]:
    apart = sorted((set(then["frames"]) & both) ^ ({twin.get(n, n) for n in now["frames"]} & both))
    if not apart:
        return []
    text = f"{name}: {plural(len(apart), 'frame')} came or went: {listing(apart)}."
    return [Difference(DECISION, (name, *apart), text)]


def _options(project: str, then: Sequence[Record], now: Sequence[Record]) -> List[Difference]:
    before, after = ({str(o["name"]): o.get("value") for o in side} for side in (then, now))
    return [
        Difference(OPTION, (project, d.subjects[0]), f"{project}: {d.message}", d.then, d.now)
        for d in _values(OPTION, before, after)
    ]


def _outputs(project: str, then: Record, now: Record) -> List[Difference]:
    apart = [n for n in sorted({*then, *now}) if then.get(n) != now.get(n)]
    if not apart:
        return []
    text = f"{project}: {len(apart)} of {plural(len({*then, *now}), 'file')} differ from the plan's: {listing(apart)}."
    return [Difference(OUTPUT, (project, *apart), text)]
