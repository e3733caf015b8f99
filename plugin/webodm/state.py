"""What is to be said of a task to this user: its state, and what may be done now."""

from __future__ import annotations

import contextlib
import os
import time
from typing import Any, Dict, List, Mapping, Optional, Sequence

from ...stages.rules.text import plural
from . import hold, home, preferences, preparing, records, tasks, workers
from .proposal import TAG
from .remedies import GATE, NODE, WORKER

CHECK, OVERRIDE, SPLIT, JUDGE, PREPARE = "check", "override", "split", "judge", "prepare"
ACTIONS = (CHECK, OVERRIDE, SPLIT, JUDGE, PREPARE)
BROKEN_OFF = "broken-off"
_MOST_TASKS = 5000
# An upload that goes on puts a file there more often.
_OPEN_S = 180.0
_FAILED, _COMPLETED, _CANCELED = 30, 40, 50


def state_of(task: Any, user: Any) -> Dict[str, Any]:
    """The answer of the API: see ``api.py``. A worker that died is replaced on the way."""
    record = records.load(task.pk) or {"state": records.NONE}
    if records.is_stale(record):
        _take_up(task, record)
    may_change = bool(user.has_perm("change_project", task.project))
    may_view = bool(user.has_perm("view_project", task.project))  # else it is a public task
    engine, said = engine_for(task)
    shown = records.WAITING if record["state"] == records.UPLOADING else record["state"]
    return {
        "state": shown,
        "message": (record.get("message") or "") if may_view else "",
        "progress": record.get("progress"),
        "verdict": record.get("verdict"),
        "report": home.page(f"tasks/{task.pk}/report") if user.is_authenticated and has_report(task) else None,
        "actions": actions_for(task, record, user) if may_change else [],
        "tasks": _left(record) if may_change else [],
        "judgement": record.get("judgement") if may_change else None,
        "engine": engine if may_change else GATE,
        "engine_message": said if may_change else "",
    }


def waiting_in(projects: Sequence[int], user: Any) -> Dict[str, List[Dict[str, Any]]]:
    """Project -> its tasks that wait for the gate or are worked on, of the projects that this user may see."""
    from app.models import Task

    rows = Task.objects.filter(project_id__in=projects, project__deleting=False, partial=False)
    found = rows.select_related("project").order_by("created_at")[:_MOST_TASKS]
    told: Dict[str, List[Dict[str, Any]]] = {}
    known = records.of_tasks([t.pk for t in found])
    for task in found:
        record = known.get(str(task.pk))
        if record is None or not _waits(record) or not user.has_perm("view_project", task.project):
            continue
        if records.is_stale(record):
            _take_up(task, record)
        told.setdefault(str(task.project_id), []).append(
            {
                "id": str(task.pk),
                "name": task.name or "",
                "state": records.WAITING if record["state"] == records.UPLOADING else record["state"],
                "message": record.get("message") or "",
                "progress": record.get("progress"),
            }
        )
    for task in Task.objects.filter(project_id__in=projects, project__deleting=False, partial=True)[:_MOST_TASKS]:
        if not broken_off(task) or not user.has_perm("view_project", task.project):
            continue
        told.setdefault(str(task.project_id), []).append(
            {
                "id": str(task.pk),
                "name": task.name or "",
                "state": BROKEN_OFF,
                "message": f"Its upload broke off after {plural(len(task.scan_images()), 'file')}. Delete this task "
                "and choose the files again.",
                "progress": None,
            }
        )
    return told


def broken_off(task: Any) -> bool:
    """Whether a task that the panel created is still open, and nobody has put a file into it for a while."""
    if TAG not in (task.tags or "").split() and records.load(task.pk) is None:
        return False
    last = task.created_at.timestamp()
    with contextlib.suppress(OSError):
        last = max([last, *(e.stat().st_mtime for e in os.scandir(task.task_path()) if e.is_file())])
    return time.time() - last > _OPEN_S


def _waits(record: Mapping[str, Any]) -> bool:
    """A look beside the processing keeps nobody waiting."""
    if record["state"] in (records.HELD, records.WORKING):
        return True
    return record["state"] in (records.UPLOADING, records.WAITING, records.CHECKING) and (
        bool(record.get("holds")) or ("wish" in record and not record.get("passed"))
    )


def _take_up(task: Any, record: Dict[str, Any]) -> None:
    """Have another worker go on; noted first, so that the next one who asks does not do it again."""
    records.change(task.pk, taken_up=record.get("taken_up", 0) + 1)
    if record["state"] == records.WORKING:
        workers.prepare(task.pk, int(record.get("by", 0)))
    else:
        hold.look_at(task.pk)


def has_report(task: Any) -> bool:
    """Whether the task has a report page."""
    return (home.task_folder(task) / "report.json").is_file()


def actions_for(task: Any, record: Dict[str, Any], user: Any) -> List[str]:
    """What a user who may change the project may do with the task now."""
    state = record["state"]
    if task.partial or (state in records.BUSY and not records.is_stale(record)):
        held = "wish" in record and not record.get("passed") and not task.partial
        return [OVERRIDE] if held and home.may_override(user) else []
    if not task.images_count or task.compacted:
        return []
    # What was taken apart is not looked at again while its parts are there: it would be taken apart twice.
    found = [] if state == records.SPLIT and _left(record) else [CHECK]
    if "wish" in record and not record.get("passed") and home.may_override(user):
        found.append(OVERRIDE)
    if task.status in (_FAILED, _COMPLETED):
        found.append(JUDGE)
    judged = (record.get("judgement") or {}).get("tasks")
    useful = bool(judged) or record.get("parts", 0) > 1
    if task.status in (None, _FAILED, _COMPLETED, _CANCELED) and not _left(record):
        if useful:
            found.append(SPLIT)
        helps = useful or record.get("harmonizing_helps") or record.get("verdict") == "inconsistent"
        if helps and engine_for(task)[0] == WORKER:
            found.append(PREPARE)
    return found


def _left(record: Dict[str, Any]) -> List[Dict[str, Any]]:
    """The tasks that came of it and are still there."""
    return [t for t in record.get("tasks", []) if home.find_task(t["id"]) is not None]


def engine_for(task: Any) -> "tuple[str, str]":
    """Where harmonizing and alignment would run for this task, said plainly."""
    record = records.load(task.pk) or {}
    wish = record.get("wish") or {"auto": task.auto_processing_node, "node": task.processing_node_id}
    return _engine(tasks.policy_node(task, wish))


def engine_ahead(owner: Any) -> "tuple[str, str]":
    """The same for tasks of this owner that are not there yet."""
    return _engine(tasks.adapter_of(owner))


def _engine(node: Optional[Any]) -> "tuple[str, str]":
    if node is not None:
        return NODE, f"The processing node {node} harmonizes and aligns the images itself."
    lacking = preferences.missing()
    if preparing.available():
        return WORKER, "No node of yours has sensorgate; this server can harmonize and align the images."
    absent = " and ".join(lacking) or "a Python that can be started"
    return GATE, (
        f"No node of yours has sensorgate, and this server lacks {absent}: images are checked and sorted, but not "
        "harmonized or aligned. An administrator finds the commands that add it on the Camera check page."
    )
