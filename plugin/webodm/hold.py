"""Hold mode: no new task reaches a node before it was looked at, however it was created.

WebODM has no hook ahead of processing, so the task's own saving is one. While
a task waits it has no node and finds none by itself; what the user wanted is
kept and given back on release. Everything here runs inside ``save()``: what
goes wrong ends the saving, and nothing is submitted.
"""

from __future__ import annotations

import logging
from typing import Any, Dict, Optional

from . import home, preferences, presence, records

LOG = logging.getLogger("app.logger")

WAITS = "Waiting: sensorgate looks at the cameras of these images first. No node is needed yet."
_FAILED = 30


def connect() -> None:
    """Hear of every task that is saved, and of those that are gone."""
    from app.models import Task
    from app.plugins import signals as plugin_signals
    from django.db.models import signals

    uid = f"{home.NAME}-hold"
    signals.pre_save.connect(before_save, sender=Task, weak=False, dispatch_uid=f"{uid}-before")
    signals.post_save.connect(after_save, sender=Task, weak=False, dispatch_uid=f"{uid}-after")
    plugin_signals.task_removed.connect(_removed, weak=False, dispatch_uid=f"{uid}-removed")
    presence.note()


def before_save(sender: Any, instance: Any, raw: bool = False, **_: Any) -> None:
    """Take the node away from a task that was not let go yet."""
    if raw or not awaits_submission(instance):
        return
    record = records.load(instance.pk)
    if record is not None and record.get("passed"):
        return
    if not _holds(record):
        return
    if instance._state.adding and not instance.images_count:
        return  # an empty task; what its creator wants of it comes with the next saving
    from app import pending_actions

    if instance.pending_action == pending_actions.RESTART:
        instance.pending_action = None
    wish = _wish_of(instance)
    known = record or {"state": records.UPLOADING}
    # The first wish counts as it is; later only one that asks for something, for we took the node away ourselves.
    asks = "wish" not in known or wish["auto"] or wish["node"] is not None
    if asks and known.get("wish") != wish:
        first = {} if "wish" in known else {"state": records.UPLOADING}
        known = records.keep(instance.pk, {**known, **first, "wish": wish})
    instance.auto_processing_node = False
    instance.processing_node = None
    instance.status = None
    if not instance.partial:
        # What WebODM shows where a task has a message; an open upload has none.
        instance.last_error = known.get("message") or WAITS


def after_save(sender: Any, instance: Any, raw: bool = False, **_: Any) -> None:
    """Look at a task as soon as all of its files are there; hear of one that failed without a signal."""
    if raw or instance.partial or not instance.images_count:
        return
    if not awaits_submission(instance):
        return
    record = records.load(instance.pk)
    if record is not None and record["state"] not in (records.UPLOADING, records.NONE):
        return
    mode = preferences.mode()
    if home.plugin() is None or (mode == preferences.OFF and record is None):
        return
    holding = record is not None and "wish" in record
    records.change(
        instance.pk,
        state=records.WAITING if holding else records.CHECKING,
        holds=holding,
        message=WAITS if holding else "",
    )
    look_at(instance.pk)


def look_at(task_id: Any) -> None:
    """Have a worker look at the task, once what was saved can be seen by it."""
    from django.db import transaction

    from .workers import check

    transaction.on_commit(lambda: check(task_id))


def awaits_submission(task: Any) -> bool:
    """Whether the next look of WebODM at this task would send it to a node."""
    from app import pending_actions

    if task.uuid or task.import_url:
        return False
    if task.pending_action not in (None, pending_actions.RESIZE, pending_actions.RESTART):
        return False
    return task.status is None or (task.status == _FAILED and _is_held(task))


def _is_held(task: Any) -> bool:
    record = records.load(task.pk)
    return record is not None and record["state"] in (records.UPLOADING, records.WAITING, records.HELD)


def _holds(record: Optional[Dict[str, Any]]) -> bool:
    """A task that waits goes on waiting whatever the setting is now: it has to be given back what it wanted."""
    if home.plugin() is None:
        return False
    if record is not None and "wish" in record:
        return True
    return preferences.mode() == preferences.HOLD


def _wish_of(task: Any) -> Dict[str, Any]:
    return {"auto": bool(task.auto_processing_node), "node": task.processing_node_id}


def _removed(sender: Any, task_id: Any = None, **_: Any) -> None:
    if task_id is not None:
        records.forget(task_id)
