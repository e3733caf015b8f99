"""What happens to WebODM's tasks: let go, kept back with a reason, taken apart."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.record import write_text
from ...stages.route import ISOLATE, PAIRWISE, PROCEED
from ...stages.rules.text import listed, plural
from ..odm.folder import EXTENSIONS, extension
from ..odm.wire import POLICY_FOR_HARMONIZED, POLICY_OPTION
from . import calibrating, records
from .gathering import ALIGN, task_files
from .proposal import GCP_FILE, GEO_FILE, Proposed

_CANCELED = 50
_COMPLETED = 40
_TEXTS = (GCP_FILE, GEO_FILE)
LAZ = "georeferenced_model.laz"
NO_ANCHORS: Mapping[str, Any] = {}
ANY_NODE: Mapping[str, Any] = {"auto": True, "node": None}


def merged(own: Any, ours: Sequence[Mapping[str, Any]]) -> List[Dict[str, Any]]:
    """The user's options with ours laid under them; what is falsy is left out, for WebODM refuses it."""
    mine = [dict(o) for o in own if isinstance(o, dict)] if isinstance(own, list) else []
    names = {o.get("name") for o in mine}
    return [o for o in [*mine, *(dict(o) for o in ours if o["name"] not in names)] if o.get("value")]


def policy_node(task: Any, wish: Mapping[str, Any]) -> Optional[Any]:
    """The node with our adapter that this task may go to: the one it asked for, else the least busy of its owner's."""
    return adapter_of(task.project.owner, wish)


def adapter_of(owner: Any, wish: Mapping[str, Any] = ANY_NODE) -> Optional[Any]:
    """The same for tasks of this owner that are not there yet."""
    from guardian.shortcuts import get_objects_for_user
    from nodeodm.models import ProcessingNode

    if wish.get("node") is not None:
        node = ProcessingNode.objects.filter(pk=wish["node"]).first()
        return node if node is not None and has_adapter(node) else None
    nodes = get_objects_for_user(owner, "view_processingnode", ProcessingNode, accept_global_perms=False).order_by(
        "queue_count"
    )
    return next((n for n in nodes if n.is_online() and has_adapter(n)), None)


def has_adapter(node: Any) -> bool:
    """Whether the node's option list names our policy."""
    listed = node.available_options
    return isinstance(listed, list) and any(isinstance(o, dict) and o.get("name") == POLICY_OPTION for o in listed)


def release(task: Any, state: str, message: str, options: Sequence[Mapping[str, Any]] = (), **more: Any) -> None:
    """Give the task what it wanted, with our options under its own, and have it processed."""
    from nodeodm.models import ProcessingNode
    from worker.tasks import process_task

    record = records.load(task.pk) or {}
    wish = record.get("wish") or {"auto": task.auto_processing_node, "node": task.processing_node_id}
    ours = list(options)
    node = policy_node(task, wish) if state == records.RELEASED and (wish["auto"] or wish["node"]) else None
    if node is not None:
        ours.append({"name": POLICY_OPTION, "value": "auto"})
    records.change(task.pk, state=state, message=message, holds=False, passed=True, progress=None, **more)
    if wish["node"] is not None:
        task.processing_node = ProcessingNode.objects.filter(pk=wish["node"]).first()
    elif node is not None:
        task.processing_node = node
    task.auto_processing_node = bool(wish["auto"]) or (wish["node"] is not None and task.processing_node is None)
    task.options = merged(task.options, ours)
    task.last_error = None
    task.status = None
    task.pending_action = task.pending_action if task.pending_action == _resize() else None
    task.save()
    process_task.delay(task.id)


def _resize() -> int:
    from app import pending_actions

    return int(pending_actions.RESIZE)


def keep_back(task: Any, state: str, message: str, **more: Any) -> None:
    """Say why a task waits where its owner looks: in its row on the dashboard."""
    records.change(task.pk, state=state, message=message, progress=None, **more)
    type(task).objects.filter(pk=task.pk).update(last_error=message)


def split(
    task: Any, parts: Sequence[Tuple[Path, Proposed]], anchors: Mapping[str, Any] = NO_ANCHORS
) -> List[Dict[str, Any]]:
    """One task per part beside the old one, with its files linked out of its folder; the old one stays as it is.

    The parts' options are laid under the user's own. Where one part cannot be
    created, none is. ``anchors`` is key of a part -> the finished task to lay it on.
    """
    from app.models import Task
    from worker.tasks import process_task

    record = records.load(task.pk) or {}
    wish = record.get("wish") or {"auto": task.auto_processing_node, "node": task.processing_node_id}
    created: List[Any] = []
    try:
        for folder, part in parts:
            created.append(_create(Task, task, folder, part, wish, anchors.get(part.key)))
    except BaseException:
        for new in created:
            new.delete()
        raise
    told = [{"id": str(t.id), "project": t.project_id, "name": t.name} for t in created]
    records.change(
        task.pk,
        state=records.SPLIT,
        holds=False,
        progress=None,
        message=f"{_came_of(parts)} {plural(len(told), 'task')}: {', '.join(str(t['name']) for t in told)}."
        + _calibrated(created)
        + _left_behind(task)
        + (" This one is not processed; its images stay until you delete it." if task.status is None else ""),
        tasks=told,
    )
    if task.status is None:
        task.status = _CANCELED
        task.last_error = (records.load(task.pk) or {}).get("message")
        task.save()
    for new in created:
        process_task.delay(new.id)
    return told


def _came_of(parts: Sequence[Tuple[Path, Proposed]]) -> str:
    harmonized = any(part.calibration is not None for _, part in parts)
    return "Harmonized; its frames are now in" if harmonized else "Taken apart into"


def _calibrated(created: Sequence[Any]) -> str:
    """What is said of the calibrations that go along."""
    many = sum(1 for t in created if calibrating.lies_in(Path(t.task_path())))
    if not many:
        return ""
    which = "The calibration" if many == len(created) else f"For {many} of them the calibration"
    return f" {which} of the cameras is sent along."


def _left_behind(task: Any) -> str:
    """Files that are no photos and go into none of the parts."""
    names = task_files(Path(task.task_path())).names
    others = [n for n in names if extension(n) not in EXTENSIONS and n.lower() not in _TEXTS]
    if not others:
        return ""
    return f" {listed(others)} stayed behind: ODM does not process that with photos that were sorted."


def _create(model: Any, task: Any, folder: Path, part: Proposed, wish: Mapping[str, Any], anchor: Any) -> Any:
    own = [o for o in (task.options or []) if isinstance(o, dict) and o.get("name") != "rerun-from"]
    resized = task.pending_action == _resize()
    load = calibrating.load_of(folder, part, own, resized)
    title = task.name or "Task"
    new = model(
        project=task.project,
        name=f"{title} / {part.name}"[:255],
        options=merged(list(load.own), load.ours),
        partial=True,  # WebODM leaves a task alone whose files are not all there
        auto_processing_node=False,
        resize_to=task.resize_to,
        tags=" ".join(dict.fromkeys([*(task.tags or "").split(), *part.tags])),
    )
    records.keep(new.pk, {"state": records.RELEASED, "passed": True, "message": "", "from": str(task.pk)})
    try:
        new.save()
        new.create_task_directories()
        for path, name in sorted(part.names.items()):
            link(folder / path, Path(new.task_path(name)))
        for name, text in sorted(part.texts.items()):
            write_text(new.task_path(name), text)
        if load.calibration is not None:
            calibrating.put(Path(new.task_path()), load.calibration)
        for name in load.linked:
            link(folder / name, Path(new.task_path(name)))
        if anchor is not None:
            new.set_alignment_file_from(anchor)
        else:
            for name in filter(ALIGN.match, task.scan_images()):
                link(Path(task.task_path(name)), Path(new.task_path(name)))
        new.images_count = len(new.scan_images())
        new.update_size()
        node = policy_node(new, wish)
        if node is not None:
            policy = POLICY_FOR_HARMONIZED if load.harmonized else "auto"
            new.options = merged(new.options, [{"name": POLICY_OPTION, "value": policy}])
        new.processing_node_id = wish["node"] if wish["node"] is not None else node.pk if node is not None else None
        new.auto_processing_node = bool(wish["auto"])
        if task.resize_to is not None and task.resize_to > 0:
            new.pending_action = _resize() if resized else None
        new.partial = False
        new.save()
    except BaseException:
        if new._state.adding is False:
            new.delete()
        records.forget(new.pk)
        raise
    return new


def link(source: Path, target: Path) -> None:
    """The same file under another name; a copy where the disk cannot link."""
    if source.is_symlink() or not source.is_file():
        raise OSError(f"{source.name} is not there any more.")
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def anchor_for(task: Any, ground: Sequence[Tuple[float, float]]) -> Optional[Any]:
    """The finished task of the project that others can be laid on: the one with most images over the same ground.

    ``ground`` are (longitude, latitude) of the frames. What the router found
    wanting, or what was taken apart, is nothing to lay others on.
    """
    done = type(task).objects.filter(project=task.project, status=_COMPLETED).exclude(pk=task.pk)
    fit = [t for t in done if LAZ in (t.available_assets or []) and _over(t, ground)]
    known = records.of_tasks([t.pk for t in fit])
    fit = [t for t in fit if _sound(known.get(str(t.pk), {}))]
    return max(fit, key=lambda t: (t.images_count, str(t.id))) if fit else None


def _sound(record: Mapping[str, Any]) -> bool:
    route = (record.get("judgement") or {}).get("route", PROCEED)
    return record.get("state") != records.SPLIT and route not in (PAIRWISE, ISOLATE)


def _over(task: Any, ground: Sequence[Tuple[float, float]]) -> bool:
    """Whether a task's products lie over this ground; one whose extent WebODM does not know may."""
    extent = getattr(task, "dsm_extent", None) or getattr(task, "orthophoto_extent", None)
    if extent is None or not ground:
        return extent is None
    west, south, east, north = extent.extent
    return any(west <= x <= east and south <= y <= north for x, y in ground)
