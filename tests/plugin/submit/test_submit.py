"""Whole submissions against the server double: what is sent, what is taken, what becomes of it."""

from __future__ import annotations

import json
import time

import pytest
from sensorgate.plugin.odm.wire import CALIBRATION_INPUT, OVERRIDES
from sensorgate.plugin.submit import Settings, lines, submit
from sensorgate.plugin.submit.errors import NodeUnusable
from sensorgate.stages.errors import UsageError

from .making import CALIBRATION, CAMERA, LOCK, files_of, go, only, project, quick, report
from .node_double import NodeDouble
from .node_parts import POLICY, TORN, Behaviour


def test_a_project_arrives_whole_and_comes_home(tmp_path):
    folder = project(tmp_path, "rgb", options=[{"name": "dsm", "value": True}], gcp="x\n", geo="y\n")
    with NodeDouble() as node:
        result = go(tmp_path, node)
    assert result.exit_code == 0 and [e.state for e in result.entries] == ["done"]
    task = only(node)
    assert task.images == files_of(folder) and set(task.gcp) == {"gcp_list.txt", "geo.txt"}
    assert {"name": "dsm", "value": True} in task.options
    assert (folder / "odm_orthophoto/odm_orthophoto.tif").read_bytes() == b"orthophoto"
    assert not list(tmp_path.rglob(".part-*")) and not (tmp_path / "submit-uploads").exists()


def test_a_second_call_sends_nothing(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble() as node:
        go(tmp_path, node)
        asked = len(node.requests)
        assert go(tmp_path, node).exit_code == 0
        assert {p for _, p in node.requests[asked:]} == {"/info", "/options"}


def test_a_lost_ledger_does_not_send_twice(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble() as node:
        go(tmp_path, node)
        sent = sum(node.received.values())
        (tmp_path / "submit.json").unlink()
        result = go(tmp_path, node)
        assert sum(node.received.values()) == sent and len(node.tasks) == 1
        assert "Found on the node" in "\n".join(lines(result))


def test_unproven_projects_stay_unless_asked_for(tmp_path):
    project(tmp_path, "rgb")
    project(tmp_path, "thermal")
    report(tmp_path, [{"name": "rgb", "route": "proceed"}, {"name": "thermal", "route": "unproven"}])
    with NodeDouble() as node:
        result = go(tmp_path, node)
        assert result.exit_code == 1 and result.left_out == ("thermal",) and only(node).name == "rgb"
        assert go(tmp_path, node, include_unproven=True).exit_code == 0
        assert len(node.tasks) == 2


def test_bad_options_are_refused_before_anything_is_sent(tmp_path):
    project(tmp_path, "bad", options=[{"name": "force-gcp", "value": True}])
    project(tmp_path, "good")
    with NodeDouble() as node:
        result = go(tmp_path, node)
        assert [(e.name, e.state) for e in result.entries] == [("bad", "refused"), ("good", "done")]
        assert result.exit_code == 1 and only(node).name == "good" and not node.uploads
        assert "no option named force-gcp" in "\n".join(lines(result))


def test_too_many_images_for_the_node(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble(Behaviour(max_images=2)) as node:
        result = go(tmp_path, node)
        assert result.entries[0].state == "refused" and not node.tasks and not node.uploads


def test_an_option_dropped_in_silence_cancels_the_task(tmp_path):
    # Behind a cluster the list is the first node's; the one that takes the task may know less.
    project(tmp_path, "rgb", options=[{"name": "dsm", "value": True}])
    with NodeDouble(Behaviour(drops=("dsm",))) as node:
        result = go(tmp_path, node)
        assert result.entries[0].state == "refused" and only(node).status == 50
        assert "dropped dsm" in "\n".join(lines(result))


def test_an_option_bent_by_the_node_cancels_the_task(tmp_path):
    project(tmp_path, "rgb", options=[{"name": "min-num-features", "value": 8000}])
    with NodeDouble(Behaviour(bends={"min-num-features": 800})) as node:
        assert "made 800 of" in "\n".join(lines(go(tmp_path, node))) and only(node).status == 50


def test_what_nodes_add_for_viewers_is_no_difference(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble(Behaviour(adds=(("max-concurrency", 4),))) as node:
        assert go(tmp_path, node).exit_code == 0


def test_a_lost_image_cancels_the_task_and_it_is_sent_again(tmp_path):
    folder = project(tmp_path, "rgb")

    class Forgetful(NodeDouble):
        def sort(self, task):
            if len(self.tasks) == 1:
                task.images.pop("B.JPG", None)
            super().sort(task)

    with Forgetful() as node:
        result = go(tmp_path, node)
        first, second = result.entries[0].attempts
        assert (first.state, second.state) == ("canceled", "fetched") and "node has 2" in first.message
        assert node.tasks[first.uuid].status == 50 and node.tasks[second.uuid].images == files_of(folder)


def test_same_names_lose_images_on_a_node_and_are_refused_here(tmp_path):
    with NodeDouble() as node:
        node.init("11111111-1111-4111-8111-111111111111", {})
        for data in (b"one", b"two"):
            node.store("11111111-1111-4111-8111-111111111111", "X.JPG", data)
        assert sorted(node.uploads.popitem()[1].files) == ["X.JPG", "X_.JPG"]
    project(tmp_path, "rgb", ("X.JPG", "x.jpg"))
    with NodeDouble() as node, pytest.raises(UsageError, match="case alone"):
        go(tmp_path, node)


def test_a_torn_upload_is_mended_under_its_own_name(tmp_path):
    folder = project(tmp_path, "rgb")
    torn = iter([True])
    with NodeDouble(fault=lambda n, m, p: TORN if "/upload/" in p and next(torn, None) else None) as node:
        result = go(tmp_path, node)
        assert only(node).images == files_of(folder) and len(result.entries[0].attempts[0].repaired) == 1


def test_a_missing_file_stops_at_once_and_does_not_hang(tmp_path):
    # pyodm's create_task waits for ever here when nobody listens to its progress.
    folder = project(tmp_path, "rgb", [f"I{i}.JPG" for i in range(30)])
    (folder / "images/I7.JPG").chmod(0o644)

    def vanish(number, method, path):
        if path.endswith("/init") or "/upload/" not in path:
            return None
        (folder / "images/I29.JPG").unlink(missing_ok=True)
        return None

    began = time.monotonic()
    with NodeDouble(fault=vanish) as node:
        result = go(tmp_path, node, limits={"submit_upload_threads": 1})
    assert result.exit_code == 1 and "cannot be read any more" in result.faults[0][1]
    assert time.monotonic() - began < 5 and not node.tasks


def test_wrong_token_and_no_node(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble(Behaviour(token="right")) as node:
        with pytest.raises(NodeUnusable, match="token"):
            go(tmp_path, node, token="wrong")
        assert go(tmp_path, node, token="right").exit_code == 0
        url = node.url
        assert "right" not in (tmp_path / "submit.json").read_text()
    with pytest.raises(NodeUnusable, match="cannot be reached"):
        submit(tmp_path, url, Settings(thresholds=quick()))


def test_a_full_disk_is_said_and_freed(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble(Behaviour(disk_bytes=700)) as node:
        result = go(tmp_path, node)
        assert result.entries[0].state == "failed" and "disk" in result.entries[0].reasons[0]
        assert not node.tasks and not node.uploads
        node.behaviour.disk_bytes = None
        assert go(tmp_path, node, retry=True).exit_code == 0


def test_a_node_that_lost_its_tasks_is_recognised(tmp_path):
    folder = project(tmp_path, "rgb")
    with NodeDouble(Behaviour(polls=5)) as node:
        lost = iter([True])

        def tell(name, phase, share):
            if phase == "running" and next(lost, None):
                node.kill()

        result = go(tmp_path, node, tell=tell)
        first, second = result.entries[0].attempts
        assert (first.state, second.state) == ("lost", "fetched") and first.uuid != second.uuid
        assert only(node).images == files_of(folder)


def test_a_node_that_dies_of_numbers_gets_none_the_second_time(tmp_path):
    project(tmp_path, "rgb", options=[{"name": "gps-accuracy", "value": 0.05}])
    with NodeDouble(Behaviour(crash_on_numbers=True)) as node:
        result = go(tmp_path, node)
        assert result.exit_code == 0 and node.deaths == 1
        assert "gps-accuracy is left out" in "\n".join(lines(result))


def test_a_cluster_that_keeps_the_uuid_of_a_removed_task(tmp_path):
    # ClusterODM keeps its route of a task that was removed: it refuses the uuid and knows no task of it.
    project(tmp_path, "rgb")

    class Remembering(NodeDouble):
        def init(self, uuid, fields):
            if uuid in self.forgotten:
                return {"error": f"Invalid set-uuid: {uuid}"}
            return super().init(uuid, fields)

    with Remembering(Behaviour(cluster=True)) as node:
        for number in range(5):
            (tmp_path / "submit.json").unlink(missing_ok=True)
            result = go(tmp_path, node)
            assert result.exit_code == 0 and len(result.entries[0].attempts) == number + 1
            node.kill()


def test_it_gives_up_where_the_node_always_dies(tmp_path):
    project(tmp_path, "rgb")

    class Deadly(NodeDouble):
        def commit(self, uuid):
            told = super().commit(uuid)
            self.kill()
            return told

    with Deadly() as node:
        result = go(tmp_path, node)
        assert result.entries[0].state == "failed" and len(result.entries[0].attempts) == 3
        assert "Tried 3 times" in "\n".join(lines(result))


@pytest.mark.parametrize(
    "behaviour, file, seed",
    [
        (Behaviour(), False, True),
        (Behaviour(adapter=True), True, False),
        (Behaviour(cluster=True), True, True),
        (Behaviour(cluster=True, adapter=True), True, True),
    ],
)
def test_the_calibration_travels_as_a_file(tmp_path, behaviour, file, seed):
    folder = project(tmp_path, "rgb", calibration=CALIBRATION, options=[LOCK])
    with NodeDouble(behaviour) as node:
        assert go(tmp_path, node).exit_code == 0
        task = only(node)
        assert (CALIBRATION_INPUT in task.images, OVERRIDES in task.others) == (file, seed)
        if file:
            assert json.loads(task.images.pop(CALIBRATION_INPUT)) == CALIBRATION
        if seed:
            told = json.loads(task.others[OVERRIDES])[f"v2 {CAMERA}"]
            assert told["focal_x"] == told["focal_x_prior"] == 0.664
        assert task.images == files_of(folder)
        assert not any(o["name"] == "cameras" for o in task.options)
        assert {"name": LOCK["name"], "value": True} in task.options


def test_a_cluster_that_refuses_seeds_gets_no_lock(tmp_path):
    folder = project(tmp_path, "rgb", calibration=CALIBRATION, options=[LOCK])
    with NodeDouble(Behaviour(cluster=True, splitmerge=False)) as node:
        result = go(tmp_path, node)
        assert result.exit_code == 0 and "nothing is locked" in "\n".join(lines(result))
        images = {k: v for k, v in only(node).images.items() if k != CALIBRATION_INPUT}
        assert images == files_of(folder) and LOCK not in only(node).options


def test_a_cluster_with_one_node_without_adapter_is_recognised(tmp_path):
    project(tmp_path, "rgb", calibration=CALIBRATION)
    with NodeDouble(Behaviour(cluster=True, adapter=True, drops=(POLICY["name"],))) as node:
        result = go(tmp_path, node)
        assert result.exit_code == 0 and "has no sensorgate adapter" in "\n".join(lines(result))
