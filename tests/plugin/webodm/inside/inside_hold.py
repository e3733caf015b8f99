"""No task reaches a node before it was looked at, whatever way it comes."""

import importlib
import os
import shutil

import pytest
from app.models import Plugin, Project, Task
from app.pending_actions import RESTART
from app.plugins import GlobalDataStore
from app.plugins.signals import task_removed
from app.plugins.worker import waiting, work
from conftest import FOLDER
from django.contrib.auth.models import Permission, User
from nodeodm.models import ProcessingNode
from worker.tasks import processed

webodm = f"plugins.{FOLDER}.plugin.webodm"
records = importlib.import_module(f"{webodm}.records")
home = importlib.import_module(f"{webodm}.home")
tasks = importlib.import_module(f"{webodm}.tasks")


def mode(value):
    GlobalDataStore(FOLDER).set_string("hold", value)


@pytest.fixture
def project():
    return Project.objects.create(name="Fields", owner=User.objects.create_user("owner"))


def uploaded(project, files, **values):
    """A task as WebODM creates it in one request."""
    task = Task.objects.create(project=project)
    os.makedirs(task.task_path())
    for number, file in enumerate(files):
        shutil.copy(file, task.task_path(f"{number:03d}_{file.name}"))
    for name, value in values.items():
        setattr(task, name, value)
    task.images_count = len(files)
    task.save()
    return task


def again(task):
    return Task.objects.get(pk=task.pk)


def ready(task):
    task = again(task)
    return task.auto_processing_node or task.processing_node_id is not None


def test_off_leaves_tasks_alone(project, frames):
    task = uploaded(project, frames["one"])
    assert ready(task) and not waiting and records.load(task.pk) is None


def test_a_disabled_plugin_holds_nothing(project, frames):
    mode("hold")
    Plugin.objects.all().update(enabled=False)
    assert ready(uploaded(project, frames["one"]))


def test_report_looks_and_does_not_hold(project, frames):
    mode("report")
    task = uploaded(project, frames["one"])
    assert ready(task)
    work()
    record = records.load(task.pk)
    assert record["state"] == "released" and record["verdict"]
    assert (home.task_folder(task) / "report.json").is_file()
    assert str(task.task_path()) not in (home.task_folder(task) / "report.json").read_text()


def test_hold_lets_one_camera_go_with_what_the_user_wanted(project, frames):
    mode("hold")
    node = ProcessingNode.objects.create(hostname="n")
    task = uploaded(project, frames["one"], processing_node=node, auto_processing_node=False)
    assert not ready(task) and again(task).last_error.startswith("Waiting")
    work()
    task = again(task)
    assert task.processing_node_id == node.pk and not task.auto_processing_node and task.last_error is None
    assert processed == [str(task.pk)]
    task.auto_processing_node = True
    task.save()
    assert ready(task), "what was let go stays so"


def test_hold_takes_two_cameras_apart_and_keeps_the_files(project, frames):
    mode("hold")
    task = uploaded(project, frames["one"] + frames["two"], options=[{"name": "dsm", "value": True}])
    work()
    task = again(task)
    new = [Task.objects.get(pk=t["id"]) for t in records.load(task.pk)["tasks"]]
    assert len(new) == 2 and task.status == 50 and not ready(task)
    assert len(task.scan_images()) == task.images_count
    assert sum(t.images_count for t in new) == task.images_count
    assert all(ready(t) and not t.partial and {"name": "dsm", "value": True} in t.options for t in new)
    assert sorted(processed) == sorted(str(t.pk) for t in new)
    assert all(t.project_id == task.project_id and "sensorgate" in t.tags for t in new)


def test_hold_keeps_back_what_is_useless_and_says_why(project, tmp_path):
    mode("hold")
    for name in ("a.jpg", "b.jpg"):
        (tmp_path / name).write_bytes(b"no image")
    task = uploaded(project, [tmp_path / "a.jpg", tmp_path / "b.jpg"])
    work()
    assert records.load(task.pk)["state"] == "held" and "none of these files" in again(task).last_error
    assert not processed


def test_no_way_around_it(project, frames):
    mode("hold")
    task = Task.objects.create(project=project, partial=False)
    task.partial = True
    task.save()
    assert not ready(task), "an open upload has no node to be sent to"
    os.makedirs(task.task_path())
    shutil.copy(frames["one"][0], task.task_path("a.jpg"))
    edited = again(task)
    edited.processing_node = ProcessingNode.objects.create(hostname="n")
    edited.images_count = 1
    edited.save()
    assert not ready(task) and not waiting
    edited.partial = False
    edited.save()
    assert not ready(task) and len(waiting) == 1
    restarted = again(task)
    restarted.pending_action = RESTART
    restarted.auto_processing_node = True
    restarted.save()
    assert not ready(task) and again(task).pending_action is None
    mode("off")
    late = again(task)
    late.auto_processing_node = True
    late.save()
    assert not ready(task), "it still waits to be given back what it wanted"
    work()
    assert ready(task)


def test_a_fault_in_the_hold_ends_the_saving(project, frames, monkeypatch):
    mode("hold")

    def broken(*_):
        raise RuntimeError("no database")

    monkeypatch.setattr(records, "load", broken)
    task = Task(project=project, images_count=3)
    with pytest.raises(RuntimeError):
        task.save()
    assert not Task.objects.filter(pk=task.pk).exists()


def test_a_fault_in_the_look_keeps_the_task_back(project, frames, monkeypatch):
    mode("hold")
    task = uploaded(project, frames["one"])
    checking = importlib.import_module(f"{webodm}.checking")

    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(checking, "look", broken)
    work()
    assert records.load(task.pk)["state"] == "held" and not ready(task) and not processed


def test_a_split_that_fails_leaves_nothing_behind(project, frames, monkeypatch):
    mode("hold")
    task = uploaded(project, frames["one"] + frames["two"])
    count = []

    def link(source, target):
        count.append(source)
        if len(count) > len(frames["one"]) + 1:
            raise OSError("disk full")
        shutil.copy(source, target)

    monkeypatch.setattr(tasks, "link", link)
    work()
    assert Task.objects.count() == 1 and records.load(task.pk)["state"] == "held"


def test_a_node_with_the_adapter_is_asked_to_harmonize(project, frames):
    mode("hold")
    ProcessingNode.objects.create(hostname="plain")
    node = ProcessingNode.objects.create(
        hostname="adapter", queue_count=3, available_options=[{"name": "mixed-sensor-policy"}]
    )
    task = uploaded(project, frames["one"])
    work()
    task = again(task)
    assert task.processing_node_id == node.pk and {"name": "mixed-sensor-policy", "value": "auto"} in task.options


def test_a_worker_that_died_is_replaced(project, frames, monkeypatch):
    mode("hold")
    state = importlib.import_module(f"{webodm}.state")
    task = uploaded(project, frames["one"])
    waiting.clear()
    state.state_of(task, project.owner)
    assert not waiting
    monkeypatch.setattr(records, "STALE_S", -1.0)
    state.state_of(task, project.owner)
    assert len(waiting) == 1


def test_override_is_a_permission(project, frames):
    boss = User.objects.create_user("boss")
    assert not home.may_override(boss)
    boss.user_permissions.add(Permission.objects.get(codename=home.OVERRIDE))
    assert home.may_override(User.objects.get(pk=boss.pk))
    mode("hold")
    task = uploaded(project, frames["one"] + frames["two"])
    tasks.release(again(task), records.OVERRIDDEN, "by boss")
    assert ready(task) and records.load(task.pk)["state"] == "overridden"
    work()
    assert records.load(task.pk)["state"] == "overridden" and Task.objects.count() == 1


def test_a_task_that_is_gone_leaves_no_record(project, frames):
    mode("hold")
    task = uploaded(project, frames["one"])
    task_removed.send_robust(sender=Task, task_id=task.pk)
    assert records.load(task.pk) is None


def test_a_failed_task_of_two_cameras_is_judged_and_laid_on_the_anchor(project, frames):
    judging = importlib.import_module(f"{webodm}.judging")
    checking = importlib.import_module(f"{webodm}.checking")
    anchor = Task.objects.create(
        project=project, name="done", status=40, images_count=9, available_assets=["georeferenced_model.laz"]
    )
    os.makedirs(anchor.assets_path())
    open(anchor.assets_path("model.laz"), "w").close()
    task = uploaded(project, frames["one"] + frames["two"], status=30)
    inspection, proposal = checking.look(task)
    judgement = judging.with_gate(judging.judge_task(task), inspection, proposal)
    parts = judging.parts_of(task, judgement, inspection, proposal)
    told = judging.remember(task, judgement, parts, inspection)["judgement"]
    assert told["route"] == "isolate" and len(told["tasks"]) == 2 and told["anchor"]["id"] == str(anchor.pk)
    from pathlib import Path

    anchors = judging.anchors_of(task, parts, inspection)
    tasks.split(task, [(Path(task.task_path()), part) for part in parts], anchors)
    new = Task.objects.filter(status=None)
    assert new.count() == 2 and all("align.laz" in t.scan_images() for t in new)
    assert again(task).status == 30


def test_harmonizing_whose_worker_died_is_taken_up_once(project, frames, monkeypatch):
    state = importlib.import_module(f"{webodm}.state")
    task = uploaded(project, frames["one"])
    records.change(task.pk, state="working", by=project.owner.pk)
    stored = records.load(task.pk)
    GlobalDataStore(FOLDER).set_json(f"task::{task.pk}", {**stored, "at": stored["at"] - 1000})
    state.state_of(task, project.owner)
    state.state_of(task, project.owner)
    assert [call[1] for call in waiting] == ["run_prepare"]


def test_a_look_or_a_split_is_no_way_around_it(project, frames):
    views = importlib.import_module(f"{webodm}.task_views")
    state = importlib.import_module(f"{webodm}.state")
    idle = uploaded(project, frames["one"] + frames["two"], auto_processing_node=False)
    mode("hold")
    views._check(idle, project.owner, {})
    work()
    assert records.load(idle.pk)["state"] == "released"
    late = again(idle)
    late.auto_processing_node = True
    late.save()
    assert not ready(idle) and len(waiting) == 1
    work()
    assert records.load(idle.pk)["state"] == "split" and not ready(idle)
    assert "check" not in state.actions_for(again(idle), records.load(idle.pk), project.owner)
    revived = again(idle)
    revived.status = None
    revived.processing_node = ProcessingNode.objects.create(hostname="n")
    revived.save()
    assert not ready(idle) and not waiting


def test_a_finished_task_whose_products_say_nothing_is_unproven_and_left_alone(project, frames):
    judging = importlib.import_module(f"{webodm}.judging")
    checking = importlib.import_module(f"{webodm}.checking")
    task = uploaded(project, frames["one"], status=40)
    os.makedirs(task.assets_path("odm_report"))
    inspection, proposal = checking.look(task)
    judgement = judging.with_gate(judging.judge_task(task), inspection, proposal)
    assert judgement.route in ("unreadable", "stop") and judgement.reasons
    assert judging.parts_of(task, judgement, inspection, proposal) == ()


LOCK = {"name": "use-fixed-camera-params", "value": True}
CAMERAS = {"dji fc6310 800 600 brown 0.85": {"projection_type": "brown", "width": 800, "height": 600, "focal_x": 0.7}}


def harmonized(task, calibration):
    from pathlib import Path

    proposal = importlib.import_module(f"{webodm}.proposal")
    names = {n: n for n in task.scan_images() if n.endswith(".JPG")}
    part = proposal.Proposed("rgb", "rgb", "rgb", ("p",), tuple(sorted(names)), names, (LOCK,), {}, {}, (), calibration)
    told = tasks.split(task, [(Path(task.task_path()), part)])
    return Task.objects.get(pk=told[0]["id"])


def test_a_calibration_goes_along_as_files_that_every_node_understands(project, frames):
    import json
    import zipfile

    old = uploaded(project, frames["one"])
    new = harmonized(old, CAMERAS)
    assert LOCK in new.options and not any(o["name"] == "cameras" for o in new.options)
    with open(new.task_path("sensorgate_calibration.json")) as file:
        assert json.load(file) == CAMERAS
    with zipfile.ZipFile(new.task_path("seed.zip")) as seed:
        assert seed.namelist() == ["opensfm/camera_models_overrides.json"]
        overrides = json.loads(seed.read(seed.namelist()[0]))
    assert overrides["v2 dji fc6310 800 600 brown 0.85"]["focal_x_prior"] == 0.7
    assert "The calibration of the cameras is sent along." in records.load(old.pk)["message"]
    # What is taken apart again keeps it.
    checking = importlib.import_module(f"{webodm}.checking")
    inspection, proposal = checking.look(new)
    assert len(inspection.survey.frames) == len(frames["one"]) and not inspection.survey.broken
    from pathlib import Path

    told = tasks.split(new, [(Path(new.task_path()), proposal.tasks[0])])
    part = Task.objects.get(pk=told[0]["id"])
    assert {"seed.zip", "sensorgate_calibration.json"} <= set(part.scan_images()) and LOCK in part.options


@pytest.mark.parametrize("why", ["nothing known", "own cameras", "resized"])
def test_without_a_calibration_that_fits_nothing_is_locked(project, frames, why):
    old = uploaded(project, frames["one"])
    if why == "own cameras":
        old.options = [{"name": "cameras", "value": "{}"}]
    if why == "resized":
        old.pending_action, old.resize_to = 4, 400
    new = harmonized(old, {} if why == "nothing known" else CAMERAS)
    assert LOCK not in new.options and "seed.zip" not in new.scan_images()
    # Its frames are harmonized all the same: no node does it again.
    assert "sensorgate_calibration.json" in new.scan_images()


def test_a_node_with_the_adapter_leaves_harmonized_frames_alone(project, frames):
    node = ProcessingNode.objects.create(
        hostname="field", available_options=[{"name": "mixed-sensor-policy", "domain": ["off", "auto"]}]
    )
    old = uploaded(project, frames["one"], auto_processing_node=False, processing_node=node)
    new = harmonized(old, CAMERAS)
    assert {"name": "mixed-sensor-policy", "value": "report"} in new.options and new.processing_node_id == node.pk


def claimed(project, user, files, task, **choices):
    """The record's claim, as the panel leaves it before the upload is committed."""
    gathering = importlib.import_module(f"{webodm}.gathering")
    proposal = importlib.import_module(f"{webodm}.proposal")
    claims = importlib.import_module(f"{webodm}.claims")
    inspection_of = importlib.import_module(f"plugins.{FOLDER}.plugin.inspection")
    from pathlib import Path

    made = proposal.Choices(frozenset(choices.get("off", ())), choices.get("moves", {}))
    inspection = gathering.of_task(Path(files), inspection_of.DEFAULT_SETTINGS)
    planned = proposal.propose(inspection, made)
    suggested = proposal.propose(inspection)
    return claims.noted(user, made, planned, suggested, choices.get("key", planned.tasks[0].key))


def arriving(project, files, claim):
    """A task that was claimed while its upload was open."""
    task = Task.objects.create(project=project, partial=True)
    os.makedirs(task.task_path())
    for number, file in enumerate(files):
        shutil.copy(file, task.task_path(f"{number:03d}_{file.name}"))
    records.change(task.pk, claim=claim(task))
    task.images_count = len(files)
    task.partial = False
    task.save()
    return task


@pytest.mark.parametrize("may", [True, False])
def test_what_was_chosen_in_new_task_is_kept_where_the_user_may(project, frames, may):
    if may:
        home.ensure_permission()
        project.owner.user_permissions.add(Permission.objects.get(codename=home.OVERRIDE))
    mode("hold")
    both = frames["one"] + frames["two"]
    task = arriving(project, both, lambda t: claimed(project, project.owner, t.task_path(), t, off=["split"]))
    assert not ready(task)
    work()
    assert records.load(task.pk)["state"] == ("overridden" if may else "split") and ready(task) is may
    assert ("owner chose in New Task" in records.load(task.pk)["message"]) is may


def test_only_a_part_of_several_groups_goes_against_the_gate(project, frames):
    both = frames["one"] + frames["two"]
    task = uploaded(project, both, auto_processing_node=False)
    gathering = importlib.import_module(f"{webodm}.gathering")
    proposal = importlib.import_module(f"{webodm}.proposal")
    inspection_of = importlib.import_module(f"plugins.{FOLDER}.plugin.inspection")
    from pathlib import Path

    inspection = gathering.of_task(Path(task.task_path()), inspection_of.DEFAULT_SETTINGS)
    first, second = proposal.propose(inspection).tasks
    where = {"moves": {second.payloads[0]: ""}, "key": first.key}
    assert claimed(project, project.owner, task.task_path(), task, **where)["against"] is False
    where = {"moves": {second.payloads[0]: first.key}, "key": first.key}
    assert claimed(project, project.owner, task.task_path(), task, **where)["against"] is True


def test_a_choice_counts_for_the_files_that_it_was_made_for(project, frames):
    home.ensure_permission()
    project.owner.user_permissions.add(Permission.objects.get(codename=home.OVERRIDE))
    mode("hold")

    def other(task):
        kept = claimed(project, project.owner, task.task_path(), task, off=["split"])
        shutil.copy(frames["one"][0], task.task_path("900_one_more.JPG"))
        return kept

    task = arriving(project, frames["one"] + frames["two"], other)
    work()
    assert records.load(task.pk)["state"] == "split" and not ready(task)


def test_options_are_the_users_own_matter(project, frames):
    mode("hold")
    task = arriving(
        project, frames["one"], lambda t: claimed(project, project.owner, t.task_path(), t, off=["options"])
    )
    work()
    assert records.load(task.pk)["state"] == "released" and ready(task) and again(task).options == []


def test_hold_is_not_switched_on_before_all_processes_have_the_plugin(project, frames, monkeypatch):
    presence = importlib.import_module(f"{webodm}.presence")
    preferences = importlib.import_module(f"{webodm}.preferences")
    settings_views = importlib.import_module(f"{webodm}.settings_views")
    from django.core.cache import cache
    from rest_framework.test import APIRequestFactory, force_authenticate

    admin = User.objects.create_superuser("admin", "", "x")

    def ask(value):
        request = APIRequestFactory().post("/", {"hold": value}, format="json")
        force_authenticate(request, admin)
        return settings_views.SettingsView.as_view()(request)

    cache.clear()
    assert "worker has not loaded" in presence.restart_needed()
    assert ask("hold").status_code == 409 and preferences.mode() == "off"
    assert ask("report").status_code == 200
    monkeypatch.setattr("sys.argv", ["/usr/bin/celery"])
    presence.note()
    assert presence.restart_needed() == "" and ask("hold").status_code == 200
    # Files that were put there after this process began.
    monkeypatch.setattr(presence, "_LOADED", 4e9)
    assert "this process still runs the old ones" in presence.restart_needed()
    monkeypatch.setattr(presence, "installed_at", lambda: 4e9)
    assert "added while WebODM ran" in presence.restart_needed()
    assert preferences.describe(project.owner)["restart"] == ""


def test_files_that_are_no_photos_go_along_or_are_named(project, frames):
    mode("hold")
    task = Task.objects.create(project=project)
    os.makedirs(task.task_path())
    for number, file in enumerate(frames["one"] + frames["two"]):
        shutil.copy(file, task.task_path(f"{number:03d}_{file.name}"))
    for name in ("align.laz", "flight.MP4", "image_groups.txt"):
        shutil.copy(__file__, task.task_path(name))
    task.images_count = 19
    task.save()
    work()
    record = records.load(task.pk)
    assert record["state"] == "split" and "flight.MP4, image_groups.txt stayed behind" in record["message"]
    for told in record["tasks"]:
        names = Task.objects.get(pk=told["id"]).scan_images()
        assert "align.laz" in names and not {"flight.MP4", "image_groups.txt"} & set(names)


def test_only_a_sound_result_over_the_same_ground_is_an_anchor(project, frames, monkeypatch):
    task = uploaded(project, frames["one"], status=30)
    anchor = Task.objects.create(
        project=project, status=40, images_count=9, available_assets=["georeferenced_model.laz"]
    )
    here, elsewhere = [(8.0, 46.0)], [(9.0, 46.0)]

    class Extent:
        extent = (7.99, 45.99, 8.01, 46.01)

    assert tasks.anchor_for(task, elsewhere) == anchor  # WebODM knows nothing of where it lies
    monkeypatch.setattr(Task, "dsm_extent", Extent, raising=False)
    assert tasks.anchor_for(task, here) == anchor and tasks.anchor_for(task, elsewhere) is None
    records.keep(anchor.pk, {"state": "none", "judgement": {"route": "isolate"}})
    assert tasks.anchor_for(task, here) is None
