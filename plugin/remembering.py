"""The calibration store around a run: what the proven alignments add to it, and what is said about that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

from ..stages.align.model import AlignmentReport
from ..stages.align.offer import offered
from ..stages.calibrations import DOUBTED, REPLACED, Entry, Key, Measurement, key_of, read_store, updated, write_entry
from ..stages.errors import UsageError
from ..stages.finding import INFO, WARNING, Finding
from ..stages.profile import CameraProfile
from ..stages.thresholds import Thresholds


@dataclass(frozen=True)
class Memory:
    """Entries to write once the run is whole, and what is to be said."""

    folder: Optional[str] = None
    entries: Tuple[Entry, ...] = ()
    findings: Tuple[Finding, ...] = ()

    def write(self) -> None:
        """Put the entries into the store. Raises ``UsageError`` where it cannot be written; the run itself is whole."""
        for entry in self.entries:
            try:
                write_entry(str(self.folder), entry)
            except OSError as error:
                raise UsageError(
                    f"The projects are written, but the calibration store {self.folder} is not: "
                    f"{error.strerror or error}. Make the folder writable and run again."
                ) from None


def learned(
    folder: Optional[str],
    alignments: Sequence[AlignmentReport],
    profiles: Sequence[CameraProfile],
    survey: str,
    limits: Thresholds,
) -> Memory:
    """What the store becomes by these alignments; nothing is written yet. ``survey`` is the digest of its frames."""
    if folder is None:
        return Memory()
    store = read_store(folder)
    changed: Dict[Key, Entry] = {}
    findings: List[Finding] = []
    of_key = {key_of(p): p.id for p in profiles}
    for key, new in sorted((o for a in alignments for o in offered(a, profiles, survey, limits)), key=_order):
        before = changed.get(key, store.get(key))
        after, what = updated(before, key, new, limits)
        if after != before:
            changed[key] = after
        if what in (DOUBTED, REPLACED) and before is not None:
            findings.append(_contradicts(of_key.get(key, key.model), before, new, what, limits))
    return Memory(folder, tuple(changed[k] for k in sorted(changed, key=str)), tuple(findings))


def _order(item: Tuple[Key, Measurement]) -> str:
    return str(item)


def _contradicts(profile: str, before: Entry, new: Measurement, what: str, limits: Thresholds) -> Finding:
    apart = abs(new.focal_ratio / before.best.focal_ratio - 1.0)
    told = (
        f"The focal that this survey proves for {profile} lies {apart:.1%} off what "
        f"{len(before.surveys)} earlier surveys of this body agreed on."
    )
    if what == REPLACED:
        return Finding(
            code="calibration-replaced",
            severity=INFO,
            subjects=(profile,),
            message=f"{told} {limits.stored_doubts} surveys in a row say so: the stored calibration is replaced.",
            remedy="Nothing has to be done, if the camera was repaired, dropped or changed its lens.",
            measured=apart,
            threshold=limits.stored_gap,
        )
    return Finding(
        code="calibration-differs",
        severity=WARNING,
        subjects=(profile,),
        message=f"{told} The stored one stays.",
        remedy="Look at this survey's heights against something independent; the camera may have been knocked.",
        measured=apart,
        threshold=limits.stored_gap,
    )
