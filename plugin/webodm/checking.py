"""The worker's look at a task: the gate's verdict on what was really uploaded, and what follows from it."""

from __future__ import annotations

import contextlib
import logging
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, Iterator, Mapping, Optional, Tuple

from ...stages.assemble import left_out
from ...stages.errors import MissingDependency, SensorgateError
from ...stages.record import dumps, write_text
from .. import pipeline
from ..inspection import Inspection
from . import claims, home, preferences, records, tasks
from .gathering import of_session, of_task
from .proposal import Proposal, propose
from .remedies import HARMONIZED
from .sessions import Session
from .verdict import headline

LOG = logging.getLogger("app.logger")
_BEAT_S = 5.0
RELEASE, SPLIT, HELD = "release", "split", "held"


@dataclass(frozen=True)
class Decision:
    """What hold mode does with a task, and what it says."""

    do: str
    message: str


def decide(inspection: Inspection, proposal: Proposal) -> Decision:
    """Let go what fits into one task, take apart what does not, keep back what is useless. Pure."""
    survey = inspection.survey
    if inspection.verdict == "blocked" or not proposal.tasks:
        return Decision(
            HELD,
            "Held: none of these files can be used for a survey. Delete this task and upload the images of the "
            "survey, or ask somebody who may to let it go as it is.",
        )
    harmful = len(survey.broken) + len(left_out(survey))
    if len(proposal.tasks) == 1 and not harmful:
        return Decision(RELEASE, "Its cameras fit into one task.")
    why = f"{headline(inspection, proposal)}"
    if harmful:
        why += f" {harmful} damaged or incomplete files stay out."
    return Decision(SPLIT, why)


class Beat:
    """Says in the record how far the work is, now and then, so that nobody takes the worker for dead."""

    def __init__(self, task_id: Any, state: str, words: Mapping[str, str]) -> None:
        self._task = task_id
        self._state = state
        self._words = words
        self._told = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Hear of a stage."""
        from django.core.cache import cache

        now = time.monotonic()
        if now - self._told < _BEAT_S:
            return
        self._told = now
        cache.touch(f"{home.NAME}-at-{self._task}", records.CLAIM_S)
        share = min(1.0, done / total) if total else None
        record = records.load(self._task)
        if record is not None and record["state"] in records.BUSY:
            records.change(self._task, progress=share, step=self._words.get(stage, stage))


def look(task: Any, beat: Optional[Beat] = None) -> Tuple[Inspection, Proposal]:
    """Read a task's images and keep the report in the task's folder. Raises ``SensorgateError``."""
    with preferences.settings_for(task.project.owner) as settings:
        inspection = of_task(Path(task.task_path()), settings, beat)
        proposal = propose(inspection, claims.mild(claims.made(records.load(task.pk) or {}, inspection)))
    keep_report(home.task_folder(task), inspection)
    return inspection, proposal


def keep_report(folder: Path, inspection: Inspection) -> Dict[str, Any]:
    """Write ``report.json`` and, where Jinja2 is there, ``report.html``; no path of this server stands in them."""
    plain = replace(inspection, settings=replace(inspection.settings, gcp=None, geo=None, calibration=None))
    report = pipeline.gate(plain.paths, plain.settings, inspection=plain).report
    write_text(folder / "report.json", dumps(report))
    try:
        with home.packages():
            from ..report.html import render

            write_text(folder / "report.html", render(report))
    except MissingDependency as error:
        LOG.info("sensorgate: %s", error)
    return report


def report_of(session: Session, user: Any) -> None:
    """Write the report of what a session holds now, unless it is there. Raises ``SensorgateError``."""
    gathered = session.gather()
    seen = {"files": len(gathered.ids)}
    if session.load("reported") == seen or not gathered.ids:
        return
    with preferences.settings_for(user) as settings:
        inspection = of_session(gathered, settings, session.control("gcp"), session.control("geo"))
    keep_report(session.folder, inspection)
    session.keep("reported", seen)


def check_task(task_id: str) -> Dict[str, Any]:
    """Look at a task; where it is held, let it go, take it apart or keep it back."""
    task = home.find_task(task_id)
    record = records.load(task_id)
    if task is None or record is None:
        return {"output": "gone"}
    if record["state"] in (records.OVERRIDDEN, records.SPLIT):
        return {"output": record["state"]}  # somebody was quicker
    with alone(task_id) as mine:
        if not mine:
            return {"output": "somebody is at it"}
        holds = bool(record.get("holds"))
        records.change(task_id, state=records.CHECKING, progress=0.0)
        try:
            inspection, proposal = look(task, Beat(task_id, records.CHECKING, {"read": "reading the images"}))
            act(home.find_task(task_id), holds, inspection, proposal)
        except (SensorgateError, OSError) as error:
            _not_checked(task, holds, str(error))
        except Exception as error:
            LOG.exception("sensorgate: looking at task %s", task_id)
            _not_checked(task, holds, f"a fault of sensorgate ({type(error).__name__})")
    return {"output": (records.load(task_id) or {}).get("state", records.NONE)}


def act(task: Any, holds: bool, inspection: Inspection, proposal: Proposal) -> None:
    """Do what follows from the verdict. Without a hold it is noted, nothing else."""
    if task is None:
        return
    known = {
        "verdict": inspection.verdict,
        "headline": headline(inspection, proposal),
        "parts": len(proposal.tasks),
        "harmonizing_helps": any(f.code in HARMONIZED for f in inspection.findings),
    }
    decision = decide(inspection, proposal)
    claim = claims.made(records.load(task.pk) or {}, inspection)
    if not holds:
        records.change(task.pk, state=records.RELEASED, message=str(known["headline"]), progress=None, **known)
        return
    if preferences.mode() != preferences.HOLD:
        tasks.release(task, records.RELEASED, "Let go: holding was turned off.", **known)
    elif decision.do == RELEASE:
        tasks.release(task, records.RELEASED, decision.message, proposal.tasks[0].options, **known)
    elif decision.do == SPLIT and claim is not None and claim.together:
        only = propose(inspection, claims.whole(claim)).tasks[0]
        said = f"Let go in one piece, as {claim.by} chose in New Task."
        tasks.release(task, records.OVERRIDDEN, said, only.options, **known)
    elif decision.do == SPLIT:
        records.change(task.pk, **known)
        tasks.split(task, [(Path(task.task_path()), part) for part in proposal.tasks])
    else:
        tasks.keep_back(task, records.HELD, decision.message, **known)


def _not_checked(task: Any, holds: bool, why: str) -> None:
    # No path of this server is for its users.
    message = f"Its images could not be looked at: {why.replace(str(task.task_path()).rstrip('/'), 'its folder')}"
    if holds:
        tasks.keep_back(
            task,
            records.HELD,
            f"Held: {message} Check it again from the task's sensorgate button, or ask somebody who may to let it go.",
        )
    else:
        records.change(task.pk, state=records.FAILED, message=message, progress=None)


@contextlib.contextmanager
def alone(task_id: Any) -> Iterator[bool]:
    """Whether nobody else works on this task now; given up by itself where a worker dies."""
    from django.core.cache import cache

    key = f"{home.NAME}-at-{task_id}"
    mine = bool(cache.add(key, 1, records.CLAIM_S))
    try:
        yield mine
    finally:
        if mine:
            cache.delete(key)
