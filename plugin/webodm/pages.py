"""The pages: the menu's own, and the report of a task or of a session."""

from __future__ import annotations

import contextlib
import functools
import json
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Callable, Dict, List

from ...stages.errors import SensorgateError
from ..report.html import themed
from . import checking, home, preferences, records, sessions

_MOST_TASKS, _SHOWN_TASKS = 200, 15
_STATES = {
    records.UPLOADING: "uploading",
    records.WAITING: "waiting",
    records.CHECKING: "being checked",
    records.HELD: "held",
    records.RELEASED: "checked",
    records.SPLIT: "taken apart",
    records.OVERRIDDEN: "let go as it was",
    records.WORKING: "being harmonized",
    records.FAILED: "not checked",
}
# The report runs no script but its own, and reaches nothing.
_POLICY = (
    "sandbox allow-scripts allow-popups; default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
    "script-src 'unsafe-inline'"
)


def for_users(plugin: Any, view: Callable[..., Any]) -> Callable[..., Any]:
    """Hand the plugin to a page; visitors are sent to the login."""
    from django.contrib.auth.decorators import login_required
    from django.views.decorators.http import require_safe

    @functools.wraps(view)
    def bound(request: Any, *args: Any, **kwargs: Any) -> Any:
        return view(request, plugin, *args, **kwargs)

    return require_safe(login_required(bound))


def _render(request: Any, template: str, context: Dict[str, Any]) -> Any:
    from django.shortcuts import render

    return render(request, template, context)


def _not_found() -> Exception:
    from django.http import Http404

    return Http404("Not found")


def menu_page(request: Any, plugin: Any) -> Any:
    """Settings, history, and what an administrator has to know."""
    told = preferences.describe(request.user)
    own = told["thresholds"]["mine"] if not request.user.is_superuser else told["thresholds"]["all"]
    rows = [
        {"name": n, "value": own.get(n, k["default"]), **k, "changed": n in own}
        for n, k in sorted(told["thresholds"]["known"].items(), key=lambda i: (i[0] not in own, i[0]))
    ]
    history = _history(request.user)
    context = {
        "title": "Camera check",
        "told": told,
        "rows": rows,
        "modes": [
            ("off", "Off", "Tasks are processed as WebODM does; the panel in New Task works all the same."),
            ("report", "Report", "Every new task is checked beside its processing, and gets a report."),
            ("hold", "Hold", "Every new task waits until its cameras were checked, then goes on or is taken apart."),
        ],
        "history": history[:_SHOWN_TASKS],
        "earlier": history[_SHOWN_TASKS:],
        "api": f"/api/plugins/{home.NAME}/settings",
        "public": home.page(""),
        "row_template": plugin.template_path("history_row.html"),
        "folder": home.ROOT,
        "version": home.version(),
        "scope": "all" if request.user.is_superuser else "mine",
    }
    return _render(request, plugin.template_path("menu.html"), context)


def _history(user: Any) -> List[Dict[str, Any]]:
    """The tasks that were looked at and that this user may see, the latest first."""
    rows = []
    known = sorted(records.all_in(*_STATES), key=lambda item: -float(item[1].get("at", 0.0)))
    for task_id, record in known:
        task = home.find_task(task_id)
        if task is None or not user.has_perm("view_project", task.project):
            continue
        report = _report_of(task).is_file()
        if record.get("from") and not report:
            continue  # the task that it was taken from tells of it
        rows.append(
            {
                "at": datetime.fromtimestamp(float(record.get("at", 0.0)), timezone.utc),
                "name": task.name or "unnamed",
                "project": task.project.name,
                "state": "created from another" if record.get("from") else _STATES[record["state"]],
                "message": record.get("headline") or record.get("message") or "",
                "report": home.page(f"tasks/{task.pk}/report") if report else None,
                "dashboard": f"/dashboard/?project_task_open={task.project_id}&project_task_expanded={task.pk}",
            }
        )
        if len(rows) >= _MOST_TASKS:
            break
    return rows


def _report_of(task: Any) -> Path:
    return home.task_folder(task) / "report.json"


def _task(request: Any, task_id: str) -> Any:
    task = home.find_task(task_id)
    if task is None or not (task.public or task.project.public or request.user.has_perm("view_project", task.project)):
        raise _not_found()
    return task


def task_report(request: Any, plugin: Any, task: str) -> Any:
    """The report of a task inside WebODM's look."""
    found = _task(request, task)
    return _frame(request, plugin, home.task_folder(found), f"Report of {found.name or 'the task'}", "document")


def task_document(request: Any, plugin: Any, task: str) -> Any:
    """The report itself."""
    return _document(request, home.task_folder(_task(request, task)))


def session_report(request: Any, plugin: Any, session: str) -> Any:
    """The report of files that were only looked at."""
    found = sessions.find(home.temporary(), session, request.user.pk)
    if found is None:
        raise _not_found()
    with contextlib.suppress(SensorgateError):
        checking.report_of(found, request.user)
    return _frame(request, plugin, found.folder, "Report of the chosen files", "document")


def session_document(request: Any, plugin: Any, session: str) -> Any:
    """The report itself."""
    found = sessions.find(home.temporary(), session, request.user.pk)
    if found is None:
        raise _not_found()
    return _document(request, found.folder)


def _frame(request: Any, plugin: Any, folder: Path, title: str, source: str) -> Any:
    if not (folder / "report.json").is_file():
        raise _not_found()
    context: Dict[str, Any] = {"title": title, "source": source, "findings": []}
    if not (folder / "report.html").is_file():
        # Without Jinja2 there is no page of the report's own; what it says is shown plainly.
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        context.update(source=None, findings=report.get("findings", []))
    return _render(request, plugin.template_path("report.html"), context)


def _document(request: Any, folder: Path) -> Any:
    """The report's own page; ``?theme=`` says whether the page around it is dark or light."""
    file = folder / "report.html"
    if not file.is_file():
        raise _not_found()
    from django.http import HttpResponse

    page = themed(file.read_text(encoding="utf-8"), request.GET.get("theme", ""))
    answer = HttpResponse(page, content_type="text/html; charset=utf-8")
    answer["Content-Security-Policy"] = _POLICY
    answer["X-Content-Type-Options"] = "nosniff"
    answer["X-Frame-Options"] = "SAMEORIGIN"
    return answer


_TASK, _SESSION = r"(?P<task>[0-9a-f-]{36})", r"(?P<session>[0-9a-f]{32})"
ROUTES = (
    (r"$", menu_page),
    (rf"tasks/{_TASK}/report$", task_report),
    (rf"tasks/{_TASK}/document$", task_document),
    (rf"sessions/{_SESSION}/report$", session_report),
    (rf"sessions/{_SESSION}/document$", session_document),
)
