"""``submit``: all sub-projects of a folder onto a node, in parallel, resumable, to a word on every payload."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence, Tuple

from ...stages.errors import Cancelled, SensorgateError, UsageError
from ...stages.progress import Cancel, Progress
from ...stages.thresholds import DEFAULTS, Thresholds
from ..odm.layout import ALIGN_PRODUCT
from . import ledger as states
from .anchor import ISOLATED, choose, product
from .anchor import NONE as NO_ANCHOR
from .client import NodeClient
from .collect import ALL, NONE, outputs_for
from .errand import Context, Tell
from .errors import NodeError, NodeUnusable, NotSent, Refused, Unsure
from .journey import Journey
from .judge import ReadOutcome
from .ledger import Attempt, Entry, Ledger
from .lock import only_one
from .negotiate import kind_of
from .parcel import UNPROVEN, Parcel, read_json, read_parcels
from .patience import Patience
from .reroute import default_aligner, frames_of

LOG = logging.getLogger("sensorgate.submit")

LEDGER = "submit.json"
_UPLOADS_AT_ONCE = 2

# Asked on an interruption: the tasks that still run on the node; true cancels them.
AskCancel = Callable[[Sequence[Attempt]], bool]


@dataclass(frozen=True)
class Settings:
    """How a submission goes about it.

    ``ledger`` is a file (default ``submit.json`` in the folder). ``assets``
    are ``all.zip``, ``none`` or paths inside a project. ``align`` is
    ``isolated``, ``all`` or ``none``. ``wait`` false leaves once all is sent;
    the same call later goes on. ``retry`` takes up again what had failed.
    """

    token: Optional[str] = None
    include_unproven: bool = False
    ledger: Optional[str] = None
    assets: Tuple[str, ...] = (ALL,)
    reroutes: Optional[int] = None
    align: str = ISOLATED
    parallel: Optional[int] = None
    wait: bool = True
    retry: bool = False
    thresholds: Thresholds = DEFAULTS


DEFAULT_SETTINGS = Settings()


@dataclass(frozen=True)
class Submission:
    """What became of it. ``left_out`` are unproven projects, ``faults`` what stopped a project by surprise."""

    entries: Tuple[Entry, ...]
    left_out: Tuple[str, ...]
    faults: Tuple[Tuple[str, str], ...]
    node: str
    ledger: str
    exit_code: int


def submit(
    folder: Path,
    node: str,
    settings: Settings = DEFAULT_SETTINGS,
    *,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    tell: Optional[Tell] = None,
    ask_cancel: Optional[AskCancel] = None,
    read_outcome: Optional[ReadOutcome] = None,
) -> Submission:
    """Submit the sub-projects below ``folder``; called again it goes on where the ledger stands.

    Exit code 0: all done. 1: something was rerouted, refused, failed or left
    out. 3: the node went away. Raises ``NodeUnusable`` where the node cannot
    be used at all, ``UsageError`` for the folder, ``Cancelled`` when
    interrupted (the ledger then says what still runs).
    """
    if not folder.is_dir():
        raise UsageError(f"{folder} is no folder. Give the one that sensorgate run wrote.")
    outputs_for(settings.assets)
    path = Path(settings.ledger) if settings.ledger else folder / LEDGER
    client = NodeClient(node, token=settings.token, limits=settings.thresholds)
    with only_one(path):
        return _Submitting(folder, client, settings, path, progress, cancel, tell, ask_cancel, read_outcome).run()


class _Submitting:
    """One call of ``submit``."""

    def __init__(
        self,
        folder: Path,
        client: NodeClient,
        settings: Settings,
        path: Path,
        progress: Optional[Progress],
        cancel: Optional[Cancel],
        tell: Optional[Tell],
        ask_cancel: Optional[AskCancel],
        read_outcome: Optional[ReadOutcome],
    ) -> None:
        self.folder = folder
        self.client = client
        self.settings = settings
        self.stop = threading.Event()
        self.patience = Patience(settings.thresholds, self.stop, cancel)
        self.ledger = Ledger.open(path)
        self.progress = progress
        self.tell = tell
        self.ask_cancel = ask_cancel
        self.read_outcome = read_outcome
        self.shares: Dict[str, float] = {}
        self.faults: List[Tuple[str, str]] = []
        self.gone: Optional[NodeError] = None

    def run(self) -> Submission:
        every = read_parcels(self.folder)
        parcels = [p for p in every if p.route != UNPROVEN or self.settings.include_unproven]
        left_out = tuple(p.name for p in every if p not in parcels)
        if not parcels:
            raise UsageError(
                f"All {len(left_out)} projects in {self.folder} are unproven. Add --include-unproven to submit them."
            )
        context = self._context()
        if self.settings.retry:
            self._take_up_again()
        try:
            self._work(context, parcels)
        except (KeyboardInterrupt, Cancelled):
            self.stop.set()
            self._interrupted()
            raise
        return self._result(left_out)

    def _context(self) -> Context:
        """Look at the node before anything is sent."""
        try:
            node = self.client.info()
            option_list = self.client.options()
        except (NotSent, Unsure, Refused) as error:
            raise NodeUnusable(str(error)) from error
        LOG.info(
            "%s: version %s, engine %s %s, %s", self.client.shown, node.version, node.engine, node.engine_version,
            kind_of(node, option_list),
        )  # fmt: skip
        report = self.folder / "report.json"
        told = read_json(report, "report") if report.is_file() else {}
        limits = self.settings.thresholds
        return Context(
            client=self.client,
            node=node,
            option_list=option_list,
            ledger=self.ledger,
            patience=self.patience,
            limits=limits,
            assets=self.settings.assets,
            max_reroutes=limits.submit_max_reroutes if self.settings.reroutes is None else self.settings.reroutes,
            wait=self.settings.wait,
            frames=frames_of(told if isinstance(told, dict) else {}),
            uploads=threading.Semaphore(_UPLOADS_AT_ONCE),
            reader=self.read_outcome,
            aligner=lambda scratch: default_aligner(scratch, limits),
            tell=self._told,
        )

    def _take_up_again(self) -> None:
        for entry in self.ledger.entries:
            if entry.state in (states.GIVEN_UP, states.REFUSED):
                self.ledger.put(
                    Entry(
                        name=entry.name,
                        digest=entry.digest,
                        folder=entry.folder,
                        images=entry.images,
                        payloads=entry.payloads,
                        parent=entry.parent,
                    )
                )

    def _told(self, name: str, phase: str, share: float) -> None:
        """Progress of one and of all: an upload is the first tenth, processing the rest."""
        part = {"upload": 0.1 * share, "queued": 0.1, "running": 0.1 + 0.85 * share, "download": 0.95 + 0.05 * share}
        self.shares[name] = max(self.shares.get(name, 0.0), part.get(phase, 1.0))
        if self.tell is not None:
            self.tell(name, phase, share)
        if self.progress is not None:
            done = sum(100.0 * s for s in list(self.shares.values()))
            self.progress("submit", int(done), 100 * max(1, len(self.shares)))

    def _slots(self, context: Context) -> int:
        """How many projects are under way: the node's slots, and one more that is sent meanwhile."""
        most = self.settings.parallel or context.limits.submit_tasks_at_once
        slots = context.node.slots
        return max(1, min(most, slots + 1 if slots and not context.node.cluster else most))

    def _work(self, context: Context, parcels: Sequence[Parcel]) -> None:
        anchor, followers = choose(parcels, self.settings.align if self.settings.wait else NO_ANCHOR)
        if anchor is not None and ALL not in context.assets:
            context = _with_assets(context, (*context.assets, "/".join(ALIGN_PRODUCT)))
        self.shares = {p.name: 0.0 for p in parcels}
        ready = sorted((p for p in parcels if p.name not in followers), key=lambda p: (p.name != anchor, p.name))
        held = [p for p in parcels if p.name in followers]
        done: Dict[str, Parcel] = {p.name: p for p in parcels}
        reference: Optional[Path] = None
        running: Dict[Future[Tuple[Parcel, ...]], Parcel] = {}
        with ThreadPoolExecutor(max_workers=self._slots(context)) as pool:
            try:
                while ready or running or held:
                    while ready:
                        parcel = ready.pop(0)
                        laid = reference if parcel.name in followers else None
                        running[pool.submit(Journey(context, parcel, laid).run)] = parcel
                    finished = wait(running, timeout=1.0, return_when=FIRST_COMPLETED).done if running else set()
                    for future in finished:
                        parcel = running.pop(future)
                        for child in self._outcome(parcel, future):
                            if child.name not in done:
                                done[child.name] = child
                                ready.append(child)
                    if held and anchor not in {p.name for p in running.values()}:
                        reference = product(Path(done[str(anchor)].folder), ALIGN_PRODUCT)
                        ready, held = [*ready, *held], []
                    self.patience.check()
            except BaseException:
                self.stop.set()
                raise

    def _outcome(self, parcel: Parcel, future: Future[Tuple[Parcel, ...]]) -> Tuple[Parcel, ...]:
        try:
            return future.result()
        except Cancelled:
            return ()
        except NodeError as error:
            self.gone = error
            self.faults.append((parcel.name, str(error)))
            if isinstance(error, NodeUnusable):
                self.stop.set()
                raise
        except SensorgateError as error:
            self.faults.append((parcel.name, str(error)))
        except OSError as error:
            self.faults.append((parcel.name, f"{error.strerror or error}: {error.filename or parcel.folder}"))
        return ()

    def _interrupted(self) -> None:
        """Ask what is to become of the tasks on the node, and do it."""
        running = [a for e in self.ledger.entries for a in e.attempts if a.state in (states.VERIFYING, states.RUNNING)]
        if not running or self.ask_cancel is None or not self.ask_cancel(running):
            return
        for entry in self.ledger.entries:
            last = entry.last
            if last is None or last not in running:
                continue
            try:
                self.client.cancel(last.uuid)
            except (NodeError, SensorgateError) as error:
                LOG.warning("%s could not be cancelled: %s", entry.name, error)
                continue
            self.ledger.attempt(entry.name, state=states.CANCELED, message="Cancelled when interrupted.")
            self.ledger.change(
                entry.name, state=states.GIVEN_UP, reasons=("Cancelled when the submission was interrupted.",)
            )

    def _result(self, left_out: Tuple[str, ...]) -> Submission:
        self.ledger.tidy()
        entries = self.ledger.entries
        wanted = (states.DONE,) if self.settings.wait else (states.DONE, states.WAITING)
        clean = all(e.state in wanted for e in entries) and not left_out and not self.faults
        code = 3 if self.gone is not None else 0 if clean else 1
        return Submission(
            entries=entries,
            left_out=left_out,
            faults=tuple(self.faults),
            node=self.client.shown,
            ledger=str(self.ledger.path),
            exit_code=code,
        )


def _with_assets(context: Context, assets: Tuple[str, ...]) -> Context:
    return replace(context, assets=tuple(a for a in assets if a != NONE))
