"""Endpoints for tasks: their state, and what may be done with them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable, Dict, Mapping

from rest_framework import exceptions, permissions
from rest_framework.parsers import JSONParser
from rest_framework.response import Response
from rest_framework.views import APIView

from . import checking, home, judging, records, state, tasks, workers
from .views import Conflict, bound, plainly

_MOST_BODY = 65536
_MOST_PROJECTS = 100


class TaskView(APIView):
    """What belongs to one task; who may see the task may see its state."""

    permission_classes = (permissions.AllowAny,)
    parser_classes = (JSONParser,)

    def task(self, project: str, task: str) -> Any:
        """The task, where this user (or, for a public one, anybody) may see it."""
        from app.api.common import check_project_perms

        found = home.find_task(task)
        if found is None or str(found.project_id) != str(project) or found.project.deleting:
            raise exceptions.NotFound()
        if not (found.public or found.project.public):
            check_project_perms(self.request, found.project)
        return found


class Waiting(APIView):
    """``waiting``."""

    permission_classes = (permissions.IsAuthenticated,)

    def get(self, request: Any) -> Response:
        """What waits in these projects, for a dashboard that asks again and again."""
        asked = str(request.query_params.get("projects", "")).split(",")
        if len(asked) > _MOST_PROJECTS or not all(p.isdigit() and len(p) < 10 for p in asked):
            raise exceptions.ValidationError({"detail": f"projects must be at most {_MOST_PROJECTS} numbers."})
        return Response({"projects": state.waiting_in([int(p) for p in asked], request.user)})


class TaskState(TaskView):
    """``projects/<project>/tasks/<task>/state``."""

    def get(self, request: Any, project: str = "", task: str = "") -> Response:
        """The state for this user."""
        return Response(state.state_of(self.task(project, task), request.user))


class TaskAction(TaskView):
    """``projects/<project>/tasks/<task>/<action>``."""

    permission_classes = (permissions.IsAuthenticated,)

    def initial(self, request: Any, *args: Any, **kwargs: Any) -> None:
        """Refuse a body that is too large before it is read."""
        super().initial(request, *args, **kwargs)
        if request.method == "POST":
            bound(request, _MOST_BODY)

    @plainly
    def post(self, request: Any, project: str = "", task: str = "", action: str = "") -> Response:
        """Do what the state offers, for who may change the project, public tasks included."""
        from app.api.common import check_project_perms

        found = self.task(project, task)
        check_project_perms(request, found.project, ("change_project",))
        record = records.load(found.pk) or {"state": records.NONE}
        if action == state.OVERRIDE and not home.may_override(request.user):
            raise exceptions.PermissionDenied("Only who has the permission may let held tasks go.")
        if action not in state.actions_for(found, record, request.user):
            raise Conflict("That cannot be done with this task now.")
        data = request.data if isinstance(request.data, dict) else {}
        _ACTIONS[action](found, request.user, data)
        return Response(state.state_of(home.find_task(found.pk), request.user))


def _check(task: Any, user: Any, data: Mapping[str, Any]) -> None:
    record = records.load(task.pk) or {}
    holds = "wish" in record and not record.get("passed")
    records.change(task.pk, state=records.WAITING if holds else records.CHECKING, holds=holds, progress=None)
    workers.check(task.pk)


def _override(task: Any, user: Any, data: Mapping[str, Any]) -> None:
    tasks.release(task, records.OVERRIDDEN, f"Let go as it is by {user.username}.")


def _split(task: Any, user: Any, data: Mapping[str, Any]) -> None:
    inspection, proposal = checking.look(task)
    parts = proposal.tasks
    if (records.load(task.pk) or {}).get("judgement"):
        judgement = judging.with_gate(judging.judge_task(task), inspection, proposal)
        parts = judging.parts_of(task, judgement, inspection, proposal) or parts
    survey = inspection.survey
    if len(parts) == 1 and len(parts[0].frames) == len(survey.frames) + len(survey.broken):
        raise Conflict("All of its images belong into one task; there is nothing to take apart.")
    if not parts:
        raise Conflict("None of its images can be used for a survey.")
    anchors = judging.anchors_of(task, parts, inspection) if data.get("align") is True else {}
    tasks.split(task, [(Path(task.task_path()), part) for part in parts], anchors)


def _judge(task: Any, user: Any, data: Mapping[str, Any]) -> None:
    inspection, proposal = checking.look(task)
    judgement = judging.with_gate(judging.judge_task(task), inspection, proposal)
    judging.remember(task, judgement, judging.parts_of(task, judgement, inspection, proposal), inspection)


def _prepare(task: Any, user: Any, data: Mapping[str, Any]) -> None:
    record = records.load(task.pk) or {"state": records.NONE}
    records.change(
        task.pk,
        before=record["state"],
        by=user.pk,
        state=records.WORKING,
        progress=0.0,
        message="Harmonizing on this server.",
    )
    workers.prepare(task.pk, user.pk)


_ACTIONS: Dict[str, Callable[[Any, Any, Mapping[str, Any]], None]] = {
    state.CHECK: _check,
    state.OVERRIDE: _override,
    state.SPLIT: _split,
    state.JUDGE: _judge,
    state.PREPARE: _prepare,
}
