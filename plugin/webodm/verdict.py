"""The gate's verdict in the words of somebody who creates a task in WebODM. Pure."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional, Sequence

from ...stages.finding import Finding
from ...stages.grouping import camera_name
from ...stages.rules.text import listed, plural
from ..inspection import Inspection
from ..report.view import SPECTRUM_WORDS
from . import bounds
from .proposal import CONTROL, LEAVE_OUT, OPTIONS, RULES, SPLIT, Choices, Proposal

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
}
# What only the command line can do is said otherwise here.
_HERE = (
    ("--calibration", "Upload a calibration sheet of this camera on the sensorgate page."),
    ("--gcp", "Choose the ground control file along with the images."),
    ("cameras file", "Harmonize on the server after the upload: the tasks that come out carry the calibration."),
    ("sensorgate run", "The proposed tasks keep these apart; harmonizing on the server corrects them."),
    ("sensorgate", ""),
    ("--", ""),
)


def remedy_here(text: str) -> str:
    """A remedy as it applies inside WebODM; empty where the command line alone has one."""
    return next((said for sign, said in _HERE if sign in text), text)


def words_for(
    inspection: Inspection,
    proposal: Proposal,
    choices: Choices,
    ids: Mapping[str, int],
    report: Optional[str],
) -> Dict[str, Any]:
    """The answer of the API: see ``api.py``."""
    survey = inspection.survey
    findings = [*inspection.findings, *(f for t in proposal.tasks for f in t.findings)]
    home = {p: t.key for t in proposal.tasks for p in t.payloads}
    return {
        "files": len(survey.frames) + len(survey.broken),
        "verdict": inspection.verdict,
        "headline": headline(inspection, proposal),
        "cameras": _cameras(inspection),
        "payloads": [
            {
                "id": p.id,
                "name": _payload_name(p.id, inspection),
                "spectrum": p.spectrum,
                "bands": list(p.bands) if len(p.profiles) > 1 else [],
                "frames": sum(1 for f in survey.frames if f.payload == p.id),
                "task": home.get(p.id, ""),
            }
            for p in survey.payloads
        ],
        "findings": [_finding(f) for f in _once(findings)[: bounds.MOST_LISTED]],
        "odm": list(inspection.prediction.notes),
        "ours": ours(inspection, proposal, choices),
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
        "left_out": _left_out(inspection, proposal, ids),
        "report": report,
    }


def headline(inspection: Inspection, proposal: Proposal) -> str:
    """The verdict in one line."""
    survey = inspection.survey
    used = len(survey.usable)
    if not used:
        return "None of these files can be used for a survey."
    cameras = {f.profile for f in survey.usable}
    shown = f"{plural(used, 'frame')} of {plural(len(cameras), 'camera')}"
    if len(proposal.tasks) > 1:
        return f"{shown}: {len(proposal.tasks)} tasks, because they do not belong in one."
    if inspection.verdict == "consistent":
        return f"{shown}: they fit into one task."
    return f"{shown}: one task, with something to put right."


def ours(inspection: Inspection, proposal: Proposal, choices: Choices) -> List[str]:
    """What we would do with the folder, as sentences."""
    said: List[str] = []
    for task in proposal.tasks:
        kind = SPECTRUM_WORDS.get(task.spectrum, "mixed")
        cameras = listed(sorted({_payload_name(p, inspection) for p in task.payloads}))
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
        said.append(
            f"{plural(frames, 'frame')} would match better at the resolution of the others: harmonizing on the "
            "server does that after the upload."
        )
    return said


def _payload_name(payload: str, inspection: Inspection) -> str:
    profiles = inspection.survey.profile_of()
    found = next((p for p in inspection.survey.payloads if p.id == payload), None)
    if found is None:
        return payload
    lead = profiles[found.primary]
    name = camera_name(lead.make, lead.model)
    return f"{name} (thermal)" if found.spectrum == "thermal" else name


def _cameras(inspection: Inspection) -> List[Dict[str, Any]]:
    survey = inspection.survey
    payload_of = {member: p.id for p in survey.payloads for member in p.profiles}
    return [
        {
            "id": p.id,
            "name": camera_name(p.make, p.model),
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


def _once(findings: Sequence[Finding]) -> List[Finding]:
    seen = set()
    kept = []
    for finding in findings:
        key = (finding.code, finding.message)
        if key not in seen:
            seen.add(key)
            kept.append(finding)
    return kept


def _finding(finding: Finding) -> Dict[str, Any]:
    return {
        "code": finding.code,
        "severity": finding.severity,
        "message": finding.message,
        "remedy": remedy_here(finding.remedy),
        "files": len(finding.subjects),
    }


def _left_out(inspection: Inspection, proposal: Proposal, ids: Mapping[str, int]) -> List[Dict[str, Any]]:
    words: Dict[str, str] = dict(_REASON_WORDS)
    for finding in inspection.findings:
        words.setdefault(finding.code, finding.message)
    rows = [
        {"id": ids[p], "path": p, "reason": code, "message": words.get(code, code.replace("-", " "))}
        for p, code in sorted(proposal.left_out.items())
    ]
    rows += [
        {"id": ids[b.path], "path": b.path, "reason": b.code, "message": b.message} for b in inspection.survey.broken
    ]
    return rows
