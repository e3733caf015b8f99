"""The figures of an alignment follow the report, and no missing figure passes."""

from __future__ import annotations

import copy
from typing import Any, Dict

import pytest
from sensorgate.plugin.report import candidates, checks
from sensorgate.plugin.report.view import View

from tests.plugin.report.sample import sample


def judged(report: Dict[str, Any], project: int = 0) -> Dict[str, checks.Check]:
    view = View(report)
    return {c.name: c for c in checks.alignment_checks(view, view.report["subprojects"][project])}


def test_checks_judge_by_the_limits() -> None:
    good = judged(sample())
    assert {c.state for name, c in good.items() if name not in ("Flying height", "Check points")} == {checks.GOOD}
    report = sample()
    report["subprojects"][0]["alignment"].update(
        mean_reproj_error_px=2.4, gps_horizontal_m=56.0, components=3, median_inliers=12, bowing_m=0.5, bowing_se_m=0.04
    )
    report["subprojects"][0]["route"] = "unproven"
    bad = judged(report)
    for name in ("Reprojection error", "GPS fit, level", "Frames placed", "Matches per pair"):
        assert bad[name].state == checks.BAD
    assert bad["GPS fit, height"].state == checks.GOOD
    assert "low against its edge" in bad["Bowing"].words


@pytest.mark.parametrize("missing", ["mean_reproj_error_px", "gps_rmse_m", "height_m", "bowing_m", "bowing_se_m"])
def test_a_missing_figure_never_passes(missing: str) -> None:
    report = sample()
    found = report["subprojects"][0]["alignment"]
    found[missing] = None
    if missing == "gps_rmse_m":
        found["gps_horizontal_m"] = found["gps_vertical_m"] = None
    found_checks = judged(report)
    if missing == "mean_reproj_error_px":
        assert found_checks["Reprojection error"].state == checks.BAD
    if missing == "gps_rmse_m":
        assert found_checks["GPS fit"].state == checks.NOTE


def test_cross_words_say_too_few() -> None:
    report = sample()
    words = checks.cross_words(report["subprojects"][1]["alignment"], 30)
    assert words == ["phantom-3 and phantom-4-pro: 11 matches per pair over 3 pairs, too few to join them (30 needed)."]


def test_cross_words_tell_a_gps_shift() -> None:
    found = copy.deepcopy(sample()["subprojects"][0]["alignment"])
    found["payloads"][1]["gps_offset_m"] = [12.0, -3.25, 18.0]
    assert "shifted by +12.0 m east, -3.2 m north, +18.0 m up" in checks.cross_words(found, 30)[-1]


def test_frames_outside_the_largest_model_are_not_placed() -> None:
    report = sample()
    found = report["subprojects"][0]["alignment"]
    found["components"], total = 2, found["frames"]
    for payload in found["payloads"]:
        payload["in_main_component"] = payload["registered"] - 4
    check = judged(report)["Frames placed"]
    assert check.state == checks.NOTE and check.value == f"{checks.in_main(found)} of {total}"
    assert "without 10 frames" in check.words and checks.in_main(found) == total - 10
    report["subprojects"][0]["route"] = "unproven"
    assert judged(report)["Frames placed"].state == checks.BAD


def test_what_the_tables_say_is_not_said_again() -> None:
    report = sample()
    project = report["subprojects"][0]
    project["alignment"]["payloads"][0]["reasons"] = ["60 of 60 frames are in the main model"]
    project["reasons"] = ["phantom-4-pro: 60 of 60 frames are in the main model", "Something else."]
    assert checks.why(View(report), project) == ["Something else."]
    project["alignment"]["payloads"][0]["verdict"] = "fail"
    assert project["reasons"][0] in checks.why(View(report), project)


def test_ground_control_is_judged_and_listed() -> None:
    report = sample()
    found = judged(report)
    assert found["Ground control"].state == checks.GOOD and found["Ground control"].value == "0.02 / 0.03 m"
    assert found["Check points"].value == "0.03 / 0.06 m" and found["Check points"].state == checks.NOTE
    table = checks.control_table(report["subprojects"][0]["alignment"])
    assert table is not None and table["verdict"] == "Ground control proves this model."
    assert [r.point for r in table["rows"] if r.outlier] == ["GCP7"]
    assert [r.kind for r in table["rows"]][-2:] == ["check point", "check point"]
    assert table["sums"] == [("6 control points", "0.02 m", "0.03 m"), ("2 check points", "0.03 m", "0.06 m")]
    assert any("+0.40 m east" in note for note in table["notes"])
    report["subprojects"][0]["alignment"]["control"]["verdict"] = "fail"
    assert judged(report)["Ground control"].state == checks.BAD
    assert checks.control_table({"control": None}) is None


def test_a_contest_names_winner_margin_and_losers() -> None:
    (contest,) = candidates.contests(sample()["subprojects"][0]["alignment"])
    assert contest.profile == "dji-fc6310-rgb" and contest.winner == "focal from calibration sheet, no distortion"
    assert contest.margin.startswith("Nearest rival: focal from calibration sheet, distortion solved;")
    assert "reprojection error 0.86 against 0.81 px" in contest.margin
    assert "bowing +0.05 against +0.47 m" in contest.margin
    assert [r.outcome for r in contest.rows] == [
        "chosen, held fixed",
        "possible, not needed",
        "Solved height 126.1 m misses the flown 118.0 m.",
    ]


def test_candidates_that_no_figure_tells_apart() -> None:
    found = sample()["subprojects"][0]["alignment"]
    first, second, _ = found["candidates"]
    for key in ("mean_reproj_error_px", "gps_horizontal_m", "gps_vertical_m", "bowing"):
        second[key] = first[key]
    assert "no figure tells them apart" in candidates.contests(found)[0].margin
    second["vetoed"] = "too far off"
    assert candidates.contests(found)[0].margin == "Every other candidate was ruled out."
