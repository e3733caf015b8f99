"""Command lines: ours taken out, ODM's kept as it is, the project found."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.node import options
from sensorgate.plugin.node.command import Grammar, parse, read_grammar, spelled

from .fake import make_odm


@pytest.fixture(scope="module")
def grammar(tmp_path_factory):
    return read_grammar(make_odm(tmp_path_factory.mktemp("odm")))


def test_the_grammar_is_read_without_running_odm(grammar):
    assert grammar.names["-e"] == "--end-with"
    assert {"--dsm", "--use-exif"} <= grammar.flags
    assert "--cameras" not in grammar.flags
    assert grammar.long_name("--gps") == "--gps-accuracy"
    assert grammar.long_name("--use") is None


@pytest.mark.parametrize(
    "words",
    [
        ["--dsm", "--gps-accuracy", "2", "--project-path", "/data", "task"],
        ["task", "--project-path", "/data", "--gps-accuracy=2", "--dsm"],
        ["--project-path", "/data", "task", "--dsm", "--gps-acc", "2", "--mixed-sensor-policy", "strict"],
        ["--mixed-sensor-policy=strict", "--force-gcp", "--dsm", "--gps-accuracy", "2", "--project-path=/data", "task"],
    ],
)
def test_the_project_is_found_wherever_it_stands(grammar, words):
    command = parse(words, grammar)
    assert (command.project_path, command.name) == ("/data", "task")
    assert command.value("gps-accuracy") == "2"
    assert command.has("dsm")
    assert not any(w.name.startswith("--mixed") for w in command.words)


def test_the_default_name_is_odms(grammar):
    assert parse(["--project-path", "/data", "--dsm"], grammar).name == "code"


def test_json_values_stay_whole(grammar):
    text = '{"v2 dji fc6310": {"focal": 0.66}}'
    assert parse(["--cameras", text, "t"], grammar).value("cameras") == text


def test_an_option_unknown_to_this_odm_does_not_eat_the_project():
    command = parse(["--new-flag", "--project-path", "/data", "--newer", "task"], read_grammar_of_nothing())
    assert command.name == "task"


def read_grammar_of_nothing():
    return Grammar({"--project-path": "--project-path"}, frozenset())


@pytest.mark.parametrize(
    "words",
    [
        ["--mixed-sensor-policy", "sometimes"],
        ["--mixed-sensor-policy"],
        ["--mixed-sensor-gsd-target", "tiny"],
        ["--mixed-sensor-gsd-target", "-3"],
        ["--mixed-sensor-gsd-target", "nan"],
    ],
)
def test_wrong_values_of_ours_are_told(words):
    with pytest.raises(options.WrongOption):
        options.take(words)


def test_flags_that_are_switched_off_are_off():
    assert options.take(["--force-gcp=false"]) == ({}, [])
    assert options.take(["--force-gcp"]) == ({"force-gcp": ""}, [])


ODM_WORDS = st.lists(
    st.sampled_from(
        [["--dsm"], ["--use-exif"], ["--gps-accuracy", "-3"], ["--cameras", '{"a b": 1}'], ["--end-with", "opensfm"]]
    ),
    max_size=6,
)
OURS = st.lists(st.sampled_from([["--mixed-sensor-policy", "off"], ["--force-gcp"]]), max_size=3)


@given(ODM_WORDS, OURS)
def test_what_is_odms_comes_out_as_it_went_in(grammar, odm, ours):
    words = [w for group in odm for w in group]
    mixed = [w for pair in zip(odm, ours) for group in pair for w in group]
    mixed += [w for group in odm[len(ours) :] for w in group] + [w for group in ours[len(odm) :] for w in group]
    command = parse([*mixed, "--project-path", "/data", "task"], grammar)
    assert spelled(command.without(), "/data", "task") == [*words, "--project-path", "/data", "task"]
