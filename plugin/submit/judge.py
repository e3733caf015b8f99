"""What became of a task: the reader of outcomes where there are products, the console where there are none."""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Optional, Sequence, Tuple

from ...stages.errors import SensorgateError
from ...stages.route import ISOLATE, PAIRWISE, PROCEED
from ..odm.outcome_console import FATAL, outcome_of_console
from .parcel import UNPROVEN
from .views import CANCELED, COMPLETED, TaskView

LOG = logging.getLogger("sensorgate.submit")

STOP = "stop"

# Anything with a ``route`` and ``reasons``.
ReadOutcome = Callable[[Path], Any]


@dataclass(frozen=True)
class Judgement:
    """The router's ``proceed``, ``pairwise``, ``isolate`` or ``unproven``, or ``stop``: only a person can help."""

    route: str
    reasons: Tuple[str, ...]


def default_reader() -> ReadOutcome:
    """The project's own reader of outcomes."""
    from ..odm.outcome import read_outcome

    return read_outcome


# Causes that lie with the node, whatever else its ODM says on its way down.
_OF_THE_NODE = frozenset(("disk-full", "out-of-memory", "program-missing"))
# What the node itself says of a task, where ODM's console explains nothing.
_MESSAGES: Tuple[Tuple[str, str, str], ...] = (
    (
        r"Not enough memory",
        STOP,
        "the node ran out of memory or the process was killed: use a larger node, then --retry",
    ),
    (r"Unsupported CPU", STOP, "the node's processor is too old for its ODM: use another node"),
    (r"Installation issue", STOP, "ODM on the node is not installed properly"),
    (r"Could not start process", STOP, "the node could not start ODM"),
    (r"can only process up to", STOP, "the node takes fewer images than the project has"),
    (r"No space left|ENOSPC", STOP, "the node's disk is full: free some space there, then --retry"),
    (r"forward task to processing node|No nodes available", STOP, "the cluster found no node: --retry later"),
    (r"Cannot process dataset", PAIRWISE, "ODM could not reconstruct the frames together"),
)


def judge_console(lines: Sequence[str], message: str) -> Judgement:
    """Judge a failed task without products from its last output and the node's own message."""
    told = outcome_of_console(lines)
    causes = [f for f in told.facts if f.severity == FATAL]
    cause = next((f for f in causes if f.code in _OF_THE_NODE), causes[0] if causes else None)
    if cause is not None:
        return Judgement(cause.route or STOP, (f"{_sentence(cause.message)} {cause.remedy}",))
    if re.search(r"is not a valid JSON string", "\n".join(lines)):
        return Judgement(STOP, ("ODM could not read an option's JSON: this node destroys quotes in values.",))
    for pattern, route, said in _MESSAGES:
        if re.search(pattern, message, re.IGNORECASE):
            return Judgement(route, (_sentence(said),))
    shown = f" Its last words: {told.last[:160]}" if told.last else ""
    return Judgement(STOP, (f"The node says {message or 'that it failed'}, without a known cause.{shown}",))


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def judge(
    view: TaskView, folder: Optional[Path], console: Sequence[str], reader: Optional[ReadOutcome] = None
) -> Judgement:
    """What the router would do with this task. ``folder`` is the project with the products, ``None`` without any."""
    if view.status == CANCELED:
        return Judgement(STOP, (f"The task was cancelled on the node. {view.message}".strip(),))
    if view.status != COMPLETED:
        return judge_console(console, view.message)
    if folder is None:
        return _from_text(console)
    try:
        told = (reader or default_reader())(folder)
        route, reasons = str(told.route), tuple(str(r) for r in told.reasons)
        failed = getattr(told, "state", "") == "failed"
    except (SensorgateError, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        LOG.info("the outcome of %s cannot be read: %s", folder.name, error)
        return _from_text(console)
    if route in (PAIRWISE, ISOLATE):
        return Judgement(route, reasons)
    # What nothing proves is still a result; a run that ended early is none.
    return Judgement(STOP if failed else UNPROVEN if route == UNPROVEN else PROCEED, reasons)


def _from_text(console: Sequence[str]) -> Judgement:
    """A completed task of which only the console speaks: one reconstruction is all that ODM carries on with."""
    pieces = outcome_of_console(console).components
    if pieces is not None and pieces > 1:
        return Judgement(PAIRWISE, (f"ODM found {pieces} separate reconstructions and carried on with one.",))
    return Judgement(PROCEED, ("The node completed the task.",))
