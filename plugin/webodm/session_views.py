"""Endpoints for files that are still on the user's machine."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping

from rest_framework import exceptions, status
from rest_framework.response import Response

from ...stages.frame import BrokenFrame
from ...stages.grouping import camera_name
from ...stages.record import write_text
from . import bounds, checking, claims, home, preferences, records, sessions, state, verdict
from .gathering import of_session
from .headers import Read, read_headers, sent_files
from .proposal import RULES, Choices, propose
from .views import Conflict, View, plainly, project_for

_MOST_BODY = {"headers": bounds.BATCH_BYTES + 65536, "control": 2 * bounds.CONTROL_BYTES}


class SessionView(View):
    """What belongs to one session of this user."""

    def session(self, name: str) -> sessions.Session:
        """The session, while the user may still change its project."""
        found = sessions.find(home.temporary(), name, self.request.user.pk)
        if found is None:
            raise exceptions.NotFound()
        project_for(self.request, found.project, "change_project")
        return found


class NewSession(View):
    """``sessions``."""

    most_body = 65536

    @plainly
    def post(self, request: Any) -> Response:
        """Begin a session."""
        from django.core.cache import cache

        project = project_for(request, self.body().get("project"), "change_project")
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

    @plainly
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


def _cameras(read: Read) -> List[Dict[str, Any]]:
    count: Dict[Any, int] = {}
    for frame in read.frames.values():
        if not isinstance(frame, BrokenFrame):
            key = (camera_name(frame.make, frame.model), frame.width, frame.height)
            count[key] = count.get(key, 0) + 1
    return [{"name": n, "width": w, "height": h, "frames": c} for (n, w, h), c in sorted(count.items())]


class ControlText(SessionView):
    """``sessions/<session>/control``."""

    most_body = _MOST_BODY["control"]

    @plainly
    def post(self, request: Any, session: str = "") -> Response:
        """Keep ground control or positions."""
        found, data = self.session(session), self.body()
        if not isinstance(data.get("text"), str):
            raise exceptions.ValidationError({"detail": "text must be text."})
        found.keep_control(str(data.get("kind")), data["text"])
        return Response({"ok": True})


class Verdict(SessionView):
    """``sessions/<session>/verdict``."""

    @plainly
    def get(self, request: Any, session: str = "") -> Response:
        """The verdict on what was read so far."""
        return Response(self._answer(self.session(session), Choices()))

    @plainly
    def post(self, request: Any, session: str = "") -> Response:
        """The same with the user's choices."""
        return Response(self._answer(self.session(session), choices_from(self.body())))

    def _answer(self, session: sessions.Session, choices: Choices) -> Dict[str, Any]:
        gathered = session.gather()
        if not gathered.scan.frames and not gathered.scan.broken:
            raise Conflict("No file was read yet.")
        with preferences.settings_for(self.request.user) as settings:
            inspection = of_session(gathered, settings, session.control("gcp"), session.control("geo"))
        proposal = propose(inspection, choices)
        report = home.page(f"sessions/{session.id}/report")
        owner = project_for(self.request, session.project, "change_project").owner
        engine = state.engine_ahead(owner)
        return verdict.words_for(inspection, proposal, choices, gathered.ids, report, engine)


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

    @plainly
    def post(self, request: Any, session: str = "") -> Response:
        """Bind a task to the session that it came from."""
        found, data = self.session(session), self.body()
        task = home.find_task(data.get("task"))
        if task is None or task.project_id != found.project:
            raise exceptions.NotFound()
        if not isinstance(data.get("key"), str) or len(data["key"]) > 200:
            raise exceptions.ValidationError({"detail": "key must be text."})
        choices = choices_from(data)
        checking.report_of(found, request.user)
        folder = home.task_folder(task)
        for name in ("report.json", "report.html"):
            if (found.folder / name).is_file():
                write_text(folder / name, (found.folder / name).read_text(encoding="utf-8"))
        return Response({"ok": True, **self._note(found, task, data["key"], choices)})

    def _note(self, session: sessions.Session, task: Any, key: str, choices: Choices) -> Dict[str, Any]:
        """Keep the choices with the task where it waits for the gate, and say what will come of them."""
        if preferences.mode() != preferences.HOLD:
            return {"honoured": True, "message": ""}
        with preferences.settings_for(self.request.user) as settings:
            inspection = of_session(session.gather(), settings, session.control("gcp"), session.control("geo"))
        kept = claims.noted(self.request.user, choices, propose(inspection, choices), propose(inspection), key)
        if kept is not None:
            records.change(task.pk, claim=kept)
        honoured = kept is not None and (not kept["against"] or home.may_override(self.request.user))
        return {"honoured": honoured, "message": "" if honoured else claims.TAKEN_APART}
