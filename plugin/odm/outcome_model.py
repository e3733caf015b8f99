"""What an ODM run came to, as a record."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

from ...stages.align.model import AlignmentReport
from ...stages.route import PROCEED
from .opensfm_errors import ErrorFigures
from .outcome_console import FINISHED, ConsoleOutcome
from .outcome_read import OdmFigures


@dataclass(frozen=True)
class CameraOutcome:
    """One camera of ODM's: who shared it, how far its focal moved, its errors (``None`` without tracks).

    ``submodel`` names the part of a split run that solved it.
    """

    id: str
    frames: int
    profiles: Tuple[str, ...]
    focal_start: Optional[float]
    focal_solved: Optional[float]
    focal_change: Optional[float]
    errors: Optional[ErrorFigures]
    submodel: str = ""


@dataclass(frozen=True)
class PayloadRoute:
    """What the router would do with one payload."""

    payload: str
    verdict: str
    route: str
    reasons: Tuple[str, ...]


@dataclass(frozen=True)
class SubmodelOutcome:
    """One part of a split run: how it ended, what of it was placed, and its own alignment's verdict.

    Parts overlap: a frame may stand in several of them.
    """

    name: str
    state: str
    frames: int
    registered: int
    components: Tuple[int, ...]
    alignment: Optional[AlignmentReport]


@dataclass(frozen=True)
class Outcome:
    """A run judged.

    ``state`` is ``finished``, ``failed`` or ``unfinished``; ``route`` what the
    router would do: ``proceed``, ``pairwise``, ``isolate`` or ``unproven``
    (nothing proves it, or there is nobody to separate). ``alignment`` is the
    verdict in the alignment's own type, ``None`` where ODM named no frame.
    ``components`` are the frames of each true piece, the largest first.
    ``missing`` frames were given to ODM and not placed, ``dropped`` ones it
    never took. ``ties_from`` says what the ties were counted by.
    ``submodels`` are the parts of a split run: each is judged by itself, and
    ``alignment`` sums them up.
    """

    state: str
    route: str
    reasons: Tuple[str, ...]
    advice: Tuple[str, ...]
    payloads: Tuple[PayloadRoute, ...]
    alignment: Optional[AlignmentReport]
    frames: int
    registered: int
    components: Tuple[int, ...]
    missing: Tuple[str, ...]
    dropped: Tuple[str, ...]
    cameras: Tuple[CameraOutcome, ...]
    odm: OdmFigures
    odm_version: str
    stage: str
    error: str
    console: ConsoleOutcome
    grouped_by: str
    ties_from: str
    notes: Tuple[str, ...]
    submodels: Tuple[SubmodelOutcome, ...] = ()

    @property
    def exit_code(self) -> int:
        """0 done, 1 rerouted, unproven or failed."""
        return 0 if self.state == FINISHED and self.route == PROCEED else 1
