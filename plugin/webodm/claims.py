"""What a user chose in New Task, kept with a task until hold mode looks at what was really uploaded.

The files have to be those that the choice was made for. What only concerns
options and control texts is the user's own matter; to keep frames together that
the gate would part, or to send what would do harm, is to let a task go as it is,
and that is a permission.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any, Dict, Iterable, Mapping, Optional

from ..inspection import Inspection
from . import home
from .proposal import CONTROL, LEAVE_OUT, OPTIONS, SPLIT, Choices, Proposal

_OWN = frozenset((OPTIONS, CONTROL))
TAKEN_APART = (
    "This server holds tasks whose frames do not belong together: this one will be taken apart again after the upload. "
    "Ask somebody who may to let it go as it is."
)


@dataclass(frozen=True)
class Claim:
    """The choices of somebody for one task. ``together``: this user may keep the frames in one task."""

    choices: Choices
    together: bool
    by: str


def noted(user: Any, choices: Choices, proposal: Proposal, suggested: Proposal, key: str) -> Optional[Dict[str, Any]]:
    """What is kept in a task's record; ``None`` where no such task was proposed.

    It goes against the gate where it holds frames of several groups that are
    ``suggested``, or frames that would be left out.
    """
    part = next((t for t in proposal.tasks if t.key == key), None)
    if part is None:
        return None
    group = {path: t.key for t in suggested.tasks for path in t.frames}
    against = len({group.get(path, "") for path in part.frames}) > 1 or any(p not in group for p in part.frames)
    files = _digest(part.names.values())
    return {"by": user.pk, "off": sorted(choices.off), "against": against, "files": files}


def made(record: Mapping[str, Any], inspection: Inspection) -> Optional[Claim]:
    """The claim of a task, where its files are the ones that were chosen."""
    from django.contrib.auth.models import User

    kept = record.get("claim")
    if not isinstance(kept, dict) or kept.get("files") != _digest(_names(inspection)):
        return None
    user = User.objects.filter(pk=kept.get("by"), is_active=True).first()
    if user is None:
        return None
    together = bool(kept.get("against")) and home.may_override(user)
    return Claim(Choices(frozenset(kept.get("off", ()))), together, user.username)


def mild(claim: Optional[Claim]) -> Choices:
    """The part of the choices that needs no permission."""
    return Choices(claim.choices.off & _OWN) if claim is not None else Choices()


def whole(claim: Claim) -> Choices:
    """The choices with the task left in one piece."""
    return Choices(claim.choices.off | {SPLIT, LEAVE_OUT})


def _names(inspection: Inspection) -> Iterable[str]:
    survey = inspection.survey
    return [*(f.path for f in survey.files), *(b.path for b in survey.broken), *inspection.masks.values()]


def _digest(names: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(sorted(n.rsplit("/", 1)[-1] for n in names)).encode("utf-8", "replace")).hexdigest()
