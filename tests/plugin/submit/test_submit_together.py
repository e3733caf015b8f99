"""Several projects at once: the anchor first, slots, interruptions, and the ledger that outlives them."""

from __future__ import annotations

import json
import threading

import pytest
from sensorgate.plugin.odm.wire import ALIGN_INPUT
from sensorgate.plugin.submit import lines
from sensorgate.plugin.submit.ledger import Ledger
from sensorgate.plugin.submit.lock import only_one
from sensorgate.stages.errors import Cancelled, UsageError

from .making import ends, go, only, project, report
from .node_double import NodeDouble
from .node_parts import Behaviour


def test_isolated_projects_are_laid_on_the_anchors_points(tmp_path):
    for name in ("main", "other", "thermal"):
        project(tmp_path, name)
    routes = {"main": "proceed", "other": "isolate", "thermal": "proceed"}
    report(tmp_path, [{"name": n, "route": r} for n, r in routes.items()])
    with NodeDouble() as node:
        assert go(tmp_path, node).exit_code == 0
        got = {t.name: t.gcp.get(ALIGN_INPUT) for t in node.tasks.values()}
        assert got == {"main": None, "other": b"points", "thermal": None}


@pytest.mark.parametrize("which, laid", [("all", {"other", "thermal"}), ("none", set())])
def test_who_is_laid_on_the_anchor_is_for_the_caller(tmp_path, which, laid):
    for name in ("main", "other", "thermal"):
        project(tmp_path, name)
    report(tmp_path, [{"name": "main", "route": "proceed"}, {"name": "other", "route": "isolate"}])
    with NodeDouble() as node:
        go(tmp_path, node, align=which, assets=("odm_orthophoto",))
        assert {t.name for t in node.tasks.values() if ALIGN_INPUT in t.gcp} == laid


def test_without_an_anchor_the_others_go_alone(tmp_path):
    for name in ("main", "other"):
        project(tmp_path, name)
    report(tmp_path, [{"name": "main", "route": "proceed"}, {"name": "other", "route": "isolate"}])
    with NodeDouble(Behaviour(ends=ends(main=(30, "Not enough memory", [])))) as node:
        result = go(tmp_path, node)
        assert [e.state for e in result.entries] == ["failed", "done"]


def test_no_more_at_once_than_the_node_has_slots(tmp_path):
    for number in range(6):
        project(tmp_path, f"p{number}")
    most = []

    class Counting(NodeDouble):
        def info(self, task):
            most.append(sum(t.status in (10, 20) for t in self.tasks.values()))
            return super().info(task)

    with Counting(Behaviour(slots=2, polls=4)) as node:
        assert go(tmp_path, node).exit_code == 0
    assert 2 <= max(most) <= 3  # two run, one is sent meanwhile


def test_leaving_early_and_coming_back(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble(Behaviour(polls=3)) as node:
        result = go(tmp_path, node, wait=False)
        assert result.exit_code == 0 and result.entries[0].state == "waiting" and len(node.tasks) == 1
        assert go(tmp_path, node).exit_code == 0 and len(node.tasks) == 1


@pytest.mark.parametrize("answer, status", [(True, 50), (False, 20)])
def test_an_interruption_asks_what_becomes_of_the_tasks(tmp_path, answer, status):
    project(tmp_path, "rgb")
    asked = []
    running = threading.Event()

    def ask(tasks):
        asked.extend(tasks)
        return answer

    with NodeDouble(Behaviour(polls=10**6)) as node:
        with pytest.raises(Cancelled):
            go(
                tmp_path,
                node,
                cancel=running.is_set,
                ask_cancel=ask,
                tell=lambda n, phase, s: running.set() if phase == "running" else None,
            )
        assert len(asked) == 1 and only(node).status == status
        state = Ledger.open(tmp_path / "submit.json").entries[0]
        assert (state.state, state.attempts[0].state) == (("failed", "canceled") if answer else ("waiting", "running"))
        if not answer:
            node.behaviour.polls = 1
            assert go(tmp_path, node).exit_code == 0 and len(node.tasks) == 1


def test_one_submission_per_ledger(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble() as node, only_one(tmp_path / "submit.json"), pytest.raises(UsageError, match="Another"):
        go(tmp_path, node)


def test_another_node_begins_anew(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble(Behaviour(polls=10**6)) as first:
        go(tmp_path, first, wait=False)
    with NodeDouble() as second:
        result = go(tmp_path, second)
        assert result.exit_code == 0 and len(second.tasks) == 1 and "It was on" in "\n".join(lines(result))


def test_changed_projects_are_sent_anew(tmp_path):
    folder = project(tmp_path, "rgb")
    with NodeDouble() as node:
        go(tmp_path, node)
        (folder / "images/A.JPG").write_bytes(b"another")
        assert go(tmp_path, node).exit_code == 0 and len(node.tasks) == 2
    told = json.loads((tmp_path / "submit.json").read_text())
    assert len(told["projects"]) == 1 and len(told["superseded"]) == 1


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema_version": 1, "projects": [{"name": 1}]}'])
def test_a_damaged_ledger_is_never_overwritten(tmp_path, text):
    project(tmp_path, "rgb")
    (tmp_path / "submit.json").write_text(text)
    with NodeDouble() as node, pytest.raises(UsageError, match="ledger"):
        go(tmp_path, node)
    assert (tmp_path / "submit.json").read_text() == text and not node.tasks
