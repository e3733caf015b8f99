"""What becomes of a project once its task has ended: done, given up, or back to the router."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.route import PROCEED
from ..odm.project import OURS
from . import ledger as states
from .collect import NONE, set_aside
from .errand import CONSOLE, Errand
from .judge import STOP, Judgement, judge
from .ledger import Attempt
from .parcel import UNPROVEN
from .reroute import build, plan
from .views import COMPLETED, FAILED, TaskView


class Aftermath(Errand):
    """Judges what came home and does what follows from it."""

    def judge(self, attempt: Attempt) -> None:
        """Read the products and the console of an ended task and close the project, or make new ones of it."""
        folder = Path(self.parcel.folder)
        fetched = attempt.state == states.FETCHED
        status = COMPLETED if fetched else FAILED
        view = TaskView(attempt.uuid, status, attempt.images, (), 100.0, True, attempt.message)
        file = folder / CONSOLE
        console = file.read_text(encoding="utf-8", errors="replace").splitlines() if file.is_file() else []
        has = fetched and self.context.assets != (NONE,)
        found = judge(view, folder if has else None, console, self.context.reader)
        if found.route in (PROCEED, UNPROVEN):
            self.end(states.DONE, found.route, *found.reasons)
        elif found.route == STOP:
            self.end(states.GIVEN_UP, "", *found.reasons)
        else:
            self._reroute(found, attempt)

    def _depth(self) -> int:
        depth, name = 0, self.parcel.parent
        while name:
            depth += 1
            parent = self.ledger.get(name)
            name = parent.parent if parent is not None else ""
        return depth

    def _reroute(self, found: Judgement, attempt: Attempt) -> None:
        """Back to the router: new projects out of this one, or the end where the tries are used up."""
        parts: List[Any] = []
        if self._depth() < self.context.max_reroutes:
            apart = self._aligned_apart() if found.route == "pairwise" and len(self._payloads()) > 1 else None
            parts = list(plan(self.parcel, found.route, found.reasons, self.context.frames, apart, self.context.limits))
        if not parts:
            whole = attempt.state == states.FETCHED
            left = "Its products are kept, but look at them." if whole else "Nothing is left to try by itself."
            self.end(states.GIVEN_UP, found.route, *found.reasons, left)
            return
        if attempt.state == states.FETCHED:
            set_aside(Path(self.parcel.folder), attempt.number)
        made = [build(self.parcel, part, self.context.frames, self.context.limits).name for part in parts]
        self.ledger.change(self.parcel.name, children=tuple(made))
        self.end(states.REROUTED, found.route, *found.reasons)

    def _payloads(self) -> Sequence[str]:
        known: Dict[str, Tuple[str, str]] = dict(self.context.frames)
        return sorted({known[i.name][0] for i in self.parcel.items if i.name in known})

    def _aligned_apart(self) -> Optional[Mapping[str, str]]:
        if self.context.aligner is None:
            return None
        folder = Path(self.parcel.folder)
        align = self.context.aligner(folder / OURS / "realign")
        if align is None:
            return None
        return align([Path(i.path) for i in self.parcel.items if i.name in self.context.frames])
