"""Whole rendered surveys through the main job, held against their truth: the long stories of ``make test-all``."""

from __future__ import annotations

import pytest

pytest.importorskip("cv2")
pytest.importorskip("pycolmap")

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
    outcome = play(story, tmp_path)
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
