"""What a project asks, held against a node's own list; all pure."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.odm.wire import POLICY_OPTION
from sensorgate.plugin.submit.negotiate import LOCK, differences, kind_of, negotiate, numeric_options, same
from sensorgate.plugin.submit.views import NodeView

from .node_double import NodeDouble
from .node_parts import Behaviour

PLAIN = NodeView("2.2.4", "odm", "3.6.0", None, 1, 0, None, False)
CLUSTER = NodeView("1.5.3", "odm", "3.6.0", None, None, 0, None, True)
OPTIONS = NodeDouble(Behaviour()).option_list()
ADAPTER = NodeDouble(Behaviour(adapter=True)).option_list()


def ask(options, node=PLAIN, listed=OPTIONS, files=10, calibration=False, **more):
    return negotiate(options, listed, node, files=files, has_calibration=calibration, **more)


@pytest.mark.parametrize(
    "name, value, said",
    [
        ("use_fixed_camera_params", True, "Did you mean use-fixed-camera-params"),
        ("force-gcp", True, "no option named force-gcp"),
        ("orthophoto-resolutoin", 5, "Did you mean orthophoto-resolution"),
        ("dsm", "yes", "true or false"),
        ("dsm", 1, "true or false"),
        ("min-num-features", "80zz", "number"),
        ("min-num-features", 8000.7, "whole number"),
        ("feature-quality", "super", "one of"),
        ("gps-accuracy", float("nan"), "number"),
        ("gps-accuracy", -1.0, "gps-accuracy"),
        ("cameras", {"a": 1}, "JSON text"),
        ("pc-quality", None, "one of"),
    ],
)
def test_what_a_node_would_drop_or_bend_is_an_error_here(name, value, said):
    agreed = ask([{"name": name, "value": value}])
    assert agreed.terms is None and said in " ".join(agreed.problems)


def test_a_domain_that_nodeodm_cannot_check():
    listed = [{"name": "z", "type": "string", "domain": "my thing", "value": ""}]
    assert "cannot check z" in ask([{"name": "z", "value": "x"}], listed=listed).problems[0]


def test_values_take_the_nodes_types():
    agreed = ask([{"name": "min-num-features", "value": "8000"}, {"name": "dsm", "value": "TRUE"}])
    assert agreed.terms is not None
    assert {o["name"]: o["value"] for o in agreed.terms.options} == {"min-num-features": 8000, "dsm": True}


def test_too_many_images_are_said_before_the_upload():
    small = NodeView("2.2.4", "odm", "3.6.0", 10, 1, 0, None, False)
    assert ask([], node=small, files=10).terms is not None
    assert "more than this node takes (10)" in ask([], node=small, files=11).problems[0]
    # Before an adapter or a cluster one file more is sent, and it counts.
    assert ask([], node=small, listed=ADAPTER, files=10).terms is None


def test_calibration_goes_the_way_the_node_has():
    lock = [{"name": LOCK, "value": True}]
    plain = ask(lock, calibration=True).terms
    adapter = ask(lock, listed=ADAPTER, calibration=True).terms
    cluster = ask(lock, node=CLUSTER, calibration=True).terms
    assert (plain.calibration_file, plain.calibration_seed) == (False, True)
    assert (adapter.calibration_file, adapter.calibration_seed) == (True, False)
    assert (cluster.calibration_file, cluster.calibration_seed) == (True, True)
    assert "no sensorgate adapter" in plain.notes[0]
    assert not any(o["name"] == "cameras" for t in (plain, adapter, cluster) for o in t.options)


def test_without_a_way_for_the_calibration_nothing_is_locked():
    terms = ask([{"name": LOCK, "value": True}], calibration=True, seeds=False).terms
    assert terms.options == () and "nothing is locked" in terms.notes[0]
    kept = ask([{"name": LOCK, "value": True}], listed=ADAPTER, calibration=True, seeds=False).terms
    assert any(o["name"] == LOCK for o in kept.options)


def test_an_adapter_is_told_that_the_project_comes_harmonized():
    assert {"name": POLICY_OPTION, "value": "report"} in ask([], listed=ADAPTER).terms.options
    assert ask([]).terms.options == ()
    assert (kind_of(PLAIN, OPTIONS), kind_of(PLAIN, ADAPTER), kind_of(CLUSTER, ADAPTER)) == (
        "plain",
        "adapter",
        "cluster",
    )


def test_options_left_out_are_said():
    terms = ask([{"name": "gps-accuracy", "value": 0.05}], leave_out={"gps-accuracy": "why"}).terms
    assert terms.options == () and terms.notes == ("gps-accuracy is left out: why",)


def test_differences():
    sent = [
        {"name": "dsm", "value": True},
        {"name": "min-num-features", "value": 8000},
        {"name": "cog", "value": False},
    ]
    fine = [("dsm", "true"), ("min-num-features", "8000"), ("pc-ept", True), ("gltf", True), ("max-concurrency", 4)]
    assert differences(sent, fine) == {}
    assert "dropped dsm" in differences(sent, fine[1:])["dsm"]
    assert "made 80" in differences(sent, [("dsm", True), ("min-num-features", 80)])["min-num-features"]
    assert "added split" in differences(sent, [*fine, ("split", 100)])["split"]


def test_numbers():
    options = [{"name": "a", "value": 1}, {"name": "b", "value": True}, {"name": "c", "value": "1"}]
    assert numeric_options(options) == ("a",)


KNOWN = {o["name"]: o for o in OPTIONS}
VALUES = st.one_of(st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.none())


@given(st.sampled_from(sorted(KNOWN)), VALUES)
def test_what_is_agreed_arrives_unbent(name, value):
    """The law: whatever passes here, NodeODM's own filter takes as it is."""
    agreed = ask([{"name": name, "value": value}])
    if agreed.terms is None:
        assert agreed.problems
        return
    took = NodeDouble(Behaviour()).filter_options([dict(o) for o in agreed.terms.options])
    assert differences(agreed.terms.options, [(o["name"], o["value"]) for o in took]) == {}


@given(VALUES)
def test_a_value_is_itself(value):
    if value == value:
        assert same(value, value) or (isinstance(value, float) and abs(value) == float("inf"))
