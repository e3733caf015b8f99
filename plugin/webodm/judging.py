"""The router's verdict on a task that failed or came out poor, and the tasks that follow from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Mapping, Optional, Sequence, Tuple

from ...stages.errors import SensorgateError
from ...stages.harmonize.model import untouched
from ...stages.route import ISOLATE, PAIRWISE, PROCEED
from ...stages.rules.text import plural
from ..inspection import Inspection
from ..odm.camera_id import file_key
from ..odm.names import mask_name
from ..odm.options import as_node_options, options_for
from ..odm.outcome import read_outcome
from ..submit.judge import STOP, Judgement, judge_console
from ..submit.parcel import Item, Parcel
from ..submit.reroute import Part, plan
from . import records, tasks
from .naming import Names
from .proposal import Proposal, Proposed, control_for
from .verdict import headline

FAILED, COMPLETED = 30, 40
UNREADABLE = "unreadable"
_CONSOLE_LINES = 20_000
_WORDS = {
    PROCEED: "It came out as it should.",
    PAIRWISE: "The frames did not hold together as one block.",
    ISOLATE: "Its payloads belong into tasks of their own.",
    STOP: "No other way of sorting the frames would help.",
    UNREADABLE: "WebODM keeps nothing of this task that could be judged.",
    "unproven": "Nothing speaks against this result, but what WebODM keeps of it does not prove that it is right: "
    "compare a few distances or points that you know.",
}


def judge_task(task: Any) -> Judgement:
    """What the router would do with a task, from its products or, where there are none, from its console."""
    if task.status == COMPLETED:
        try:
            told = read_outcome(Path(task.assets_path()))
        except (SensorgateError, OSError, ValueError, KeyError, TypeError) as error:
            said = str(error).replace(task.assets_path(), "the folder of its results")
            return Judgement(UNREADABLE, (f"Its products cannot be judged: {said}",))
        if getattr(told, "state", "") == "failed":
            return Judgement(STOP, tuple(told.reasons))
        reasons = tuple(str(r).replace("in this folder", "among what WebODM keeps") for r in told.reasons)
        if told.alignment is None:
            return Judgement(UNREADABLE, reasons)
        return Judgement(str(told.route), (_placed(told.registered, told.frames), *reasons))
    text = str(task.console.output() or "")
    return judge_console(text.rstrip().split("\n")[-_CONSOLE_LINES:], str(task.last_error or ""))


def _placed(registered: int, frames: int) -> str:
    return f"{registered} of {plural(frames, 'frame')} found their place."


def with_gate(judgement: Judgement, inspection: Inspection, proposal: Proposal) -> Judgement:
    """What went wrong without a known cause is put down to frames that do not belong together, where they do not.

    Cameras are called as everywhere in WebODM, not by ODM's ids.
    """
    names = Names(inspection.survey)
    payload = {f.path: f.payload for f in inspection.survey.frames}
    ids = {file_key(i): names.payload(payload[p]) for p, i in inspection.prediction.camera_ids.items() if p in payload}
    said = []
    for reason in judgement.reasons:
        for key in sorted(ids, key=lambda k: (-len(k), k)):
            reason = reason.replace(key, ids[key])
        said.append(names.plain(reason))
    judgement = Judgement(judgement.route, tuple(said))
    if judgement.route == PROCEED or len(proposal.tasks) < 2:
        return judgement
    return Judgement(ISOLATE, (*judgement.reasons, headline(inspection, proposal)))


def parts_of(task: Any, judgement: Judgement, inspection: Inspection, proposal: Proposal) -> Tuple[Proposed, ...]:
    """The tasks to create. Where the gate already saw that the frames do not belong in one, its tasks are these."""
    if judgement.route not in (PAIRWISE, ISOLATE):
        return ()
    if len(proposal.tasks) > 1:
        return proposal.tasks
    parcel = _parcel(task, proposal)
    if parcel is None:
        return ()
    payload_of = {f.path: (f.payload, "") for f in inspection.survey.frames}
    parts = plan(parcel, judgement.route, judgement.reasons, payload_of)
    return tuple(_proposed(part, inspection) for part in parts)


def _parcel(task: Any, proposal: Proposal) -> Optional[Parcel]:
    """The task's frames in the terms of the router. What the gate leaves out is not tried again."""
    if not proposal.tasks:
        return None
    only = proposal.tasks[0]
    own = task.options if isinstance(task.options, list) else []
    return Parcel(
        name=only.name,
        folder=str(task.task_path()),
        items=tuple(Item(p, str(Path(task.task_path()) / p), 0) for p in only.frames),
        options=tuple(o for o in own if isinstance(o, dict) and "name" in o and "value" in o),
        calibration=None,
        route=PROCEED,
        reasons=(),
        payloads=only.payloads,
        digest="",
    )


def _proposed(part: Part, inspection: Inspection) -> Proposed:
    survey = inspection.survey
    by_path = {f.path: f for f in survey.files}
    copies = {p: replace(c, name=p) for p, c in untouched(by_path[p] for p in part.frames).items()}
    texts, needs, said = control_for(inspection, part.name, part.frames, copies)
    options = options_for(needs)
    names = {p: p for p in part.frames}
    for path in part.frames:
        if path in inspection.masks:
            names[inspection.masks[path]] = mask_name(path, inspection.masks[path])
    spectra = {f.spectrum for f in survey.frames if f.path in set(part.frames)}
    return Proposed(
        key=part.name,
        name=part.name,
        spectrum=next(iter(spectra)) if len(spectra) == 1 else "",
        payloads=part.payloads,
        frames=part.frames,
        names=names,
        options=(*as_node_options(options), *({"name": n, "value": v} for n, v, _ in part.options)),
        reasons={**{o.name: o.reason for o in options}, **{n: w for n, _, w in part.options}},
        texts=texts,
        findings=said,
    )


def anchors_of(task: Any, parts: Sequence[Proposed], inspection: Inspection) -> Dict[str, Any]:
    """Key of a part -> the finished task that it can be laid on, for the parts that lie over its ground."""
    found = {p.key: tasks.anchor_for(task, _ground(inspection, p.frames)) for p in parts}
    return {key: anchor for key, anchor in found.items() if anchor is not None}


def _ground(inspection: Inspection, frames: Sequence[str]) -> Sequence[Tuple[float, float]]:
    """(longitude, latitude) of frames that have a position."""
    wanted = set(frames)
    files = [f for f in inspection.survey.files if f.path in wanted]
    return [(f.longitude, f.latitude) for f in files if f.longitude is not None and f.latitude is not None]


def told(task: Any, judgement: Judgement, parts: Sequence[Proposed], inspection: Inspection) -> Dict[str, Any]:
    """The judgement as the API says it."""
    anchor = tasks.anchor_for(task, _ground(inspection, [p for part in parts for p in part.frames])) if parts else None
    return {
        "route": judgement.route,
        "message": _WORDS.get(judgement.route, ""),
        "reasons": list(judgement.reasons),
        "tasks": [{"name": p.name, "frames": len(p.frames), "options": [dict(o) for o in p.options]} for p in parts],
        "anchor": {"id": str(anchor.id), "name": anchor.name or ""} if anchor is not None else None,
    }


def remember(task: Any, judgement: Judgement, parts: Sequence[Proposed], inspection: Inspection) -> Dict[str, Any]:
    """Keep the judgement in the task's record."""
    record: Mapping[str, Any] = records.load(task.pk) or {}
    said = told(task, judgement, parts, inspection)
    return records.change(task.pk, state=record.get("state", records.NONE), judgement=said)
