"""The same assertions against the double and, where its address is given, against a real node.

``SENSORGATE_TEST_NODE=http://localhost:3000?token=...`` names a NodeODM or NodeODX started with ``--test`` (it then
runs no ODM). Everything that this suite puts there it also removes.
"""

from __future__ import annotations

import json
import os
import urllib.request
import uuid
from pathlib import Path
from typing import Any, Dict, Iterator, List

import jsonschema
import pytest
from sensorgate.plugin.submit import Settings, submit
from sensorgate.plugin.submit.client import NodeClient
from sensorgate.plugin.submit.errors import NodeUnusable, Refused
from sensorgate.plugin.submit.negotiate import differences
from sensorgate.plugin.submit.parcel import Item
from sensorgate.plugin.submit.transfer import write_seed
from sensorgate.plugin.submit.views import COMPLETED

from .making import CALIBRATION, LOCK, files_of, picture, project, quick
from .node_double import NodeDouble

REAL = os.environ.get("SENSORGATE_TEST_NODE", "")
WHICH = ["double", *(["real"] if REAL else [])]

# What the node answers, as its published description says with its errors mended (seen on NodeODM 2.2.4 and NodeODX
# 2.3.1): option types have "enum" with a list for a domain, output is a list, maxImages may be null, progress is a
# number, and an error is an object with "error" and status 200.
TEXT, WHOLE, NUMBER = {"type": "string"}, {"type": "integer"}, {"type": "number"}


def shape(required: List[str], **fields: Any) -> Dict[str, Any]:
    return {"type": "object", "required": required, "properties": fields}


ERROR = shape(["error"], error=TEXT, noRetry={"type": "boolean"})
OPTION = shape(
    ["name", "type", "value", "domain", "help"],
    name=TEXT,
    type={"enum": ["int", "float", "string", "bool", "enum"]},
    value=TEXT,
    domain={"anyOf": [TEXT, {"type": "array", "items": TEXT}]},
    help=TEXT,
)
NODE = shape(
    ["version", "taskQueueCount", "maxImages", "maxParallelTasks", "engineVersion", "engine"],
    version=TEXT,
    taskQueueCount=WHOLE,
    totalMemory=NUMBER,
    availableMemory=NUMBER,
    cpuCores=WHOLE,
    maxImages={"type": ["integer", "null"]},
    maxParallelTasks=WHOLE,
    engineVersion=TEXT,
    engine=TEXT,
)
TASK = shape(
    ["uuid", "name", "dateCreated", "processingTime", "status", "options", "imagesCount", "progress"],
    uuid=TEXT,
    name=TEXT,
    dateCreated=WHOLE,
    processingTime=WHOLE,
    status=shape(["code"], code={"enum": [10, 20, 30, 40, 50]}, errorMessage=TEXT),
    options={"type": "array", "items": shape(["name", "value"], name=TEXT)},
    imagesCount=WHOLE,
    progress=NUMBER,
)
LINES = {"type": "array", "items": TEXT}
TASKS = {"type": "array", "items": shape(["uuid"], uuid=TEXT)}


@pytest.fixture(params=WHICH)
def at(request) -> Iterator[NodeClient]:
    if request.param == "real":
        client = NodeClient(REAL, limits=quick())
        before = set(client.tasks())
        yield client
        for task in set(client.tasks()) - before:
            client.remove(task)
    else:
        with NodeDouble() as node:
            yield NodeClient(node.url, limits=quick())


def fits(value: Any, schema: Dict[str, Any]) -> Any:
    jsonschema.validate(value, schema)
    return value


def send(at: NodeClient, folder: Path, names, options=(), seed=None) -> str:
    task = str(uuid.uuid4())
    at.init(task, "behaviour", list(options))
    for number, name in enumerate(names):
        (folder / f"{number}").write_bytes(picture(number))
        at.upload(task, name, folder / f"{number}")
    if seed is not None:
        at.upload(task, "seed.zip", seed)
    at.commit(task)
    return task


def settled(at: NodeClient, task: str):
    import time

    for _ in range(400):
        view = at.task(task)
        if view is not None and view.settled:
            return view
        time.sleep(0.02)
    raise AssertionError("the node did not sort its files")


def test_answers_have_their_shapes(at, tmp_path):
    fits(at.ask("GET", "/info"), NODE)
    for option in at.ask("GET", "/options"):
        fits(option, OPTION)
    task = send(at, tmp_path, ["A.JPG"])
    fits(at.ask("GET", "/task/list"), TASKS)
    fits(at.ask("GET", f"/task/{task}/info"), TASK)
    fits(at.ask("GET", f"/task/{task}/output", query={"line": 0}), LINES)


def test_an_error_comes_as_200(at):
    url = at.link(f"/task/{uuid.uuid4()}/info")
    with urllib.request.urlopen(url, timeout=10) as answer:
        assert answer.status == 200
        fits(json.loads(answer.read()), ERROR)


def test_an_unknown_option_vanishes_without_a_word(at, tmp_path):
    sent = [{"name": "force-gcp", "value": True}, {"name": "dsm", "value": True}]
    task = send(at, tmp_path, ["A.JPG"], sent)
    found = differences(sent, settled(at, task).options)
    assert list(found) == ["force-gcp"] and "dropped" in found["force-gcp"]


def test_values_out_of_their_domain_are_refused_at_the_beginning(at):
    for name, value in (("feature-quality", "super"), ("dsm", "yes"), ("min-num-features", "none")):
        with pytest.raises(Refused):
            at.init(str(uuid.uuid4()), "x", [{"name": name, "value": value}])


def test_the_same_name_twice_is_renamed(at, tmp_path):
    task = send(at, tmp_path, ["A.JPG", "A.JPG"])
    assert settled(at, task).images == 2  # A.JPG and A_.JPG: nothing lost one after the other, but not ours any more


def test_text_files_are_not_counted(at, tmp_path):
    task = send(at, tmp_path, ["A.JPG", "geo.txt", "gcp_list.txt", "align.laz"])
    assert settled(at, task).images == 1


def test_a_seed_mends_what_lies_there(at, tmp_path):
    (tmp_path / "whole").write_bytes(picture(7))
    items = [Item(n, str(tmp_path / "whole"), 1) for n in ("A.JPG", "C.JPG")]
    write_seed(tmp_path / "seed.zip", items, CALIBRATION)
    task = send(at, tmp_path, ["A.JPG", "B.JPG"], seed=tmp_path / "seed.zip")
    assert settled(at, task).images == 3  # A mended, B as it was, C put in, the seed not counted


def test_a_second_seed_is_deleted(at, tmp_path):
    (tmp_path / "whole").write_bytes(picture(7))
    write_seed(tmp_path / "seed.zip", [Item("C.JPG", str(tmp_path / "whole"), 1)], None)
    task = send(at, tmp_path, ["A.JPG", "seed.zip"], seed=tmp_path / "seed.zip")
    view = settled(at, task)
    assert (view.images, view.status) != (3, COMPLETED)


def test_a_uuid_is_ours_and_taken_once(at, tmp_path):
    task = send(at, tmp_path, ["A.JPG"])
    settled(at, task)
    with pytest.raises(Refused, match="set-uuid"):
        at.init(task, "x", [])


def test_an_upload_may_be_begun_twice_but_not_committed_twice(at, tmp_path):
    task = str(uuid.uuid4())
    at.init(task, "x", [])
    at.init(task, "x", [])
    (tmp_path / "a").write_bytes(picture(1))
    at.upload(task, "A.JPG", tmp_path / "a")
    at.commit(task)
    with pytest.raises(Refused, match="Invalid uuid"):
        at.commit(task)
    assert settled(at, task).images == 1


def test_cancel_stays_known_remove_does_not(at, tmp_path):
    task = send(at, tmp_path, ["A.JPG"])
    settled(at, task)
    at.cancel(task)
    view = at.task(task)
    # A task that is cancelled while it is packed still ends as completed (seen on both, in --test mode).
    assert view is not None and view.status in ("canceled", COMPLETED)
    at.remove(task)
    assert at.task(task) is None


def test_a_task_that_is_not_done_has_no_archive(at, tmp_path):
    task = send(at, tmp_path, ["A.JPG"])
    with pytest.raises(Refused, match="not ready"):
        at.download(task, tmp_path / "all.zip", max_bytes=10**6)


def test_a_whole_submission(at, tmp_path):
    folder = project(tmp_path, "rgb", calibration=CALIBRATION, options=[LOCK], geo="EPSG:4326\nA.JPG 1 2 3\n")
    address = f"{at.address}?token={at.token}" if at.token else at.address
    result = submit(tmp_path, address, Settings(thresholds=quick(submit_patience_s=60.0, submit_poll_s=0.2)))
    assert result.exit_code == 0, result
    assert (folder / "odm_orthophoto").is_dir() and len(files_of(folder)) == 3


@pytest.mark.skipif(not REAL or "token=" not in REAL, reason="SENSORGATE_TEST_NODE names no node with a token")
def test_a_real_node_refuses_a_wrong_token():
    with pytest.raises(NodeUnusable, match="token"):
        NodeClient(REAL.partition("?")[0], token="wrong").info()


@pytest.mark.skipif(not REAL, reason="SENSORGATE_TEST_NODE is not set")
def test_the_published_description_names_what_is_used():
    at = NodeClient(REAL)
    told = at.ask("GET", "/swagger.json")
    used = {
        "/info",
        "/options",
        "/task/list",
        "/task/new/init",
        "/task/new/upload/{uuid}",
        "/task/new/commit/{uuid}",
        "/task/{uuid}/info",
        "/task/{uuid}/output",
        "/task/{uuid}/download/{asset}",
        "/task/cancel",
        "/task/remove",
    }
    published = {p.rstrip("/") for p in told["paths"]}
    assert used <= published, used - published
