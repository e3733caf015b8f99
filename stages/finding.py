"""A finding: one thing the gate has to say, with what it measured and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

INFO = "info"
WARNING = "warning"
ERROR = "error"
SEVERITIES = (INFO, WARNING, ERROR)


@dataclass(frozen=True)
class Finding:
    """What was found, on whom, and the way out.

    ``code`` is stable and has a page in ``docs/findings/``. ``subjects`` are
    frame paths, profile ids or sub-project names. ``measured`` and
    ``threshold`` are given in the unit that ``message`` names. ``odm_message``
    is the text that ODM itself would print, where it would print one.
    """

    code: str
    severity: str
    subjects: Tuple[str, ...]
    message: str
    remedy: str
    measured: Optional[float] = None
    threshold: Optional[float] = None
    odm_message: Optional[str] = None


def sort_key(finding: Finding) -> Tuple[int, str, Tuple[str, ...], str]:
    """Errors first, then by code and subject: the order never depends on how files were listed."""
    return (-SEVERITIES.index(finding.severity), finding.code, finding.subjects, finding.message)
