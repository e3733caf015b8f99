"""The gate's verdict in the words of somebody who creates a task in WebODM. Pure."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.finding import Finding
from ...stages.rules.text import listed, plural
from ..inspection import Inspection
from ..report.view import SPECTRUM_WORDS
from . import bounds
from .foresight import as_it_is
from .naming import Names
from .proposal import CONTROL, LEAVE_OUT, OPTIONS, RULES, SPLIT, Choices, Proposal
from .remedies import WORKER, remedy_here

_RULE_WORDS = {
    SPLIT: "Create one task for each group of frames that belongs together",
    LEAVE_OUT: "Leave out what is no survey frame or would stop the processing",
    OPTIONS: "Set the options that follow from the cameras",
    CONTROL: "Add ground control and positions, rewritten for each task's files",
}
NOT_WANTED = "not-wanted"
_REASON_WORDS = {
    NOT_WANTED: "You chose not to send it.",
    "panel-frame": "A picture of the calibration panel; no survey frame.",
    "takeoff-frame": "Taken at take-off.",
    "landing-frame": "Taken at landing.",
    "transit-frame": "Taken on the way to the survey.",
    "duplicate-file": "The same file twice.",
    "picture-cut-short": "Its picture data breaks off: the copy is incomplete.",
    "capture-incomplete": "A band of its capture is missing.",
    "band-mostly-missing": "Its band is missing in most captures.",
    "horizon-frame": "It looks at the horizon; no survey frame.",
}
_MOST_NAMED = 6


def words_for(
    inspection: Inspection,
    proposal: Proposal,
    choices: Choices,
    ids: Mapping[str, int],
    report: Optional[str],
    engine: Tuple[str, str] = (WORKER, ""),
) -> Dict[str, Any]:
    """The answer of the API: see ``api.py``. ``engine`` is where harmonizing would run, and that as a sentence."""
    survey = inspection.survey
    names = Names(survey)
    findings = [*inspection.findings, *(f for t in proposal.tasks for f in t.findings)]
    home = {p: t.key for t in proposal.tasks for p in t.payloads}
    return {
        "files": len(survey.frames) + len(survey.broken),
        "verdict": inspection.verdict,
        "headline": headline(inspection, proposal),
        "cameras": _cameras(inspection, names),
        "payloads": [
            {
                "id": p.id,
                "name": names.payload(p.id),
                "spectrum": p.spectrum,
                "bands": list(p.bands) if len(p.profiles) > 1 else [],
                "frames": sum(1 for f in survey.frames if f.payload == p.id),
                "task": home.get(p.id, ""),
            }
            for p in survey.payloads
        ],
        "findings": _findings(findings, names, engine[0], len(proposal.tasks) > 1)[: bounds.MOST_LISTED],
        "odm": as_it_is(inspection, names),
        "ours": ours(inspection, proposal, choices, names),
        "rules": [
            {"id": r, "text": _RULE_WORDS[r], "on": r not in choices.off, "frames": proposal.affected[r]}
            for r in RULES
            if proposal.affected[r]
        ],
        "tasks": [
            {
                "key": t.key,
                "name": t.name,
                "spectrum": t.spectrum,
                "payloads": list(t.payloads),
                "frames": len(t.frames),
                "files": sorted([ids[path], name] for path, name in t.names.items()),
                "options": [dict(o) for o in t.options],
                "reasons": dict(t.reasons),
                "tags": list(t.tags),
                "texts": dict(t.texts),
            }
            for t in proposal.tasks
        ],
        "left_out": _left_out(inspection, proposal, ids, names),
        "report": report,
        "engine": engine[0],
        "engine_message": engine[1],
    }


def headline(inspection: Inspection, proposal: Proposal) -> str:
    """The verdict in one line."""
    survey = inspection.survey
    used = len(survey.usable)
    if not used or not proposal.tasks:
        return "None of these files can be used for a survey." if not used else "No file is left to be sent."
    names = Names(survey)
    cameras = {names.camera(f.payload) for f in survey.usable}
    shown = f"{plural(used, 'frame')} of {plural(len(cameras), 'camera')}"
    if len(proposal.tasks) > 1:
        return f"{shown}: {len(proposal.tasks)} tasks, because they do not belong in one."
    if inspection.verdict == "consistent":
        return f"{shown}: they fit into one task."
    if proposal.left_out or survey.broken:
        out = len(proposal.left_out) + len(survey.broken)
        return f"{shown}: one task, without {plural(out, 'file')} that would do harm."
    return f"{shown}: one task, with problems that you should read."


def ours(inspection: Inspection, proposal: Proposal, choices: Choices, names: Names) -> List[str]:
    """What we would do with the folder, as sentences."""
    said: List[str] = []
    for task in proposal.tasks:
        kind = SPECTRUM_WORDS.get(task.spectrum, "mixed")
        cameras = listed(sorted({names.camera(p).replace(f" ({kind})", "") for p in task.payloads}))
        said.append(f"Task {task.name}: {plural(len(task.frames), f'{kind} frame')} of {cameras}.")
    renamed = sum(1 for t in proposal.tasks for p, n in t.names.items() if p.rsplit("/", 1)[-1] != n)
    if renamed:
        said.append(
            f"{plural(renamed, 'file')} would get a new name, so that equal names of two cameras cannot "
            "overwrite each other."
        )
    if proposal.left_out:
        said.append(f"{plural(len(proposal.left_out), 'file')} would stay out; the list says why.")
    changes = [a for a in inspection.assessed.plan.actions if a.scale != 1.0]
    if changes and choices.off != frozenset(RULES):
        frames = sum(len(a.frames) for a in changes)
        said.append(f"{plural(frames, 'frame')} would match better at the resolution of the others (see below).")
    return said


def _cameras(inspection: Inspection, names: Names) -> List[Dict[str, Any]]:
    survey = inspection.survey
    payload_of = {member: p.id for p in survey.payloads for member in p.profiles}
    return [
        {
            "id": p.id,
            "camera": names.camera(payload_of[p.id]),
            "name": names.camera(payload_of[p.id]),
            "spectrum": p.spectrum,
            "band": p.band,
            "width": p.width,
            "height": p.height,
            "focal_mm": p.intrinsics.focal_mm,
            "frames": len(p.frames),
            "payload": payload_of[p.id],
        }
        for p in survey.profiles
    ]


def _findings(findings: Sequence[Finding], names: Names, engine: str, parted: bool) -> List[Dict[str, Any]]:
    """Each thing once: what is found of many cameras is said of the first, and the others are named."""
    groups: Dict[Tuple[str, str, str], List[Finding]] = {}
    for finding in findings:
        alike = finding.code if names.subjects([finding]) else finding.message
        groups.setdefault((finding.severity, finding.code, alike), []).append(finding)
    return [_finding(group, names, engine, parted) for group in groups.values()]


def _finding(group: Sequence[Finding], names: Names, engine: str, parted: bool) -> Dict[str, Any]:
    first = group[0]
    message = names.plain(first.message)
    others = [s for s in names.subjects(group[1:]) if s not in names.subjects([first])]
    if others:
        message += f" The same holds for {len(others)} more: {listed(others, _MOST_NAMED)}."
    return {
        "code": first.code,
        "severity": first.severity,
        "message": message,
        "remedy": names.plain(remedy_here(first, engine, parted)),
        "files": sum(names.frames(f) for f in group),
    }


def _left_out(inspection: Inspection, proposal: Proposal, ids: Mapping[str, int], names: Names) -> List[Dict[str, Any]]:
    words: Dict[str, str] = dict(_REASON_WORDS)
    for finding in inspection.findings:
        words.setdefault(finding.code, names.plain(finding.message))
    rows = [
        {"id": ids[p], "path": p, "reason": code, "message": words.get(code, code.replace("-", " "))}
        for p, code in sorted(proposal.left_out.items())
    ]
    rows += [
        {"id": ids[b.path], "path": b.path, "reason": b.code, "message": b.message} for b in inspection.survey.broken
    ]
    return rows
