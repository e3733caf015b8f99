"""Brings one project onto a node whole and once, whatever breaks on the way.

A node renames a file that arrives twice (``X.JPG``, ``X_.JPG``) and keeps the
torn half of one whose connection broke. So a file is sent under its name
once. What got no clear answer goes at the end into ``seed.zip``, which the
node unpacks over whatever lies there: the torn half is overwritten, the
missing file is put in. At the end the node's count is held against ours.
"""

from __future__ import annotations

import tempfile
import threading
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence

from ...stages.errors import SensorgateError
from ...stages.record import dumps
from ..odm.wire import CALIBRATION_INPUT, OVERRIDES, opensfm_overrides
from . import ledger as states
from .client import NodeClient
from .errors import Abandoned, NodeError, NotSent, Refused, Unsure
from .ledger import Attempt, Journal, Ledger
from .negotiate import differences
from .parcel import Item, Parcel
from .patience import Patience
from .views import CANCELED, FAILED, TaskView

SEED = "seed.zip"
# A file's date in the archive; the node does not look at it, and a clock would change the bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)
# What a node answers when it does not know the upload (any more).
_NO_UPLOAD = ("invalid uuid", "invalid taskid", "no longer exists")

Uploaded = Callable[[int, int], None]


class Transfer:
    """Sends one attempt of a parcel. Each step may be entered again after a crash."""

    def __init__(
        self,
        client: NodeClient,
        parcel: Parcel,
        ledger: Ledger,
        patience: Patience,
        *,
        extra: Sequence[Item] = (),
        outputs: Sequence[str] = (),
        uploaded: Optional[Uploaded] = None,
    ) -> None:
        self.client = client
        self.parcel = parcel
        self.ledger = ledger
        self.patience = patience
        self.items = (*parcel.items, *extra)
        self.outputs = outputs
        self.uploaded = uploaded

    def run(self, attempt: Attempt) -> TaskView:
        """From wherever the attempt stands to a task on the node that holds what was sent.

        Raises ``Abandoned`` where a new attempt is needed, and
        ``Mismatch`` where the node took something else than was sent.
        """
        journal = self.ledger.journal(attempt.uuid)
        if attempt.state == states.OPENING:
            attempt = self._open(attempt)
        if attempt.state == states.UPLOADING:
            self._upload(attempt, journal)
            attempt = self._to(states.COMMITTING)
        if attempt.state == states.COMMITTING:
            self._commit(attempt)
            attempt = self._to(states.VERIFYING)
        view = self._verify(attempt)
        journal.remove()
        self._to(states.RUNNING)
        return view

    def _to(self, state: str) -> Attempt:
        return self.ledger.attempt(self.parcel.name, state=state)

    def _open(self, attempt: Attempt) -> Attempt:
        """Ask for an upload under our uuid. To ask twice does no harm: the node only writes its note again."""

        def ask() -> None:
            self.client.init(attempt.uuid, self.parcel.name, attempt.options, self.outputs)

        try:
            self.patience.keep_asking(ask)
        except Refused as error:
            if "set-uuid" not in error.text:
                raise
            # The node knows this uuid: our own task whose answer was lost, or one whose ledger was.
            known = self.patience.keep_asking(lambda: self.client.task(attempt.uuid))
            if known is None:
                raise Abandoned("The node does not take the task's uuid") from error
            return self._to(states.VERIFYING)
        return self.ledger.attempt(self.parcel.name, state=states.UPLOADING, opened=True)

    def _upload(self, attempt: Attempt, journal: Journal) -> None:
        with tempfile.TemporaryDirectory(prefix="sensorgate-") as scratch:
            files = list(self.items)
            if attempt.calibration_file:
                files.append(_calibration_item(self.parcel, Path(scratch)))
            self._send_all(attempt, files, journal)
            torn = journal.torn - {SEED}
            if torn:
                self.ledger.attempt(self.parcel.name, repaired=tuple(sorted(torn)))
            if (torn or attempt.seed) and SEED not in journal.done:
                self._send_seed(attempt, [f for f in files if f.name in torn], journal, Path(scratch))

    def _send_all(self, attempt: Attempt, files: Sequence[Item], journal: Journal) -> None:
        todo = [f for f in files if f.name not in journal.begun]
        count = len(files)
        stop = threading.Event()
        faults: List[Exception] = []

        def send(item: Item) -> None:
            if stop.is_set():
                return
            try:
                self._send(attempt, item, journal)
                if self.uploaded is not None:
                    self.uploaded(len(journal.done), count)
            except Exception as error:
                faults.append(error)
                stop.set()

        threads = max(1, min(self.patience.limits.submit_upload_threads, len(todo)))
        with ThreadPoolExecutor(max_workers=threads) as pool:
            for future in [pool.submit(send, item) for item in todo]:
                future.result()
        if faults:
            raise faults[0]

    def _send(self, attempt: Attempt, item: Item, journal: Journal) -> None:
        """Send one file once; only where the connection was never made is it tried again."""
        _check_file(item)

        def once() -> None:
            self.patience.check()
            journal.begin(item.name)
            try:
                self.client.upload(attempt.uuid, item.name, Path(item.path))
            except NotSent:
                journal.never_sent(item.name)
                raise
            journal.finish(item.name)

        try:
            self.patience.keep_asking(once, repeat=(NotSent,))
        except Refused as error:
            if any(sign in error.text.lower() for sign in _NO_UPLOAD):
                raise Abandoned("The node forgot the upload") from error
            if error.text == "413" or "max images" in error.text.lower():
                raise
        except Unsure:
            pass  # it stays torn in the journal, and goes into the seed

    def _send_seed(self, attempt: Attempt, torn: Sequence[Item], journal: Journal, scratch: Path) -> None:
        """Send the archive until the node says that it has it.

        Here to repeat is right: beside a whole one the second becomes
        ``seed_.zip``, which the node deletes; a torn one cannot be unpacked,
        and the node says so.
        """
        path = scratch / SEED
        write_seed(path, torn, self.parcel.calibration if attempt.seed else None)
        for go in range(self.patience.limits.submit_seed_tries):
            if go:
                self.patience.wait(self.patience.limits.submit_retry_s)
            self._send(attempt, Item(SEED, str(path), path.stat().st_size), journal)
            if SEED in journal.done:
                return
        raise Abandoned("The archive that was to mend the upload got no answer")

    def _commit(self, attempt: Attempt) -> None:
        """Make a task of the upload, once. Where there was no answer, look before asking again."""
        while True:
            if self._known(attempt, looks=1):
                return
            try:
                self.client.commit(attempt.uuid)
                return
            except NotSent:
                self.patience.keep_asking(self.client.info)
            except Unsure:
                if self._known(attempt, looks=self.patience.limits.submit_lost_answers):
                    return
            except Refused as error:
                if self._known(attempt, looks=self.patience.limits.submit_lost_answers):
                    return
                if any(sign in error.text.lower() for sign in _NO_UPLOAD):
                    raise Abandoned("The node forgot the upload before it became a task") from error
                raise

    def _known(self, attempt: Attempt, looks: int) -> bool:
        for look in range(looks):
            if look:
                self.patience.wait(self.patience.limits.submit_retry_s)
            if self.patience.keep_asking(lambda: self.client.task(attempt.uuid)) is not None:
                return True
        return False

    def _verify(self, attempt: Attempt) -> TaskView:
        """Hold the node's count and options against ours once the node has sorted the files."""
        limits = self.patience.limits
        waited, unknown = 0.0, 0
        while True:
            view = self.patience.keep_asking(lambda: self.client.task(attempt.uuid))
            if view is None:
                unknown += 1
                if unknown >= limits.submit_lost_answers:
                    raise Lost("The node does not know the task any more")
            elif view.settled:
                break
            else:
                unknown = 0
                if waited > limits.submit_settle_s:
                    raise Abandoned("The node did not come to an end with sorting the files")
            pause = limits.submit_poll_s if waited > limits.submit_retry_s else limits.submit_poll_s / 10
            self.patience.wait(pause)
            waited += pause
        if view.status == FAILED and "extract .zip" in view.message:
            raise Abandoned("The archive that was to mend the upload arrived in part")
        if view.status not in (FAILED, CANCELED):
            self._compare(attempt, view)
        return view

    def _compare(self, attempt: Attempt, view: TaskView) -> None:
        wrong = differences(attempt.options, view.options)
        if view.images != attempt.images:
            raise Mismatch(f"{attempt.images} images were sent and the node has {view.images}", {}, view.images)
        if wrong:
            raise Mismatch("; ".join(wrong[k] for k in sorted(wrong)), wrong, view.images)


class Lost(NodeError):
    """The node lost the task."""


class Mismatch(NodeError):
    """The node took something else than was sent: ``options`` maps names to what is wrong."""

    def __init__(self, message: str, options: Dict[str, str], images: Optional[int]) -> None:
        super().__init__(message)
        self.options = options
        self.images = images


def _check_file(item: Item) -> None:
    """The file is still the one that was counted; else the node would get another survey than the ledger says."""
    try:
        size = Path(item.path).stat().st_size
    except OSError as error:
        raise SensorgateError(f"{item.path} cannot be read any more: {error.strerror}. Nothing was started.") from error
    if size != item.size:
        raise SensorgateError(f"{item.path} changed while it was sent. Nothing was started; submit again.")


def _calibration_item(parcel: Parcel, scratch: Path) -> Item:
    path = scratch / CALIBRATION_INPUT
    path.write_text(dumps(dict(parcel.calibration or {})), encoding="utf-8")
    return Item(CALIBRATION_INPUT, str(path), path.stat().st_size)


def write_seed(path: Path, files: Sequence[Item], calibration: Optional[object]) -> None:
    """An archive that the node unpacks over the project: files to mend, and a calibration where plain ODM finds it."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        for item in sorted(files, key=lambda i: i.name):
            entry = zipfile.ZipInfo(f"images/{item.name}", _EPOCH)
            entry.external_attr = 0o644 << 16
            with Path(item.path).open("rb") as source, archive.open(entry, "w", force_zip64=item.size > 1 << 31) as to:
                while True:
                    part = source.read(1 << 20)
                    if not part:
                        break
                    to.write(part)
        if isinstance(calibration, dict):
            entry = zipfile.ZipInfo(OVERRIDES, _EPOCH)
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, dumps(opensfm_overrides(calibration)))
