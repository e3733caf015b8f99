# ruff: noqa: E501 - a table of sample values reads better with one record per line
"""The sub-projects of the sample survey, as ``run`` would have written and judged them."""

from __future__ import annotations

import random
from typing import Any, List, Optional, Tuple

from tests.plugin.report.sample_parts import Json


def _fit(frames: int, horizontal: Optional[float], vertical: Optional[float]) -> Json:
    return {
        "frames": frames, "horizontal_m": horizontal, "vertical_m": vertical,
        "sigma_horizontal_m": 3.0, "sigma_vertical_m": 5.0, "collinear": False,
    }  # fmt: skip


def _bow(value: Optional[float], se: Optional[float], radius: Optional[float]) -> Json:
    return {"bowing_m": value, "se_m": se, "radius_m": radius}


def _payload_fit(name: str, frames: int, registered: int, together: Json, alone: Json, bow: Json, **more: Any) -> Json:
    return {
        "payload": name, "frames": frames, "registered": registered, "in_main_component": registered,
        "mean_reproj_error_px": more.get("error", 0.9), "together": together, "alone": alone,
        "height_m": more.get("height"), "flown_height_m": more.get("flown"), "bowing": bow,
        "cross_pairs": more.get("cross_pairs", 0), "cross_inliers": more.get("cross_inliers"),
        "capture_gap_m": None, "verdict": more.get("verdict", "pass"), "reasons": more.get("reasons", []),
    }  # fmt: skip


def _candidate(
    prof: str,
    name: str,
    source: str,
    distortion: str,
    ratio: float,
    held: bool,
    chosen: bool,
    figures: Tuple[float, ...],
    vetoed: str = "",
) -> Json:
    error, horizontal, vertical, height, bow, se = figures
    return {
        "profile": prof, "name": name, "focal_source": source, "distortion_source": distortion, "focal_ratio": ratio,
        "distortion": [0.0] * 5, "held": held, "mean_reproj_error_px": error, "gps_horizontal_m": horizontal,
        "gps_vertical_m": vertical, "height_m": height, "bowing": _bow(bow, se, 240.0), "vetoed": vetoed, "chosen": chosen,
    }  # fmt: skip


def _alignment(frames: List[Json], payloads: List[Json], pairs: List[Json], lost: int, **more: Any) -> Json:
    registered = [f for i, f in enumerate(frames) if i >= lost]
    spread = more.get("spread", 1.2)
    noise = random.Random(7)
    return {
        "registered": len(registered), "frames": len(frames), "components": more.get("components", 1),
        "mean_reproj_error_px": more.get("error", 0.86), "gps_rmse_m": more.get("rmse", 2.3),
        "height_m": more.get("height"), "bowing_m": more.get("bowing", 0.05), "bowing_se_m": more.get("se", 0.03),
        "engine": "pycolmap 4.2.1", "rung": more.get("rung", "quick"), "anchor": payloads[0]["payload"],
        "gps_horizontal_m": more.get("horizontal", 1.6), "gps_vertical_m": more.get("vertical", 1.7),
        "gps_limit_horizontal_m": 6.0, "gps_limit_vertical_m": 10.0, "bowing_radius_m": 240.0,
        "median_inliers": more.get("inliers", 312), "payloads": payloads, "pairs": pairs,
        "candidates": more.get("candidates", []),
        "residuals": [
            {"path": f["path"], "east_m": noise.gauss(0.0, spread), "north_m": noise.gauss(0.3, spread),
             "up_m": noise.gauss(0.0, spread)}
            for f in registered
        ],
        "unregistered": [f["path"] for f in frames[:lost]], "control": more.get("control"), "notes": [],
    }  # fmt: skip


def _option(name: str, value: Any, reason: str) -> Json:
    return {"name": name, "value": value, "reason": reason}


def _control() -> Json:
    """Six points that hold the model, one that the others contradict, and two check points."""
    points = [(f"GCP{i}", False, 5 + i, [0.011 * i - 0.03, -0.004 * i, 0.02]) for i in range(1, 7)]
    points += [
        ("GCP7", False, 4, [3.1, -0.4, 0.2]),
        ("CP1", True, 7, [0.02, -0.03, 0.05]),
        ("CP2", True, 6, [-0.01, 0.0, -0.06]),
    ]
    return {
        "points": 6, "horizontal_m": 0.021, "vertical_m": 0.034, "limit_m": 1.2, "held": True, "check_points": 2,
        "check_horizontal_m": 0.027, "check_vertical_m": 0.055, "gps_offset_m": [0.4, -0.1, 1.3], "bowing": _bow(0.01, 0.02, 240.0),
        "points_m": [{"point": p, "check": c, "images": n, "residual_m": r} for p, c, n, r in points],
        "outliers": ["GCP7"], "verdict": "pass", "text": "6 control points fit to 0.02 m horizontally, 0.03 m vertically",
    }  # fmt: skip


def subprojects(frames: List[Json]) -> List[Json]:
    """One entry per project; ``frames`` are all of the survey's, already given to theirs."""
    used = {
        name: [f for f in frames if f["subproject"] == name]
        for name in ("rgb", "rgb-phantom-3", "multispectral", "thermal")
    }
    p4 = [f for f in used["rgb"] if f["payload"] == "phantom-4-pro"]
    mavic = [f for f in used["rgb"] if f["payload"] == "mavic-2-pro"]
    green = [f for f in used["multispectral"] if f["band"] == "Green"]
    return [
        {
            "name": "rgb", "spectrum": "rgb", "frames": [f["path"] for f in used["rgb"]],
            "payloads": ["phantom-4-pro", "mavic-2-pro"],
            "options": [
                _option("use-fixed-camera-params", True, "Both cameras are covered by the cameras file and hold best when fixed."),
                _option("feature-quality", "high", "The written frames agree in GSD; ODM's default is enough."),
                _option("dem-resolution", 2.6, "Twice the finest GSD of the project."),
            ],
            "route": "proceed",
            "reasons": ["Both payloads fit one model, and each fits its GPS as well together as alone."],
            "alignment": _alignment(
                used["rgb"],
                [
                    _payload_fit("phantom-4-pro", len(p4), len(p4) - 2, _fit(len(p4), 1.6, 1.7), _fit(len(p4), 1.5, 1.5),
                                 _bow(0.05, 0.03, 240.0), height=118.4, flown=118.0, cross_pairs=214, cross_inliers=187),
                    _payload_fit("mavic-2-pro", len(mavic), len(mavic), _fit(len(mavic), 2.2, 2.9), _fit(len(mavic), 1.8, 2.0),
                                 _bow(0.08, 0.05, 210.0), height=90.6, flown=90.0, cross_pairs=214, cross_inliers=187),
                ],
                [
                    {"a": "mavic-2-pro", "b": "mavic-2-pro", "pairs": 402, "inliers_median": 355},
                    {"a": "mavic-2-pro", "b": "phantom-4-pro", "pairs": 214, "inliers_median": 187},
                    {"a": "phantom-4-pro", "b": "phantom-4-pro", "pairs": 611, "inliers_median": 402},
                ],
                2, height=102.0, control=_control(),
                candidates=[
                    _candidate("dji-fc6310-rgb", "sheet, no distortion", "sheet", "corrected-in-camera", 0.6667, True, True,
                               (0.86, 1.6, 1.7, 118.4, 0.05, 0.03)),
                    _candidate("dji-fc6310-rgb", "sheet, solved distortion", "sheet", "solved", 0.6667, False, False,
                               (0.81, 1.9, 2.6, 118.9, 0.47, 0.04)),
                    _candidate("dji-fc6310-rgb", "all solved", "solved", "solved", 0.7013, False, False,
                               (0.79, 2.0, 3.4, 126.1, 0.50, 0.04), "Solved height 126.1 m misses the flown 118.0 m."),
                ],
            ),
            "gcp": {"points": 6, "images": 41},
            "calibration": [
                {"profile": "dji-fc6310-rgb", "camera_id": "dji fc6310 8372 5581 brown 0.6666", "focal_ratio": 0.66667,
                 "source": "sheet", "held": True, "reason": "Bows least and hits the flown height."},
                {"profile": "hasselblad-l1d-20c-rgb", "camera_id": "hasselblad l1d-20c 5472 3648 brown 0.7772",
                 "focal_ratio": 0.77727, "source": "xmp-calibrated", "held": True, "reason": "Calibrated by the maker, in the file."},
            ],
        },
        {
            "name": "rgb-phantom-3", "spectrum": "rgb", "frames": [f["path"] for f in used["rgb-phantom-3"]],
            "payloads": ["phantom-3"],
            "options": [_option("matcher-neighbors", 12, "One flight, 80 % overlap: twelve neighbours reach every strip.")],
            "route": "isolate",
            "reasons": ["Together with the others it lies 38 m off its own GPS; alone it fits within 2.4 m.",
                        "Pairwise alignment with ground control points found 11 inliers (30 needed)."],
            "alignment": _alignment(
                used["rgb-phantom-3"],
                [_payload_fit("phantom-3", len(used["rgb-phantom-3"]), len(used["rgb-phantom-3"]) - 1,
                              _fit(len(used["rgb-phantom-3"]), 2.4, 3.9), _fit(len(used["rgb-phantom-3"]), 2.4, 3.9),
                              _bow(0.61, 0.09, 130.0), height=96.8, flown=95.0, error=1.31)],
                [{"a": "phantom-3", "b": "phantom-3", "pairs": 143, "inliers_median": 121},
                 {"a": "phantom-3", "b": "phantom-4-pro", "pairs": 3, "inliers_median": 11}],
                1, error=1.31, rmse=4.6, horizontal=2.4, vertical=3.9, bowing=0.61, se=0.09, inliers=121, rung="alone", spread=1.9,
            ),
            "gcp": None,
            "calibration": [{"profile": "dji-fc300x-rgb", "camera_id": "dji fc300x 4000 3000 brown 0.5850", "focal_ratio": 0.5912,
                             "source": "solved", "held": False, "reason": "Its own tag is a rounded 35 mm equivalent."}],
        },
        {
            "name": "multispectral", "spectrum": "multispectral", "frames": [f["path"] for f in used["multispectral"]],
            "payloads": ["rededge"],
            "options": [
                _option("primary-band", "Green", "The solver saw the green frames."),
                _option("radiometric-calibration", "camera", "Black level, vignette and gain stand in every frame."),
            ],
            "route": "proceed", "reasons": ["The green band aligns alone; the other bands ride on the rig."],
            "alignment": _alignment(
                green, [_payload_fit("rededge", len(green), len(green), _fit(len(green), 1.1, 1.4), _fit(len(green), 1.1, 1.4),
                                     _bow(-0.02, 0.04, 220.0), height=80.9, flown=80.0, error=0.62)],
                [{"a": "rededge", "b": "rededge", "pairs": 381, "inliers_median": 266}], 0,
                error=0.62, rmse=1.8, horizontal=1.1, vertical=1.4, bowing=-0.02, se=0.04, inliers=266, spread=0.8,
            ),
            "gcp": None, "calibration": [],
        },
        {
            "name": "thermal", "spectrum": "thermal", "frames": [f["path"] for f in used["thermal"]], "payloads": ["xt2-thermal"],
            "options": [_option("use-fixed-camera-params", True, "Without the sheet's focal ODM assumes a ratio of 0.85.")],
            "route": "unproven", "reasons": ["No alignment was run: pycolmap is not installed on this machine."],
            "alignment": None, "gcp": None,
            "calibration": [{"profile": "dji-xt2-thermal", "camera_id": "dji xt2 640 512 brown 0.85", "focal_ratio": 1.19485,
                             "source": "sheet", "held": True, "reason": "There is no focal tag at all."}],
        },
    ]  # fmt: skip
