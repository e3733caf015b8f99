"""The sentences follow the figures."""

from __future__ import annotations

from typing import Any, Dict, List

import pytest
from sensorgate.plugin.report import story
from sensorgate.plugin.report.flights import flight_rows
from sensorgate.plugin.report.view import View, clean_text, figure, in_words, listing

from tests.plugin.report.sample import empty, sample


def without_projects() -> Dict[str, Any]:
    report = sample()
    report["subprojects"] = []
    for frame in report["frames"]:
        frame.update(subproject=None, output=None, change=None, gsd_after_cm=None)
    return report


def test_verdict_counts_projects_and_proof() -> None:
    headline, detail = story.verdict(View(sample()))
    assert headline.endswith("of the 4 projects made from it, 3 are ready to queue.")
    assert "2 proven to reconstruct, 1 set apart, 1 unproven" in detail
    assert "415 frames from 9 cameras in 3 spectra" in detail


@pytest.mark.parametrize(
    ("routes", "said"),
    [
        (["proceed", "isolate"], "queue the 2 projects made from it."),
        (["unproven", "unproven"], "the 2 projects made from it are unproven."),
        (["unproven", "proceed"], "of the 2 projects made from it, 1 is ready to queue."),
        (["proceed"], "queue the project made from it."),
        (["unproven"], "the project made from it is unproven."),
    ],
)
def test_verdict_sends_nobody_to_an_unproven_project(routes: List[str], said: str) -> None:
    report = sample()
    report["subprojects"] = [{**p, "route": route} for p, route in zip(report["subprojects"], routes)]
    assert story.verdict(View(report))[0].endswith(said)


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


def test_a_folder_that_odm_cannot_load_is_told_first() -> None:
    report = sample()
    report["findings"].append({**report["findings"][0], "code": "odm-crash-band-count", "message": "ODM would stop."})
    first = story.comparisons(View(report))[0]
    assert first.topic == "Does it run?" and first.alone == "No. ODM would stop."
    assert first.instead == "4 projects that ODM can load, 3 of them reconstructed on trial."


def test_merged_cameras_are_named() -> None:
    report = sample()
    for frame in report["frames"]:
        if frame["band"] in ("Blue", "Green"):
            frame["odm_camera_id"] = "v2 micasense rededge-m 1280 960 brown 1.1312"
    row = next(c for c in story.comparisons(View(report)) if c.topic == "Cameras")
    assert "micasense-rededge-blue and micasense-rededge-green would be taken for one camera" in row.alone


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


def test_a_finding_belongs_to_the_payloads_that_it_names() -> None:
    report = sample()
    flight = next(f["id"] for f in report["flights"] if f["profile"] == "dji-fc300x-rgb")
    report["findings"] = [
        {**report["findings"][0], "code": "a", "subjects": subjects, "message": message}
        for subjects, message in (
            ([flight], "by flight"), (["dji-xt2-thermal"], "by profile"), (["rededge"], "by payload"),
            (["rgb"], "by project"), ([report["frames"][0]["path"]], "by frame"), (["nowhere"], "of the folder"),
        )
    ]  # fmt: skip
    (group,) = View(report).finding_groups()
    about = {line.message: line.payloads for line in group.lines}
    assert about["by flight"] == ("phantom-3",) and about["by profile"] == ("xt2-thermal",)
    assert about["by payload"] == ("rededge",) and about["by project"] == ("phantom-4-pro", "mavic-2-pro")
    assert about["by frame"] == (report["frames"][0]["payload"],) and about["of the folder"] == ()
    assert group.payloads == ()  # one line is about the whole folder, so the group always shows


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("distortion xmp-camera; focal from xmp-camera; held",
         "Distortion from the factory calibration in the file; focal from the factory calibration in the file; held"),
        ("focal from equivalent-35mm; left to be solved", "Focal from the 35 mm equivalent; left to be solved"),
        ("distortion solved; focal from sheet-like", "Distortion solved; focal from sheet-like"),
        ("rgb", "rgb"), ("", ""),
    ],
)  # fmt: skip
def test_reasons_name_sources_in_words(text: str, words: str) -> None:
    assert in_words(text) == words


def test_bands_of_one_flight_are_one_row() -> None:
    report = sample()
    rows = flight_rows(View(report))
    assert len({r.name for r in rows}) == len(rows)
    assert sum(r.frames for r in rows) == sum(len(f["frames"]) for f in report["flights"])
    for flight in report["flights"]:
        flight["id"] = flight["id"].replace("-flight-", ":")
    for action in report["actions"]:
        action["flight"] = action["flight"].replace("-flight-", ":")
    by_name = {r.name: r for r in flight_rows(View(report))}
    spread = len({f["gsd_cm"] for f in report["flights"] if "rededge" in f["id"]})
    assert sum(r.bands for r in by_name.values() if r.payload == "rededge") == 5
    assert len([r for r in by_name.values() if r.payload == "rededge"]) <= spread


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
