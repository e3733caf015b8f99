"""Whole rendered surveys through the main job, held against their truth: the long stories of ``make test-all``."""

from __future__ import annotations

from dataclasses import replace

import pytest

pytest.importorskip("cv2")
pytest.importorskip("pycolmap")

from tests import simulator
from tests.simulator.run import gcp_text
from tests.story import lost_frames, open_loops, play, wrong_routes

STORIES = (
    "clean",
    "demo",
    "demo-nasty",
    "two-lenses",
    "firmware-drift",
    "gps-shift",
    "no-gps",
    "altitudes-1-3",
    "rig-trouble",
    "panels",
    "stale-tags",
    "one-other-size",
    "obliques",
)


@pytest.mark.slow
@pytest.mark.parametrize("story", STORIES)
def test_every_payload_goes_where_the_truth_says(story, tmp_path):
    # Without GPS only ground control proves a block: its own test has it.
    outcome = play(story, tmp_path, **({"gcp": None} if story == "no-gps" else {}))
    assert wrong_routes(outcome) == []
    assert lost_frames(outcome) == []
    assert open_loops(outcome) == []


@pytest.mark.slow
def test_bad_files_among_good_ones_lose_no_other_frame(tmp_path):
    outcome = play("broken-files", tmp_path)
    assert lost_frames(outcome) == []
    assert open_loops(outcome) == []
    # Of two equal files the first by path stays, whichever of them is called the copy.
    left_out = [f for f in outcome.report["frames"] if not f["subproject"] and f["reason"] != "duplicate-file"]
    homeless = {f["path"].rsplit("/", 1)[-1] for f in left_out}
    told = {f.path.rsplit("/", 1)[-1] for f in outcome.truth.frames if f.lies}
    told |= {path.rsplit("/", 1)[-1] for path in outcome.truth.extra}
    assert homeless <= told


@pytest.mark.slow
@pytest.mark.parametrize("story", ["clean", "no-gps"])
def test_ground_control_is_held_and_check_points_come_out(story, tmp_path):
    survey = tmp_path / "marks"
    truth = simulator.render(story, survey)
    marked = {m.path for p in truth.points for m in p.marks}
    everything = [replace(p, role="gcp") for p in truth.points]
    (tmp_path / "gcp.txt").write_text(gcp_text(everything, "utm", marked), encoding="utf-8")
    outcome = play(story, tmp_path, gcp=str(tmp_path / "gcp.txt"))
    (project,) = outcome.report["subprojects"]
    control = project["alignment"]["control"]
    gsd_m = min(f.gsd_cm for f in truth.frames) / 100.0
    assert project["route"] == "proceed" and project["gcp"]["points"] == 5
    assert control["held"] and control["check_points"] == 3
    assert control["check_horizontal_m"] <= 1.5 * gsd_m and control["check_vertical_m"] <= 3.0 * gsd_m
    assert lost_frames(outcome) == []
