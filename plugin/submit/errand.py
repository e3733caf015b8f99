"""What every step of a project's way on a node knows, and how it ends."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Mapping, Optional, Sequence, Tuple

from ...stages.thresholds import Thresholds
from ..odm.project import OURS
from .client import NodeClient
from .judge import ReadOutcome
from .ledger import Ledger
from .parcel import Parcel
from .patience import Patience
from .reroute import AlignPairwise
from .views import NodeView

# project, phase, share done (0..1)
Tell = Callable[[str, str, float], None]

CONSOLE = f"{OURS}/task_output.txt"


@dataclass(frozen=True)
class Context:
    """What all journeys of one submission share."""

    client: NodeClient
    node: NodeView
    option_list: Sequence[Mapping[str, Any]]
    ledger: Ledger
    patience: Patience
    limits: Thresholds
    assets: Tuple[str, ...]
    max_reroutes: int
    wait: bool
    frames: Mapping[str, Tuple[str, str]]
    uploads: threading.Semaphore
    reader: Optional[ReadOutcome] = None
    aligner: Optional[Callable[[Path], Optional[AlignPairwise]]] = None
    tell: Optional[Tell] = None


class Errand:
    """One parcel's business with the node; ``reference`` is the anchor's point cloud that it is laid on."""

    def __init__(self, context: Context, parcel: Parcel, reference: Optional[Path] = None) -> None:
        self.context = context
        self.parcel = parcel
        self.reference = reference
        self.ledger = context.ledger
        self.client = context.client
        self.patience = context.patience

    def tell(self, phase: str, share: float) -> None:
        """Say how far this project is, to whoever listens."""
        if self.context.tell is not None:
            self.context.tell(self.parcel.name, phase, share)

    def end(self, state: str, route: str, *reasons: str) -> None:
        """Close the project in the ledger."""
        self.ledger.change(self.parcel.name, state=state, route=route, reasons=tuple(r for r in reasons if r))
        self.tell(state, 1.0)
