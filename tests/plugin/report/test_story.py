"""The sentences follow the figures."""

from __future__ import annotations

import copy
from typing import Any, Dict, List

import pytest
from sensorgate.plugin.report import story
from sensorgate.plugin.report.view import View, clean_text, figure, listing

from tests.plugin.report.sample import empty, sample


def checks(report: Dict[str, Any], project: int = 0) -> Dict[str, story.Check]:
    view = View(report)
    return {c.name: c for c in story.alignment_checks(view, view.report["subprojects"][project])}


def without_projects() -> Dict[str, Any]:
    report = sample()
    report["subprojects"] = []
    for frame in report["frames"]:
        frame.update(subproject=None, output=None, change=None, gsd_after_cm=None)
    return report


def test_verdict_counts_projects_and_proof() -> None:
    headline, detail = story.verdict(View(sample()))
    assert "4 projects" in headline
    assert "2 proven to reconstruct, 1 set apart, 1 unproven" in detail
    assert "415 frames from 9 cameras in 3 spectra" in detail


def test_verdict_of_a_gate_points_to_run() -> None:
    headline, detail = story.verdict(View(without_projects()))
    assert "colour, multispectral and thermal" in headline
    assert "sensorgate run" in detail


def test_verdict_blocked_says_why() -> None:
    assert story.verdict(View(empty())) == (
        "Blocked: nothing here can be reconstructed yet.",
        "There is no image below survey.",
    )


def test_comparisons_name_the_faults_of_the_plain_way() -> None:
    rows = {c.topic: c for c in story.comparisons(View(sample()))}
    assert "16 separate cameras" in rows["Cameras"].alone
    assert "dji-xt2-thermal" in rows["Focal length"].alone and "0.85" in rows["Focal length"].alone
    assert "96 frames resampled × 1.53" in rows["Ground resolution"].instead
    assert "21 of 255" in rows["Brightness"].alone


def test_a_true_ratio_of_085_is_no_silent_default() -> None:
    report = sample()
    thermal = next(p for p in report["profiles"] if p["spectrum"] == "thermal")
    thermal["intrinsics"]["focal_ratio"] = 0.851
    rows = {c.topic: c for c in story.comparisons(View(report))}
    assert "0.85 ×" not in rows["Focal length"].alone


def test_merged_cameras_are_named() -> None:
    report = sample()
    for frame in report["frames"]:
        if frame["band"] in ("Blue", "Green"):
            frame["odm_camera_id"] = "v2 micasense rededge-m 1280 960 brown 1.1312"
    row = next(c for c in story.comparisons(View(report)) if c.topic == "Cameras")
    assert "micasense-rededge-blue and micasense-rededge-green would be taken for one camera" in row.alone


def test_checks_judge_by_the_limits() -> None:
    good = checks(sample())
    assert {c.state for name, c in good.items() if name != "Flying height"} == {story.GOOD}
    report = sample()
    report["subprojects"][0]["alignment"].update(
        mean_reproj_error_px=2.4, gps_horizontal_m=56.0, components=3, median_inliers=12, bowing_m=0.5, bowing_se_m=0.04
    )
    bad = checks(report)
    for name in ("Reprojection error", "GPS fit, level", "Frames placed", "Matches per pair"):
        assert bad[name].state == story.BAD
    assert bad["GPS fit, height"].state == story.GOOD
    assert "low against its edge" in bad["Bowing"].words


@pytest.mark.parametrize("missing", ["mean_reproj_error_px", "gps_rmse_m", "height_m", "bowing_m", "bowing_se_m"])
def test_a_missing_figure_never_passes(missing: str) -> None:
    report = sample()
    found = report["subprojects"][0]["alignment"]
    found[missing] = None
    if missing == "gps_rmse_m":
        found["gps_horizontal_m"] = found["gps_vertical_m"] = None
    judged = checks(report)
    if missing == "mean_reproj_error_px":
        assert judged["Reprojection error"].state == story.BAD
    if missing == "gps_rmse_m":
        assert judged["GPS fit"].state == story.NOTE


def test_cross_words_say_too_few() -> None:
    report = sample()
    words = story.cross_words(report["subprojects"][1]["alignment"], 30)
    assert words == ["phantom-3 and phantom-4-pro: 11 matches per pair over 3 pairs, too few to join them (30 needed)."]


def test_cross_words_tell_a_gps_shift() -> None:
    found = copy.deepcopy(sample()["subprojects"][0]["alignment"])
    found["payloads"][1]["gps_offset_m"] = [12.0, -3.25, 18.0]
    assert "shifted by +12.0 m east, -3.2 m north, +18.0 m up" in story.cross_words(found, 30)[-1]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([("fast-orthophoto", True), ("dsm", False)], ["--fast-orthophoto"]),
        ([("dem-resolution", 2.5)], ["--dem-resolution 2.5"]),
        ([("name", "a b; rm -rf /")], ["--name 'a b; rm -rf /'"]),
        ([("name", "it's")], ["--name 'it'\"'\"'s'"]),
        ([("name", "")], ["--name ''"]),
    ],
)
def test_option_words_are_safe_to_paste(options: Any, words: List[str]) -> None:
    assert story.option_words([{"name": n, "value": v} for n, v in options]) == words


def test_findings_are_grouped_worst_first() -> None:
    groups = View(sample()).finding_groups()
    assert [g.severity for g in groups] == sorted((g.severity for g in groups), key=["error", "warning", "info"].index)
    transit = next(g for g in groups if g.code == "transit")
    assert transit.count == 3 and len(transit.subjects) == 3


def test_text_is_cleaned() -> None:
    assert clean_text("a\x1b[31mb\u202ec\ud800\x00") == "a\ufffd[31mb\ufffdc\ufffd\ufffd"
    assert clean_text("two\nlines\u00a0here") == "two lines here"
    assert clean_text("Ground 5 µm × ü 無人機") == "Ground 5 µm × ü 無人機"


def test_small_words() -> None:
    assert listing(["a", "b", "c"]) == "a, b and c"
    assert listing(list("abcdef"), 2) == "a, b and 4 more"
    assert figure(None) == "–" and figure(-0.001, 2, "m") == "0.00 m" and figure(12345.6, 0) == "12,346"


def gain(ratio: float, chosen: bool, scale: float) -> Dict[str, Any]:
    now = {
        "scale": 1.0, "width": 4000, "height": 3000, "inliers": 0.5, "megapixels": 240.0, "size_bytes": 160_000_000,
        "odm_inliers": 1.0, "odm_feature_px": 2736, "odm_undistorted_px": 5472,
    }  # fmt: skip
    then = {**now, "scale": scale, "inliers": 0.9, "megapixels": 240.0 * scale**2, "size_bytes": 1_400_000_000}
    return {"gain": {"ratio": ratio, "trigger": 0.05, "chosen": chosen, "native": now, "resampled": then}}


def test_a_gain_says_what_it_brings_and_costs() -> None:
    words = story.gain_words(gain(2.0, True, 2.0))
    assert "2.00 × coarser" in words and "resampled × 2.00" in words and "kept" not in words
    assert "50 → 90 %" in words and "inside ODM 100 %" in words
    assert "4 × pixels" in words and "160 MB → about 1.4 GB" in words
    assert "features at 2736 px" in words and "undistorted 5472 px" in words


def test_a_gain_of_kept_frames_says_so_and_within_the_trigger_nothing() -> None:
    assert "kept; resampled × 5.00" in story.gain_words(gain(5.0, False, 5.0))
    assert story.gain_words(gain(1.04, False, 1.04)) == ""
    assert story.gain_words({"gain": None}) == story.gain_words(None) == story.gain_words({}) == ""


@pytest.mark.parametrize("count, words", [(0, "0 kB"), (820_000_000, "820 MB"), (1.44e9, "1.4 GB"), (3e12, "3.0 TB")])
def test_sizes_in_words(count: float, words: str) -> None:
    assert story.size_words(int(count)) == words
