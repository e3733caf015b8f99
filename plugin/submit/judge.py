"""What became of a task: the reader of outcomes where there are products, the console where there are none."""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Optional, Sequence, Tuple

from ...stages.errors import SensorgateError
from ...stages.route import ISOLATE, PAIRWISE, PROCEED
from .client import CANCELED, COMPLETED, TaskView
from .parcel import UNPROVEN

LOG = logging.getLogger("sensorgate.submit")

STOP = "stop"
_ROUTES = (PROCEED, PAIRWISE, ISOLATE, UNPROVEN)

# Anything with a ``route`` and ``reasons``.
ReadOutcome = Callable[[Path], Any]


@dataclass(frozen=True)
class Judgement:
    """``proceed``, ``pairwise`` or ``isolate`` as the router says them, or ``stop``: only a person can help."""

    route: str
    reasons: Tuple[str, ...]


def default_reader() -> Optional[ReadOutcome]:
    """The project's own reader of outcomes."""
    try:
        from ..odm import outcome
    except ImportError:
        return None
    reader: Optional[ReadOutcome] = getattr(outcome, "read_outcome", None)
    return reader


# What ODM prints before it ends, and what that means for the route. The first that is found decides.
_TEXTS: Tuple[Tuple[str, str, str], ...] = (
    (
        r"not all band images have been matched|Cannot match bands by filename|Cannot find secondary photos",
        ISOLATE,
        "ODM could not put the bands of the captures together",
    ),
    (
        r"unrecognized arguments|argument --[\w-]+:|is not a valid JSON string",
        STOP,
        "ODM did not take an option: the node's ODM is another version than its option list",
    ),
    (
        r"This GCP file does not have any entries|Could not project GCP file|no valid GCP entries could be used"
        r"|Bad SRS supplied",
        STOP,
        "ODM could not use the ground control file",
    ),
    (
        r"There are no images in|Not enough supported images|Not enough photos in photos array",
        STOP,
        "ODM found no image that it could use",
    ),
    (r"No space left on device|ENOSPC", STOP, "the node's disk is full: free some space there, then --retry"),
    (
        r"MemoryError|std::bad_alloc|Cannot allocate memory|out of memory|oom-kill",
        STOP,
        "the node has too little memory: use a larger node or a lower feature-quality, then --retry",
    ),
    (
        r"The program could not process this dataset using the current settings|strange values in the reconstruction"
        r"|Not enough images in selected band",
        PAIRWISE,
        "ODM could not reconstruct the frames together",
    ),
)
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
    (
        r"forward task to processing node|No nodes available",
        STOP,
        "the cluster found no node: --retry later",
    ),
    (r"Cannot process dataset", PAIRWISE, "ODM could not reconstruct the frames together"),
)


def judge_console(lines: Sequence[str], message: str) -> Judgement:
    """Judge a failed task without products from its last output and the node's own message."""
    text = "\n".join(lines)
    for pattern, route, said in _TEXTS:
        if re.search(pattern, text, re.IGNORECASE):
            return Judgement(route, (f"{said}.",))
    for pattern, route, said in _MESSAGES:
        if re.search(pattern, message, re.IGNORECASE):
            return Judgement(route, (f"{said}.",))
    last = next((line.strip() for line in reversed(lines) if line.strip()), "")
    shown = f" Its last words: {last[:160]}" if last else ""
    return Judgement(STOP, (f"The node says {message or 'that it failed'}, without a known cause.{shown}",))


def judge(
    view: TaskView, folder: Optional[Path], console: Sequence[str], reader: Optional[ReadOutcome] = None
) -> Judgement:
    """What the router would do with this task. ``folder`` is the project with the products, ``None`` without any."""
    if view.status == CANCELED:
        return Judgement(STOP, (f"The task was cancelled on the node. {view.message}".strip(),))
    if view.status == COMPLETED and folder is not None:
        read = reader or default_reader()
        if read is not None:
            try:
                told = read(folder)
                route, reasons = str(told.route), tuple(str(r) for r in told.reasons)
            except (SensorgateError, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
                LOG.info("the outcome of %s cannot be read: %s", folder.name, error)
            else:
                if route in _ROUTES:
                    return Judgement(PROCEED if route == UNPROVEN else route, reasons)
        return _from_text(console)
    if view.status == COMPLETED:
        return _from_text(console)
    return judge_console(console, view.message)


def _from_text(console: Sequence[str]) -> Judgement:
    """A completed task of which only the console speaks: one reconstruction is all that ODM carries on with."""
    found = re.search(r"Multiple reconstructions detected \((\d+)", "\n".join(console))
    if found:
        return Judgement(PAIRWISE, (f"ODM found {found.group(1)} separate reconstructions and carried on with one.",))
    return Judgement(PROCEED, ("The node completed the task.",))
