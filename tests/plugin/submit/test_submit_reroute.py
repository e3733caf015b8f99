"""What becomes of a submitted project: taken, tried again, given up, and which products come home."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

from sensorgate.plugin.submit import lines, record

from .making import CALIBRATION, ends, files_of, go, only, project, report
from .node_double import NodeDouble
from .node_parts import Behaviour, products


def two_payloads(root: Path, name: str = "rgb") -> Path:
    folder = project(root, name, ("A1.JPG", "A2.JPG", "B1.JPG"), calibration=CALIBRATION)
    payloads = {"A1.JPG": "a", "A2.JPG": "a", "B1.JPG": "b"}
    report(root, [{"name": name, "route": "proceed", "payloads": ["a", "b"], "payload_of": payloads}])
    return folder


BANDS = (30, "Cannot process dataset", ["Exception: Cannot write x, not all band images have been matched"])


def test_a_failed_task_goes_back_to_the_router(tmp_path):
    two_payloads(tmp_path)
    with NodeDouble(Behaviour(ends=ends(rgb=BANDS))) as node:
        result = go(tmp_path, node, read_outcome=lambda f: SimpleNamespace(route="proceed", reasons=()))
        assert {(e.name, e.state) for e in result.entries} == {
            ("rgb", "rerouted"),
            ("rgb-a", "done"),
            ("rgb-b", "done"),
        }
        assert result.exit_code == 1
        told = {t.name: sorted(t.images) for t in node.tasks.values()}
        assert told == {"rgb": ["A1.JPG", "A2.JPG", "B1.JPG"], "rgb-a": ["A1.JPG", "A2.JPG"], "rgb-b": ["B1.JPG"]}
        text = "\n".join(lines(result))
        assert "bands of its captures" in text and "goes on as rgb-a, rgb-b" in text
        assert record(result)["payloads"]["b"] == [{"project": "rgb-b", "state": "done", "route": "proceed"}]
        sent = sum(node.received.values())
        assert go(tmp_path, node).exit_code == 1 and sum(node.received.values()) == sent


def test_a_poor_result_is_set_aside_and_tried_again(tmp_path):
    folder = two_payloads(tmp_path)

    def reader(path):
        return SimpleNamespace(route="isolate" if path == folder else "proceed", reasons=("2 components",))

    with NodeDouble() as node:
        result = go(tmp_path, node, read_outcome=reader)
    assert [e.state for e in result.entries] == ["rerouted", "done", "done"]
    assert not (folder / "odm_orthophoto").exists() and (folder / "sensorgate/rejected-1/odm_orthophoto").is_dir()
    assert (tmp_path / "projects/rgb-a/odm_orthophoto").is_dir()


def test_an_unproven_result_is_kept_and_said(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble() as node:
        result = go(tmp_path, node, read_outcome=lambda f: SimpleNamespace(route="unproven", reasons=("no GPS",)))
    text = "\n".join(lines(result))
    assert result.exit_code == 0 and "done, unproven" in text and "rgb: no GPS" in text


def test_rerouting_comes_to_an_end(tmp_path):
    two_payloads(tmp_path)
    bad = (30, "Cannot process dataset", [])
    with NodeDouble(Behaviour(ends=lambda t: bad)) as node:
        result = go(tmp_path, node)
        names = [e.name for e in result.entries]
        assert names == ["rgb", "rgb-again", "rgb-again-a", "rgb-again-b"]
        assert [e.state for e in result.entries] == ["rerouted", "rerouted", "failed", "failed"]
        assert any(o["name"] == "min-num-features" for t in node.tasks.values() for o in t.options)


def test_no_reroutes_when_none_are_wanted(tmp_path):
    two_payloads(tmp_path)
    with NodeDouble(Behaviour(ends=ends(rgb=BANDS))) as node:
        assert [e.state for e in go(tmp_path, node, reroutes=0).entries] == ["failed"]


def test_the_console_is_kept_and_holds_no_token(tmp_path):
    folder = project(tmp_path, "rgb")
    end = (30, "Not enough memory", ["first", "sm-cluster http://h?token=s3cret"])
    with NodeDouble(Behaviour(token="s3cret", ends=lambda t: end)) as node:
        result = go(tmp_path, node, token="s3cret")
    assert result.entries[0].state == "failed" and "memory" in result.entries[0].reasons[0]
    kept = (folder / "sensorgate/task_output.txt").read_text()
    assert "first" in kept and "s3cret" not in kept


def test_an_archive_that_attacks_is_refused(tmp_path):
    folder = project(tmp_path, "rgb")
    before = files_of(folder)
    with NodeDouble(Behaviour(archive=lambda t: products(**{"../../escaped.txt": b"x"}))) as node:
        result = go(tmp_path, node)
    assert result.entries[0].state == "failed" and "must not be unpacked" in result.entries[0].reasons[0]
    assert files_of(folder) == before and not list(tmp_path.rglob("escaped.txt"))


def test_assets_are_asked_for(tmp_path):
    project(tmp_path, "rgb")
    with NodeDouble() as node:
        go(tmp_path, node, assets=("odm_orthophoto",))
        assert only(node).outputs[0] == "odm_orthophoto" and "log.json" in only(node).outputs


def test_no_assets(tmp_path):
    folder = project(tmp_path, "rgb")
    with NodeDouble() as node:
        assert go(tmp_path, node, assets=("none",)).exit_code == 0
    assert not (folder / "odm_orthophoto").exists()
