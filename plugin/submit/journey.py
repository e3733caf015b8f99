"""One project's way on a node, from wherever the ledger says it stands to where nothing is left to do."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Optional, Tuple

from ...stages.errors import UsageError
from ...stages.record import write_text
from ..odm.wire import ALIGN_INPUT, POLICY_OPTION
from . import ledger as states
from .aftermath import Aftermath
from .collect import NONE, outputs_for, room, unpack
from .errand import CONSOLE, Errand
from .errors import Abandoned, NodeFull, Refused
from .ledger import Attempt, Entry
from .negotiate import Terms, kind_of, negotiate, numeric_options
from .parcel import Item, Parcel, read_parcel, said_of
from .transfer import Lost, Mismatch, Transfer
from .views import CANCELED, COMPLETED, ENDED, TaskView

ARCHIVE = ".part-all.zip"


class Journey(Errand):
    """Runs one parcel; what it returns besides the ledger's entry are the parcels that came out of it."""

    def run(self) -> Tuple[Parcel, ...]:
        """Go on until nothing is left to do. Raises ``NodeUnusable``, ``Cancelled`` and what the node's absence is."""
        entry = self._entry()
        while entry.state == states.WAITING:
            self.patience.check()
            last = entry.last
            if last is None or last.state in (states.LOST, states.DISCARDED, states.CANCELED):
                if not self._begin(entry):
                    break
            elif last.state == states.DISCARDING:
                self._discard(last)
            elif last.state in (states.OPENING, states.UPLOADING, states.COMMITTING, states.VERIFYING):
                self._send(entry, last)
            elif last.state == states.RUNNING:
                if not self.context.wait:
                    break
                self._watch(last)
            elif last.state == states.COMPLETED:
                self._fetch(last)
            else:
                Aftermath(self.context, self.parcel).judge(last)
            entry = self._entry()
        return tuple(self._child(name) for name in entry.children)

    def _entry(self) -> Entry:
        known = self.ledger.get(self.parcel.name)
        if known is not None and known.digest == self.parcel.digest:
            return known
        return self.ledger.put(
            Entry(
                name=self.parcel.name,
                digest=self.parcel.digest,
                folder=f"{Path(self.parcel.folder).parent.name}/{self.parcel.name}",
                images=self.parcel.images,
                payloads=self.parcel.payloads,
                parent=self.parcel.parent,
            )
        )

    def _child(self, name: str) -> Parcel:
        folder = Path(self.parcel.folder).parent / name
        return read_parcel(folder, said_of(folder))

    # --- sending -------------------------------------------------------------

    def _extra(self) -> Tuple[Item, ...]:
        if self.reference is None or not self.reference.is_file():
            return ()
        return (Item(ALIGN_INPUT, str(self.reference), self.reference.stat().st_size),)

    def _begin(self, entry: Entry) -> bool:
        """Negotiate and begin a new task, or end the project; true where there is a task to go on with."""
        agreed = negotiate(
            self.parcel.options,
            self.context.option_list,
            self.context.node,
            files=len(self.parcel.items) + len(self._extra()),
            has_calibration=self.parcel.calibration is not None,
            leave_out=entry.leave_out,
            seeds=entry.seeds,
        )
        if agreed.terms is None:
            self.end(states.REFUSED, "", *agreed.problems)
            return False
        tried = sum(a.opened for a in entry.attempts)
        if tried >= self.context.limits.submit_max_sends:
            why = entry.attempts[-1].message
            self.end(states.GIVEN_UP, "", f"Tried {tried} times. {why}")
            return False
        number, known = self._free_number(entry)
        reason = "first" if not entry.attempts else entry.attempts[-1].message
        attempt = self._attempt(number, reason, agreed.terms)
        if known is not None:
            attempt = replace(
                attempt, state=states.VERIFYING, notes=(*attempt.notes, "Found on the node: sent before.")
            )
        self.ledger.begin(self.parcel.name, attempt)
        return True

    def _attempt(self, number: int, reason: str, terms: Terms) -> Attempt:
        files = len(self.parcel.items) + len(self._extra()) + terms.calibration_file
        return Attempt(
            number=number,
            uuid=self.parcel.uuid(number),
            node=self.client.shown,
            state=states.OPENING,
            reason=reason,
            options=tuple(dict(o) for o in terms.options),
            files=files,
            images=self.parcel.images + terms.calibration_file,
            seed=terms.calibration_seed,
            calibration_file=terms.calibration_file,
            notes=terms.notes,
        )

    def _free_number(self, entry: Entry) -> Tuple[int, Optional[TaskView]]:
        """The next task of this project: one that the node already has from a lost ledger, else a new one."""
        first = max((a.number for a in entry.attempts), default=0) + 1
        free: Optional[int] = None
        for number in range(first, first + self.context.limits.submit_task_numbers):
            if free is not None and number >= first + self.context.limits.submit_max_sends:
                break
            uuid = self.parcel.uuid(number)
            view = self.patience.keep_asking(lambda u=uuid: self.client.task(u))  # type: ignore[misc]
            if view is None:
                free = number if free is None else free
            elif view.status not in ENDED or view.status == COMPLETED:
                return number, view
        if free is None:
            raise UsageError(f"{self.client.shown} has too many tasks of {self.parcel.name}. Remove some there.")
        return free, None

    def _send(self, entry: Entry, attempt: Attempt) -> None:
        if self._elsewhere(attempt):
            return
        extra = self._extra() if attempt.files > len(self.parcel.items) + attempt.calibration_file else ()
        transfer = Transfer(
            self.client,
            self.parcel,
            self.ledger,
            self.patience,
            extra=extra,
            outputs=outputs_for(self.context.assets),
            uploaded=lambda done, of: self.tell("upload", done / max(1, of)),
        )
        try:
            with self.context.uploads:
                transfer.run(attempt)
        except Abandoned as error:
            self._note(states.DISCARDING, f"{error}.")
        except Lost as error:
            self._lost(entry, attempt, str(error))
        except Mismatch as error:
            self._mismatch(entry, attempt, error)
        except NodeFull as error:
            self._note(states.DISCARDING, str(error))
            self._discard(self._last())
            self.end(states.GIVEN_UP, "", str(error))
        except Refused as error:
            self._refused(error)

    def _refused(self, error: Refused) -> None:
        """The node says no to an upload or to its commit; it removed what it had."""
        self._note(states.DISCARDING, str(error))
        self._discard(self._last())
        if "split-merge cluster" in error.text:
            self.ledger.change(self.parcel.name, seeds=False)
        else:
            self.end(states.GIVEN_UP, "", str(error))

    def _mismatch(self, entry: Entry, attempt: Attempt, error: Mismatch) -> None:
        """The node took something else: cancel it there, and say so."""
        if set(error.options) == {POLICY_OPTION} and kind_of(self.context.node, self.context.option_list) == "cluster":
            kept = "; the calibration lies where its ODM finds it" if attempt.seed else ""
            note = f"The node of the cluster that took it has no sensorgate adapter{kept}."
            self.ledger.attempt(self.parcel.name, state=states.RUNNING, notes=(*attempt.notes, note))
            self.ledger.journal(attempt.uuid).remove()
            return
        self.patience.keep_asking(lambda: self._cancel(attempt))
        message = f"The node took something else than was sent, so the task was cancelled: {error}."
        self._note(states.CANCELED, message)
        self.ledger.journal(attempt.uuid).remove()
        if error.options:
            self.end(states.REFUSED, "", message)

    def _cancel(self, attempt: Attempt) -> None:
        try:
            self.client.cancel(attempt.uuid)
        except Refused:
            view = self.client.task(attempt.uuid)
            if view is not None and view.status not in ENDED:
                raise

    def _elsewhere(self, attempt: Attempt) -> bool:
        """The ledger speaks of another node than the one that was given: begin anew here."""
        if attempt.node == self.client.shown:
            return False
        self._note(states.LOST, f"It was on {attempt.node}; now {self.client.shown} was given.")
        return True

    def _last(self) -> Attempt:
        entry = self.ledger.get(self.parcel.name)
        if entry is None or entry.last is None:
            raise KeyError(self.parcel.name)
        return entry.last

    def _note(self, state: str, message: str) -> None:
        self.ledger.attempt(self.parcel.name, state=state, message=message)

    def _lost(self, entry: Entry, attempt: Attempt, message: str) -> None:
        """The node lost the task. Where it may have ended on a number, the next one goes without."""
        self._note(states.LOST, f"{message}: it was probably restarted without its list of tasks.")
        self.ledger.journal(attempt.uuid).remove()
        numbers = numeric_options(attempt.options)
        if numbers and self.context.node.version == "2.2.4" and not entry.leave_out:
            why = "a NodeODM 2.2.4 without the fix of its issue 269 ends on any option with a number; update the node"
            self.ledger.change(self.parcel.name, leave_out=dict.fromkeys(numbers, why))

    def _discard(self, attempt: Attempt) -> None:
        """Leave nothing of an upload on the node: make a task of it, for only tasks can be removed."""
        if self._elsewhere(attempt):
            return

        def gone() -> bool:
            if self.client.task(attempt.uuid) is None:
                try:
                    self.client.commit(attempt.uuid)
                except Refused:
                    return True  # no upload of that name, or the node removed it with its refusal
            with contextlib.suppress(Refused):
                self.client.remove(attempt.uuid)
            return self.client.task(attempt.uuid) is None

        for _ in range(self.context.limits.submit_lost_answers):
            if self.patience.keep_asking(gone):
                break
            self.patience.wait(self.context.limits.submit_retry_s)
        self.ledger.attempt(self.parcel.name, state=states.DISCARDED)
        self.ledger.journal(attempt.uuid).remove()

    # --- waiting and bringing home -------------------------------------------

    def _watch(self, attempt: Attempt) -> None:
        if self._elsewhere(attempt):
            return
        unknown = 0
        while True:
            view = self.patience.keep_asking(lambda: self.client.task(attempt.uuid))
            if view is None:
                unknown += 1
                if unknown >= self.context.limits.submit_lost_answers:
                    entry = self.ledger.get(self.parcel.name)
                    if entry is not None:
                        self._lost(entry, attempt, "The node does not know the task any more")
                    return
            else:
                unknown = 0
                self.tell(view.status, view.progress / 100.0)
                if view.status in ENDED:
                    break
            self.patience.wait(self.context.limits.submit_poll_s)
        self._save_console(attempt)
        state = {COMPLETED: states.COMPLETED, CANCELED: states.CANCELED}.get(view.status, states.FAILED)
        self._note(state, view.message)
        if state == states.CANCELED:
            self.end(states.GIVEN_UP, "", f"The task was cancelled on the node. {view.message}".strip())

    def _console(self, attempt: Attempt) -> Tuple[str, ...]:
        try:
            return self.patience.keep_asking(lambda: self.client.console(attempt.uuid))
        except Refused:
            return ()

    def _save_console(self, attempt: Attempt) -> None:
        lines = "".join(f"{self.client.hide(line)}\n" for line in self._console(attempt))
        write_text(Path(self.parcel.folder) / CONSOLE, lines)

    def _fetch(self, attempt: Attempt) -> None:
        if self._elsewhere(attempt):
            return
        folder = Path(self.parcel.folder)
        if self.context.assets == (NONE,):
            self._note(states.FETCHED, "")
            return
        archive = folder / ARCHIVE
        told = lambda done, of: self.tell("download", done / of if of else 0.0)  # noqa: E731
        try:
            self.patience.keep_asking(
                lambda: self.client.download(
                    attempt.uuid, archive, max_bytes=room(folder, self.context.limits), progress=told
                )
            )
            unpack(archive, folder, self.context.limits)
        except Refused as error:
            if self.patience.keep_asking(lambda: self.client.task(attempt.uuid)) is None:
                self._note(states.LOST, "The node lost the task before its products were here.")
                return
            self._note(states.FETCHED, f"The products could not be taken: {error}")
            self.end(states.GIVEN_UP, "", str(error))
            return
        finally:
            archive.unlink(missing_ok=True)
        self._note(states.FETCHED, "")
