"""The last word on every payload, as lines for the screen and as JSON."""

from __future__ import annotations

from typing import Any, Dict, List

from ...stages.record import to_plain
from . import ledger as states
from .ledger import Entry
from .parcel import UNPROVEN
from .run import Submission

SCHEMA_VERSION = 1
_SAID = {
    states.DONE: "done",
    states.REROUTED: "tried again",
    states.GIVEN_UP: "failed",
    states.REFUSED: "not sent",
    states.WAITING: "under way",
}


def record(result: Submission) -> Dict[str, Any]:
    """What ``--json`` writes."""
    return {
        "schema_version": SCHEMA_VERSION,
        "node": result.node,
        "projects": [to_plain(e) for e in result.entries],
        "left_out": list(result.left_out),
        "faults": [{"project": n, "message": m} for n, m in result.faults],
        "payloads": {p: _of_payload(p, result) for p in _payloads(result)},
    }


def _payloads(result: Submission) -> List[str]:
    return sorted({p for e in result.entries for p in e.payloads})


def _of_payload(payload: str, result: Submission) -> List[Dict[str, str]]:
    return [
        {"project": e.name, "state": e.state, "route": e.route}
        for e in result.entries
        if payload in e.payloads and e.state != states.REROUTED
    ]


def lines(result: Submission) -> List[str]:
    """What is printed: a row per payload, then per project why."""
    rows = [("payload", "project", "frames", "tasks", "became")]
    for payload in _payloads(result):
        for entry in result.entries:
            if payload in entry.payloads:
                unsure = ", unproven" if entry.state == states.DONE and entry.route == UNPROVEN else ""
                became = _SAID.get(entry.state, entry.state) + unsure
                rows.append((payload, entry.name, str(entry.images), str(len(entry.attempts)), became))
    widths = [max(len(r[i]) for r in rows) for i in range(len(rows[0]))]
    told = ["  ".join(c.ljust(w) for c, w in zip(r, widths)).rstrip() for r in rows]
    why = [line for e in result.entries for line in _why(e)] + _notes(result)
    told += ["", *why] if why else []
    told += [f"{name}: {message}" for name, message in result.faults]
    if result.left_out:
        told += ["", f"Left out as unproven ({', '.join(result.left_out)}): add --include-unproven to submit them."]
    if any(e.state == states.WAITING for e in result.entries):
        told += ["", "Something is still under way: the same command again goes on from there."]
    return [*told, "", f"Ledger: {result.ledger}"]


def _why(entry: Entry) -> List[str]:
    told = []
    for attempt in entry.attempts[:-1]:
        told.append(f"{entry.name}: task {attempt.number} was {attempt.state}. {attempt.message}".rstrip())
    last = entry.last
    if last is not None and last.repaired:
        told.append(f"{entry.name}: {len(last.repaired)} files were sent again in an archive after broken uploads.")
    if entry.state != states.DONE or entry.route == UNPROVEN:
        told += [f"{entry.name}: {reason}" for reason in entry.reasons]
    if entry.children:
        told.append(f"{entry.name}: goes on as {', '.join(entry.children)} ({entry.route}).")
    return told


def _notes(result: Submission) -> List[str]:
    """What is to be known of the tasks that count; what holds for several projects is said once."""
    found: Dict[str, List[str]] = {}
    for entry in result.entries:
        for note in entry.last.notes if entry.last is not None else ():
            found.setdefault(note, []).append(entry.name)
    return [f"{names[0] if len(names) == 1 else f'{len(names)} projects'}: {note}" for note, names in found.items()]
