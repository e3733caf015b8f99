"""What is known of a task and the gate: one value per task in WebODM's own store, seen by all its processes."""

from __future__ import annotations

import time
from typing import Any, Dict, List, Optional, Sequence, Tuple

from . import home

NONE = "none"
UPLOADING, WAITING, CHECKING, HELD = "uploading", "waiting", "checking", "held"
RELEASED, SPLIT, OVERRIDDEN, WORKING, FAILED = "released", "split", "overridden", "working", "failed"
# In one of these nobody works on it unless a worker says so now and then.
BUSY = frozenset((WAITING, CHECKING, WORKING))
# A worker that has said nothing for so long is gone.
STALE_S = 180.0
# Its claim on the task ends before, so that the next one does not find it taken.
CLAIM_S = 120.0
_PREFIX = "task::"
_MOST_KEYS = 500


def _key(task_id: Any) -> str:
    return f"{_PREFIX}{task_id}"


def load(task_id: Any) -> Optional[Dict[str, Any]]:
    """The record, or ``None``."""
    value = home.global_store().get_json(_key(task_id), None)
    return value if isinstance(value, dict) and "state" in value else None


def keep(task_id: Any, record: Dict[str, Any]) -> Dict[str, Any]:
    """Keep a record with the time of its last change."""
    record = {**record, "at": time.time()}
    home.global_store().set_json(_key(task_id), record)
    return record


def change(task_id: Any, **changes: Any) -> Dict[str, Any]:
    """Change some values of a record."""
    return keep(task_id, {"state": NONE, **(load(task_id) or {}), **changes})


def forget(task_id: Any) -> None:
    """Remove the record of a task that is gone."""
    home.global_store().del_key(_key(task_id))


def is_stale(record: Dict[str, Any]) -> bool:
    """Whether the worker that should be at it is gone."""
    return record["state"] in BUSY and time.time() - float(record.get("at", 0.0)) > STALE_S


def all_in(*states: str) -> List[Tuple[str, Dict[str, Any]]]:
    """(task id, record) of all tasks in these states, by id."""
    from app.models import PluginDatum

    rows = PluginDatum.objects.filter(key__startswith=f"{home.NAME}::{_PREFIX}", user=None)
    found = []
    for row in rows:
        value = row.json_value
        if isinstance(value, dict) and value.get("state") in states:
            found.append((row.key.rpartition("::")[2], value))
    return sorted(found, key=lambda item: item[0])


def of_tasks(task_ids: Sequence[Any]) -> Dict[str, Dict[str, Any]]:
    """Task id -> record, of those of these tasks that have one."""
    from app.models import PluginDatum

    keys = [f"{home.NAME}::{_key(i)}" for i in task_ids]
    found = {}
    for first in range(0, len(keys), _MOST_KEYS):
        for row in PluginDatum.objects.filter(key__in=keys[first : first + _MOST_KEYS], user=None):
            if isinstance(row.json_value, dict) and "state" in row.json_value:
                found[row.key.rpartition("::")[2]] = row.json_value
    return found
