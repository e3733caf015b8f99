"""Who may do what, and what is refused."""

import base64
import json

import pytest
from app.models import Grant, Project, Task
from conftest import FOLDER, MEDIA
from django.contrib.auth.models import User
from django.test import Client

API = f"/api/plugins/{FOLDER}/"


class Someone:
    """A browser, with WebODM's CSRF check on."""

    def __init__(self, user=None):
        self.client = Client(enforce_csrf_checks=True)
        self.token = "a" * 64
        if user is not None:
            self.client.force_login(user)
        self.client.cookies["csrftoken"] = self.token

    def post(self, path, body, token=True):
        extra = {"HTTP_X_CSRFTOKEN": self.token} if token else {}
        return self.client.post(API + path, json.dumps(body), content_type="application/json", **extra)

    def get(self, path):
        return self.client.get(API + path)


@pytest.fixture
def people():
    owner = User.objects.create_user("owner")
    viewer = User.objects.create_user("viewer")
    other = User.objects.create_user("other")
    admin = User.objects.create_superuser("admin", "", "x")
    project = Project.objects.create(name="Fields", owner=owner)
    for perm in ("view_project", "change_project", "delete_project"):
        Grant.objects.create(user=owner, project=project, perm=perm)
    Grant.objects.create(user=viewer, project=project, perm="view_project")
    return {
        "project": project,
        "owner": Someone(owner),
        "viewer": Someone(viewer),
        "other": Someone(other),
        "admin": Someone(admin),
        "nobody": Someone(),
        "users": {"owner": owner, "other": other},
    }


def sent(files, length=65536):
    return [
        {
            "id": number,
            "path": f"card/{file.name}",
            "size": file.stat().st_size,
            "modified": 0,
            "ranges": [[0, base64.b64encode(file.read_bytes()[:length]).decode()]],
        }
        for number, file in enumerate(files)
    ]


def all_read(someone, session, files):
    """Send, and send again what is asked for, as the panel does."""
    todo = sent(files)
    for _ in range(40):
        answer = someone.post(f"sessions/{session}/headers", {"files": todo})
        assert answer.status_code == 200, answer.content
        by_id = {f["id"]: f for f in todo}
        todo = []
        for need in answer.json()["need"]:
            file = by_id[need["id"]]
            data = files[need["id"]].read_bytes()[need["offset"] : need["offset"] + need["length"]]
            file["ranges"].append([need["offset"], base64.b64encode(data).decode()])
            todo.append(file)
        if not todo:
            return
    raise AssertionError("it never has enough")


def begun(people, who="owner"):
    answer = people[who].post("sessions", {"project": people["project"].pk})
    assert answer.status_code == 201, answer.content
    return answer.json()["session"]


def test_only_who_may_change_the_project_gets_a_session(people):
    body = {"project": people["project"].pk}
    assert people["viewer"].post("sessions", body).status_code == 404
    assert people["other"].post("sessions", body).status_code == 404
    assert people["nobody"].post("sessions", body).status_code in (401, 403)
    assert people["owner"].post("sessions", body, token=False).status_code == 403


def test_a_session_is_its_owners_alone(people, frames):
    session = begun(people)
    all_read(people["owner"], session, frames["one"])
    for who in ("viewer", "other", "admin"):
        assert people[who].get(f"sessions/{session}/verdict").status_code == 404
        assert people[who].post(f"sessions/{session}/headers", {"files": sent(frames["one"])}).status_code == 404
    assert people["other"].client.get(f"/plugins/{FOLDER}/sessions/{session}/report").status_code == 404
    Grant.objects.filter(user=people["users"]["owner"], perm="change_project").delete()
    assert people["owner"].get(f"sessions/{session}/verdict").status_code == 404


def test_two_cameras_with_equal_names_become_two_tasks_with_unique_names(people, frames):
    session = begun(people)
    assert people["owner"].get(f"sessions/{session}/verdict").status_code == 409
    files = frames["one"] + frames["two"]
    assert {f.name for f in frames["one"]} & {f.name for f in frames["two"]}
    all_read(people["owner"], session, files)
    told = people["owner"].get(f"sessions/{session}/verdict").json()
    assert told["verdict"] == "inconsistent" and told["files"] == len(files)
    assert len(told["tasks"]) == 2
    names = [name for task in told["tasks"] for _, name in task["files"]]
    assert len(names) == len(files) == len({n.lower() for n in names})
    assert all(option["value"] for task in told["tasks"] for option in task["options"])
    whole = people["owner"].post(f"sessions/{session}/verdict", {"off": ["split"]}).json()
    assert [t["frames"] for t in whole["tasks"]] == [len(files)]
    first = told["payloads"][0]["id"]
    fewer = people["owner"].post(f"sessions/{session}/verdict", {"moves": {first: ""}}).json()
    assert sum(t["frames"] for t in fewer["tasks"]) == len(files) - told["payloads"][0]["frames"]


def test_what_is_malformed_or_too_large_is_refused(people, frames):
    session = begun(people)
    post = people["owner"].post
    good = sent(frames["one"][:1])[0]
    for wrong in (
        {},
        {"files": []},
        {"files": [{**good, "ranges": [[0, "not base64!"]]}]},
        {"files": [{**good, "ranges": [[-1, "AAAA"]]}]},
        {"files": [{**good, "size": "x"}]},
        {"files": [{**good, "path": ""}]},
        {"files": [{**good, "id": True}]},
        {"files": [good] * 65},
        {"files": [{**good, "ranges": [[0, "A" * (4 * 400_000)]]}]},
    ):
        assert post(f"sessions/{session}/headers", wrong).status_code == 400, str(wrong)[:80]
    huge = {"files": [], "x": "y" * (5 * 1024 * 1024)}
    assert post(f"sessions/{session}/headers", huge).status_code == 413
    assert post(f"sessions/{session}/verdict", {"off": ["everything"]}).status_code == 400
    assert post(f"sessions/{session}/control", {"kind": "../x", "text": "y"}).status_code == 400


def test_names_from_a_browser_never_reach_the_disk(people, frames):
    session = begun(people)
    file = {**sent(frames["one"][:1])[0], "path": "../../../etc/\x00evil/..\\DJI_1.JPG"}
    answer = people["owner"].post(f"sessions/{session}/headers", {"files": [file]})
    assert answer.status_code == 200
    told = people["owner"].get(f"sessions/{session}/verdict").json()
    shown = [p["path"] for p in told["left_out"]] + [n for t in told["tasks"] for _, n in t["files"]]
    assert shown and not any(".." in name or "\x00" in name or name.startswith("/") for name in shown)


def test_who_sends_too_many_bytes_waits(people, frames, monkeypatch):
    import importlib

    bounds = importlib.import_module(f"plugins.{FOLDER}.plugin.webodm.bounds")
    session = begun(people)
    monkeypatch.setattr(bounds, "USER_BYTES", 1000)
    answer = people["owner"].post(f"sessions/{session}/headers", {"files": sent(frames["one"])})
    assert answer.status_code == 429 and answer["Retry-After"]


def test_settings_for_all_are_the_administrators(people):
    assert people["owner"].post("settings", {"hold": "hold"}).status_code == 403
    assert people["owner"].post("settings", {"thresholds": {}, "scope": "all"}).status_code == 403
    assert people["admin"].post("settings", {"hold": "sometimes"}).status_code == 400
    assert people["admin"].post("settings", {"hold": "hold"}).json()["hold"] == "hold"
    mine = people["owner"].post("settings", {"thresholds": {"focal_variance": 0.05}}).json()
    assert mine["thresholds"]["mine"] == {"focal_variance": 0.05} and not mine["thresholds"]["all"]
    assert people["owner"].post("settings", {"thresholds": {"nothing": 1}}).status_code == 400
    assert people["other"].get("settings").json()["thresholds"]["mine"] == {}


def test_a_calibration_sheet_is_read_before_it_is_kept(people):
    wrong = people["owner"].post("settings", {"sheet": {"name": "mine.csv", "text": "make,modl\n"}})
    assert wrong.status_code == 400 and "modl" in wrong.json()["detail"] and "mine.csv" in wrong.json()["detail"]
    text = "make,model,sensor_width_mm\nACME,X1,13.2\n"
    told = people["owner"].post("settings", {"sheet": {"name": "mine.csv", "text": text}}).json()
    assert told["sheet"] == {"mine": "mine.csv", "all": None, "rows": 1}
    assert people["owner"].post("settings", {"sheet": None}).json()["sheet"]["mine"] is None


def test_a_public_task_is_seen_and_not_touched(people):
    task = Task.objects.create(project=people["project"], name="t", public=True, images_count=2, status=30)
    base = f"projects/{people['project'].pk}/tasks/{task.pk}/"
    assert people["nobody"].get(base + "state").status_code == 200
    # Nothing of the nodes or the server either.
    seen = people["nobody"].get(base + "state").json()
    assert seen["actions"] == [] and seen["engine_message"] == "" and seen["report"] is None
    for action in ("check", "override", "split", "judge", "prepare"):
        assert people["nobody"].post(base + action, {}).status_code in (401, 403)
        assert people["other"].post(base + action, {}).status_code == 404
        assert people["viewer"].post(base + action, {}).status_code == 404
    assert people["owner"].post(base + "judge", {"x": "y" * 100_000}).status_code == 413
    Task.objects.filter(pk=task.pk).update(public=False)
    assert people["other"].get(base + "state").status_code == 404
    assert people["owner"].get(f"projects/{people['project'].pk + 1}/tasks/{task.pk}/state").status_code == 404


DARK_STYLE = "@media screen and (prefers-color-scheme: dark)"


def test_pages_are_for_users_and_reports_for_who_may_see_the_task(people):
    folder = f"/plugins/{FOLDER}/"
    assert people["nobody"].client.get(folder).status_code == 302
    assert people["owner"].client.get(folder).status_code == 200
    task = Task.objects.create(project=people["project"], name="t")
    kept = MEDIA / "project" / str(task.project_id) / "task" / str(task.pk) / "data/sensorgate"
    kept.mkdir(parents=True)
    (kept / "report.json").write_text('{"findings": []}')
    (kept / "report.html").write_text(f"<style>{DARK_STYLE} {{ p {{ color: white }} }}</style><p>seen</p>")
    assert people["owner"].client.get(f"{folder}tasks/{task.pk}/report").status_code == 200
    document = people["owner"].client.get(f"{folder}tasks/{task.pk}/document")
    assert b"seen" in document.content and "sandbox" in document["Content-Security-Policy"]
    for theme, query in (
        ("dark", "@media screen {"),
        ("light", "@media not all {"),
        ("<b>", DARK_STYLE),
        ("", DARK_STYLE),
    ):
        page = people["owner"].client.get(f"{folder}tasks/{task.pk}/document", {"theme": theme}).content.decode()
        assert f"<style>{query}" in page and "<b>" not in page
    for page in ("report", "document"):
        assert people["other"].client.get(f"{folder}tasks/{task.pk}/{page}").status_code == 404


def test_what_waits_is_told_to_who_may_see_it(people):
    import importlib

    records = importlib.import_module(f"plugins.{FOLDER}.plugin.webodm.records")
    project = people["project"]
    for state, more in (
        ("held", {}),
        ("checking", {"holds": True}),
        ("checking", {}),
        ("released", {}),
        ("working", {}),
    ):
        task = Task.objects.create(project=project, name=state, images_count=3)
        records.keep(task.pk, {"state": state, "message": "why", **more})
    path = f"waiting?projects={project.pk},999"
    told = people["viewer"].get(path).json()["projects"]
    assert [t["state"] for t in told[str(project.pk)]] == ["held", "checking", "working"] and len(told) == 1
    assert people["other"].get(path).json() == {"projects": {}}
    assert people["nobody"].get(path).status_code in (401, 403)
    for wrong in ("", "x", "1," * 100 + "1", "1;2"):
        assert people["owner"].get(f"waiting?projects={wrong}").status_code == 400


def test_an_upload_that_broke_off_is_told(people):
    import datetime

    project = people["project"]
    long_ago = datetime.datetime.now() - datetime.timedelta(minutes=10)
    for name, tags, since in (("left", "sensorgate rgb", long_ago), ("own", "", long_ago), ("new", "sensorgate", None)):
        task = Task.objects.create(project=project, name=name, tags=tags, partial=True)
        if since is not None:
            Task.objects.filter(pk=task.pk).update(created_at=since)
    told = people["owner"].get(f"waiting?projects={project.pk}").json()["projects"][str(project.pk)]
    assert [(t["name"], t["state"]) for t in told] == [("left", "broken-off")] and "after 0 files" in told[0]["message"]
    assert people["other"].get(f"waiting?projects={project.pk}").json() == {"projects": {}}
