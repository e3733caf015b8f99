"""Outcome reader where there are products, console text where there are none."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from sensorgate.plugin.submit.judge import judge, judge_console
from sensorgate.plugin.submit.views import COMPLETED, FAILED, TaskView


def view(status: str, message: str = "") -> TaskView:
    return TaskView("u", status, 3, (), 100.0, True, message)


@pytest.mark.parametrize(
    "line, message, route",
    [
        ("[ERROR] The program could not process this dataset using the current settings. Check", "", "pairwise"),
        ("Uh oh! Processing stopped because of strange values in the reconstruction.", "", "pairwise"),
        ("Exception: Cannot write /p/x.tif, not all band images have been matched", "", "isolate"),
        ("Cannot match bands by filename on IMG_1.tif, make sure to name your files", "", "isolate"),
        ("run.py: error: unrecognized arguments: --force-gcp", "Processing failed (2)", "stop"),
        ("argument --cameras: {v2: 1} is not a valid JSON string.", "Processing failed (2)", "stop"),
        ("OSError: [Errno 28] No space left on device", "Cannot process dataset", "stop"),
        ("This GCP file does not have any entries. Are the entries entered in the proper format?", "", "stop"),
        ("nothing known", "Not enough memory", "stop"),
        ("nothing known", "Cannot process dataset", "pairwise"),
        ("nothing known", "Processing failed (65)", "stop"),
        ("", "", "stop"),
    ],
)
def test_failed_tasks_are_judged_by_their_last_words(line, message, route):
    found = judge(view(FAILED, message), None, ["[INFO] before", line])
    assert found.route == route and all(found.reasons)


def test_the_disk_is_blamed_before_the_data():
    lines = ["No space left on device", "The program could not process this dataset using the current settings"]
    assert "disk" in judge_console(lines, "Cannot process dataset").reasons[0]


def test_an_unknown_end_shows_its_last_words():
    assert "strange thing" in judge_console(["a strange thing", ""], "Processing failed (9)").reasons[0]


def test_the_outcome_reader_decides_where_there_are_products(tmp_path):
    def reader(folder):
        assert folder == tmp_path
        return SimpleNamespace(route="isolate", reasons=("two components",))

    assert judge(view(COMPLETED), tmp_path, [], reader).route == "isolate"


def test_unproven_is_no_reason_to_throw_a_result_away(tmp_path):
    told = SimpleNamespace(route="unproven", reasons=("no GPS",), state="finished")
    found = judge(view(COMPLETED), tmp_path, [], lambda f: told)
    assert (found.route, found.reasons) == ("unproven", ("no GPS",))


def test_a_run_that_ended_early_is_no_result(tmp_path):
    told = SimpleNamespace(route="unproven", reasons=("it stopped",), state="failed")
    assert judge(view(COMPLETED), tmp_path, [], lambda f: told).route == "stop"


@pytest.mark.parametrize("error", [ValueError, KeyError, OSError, AttributeError])
def test_a_result_that_cannot_be_read_is_judged_by_its_console(tmp_path, error):
    def reader(folder):
        raise error("x")

    assert judge(view(COMPLETED), tmp_path, ["fine"], reader).route == "proceed"
    poor = ["[WARNING] Multiple reconstructions detected (3), this might be an indicator"]
    found = judge(view(COMPLETED), tmp_path, poor, reader)
    assert found.route == "pairwise" and "3 separate" in found.reasons[0]


def test_cancelled():
    assert judge(view("canceled"), None, []).route == "stop"
