"""The plugin's API below ``/api/plugins/<name>/``.

Every answer is JSON; an error is ``{"detail": "<sentence for the user>"}`` with
400 (malformed), 403 (no CSRF token, or not allowed), 404 (not there, or not
yours: the two are not told apart), 409 (the state does not allow it), 413 (a
bound was exceeded) or 429 (more bytes than allowed for now; header
``Retry-After``, in seconds). All mutating requests need a logged-in user and
``X-CSRFToken``; bodies are ``application/json``.

Before the upload
=================

``POST sessions`` ``{"project": 7}`` -> 201::

    {"session": "<32 hex>",            # belongs to the user; gone after a day
     "limits": {"head_bytes": 65536,   # send at least this much from offset 0, or the header segments up to the scan
                "batch_files": 64, "batch_bytes": 4194304,       # per request: files, and characters of base64
                "file_bytes": 1048576, "files": 20000,           # per file: header bytes; per session: files
                "control_bytes": 4194304},
     "hold": "off" | "report" | "hold", "may_override": false}

Needs ``change_project`` on the project.

``POST sessions/<session>/headers``::

    {"files": [{"id": 0,                                  # the caller's number of the file, unique in the session
                "path": "DCIM/100MEDIA/DJI_0001.JPG",     # name, with its folder where the browser knows it
                "size": 10485760, "modified": 1716200000000,
                "ranges": [[0, "<base64>"], [9000000, "<base64>"]]}]}   # [offset, bytes]

    -> {"read": 63, "files": 63,                          # read from this batch; of the session so far
        "need": [{"id": 5, "offset": 9000000, "length": 4096}],
        "broken": [{"id": 8, "path": "...", "message": "The file has no bytes: ..."}],
        "cameras": [{"name": "DJI FC6310", "width": 5472, "height": 3648, "frames": 40}],   # in this batch
        "ignored": 0}

``need`` names the next bytes without which a file cannot be read: send the
file again with **all** its ranges, that one added (nothing is kept of a file
that could not be read). Masks (``*_mask.png`` and so on) are sent with ``ranges: []``, so that they
get their image's new name. Batches may be sent in parallel and in any order; a file sent twice counts once,
the later one. Files that are no images (videos, logs) are not sent here.

``POST sessions/<session>/control`` ``{"kind": "gcp" | "geo", "text": "..."}`` -> ``{"ok": true}``:
ground control or positions that the user chose along. An empty text takes it back.

``GET sessions/<session>/verdict``, or ``POST`` with the user's choices::

    {"off": ["options"],                        # rules that were unticked
     "moves": {"<payload id>": "<task key>"}}   # payloads that were put elsewhere ("" = not sent)

    -> {"files": 1000,                          # read so far: the verdict may be asked for while reading goes on
        "verdict": "consistent" | "inconsistent" | "blocked",
        "headline": "3 cameras that do not belong in one task",
        "cameras": [{"id": "dji-fc6310", "name": "DJI FC6310", "spectrum": "rgb", "band": "", "width": 5472,
                     "height": 3648, "focal_mm": 8.8, "frames": 500, "payload": "dji-fc6310"}],
        "payloads": [{"id": "...", "name": "...", "spectrum": "...", "bands": ["green", "nir"], "frames": 500,
                      "task": "rgb"}],
        "findings": [{"code": "...", "severity": "error" | "warning" | "info", "message": "...", "remedy": "...",
                      "files": 12}],
        "odm": ["ODM would use 900 of 1000 frames.", "..."],        # this folder as it is, in words
        "ours": ["Two tasks: ...", "..."],                          # what we would do instead, in words
        "rules": [{"id": "split", "text": "...", "on": true, "frames": 100}],
        "tasks": [{"key": "rgb", "name": "rgb",                     # put behind the name that the user gives
                   "spectrum": "rgb", "payloads": ["..."], "frames": 500,
                   "files": [[0, "DJI_0001.JPG"], [17, "zenmuse_DJI_0001.JPG"]],     # [id, name to upload it under]
                   "options": [{"name": "gps-accuracy", "value": 0.05}],
                   "reasons": {"gps-accuracy": "all frames have this accuracy and ODM would take 10 m"},
                   "tags": ["sensorgate", "rgb"],
                   "texts": {"gcp_list.txt": "...", "geo.txt": "..."}}],             # to be uploaded as files
        "left_out": [{"id": 8, "path": "...", "reason": "panel", "message": "..."}],
        "report": "/plugins/<name>/sessions/<session>/report"}

Rules are ``split``, ``leave-out``, ``options`` and ``control``. ``options``
holds no false flag (WebODM refuses falsy values) and is meant to be laid over
the user's own. Without any readable file: 409.

``POST sessions/<session>/claim`` ``{"task": "<uuid>", "key": "rgb"}`` -> ``{"ok": true}``:
after a proposed task was created (partial) and before it is committed, so that
hold mode knows the user's choices and the task gets its report page. It does not
let a task past the gate: hold mode looks at what was really uploaded.

A task
======

``GET projects/<project>/tasks/<task>/state`` (needs ``view_project``; public tasks too) ::

    {"state": "none" | "waiting" | "checking" | "released" | "held" | "split" | "overridden" | "working" | "failed",
     "message": "Waiting until its cameras have been checked.",    # why, and what to do
     "progress": 0.4,                                              # of work under way, else null
     "verdict": "inconsistent" | null, "report": "/plugins/<name>/tasks/<task>/report" | null,
     "actions": ["check", "override", "split", "judge", "prepare"],   # what this user may do now
     "tasks": [{"id": "...", "project": 7, "name": "..."}],        # that came of it
     "engine": "node" | "worker" | "gate", "engine_message": "..."}

``POST projects/<project>/tasks/<task>/<action>`` with an action out of
``actions`` (needs ``change_project``; ``override`` also the permission
``app.override_sensorgate_hold``) -> the new state:

``check``     look at its images (again), in the worker
``override``  let a held task go as it is
``split``     create the proposed tasks from its images: ``{"align": true}`` lays them on the anchor's result
``judge``     the router's verdict on a failed or finished task; then ``state`` has ``"judgement":
              {"route": "pairwise", "reasons": ["..."], "tasks": [{"name", "frames", "options"}],
              "anchor": {"id", "name"} | null}``, and ``split`` creates these
``prepare``   harmonize and align in WebODM's worker, then create the projects as tasks

Settings
========

``GET settings`` -> ``{"hold": ..., "may_change": bool, "thresholds": {"mine": {}, "all": {}, "known": {name:
{"default", "unit", "why"}}}, "sheet": {"mine": "name.csv" | null, "all": null, "rows": 3}, "extras": [{"name",
"needed_for", "installed", "message"}]}``.

``POST settings`` with any of ``{"hold": "report", "thresholds": {"focal_variance": 0.05}, "sheet": {"name": "mine.csv",
"text": "..."}, "scope": "mine" | "all"}``; ``scope`` ``all`` and ``hold`` need an administrator. ``thresholds`` are
all changes (what is missing returns to its default), ``sheet: null`` removes the sheet.
"""

from __future__ import annotations

import functools
import logging
from pathlib import Path
from typing import Any, Callable, Dict, Mapping

from rest_framework import exceptions, permissions, status
from rest_framework.parsers import JSONParser
from rest_framework.response import Response
from rest_framework.views import APIView

from ...stages.errors import SensorgateError
from ...stages.frame import BrokenFrame
from ...stages.grouping import camera_name
from . import bounds, checking, hold, home, judging, preferences, records, sessions, state, tasks, verdict, workers
from .gathering import of_session
from .headers import Read, read_headers, sent_files
from .proposal import RULES, Choices, propose

LOG = logging.getLogger("app.logger")
_MOST_BODY = {"headers": bounds.BATCH_BYTES + 65536, "control": 2 * bounds.CONTROL_BYTES}
_SMALL_BODY = 6 * bounds.SHEET_BYTES


class TooLarge(exceptions.APIException):
    """A bound was exceeded."""

    status_code = status.HTTP_413_REQUEST_ENTITY_TOO_LARGE
    default_detail = "The request is too large."


class Conflict(exceptions.APIException):
    """The state does not allow it."""

    status_code = status.HTTP_409_CONFLICT


def _plainly(method: Callable[..., Response]) -> Callable[..., Response]:
    """Turn our errors into answers."""

    @functools.wraps(method)
    def answer(*args: Any, **kwargs: Any) -> Response:
        try:
            return method(*args, **kwargs)
        except sessions.TooMuch as error:
            raise TooLarge(str(error)) from None
        except SensorgateError as error:
            raise exceptions.ValidationError({"detail": str(error)}) from None

    return answer


class View(APIView):
    """For users who are logged in. Session authentication brings WebODM's CSRF check along."""

    permission_classes = (permissions.IsAuthenticated,)
    parser_classes = (JSONParser,)
    most_body = _SMALL_BODY

    def initial(self, request: Any, *args: Any, **kwargs: Any) -> None:
        """Refuse a body that is too large before it is read."""
        super().initial(request, *args, **kwargs)
        if request.method == "POST":
            try:
                length = int(request.META.get("CONTENT_LENGTH") or 0)
            except ValueError:
                raise exceptions.ParseError("Content-Length is no number.") from None
            if length <= 0:
                raise exceptions.ParseError("A request needs a body with its Content-Length.")
            if length > self.most_body:
                raise TooLarge()
            _charge(request.user, length)

    def body(self) -> Mapping[str, Any]:
        """The JSON object that was sent."""
        data = self.request.data
        if not isinstance(data, dict):
            raise exceptions.ParseError("The body must be a JSON object.")
        return data


def _charge(user: Any, size: int) -> None:
    """Count bytes by user; who sends too many waits."""
    from django.core.cache import cache

    key = f"{home.NAME}-bytes-{user.pk}"
    cache.add(key, 0, bounds.USER_WINDOW_S)
    try:
        total = cache.incr(key, size)
    except ValueError:
        cache.set(key, size, bounds.USER_WINDOW_S)
        total = size
    if total > bounds.USER_BYTES:
        raise exceptions.Throttled(wait=bounds.USER_WINDOW_S, detail="Too many bytes at once; try again later.")


def _project(request: Any, value: Any, perm: str) -> Any:
    """The project where this user has ``perm``; it is not told whether it exists otherwise."""
    from app.api.common import get_and_check_project

    if not isinstance(value, int) or isinstance(value, bool):
        raise exceptions.ValidationError({"detail": "project must be a number."})
    return get_and_check_project(request, value, (perm,))


class SessionView(View):
    """What belongs to one session of this user."""

    def session(self, name: str) -> sessions.Session:
        """The session, while the user may still change its project."""
        found = sessions.find(home.temporary(), name, self.request.user.pk)
        if found is None:
            raise exceptions.NotFound()
        _project(self.request, found.project, "change_project")
        return found


class NewSession(View):
    """``sessions``."""

    most_body = 65536

    @_plainly
    def post(self, request: Any) -> Response:
        """Begin a session."""
        from django.core.cache import cache

        project = _project(request, self.body().get("project"), "change_project")
        key = f"{home.NAME}-sessions-{request.user.pk}"
        cache.add(key, 0, bounds.USER_WINDOW_S)
        try:
            if cache.incr(key) > bounds.SESSIONS_PER_WINDOW:
                raise exceptions.Throttled(wait=bounds.USER_WINDOW_S)
        except ValueError:
            pass  # it ran out between the two calls
        session = sessions.create(home.temporary(), request.user.pk, project.pk)
        answer = {
            "session": session.id,
            "limits": bounds.shown(),
            "hold": preferences.mode(),
            "may_override": home.may_override(request.user),
        }
        return Response(answer, status=status.HTTP_201_CREATED)


class Headers(SessionView):
    """``sessions/<session>/headers``."""

    most_body = _MOST_BODY["headers"]

    @_plainly
    def post(self, request: Any, session: str = "") -> Response:
        """Read a batch."""
        found = self.session(session)
        files = sent_files(self.body().get("files"))
        read = read_headers(files, preferences.thresholds_for(request.user))
        total = found.add(read)
        return Response(
            {
                "read": len(read.frames),
                "files": total,
                "need": [{"id": n.id, "offset": n.offset, "length": n.length} for n in read.need],
                "broken": [
                    {"id": i, "path": f.path, "message": f.message}
                    for i, f in sorted(read.frames.items())
                    if isinstance(f, BrokenFrame)
                ],
                "cameras": _cameras(read),
                "ignored": read.ignored,
            }
        )


def _cameras(read: Read) -> "list[Dict[str, Any]]":
    count: Dict[Any, int] = {}
    for frame in read.frames.values():
        if not isinstance(frame, BrokenFrame):
            key = (camera_name(frame.make, frame.model), frame.width, frame.height)
            count[key] = count.get(key, 0) + 1
    return [{"name": n, "width": w, "height": h, "frames": c} for (n, w, h), c in sorted(count.items())]


class ControlText(SessionView):
    """``sessions/<session>/control``."""

    most_body = _MOST_BODY["control"]

    @_plainly
    def post(self, request: Any, session: str = "") -> Response:
        """Keep ground control or positions."""
        found, data = self.session(session), self.body()
        if not isinstance(data.get("text"), str):
            raise exceptions.ValidationError({"detail": "text must be text."})
        found.keep_control(str(data.get("kind")), data["text"])
        return Response({"ok": True})


class Verdict(SessionView):
    """``sessions/<session>/verdict``."""

    @_plainly
    def get(self, request: Any, session: str = "") -> Response:
        """The verdict on what was read so far."""
        return Response(self._answer(self.session(session), Choices()))

    @_plainly
    def post(self, request: Any, session: str = "") -> Response:
        """The same with the user's choices."""
        return Response(self._answer(self.session(session), choices_from(self.body())))

    def _answer(self, session: sessions.Session, choices: Choices) -> Dict[str, Any]:
        gathered = session.gather()
        if not gathered.scan.frames and not gathered.scan.broken:
            raise Conflict("No file was read yet.")
        with preferences.settings_for(self.request.user) as settings:
            inspection = of_session(gathered, settings, session.control("gcp"), session.control("geo"))
            checking.keep_report(session.folder, inspection)
        proposal = propose(inspection, choices)
        report = home.page(f"sessions/{session.id}/report")
        return verdict.words_for(inspection, proposal, choices, gathered.ids, report)


def choices_from(data: Mapping[str, Any]) -> Choices:
    """The user's choices, checked."""
    off, moves = data.get("off", []), data.get("moves", {})
    if not isinstance(off, list) or not all(r in RULES for r in off):
        raise exceptions.ValidationError({"detail": f"off must be a list of {', '.join(RULES)}."})
    if not isinstance(moves, dict) or not all(isinstance(v, str) for v in moves.values()):
        raise exceptions.ValidationError({"detail": "moves must be an object of payload and task."})
    return Choices(frozenset(off), dict(moves))


class Claim(SessionView):
    """``sessions/<session>/claim``."""

    most_body = 65536

    @_plainly
    def post(self, request: Any, session: str = "") -> Response:
        """Bind a task to the session that it came from."""
        found, data = self.session(session), self.body()
        task = home.find_task(data.get("task"))
        if task is None or task.project_id != found.project:
            raise exceptions.NotFound()
        if not isinstance(data.get("key"), str) or len(data["key"]) > 200:
            raise exceptions.ValidationError({"detail": "key must be text."})
        folder = home.task_folder(task)
        for name in ("report.json", "report.html"):
            if (found.folder / name).is_file():
                checking.write_text(folder / name, (found.folder / name).read_text(encoding="utf-8"))
        return Response({"ok": True})


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


class TaskState(TaskView):
    """``projects/<project>/tasks/<task>/state``."""

    def get(self, request: Any, project: str = "", task: str = "") -> Response:
        """The state for this user."""
        return Response(state.state_of(self.task(project, task), request.user))


class TaskAction(TaskView):
    """``projects/<project>/tasks/<task>/<action>``."""

    permission_classes = (permissions.IsAuthenticated,)

    @_plainly
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
    records.change(task.pk, state=records.WAITING if record.get("holds") else records.CHECKING, progress=None)
    workers.check(task.pk)


def _override(task: Any, user: Any, data: Mapping[str, Any]) -> None:
    tasks.release(task, records.OVERRIDDEN, f"Let go as it is by {user.username}.")


def _split(task: Any, user: Any, data: Mapping[str, Any]) -> None:
    inspection, proposal = checking.look(task)
    parts = proposal.tasks
    if (records.load(task.pk) or {}).get("judgement"):
        parts = judging.parts_of(task, judging.judge_task(task), inspection, proposal) or parts
    if len(parts) < 2 and parts and len(parts[0].frames) == task.images_count:
        raise Conflict("All of its images belong into one task; there is nothing to take apart.")
    if not parts:
        raise Conflict("None of its images can be used for a survey.")
    anchor = tasks.anchor_for(task) if data.get("align") is True else None
    tasks.split(task, [(Path(task.task_path()), part) for part in parts], anchor)


def _judge(task: Any, user: Any, data: Mapping[str, Any]) -> None:
    inspection, proposal = checking.look(task)
    judgement = judging.judge_task(task)
    judging.remember(task, judgement, judging.parts_of(task, judgement, inspection, proposal))


def _prepare(task: Any, user: Any, data: Mapping[str, Any]) -> None:
    record = records.load(task.pk) or {"state": records.NONE}
    records.change(
        task.pk, before=record["state"], state=records.WORKING, progress=0.0, message="Harmonizing on this server."
    )
    workers.prepare(task.pk, user.pk)


_ACTIONS: Dict[str, Callable[[Any, Any, Mapping[str, Any]], None]] = {
    state.CHECK: _check,
    state.OVERRIDE: _override,
    state.SPLIT: _split,
    state.JUDGE: _judge,
    state.PREPARE: _prepare,
}


class SettingsView(View):
    """``settings``."""

    def get(self, request: Any) -> Response:
        """What is set."""
        return Response(preferences.describe(request.user))

    @_plainly
    def post(self, request: Any) -> Response:
        """Change some of it."""
        data = self.body()
        scope = data.get("scope", preferences.MINE)
        if ("hold" in data or scope == preferences.ALL) and not request.user.is_superuser:
            raise exceptions.PermissionDenied("Only an administrator may set that for all users.")
        store = preferences.store_for(scope, request.user)
        if "thresholds" in data:
            preferences.set_thresholds(store, data["thresholds"])
        if "sheet" in data:
            preferences.set_sheet(store, data["sheet"])
        if "hold" in data:
            preferences.set_mode(data["hold"])
            if data["hold"] != preferences.HOLD:
                _look_at_what_waits()
        return Response(preferences.describe(request.user))


def _look_at_what_waits() -> None:
    """Tasks that were held are let go by the worker's next look at them."""
    for task_id, _ in records.all_in(records.WAITING, records.HELD):
        hold.look_at(task_id)


ROUTES = (
    (r"sessions$", NewSession),
    (r"sessions/(?P<session>[0-9a-f]{32})/headers$", Headers),
    (r"sessions/(?P<session>[0-9a-f]{32})/control$", ControlText),
    (r"sessions/(?P<session>[0-9a-f]{32})/verdict$", Verdict),
    (r"sessions/(?P<session>[0-9a-f]{32})/claim$", Claim),
    (r"projects/(?P<project>[0-9]+)/tasks/(?P<task>[0-9a-f-]{36})/state$", TaskState),
    (
        r"projects/(?P<project>[0-9]+)/tasks/(?P<task>[0-9a-f-]{36})/(?P<action>" + "|".join(state.ACTIONS) + r")$",
        TaskAction,
    ),
    (r"settings$", SettingsView),
)
