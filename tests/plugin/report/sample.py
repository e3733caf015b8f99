# ruff: noqa: E501 - a table of sample values reads better with one record per line
"""A hand-built report of one mixed survey, as ``build`` would write it after ``run``.

Four drones over one quarry: a Phantom 4 Pro and a Mavic 2 Pro that align
together, an old Phantom 3 that does not, a RedEdge rig of five bands and an XT2
thermal camera. ``sample(per_flight=...)`` scales the number of frames.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import random
from typing import Any, Dict, List, Optional, Tuple

from sensorgate.stages.thresholds import DEFAULTS

LATITUDE, LONGITUDE = 46.8421, -92.0317
METRES_PER_DEGREE = 111_320.0
Json = Dict[str, Any]


def grid(count: int, west_m: float, south_m: float, width_m: float, depth_m: float) -> List[Tuple[float, float]]:
    """Latitude and longitude of a lawn-mower flight in flying order."""
    lines = max(2, round(math.sqrt(count * depth_m / width_m)))
    per_line = math.ceil(count / lines)
    spots = []
    for index in range(count):
        line, step = divmod(index, per_line)
        along = step / max(1, per_line - 1)
        along = along if line % 2 == 0 else 1.0 - along
        wobble = 1.5 * math.sin(index * 1.7)
        spots.append(
            (
                LATITUDE + (south_m + depth_m * line / max(1, lines - 1) + wobble) / METRES_PER_DEGREE,
                LONGITUDE + (west_m + width_m * along) / (METRES_PER_DEGREE * math.cos(math.radians(LATITUDE))),
            )
        )
    return spots


def intrinsics(
    ratio: Optional[float], source: str, focal_mm: Optional[float], width_mm: Optional[float], **more: Any
) -> Json:
    return {
        "focal_ratio": ratio,
        "focal_source": source,
        "focal_mm": focal_mm,
        "sensor_width_mm": width_mm,
        "sensor_width_source": more.get("width_source", "sheet" if width_mm else "unknown"),
        "center_ratio": None,
        "distortion": more.get("distortion"),
        "distortion_source": more.get("distortion_source", "unknown"),
        "projection": "brown",
    }


def profile(ident: str, spectrum: str, make: str, model: str, size: Tuple[int, int], inner: Json, **more: Any) -> Json:
    band = more.get("band", "")
    return {
        "id": ident,
        "family": " / ".join(p for p in (make, model, more.get("lens", ""), spectrum, band) if p),
        "spectrum": spectrum,
        "band": band,
        "make": make,
        "model": model,
        "lens": more.get("lens", ""),
        "serial": more.get("serial", ""),
        "mode": "",
        "width": size[0],
        "height": size[1],
        "frames": [],
        "intrinsics": inner,
        "focal_mm_min": more.get("focal_min", inner["focal_mm"]),
        "focal_mm_max": more.get("focal_max", inner["focal_mm"]),
        "focal_variance": more.get("variance", 0.0),
        "family_focal_variance": more.get("variance", 0.0),
        "corrected_in_camera": more.get("corrected", False),
        "thermal_reading": more.get("thermal_reading", ""),
        "lock": more.get("lock", False),
        "lock_reason": more.get("lock_reason", "The focal lengths agree; nothing needs to be held."),
        "odm_camera_ids": [],
    }


PROFILES = (
    profile(
        "dji-fc6310-rgb", "rgb", "DJI", "FC6310", (5472, 3648),
        intrinsics(8.8 / 13.2, "sheet", 8.8, 13.2, distortion=[0, 0, 0, 0, 0], distortion_source="corrected-in-camera"),
        serial="0f9b21c4", focal_min=8.6, focal_max=9.0, variance=0.0455, corrected=True, lock=True,
        lock_reason="Focal tags spread 4.5 % in this family (limit 3 %) and the sheet's 8.80 mm is trusted: held.",
    ),
    profile(
        "hasselblad-l1d-20c-rgb", "rgb", "Hasselblad", "L1D-20c", (5472, 3648),
        intrinsics(10.26 / 13.2, "xmp-calibrated", 10.26, 13.2), serial="163DF8C0012",
    ),
    profile(
        "dji-fc300x-rgb", "rgb", "DJI", "FC300X", (4000, 3000),
        intrinsics(3.61 / 6.17, "equivalent-35mm", 3.61, 6.17, width_source="generic-width"),
        lock_reason="The focal is a rounded 35 mm equivalent: never held.",
    ),
    *(
        profile(
            f"micasense-rededge-{band.lower().replace(' ', '-')}", "multispectral", "MicaSense", "RedEdge-M", (1280, 960),
            intrinsics(5.43 / 4.8, "xmp-camera", 5.43 + 0.01 * i, 4.8, width_source="focal-plane",
                       distortion=[-0.09, 0.15, 0, 0, -0.03], distortion_source="xmp-camera"),
            band=band, serial="RX01-1809051-SC", lock=True,
            lock_reason="Every band carries its factory calibration in XMP: held.",
        )
        for i, band in enumerate(("Blue", "Green", "Red", "NIR", "Red edge"))
    ),
    profile(
        "dji-xt2-thermal", "thermal", "DJI", "XT2", (640, 512),
        intrinsics(13.0 / 10.88, "sheet", 13.0, 10.88),
        thermal_reading="ODM 3.6 reads these R-JPEG frames as a palette picture, not as temperature.",
        lock=True, lock_reason="There is no focal tag; the sheet's 13 mm at 17 um is held, or ODM assumes 0.85.",
    ),
)  # fmt: skip

# payload, primary profile, profiles, flights: (count share, west, south, width, depth, height, sub-project)
PLAN: Tuple[Tuple[str, str, Tuple[str, ...], Tuple[Tuple[float, float, float, float, float, float], ...], str], ...] = (
    ("phantom-4-pro", "rgb", ("dji-fc6310-rgb",), ((1.0, 0, 0, 420, 260, 118), (0.6, 200, 40, 360, 220, 119)), "rgb"),
    ("mavic-2-pro", "rgb", ("hasselblad-l1d-20c-rgb",), ((0.9, 60, 30, 380, 240, 90),), "rgb"),
    ("phantom-3", "rgb", ("dji-fc300x-rgb",), ((0.5, 430, 150, 240, 200, 95),), "rgb-phantom-3"),
    (
        "rededge", "multispectral",
        tuple(f"micasense-rededge-{b}" for b in ("green", "blue", "red", "nir", "red-edge")),
        ((0.7, 20, 10, 400, 240, 80),), "multispectral",
    ),
    ("xt2-thermal", "thermal", ("dji-xt2-thermal",), ((0.4, 120, 60, 220, 150, 60),), "thermal"),
)  # fmt: skip


def _frame(
    path: str, prof: Json, flight: str, payload: str, spot: Tuple[float, float], height: float, index: int
) -> Json:
    ratio = prof["intrinsics"]["focal_ratio"]
    jitter = 0.2 * math.sin(index * 2.1) if prof["id"] == "dji-fc6310-rgb" else 0.0
    focal = round(prof["intrinsics"]["focal_mm"] + jitter, 2)
    shown = {"dji-xt2-thermal": "0.85"}.get(prof["id"], f"{focal / prof['intrinsics']['sensor_width_mm']:.6f}"[:6])
    return {
        "path": path,
        "subproject": None,
        "output": None,
        "reason": None,
        "profile": prof["id"],
        "flight": flight,
        "payload": payload,
        "role": "survey",
        "spectrum": prof["spectrum"],
        "band": prof["band"],
        "capture": f"{payload}-{index:05d}",
        "make": prof["make"],
        "model": prof["model"],
        "serial": prof["serial"],
        "width": prof["width"],
        "height": prof["height"],
        "focal_mm": focal,
        "focal_source": prof["intrinsics"]["focal_source"],
        "sensor_width_mm": prof["intrinsics"]["sensor_width_mm"],
        "sensor_width_source": prof["intrinsics"]["sensor_width_source"],
        "altitude_m": 402.0 + height + 0.8 * math.sin(index),
        "height_m": height + 0.8 * math.sin(index),
        "height_source": "relative-altitude",
        "gsd_cm": round(100.0 * (height + 0.8 * math.sin(index)) / ratio / prof["width"], 3),
        "gsd_after_cm": None,
        "latitude": spot[0],
        "longitude": spot[1],
        "gps": {"rtk_fixed": False, "sigma_horizontal_m": 3.0, "sigma_vertical_m": 5.0},
        "odm_camera_id": f"v2 {prof['make']} {prof['model']} {prof['width']} {prof['height']} brown {shown}".lower(),
        "intrinsics_notes": [],
        "original_tags": None,
        "change": None,
    }


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
        "unregistered": [f["path"] for f in frames[:lost]], "notes": [],
    }  # fmt: skip


def _finding(code: str, severity: str, subjects: List[str], message: str, remedy: str, **more: Any) -> Json:
    return {
        "code": code, "severity": severity, "subjects": subjects, "measured": more.get("measured"),
        "threshold": more.get("threshold"), "message": message, "remedy": remedy, "odm_message": more.get("odm"),
    }  # fmt: skip


def _option(name: str, value: Any, reason: str) -> Json:
    return {"name": name, "value": value, "reason": reason}


def sample(per_flight: int = 60) -> Json:
    """The report; ``per_flight`` is the length of the longest flight in captures."""
    profiles = {p["id"]: p for p in copy.deepcopy(PROFILES)}
    frames: List[Json] = []
    flights: List[Json] = []
    payloads: List[Json] = []
    for name, spectrum, members, legs, project in PLAN:
        payloads.append({
            "id": name, "spectrum": spectrum, "profiles": list(members), "primary": members[0],
            "bands": [profiles[m]["band"] for m in members if profiles[m]["band"]],
        })  # fmt: skip
        for leg, (share, west, south, width, depth, height) in enumerate(legs, 1):
            spots = grid(max(8, round(per_flight * share)), west, south, width, depth)
            for member in members:
                flight = f"{member}-flight-{leg}"
                made = [
                    _frame(f"survey/{name}/F{leg}/{'IMG' if len(members) > 1 else 'DJI'}_{i:04d}"
                           f"{'_' + str(members.index(member) + 1) + '.tif' if len(members) > 1 else '.JPG'}",
                           profiles[member], flight, name, spot, height, i)
                    for i, spot in enumerate(spots)
                ]  # fmt: skip
                for frame in made:
                    frame["subproject"] = project
                gsd = sorted(f["gsd_cm"] for f in made)[len(made) // 2]
                flights.append({
                    "id": flight, "profile": member, "frames": [f["path"] for f in made],
                    "start": f"2024-06-1{leg}T10:02:11", "end": f"2024-06-1{leg}T10:21:48", "height_m": height,
                    "height_source": "relative-altitude", "height_sigma_m": 2.0, "gsd_cm": gsd,
                })  # fmt: skip
                frames.extend(made)
    for index, frame in enumerate(
        f for f in frames if f["payload"] == "rededge" and f["capture"].endswith(("-00000", "-00001"))
    ):
        frame.update(role="panel", reason="calibration-panel", subproject=None, height_m=1.2, gsd_cm=None)
        frame["intrinsics_notes"] = [f"Panel capture {index}."]
    for frame in [f for f in frames if f["payload"] == "phantom-4-pro"][:3]:
        frame.update(role="transit", reason="transit", subproject=None, height_m=22.0)
    far = next(f for f in frames if f["payload"] == "mavic-2-pro")
    far.update(latitude=0.0, longitude=0.0, reason="gps-zero", subproject=None)
    broken: Json = dict.fromkeys(frames[0])
    broken.update(path="survey/phantom-3/F1/DJI_0999.JPG", role="broken", reason="truncated-file", intrinsics_notes=[])
    frames.append(broken)

    scales = {"phantom-4-pro": 1.53}
    for frame in frames:
        if frame["subproject"] is None:
            continue
        scale = scales.get(frame["payload"], 1.0)
        retag = frame["payload"] == "mavic-2-pro"
        frame["output"] = f"projects/{frame['subproject']}/images/{frame['payload']}-{frame['path'].rsplit('/', 1)[1]}"
        frame["gsd_after_cm"] = round(frame["gsd_cm"] / scale, 3)
        frame["change"] = {
            "how": "resampled" if scale != 1.0 else ("retagged" if retag else "linked"),
            "scale": scale, "width": round(frame["width"] * scale), "height": round(frame["height"] * scale),
        }  # fmt: skip
        if frame["change"]["how"] != "linked":
            frame["original_tags"] = {"focal_mm": frame["focal_mm"], "focal_35mm": 24.0}
    frames.sort(key=lambda f: f["path"])
    for frame in frames:
        if frame["profile"]:
            profiles[frame["profile"]]["frames"].append(frame["path"])
    for prof in profiles.values():
        prof["odm_camera_ids"] = sorted({f["odm_camera_id"] for f in frames if f["profile"] == prof["id"]})

    used = {
        name: [f for f in frames if f["subproject"] == name]
        for name in ("rgb", "rgb-phantom-3", "multispectral", "thermal")
    }
    p4 = [f for f in used["rgb"] if f["payload"] == "phantom-4-pro"]
    mavic = [f for f in used["rgb"] if f["payload"] == "mavic-2-pro"]
    green = [f for f in used["multispectral"] if f["band"] == "Green"]
    subprojects = [
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
                2, height=102.0,
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
    findings = [
        _finding("mixed-spectra", "error", ["phantom-4-pro", "rededge", "xt2-thermal"],
                 "Colour, multispectral and thermal frames lie in one folder. Their descriptors do not match each other.",
                 "Use the written projects, one per spectrum."),
        _finding("truncated-file", "error", ["survey/phantom-3/F1/DJI_0999.JPG"],
                 "The file ends after 61 kB of about 5 MB.", "Copy it from the card again, or leave it out.",
                 odm="PIL.UnidentifiedImageError: cannot identify image file"),
        _finding("focal-variance", "warning", ["dji-fc6310-rgb"],
                 "Focal lengths of DJI FC6310 run from 8.60 to 9.00 mm: 4.5 % apart.",
                 "Nothing to do: the copies carry one focal tag, and the sheet's 8.80 mm is held.", measured=0.0455, threshold=0.03),
        _finding("gps-zero", "warning", [far["path"]], "The position is 0, 0: the camera had no fix yet.",
                 "Give its position in a geo.txt with --geo, or leave it out."),
        _finding("gsd-mismatch", "warning", ["phantom-4-pro", "mavic-2-pro"],
                 "Ground resolution differs 1.5-fold: 3.23 cm (phantom-4-pro) against 2.12 cm (mavic-2-pro).",
                 "The coarser frames were resampled to 2.12 cm. Matching gains; no detail is added.", measured=1.53, threshold=1.05),
        _finding("silent-default-focal", "warning", ["dji-xt2-thermal"],
                 "ODM finds no focal length for DJI XT2 and silently takes 0.85 of the width; the true ratio is 1.195.",
                 "The thermal project has a cameras file with the sheet's value.", measured=0.85, threshold=1.195),
        _finding("not-temperature", "info", ["dji-xt2-thermal"],
                 "ODM 3.6 reads these R-JPEG frames as a palette picture: the orthophoto will hold colours, not degrees.",
                 "Convert the frames to temperature TIFFs with the maker's tool before the run if you need degrees."),
        *(
            _finding("transit", "info", [f["path"]], "Taken at 22 m while the flight ran at 118 m: take-off or landing.",
                     "Nothing to do: it is left out.", measured=22.0, threshold=59.0)
            for f in frames if f["reason"] == "transit"
        ),
    ]  # fmt: skip
    actions = []
    for flight in flights:
        prof = profiles[flight["profile"]]
        scale = 1.53 if prof["id"] == "dji-fc6310-rgb" else 1.0
        second = flight["id"].endswith("flight-2")
        actions.append({
            "profile": prof["id"], "flight": flight["id"], "frames": len(flight["frames"]), "gsd_before_cm": flight["gsd_cm"],
            "gsd_after_cm": round(flight["gsd_cm"] / scale, 3), "scale": scale, "width": prof["width"], "height": prof["height"],
            "out_width": round(prof["width"] * scale), "out_height": round(prof["height"] * scale),
            "focal_mm": 8.8 if scale != 1.0 else None,
            "lut": {"id": f"{flight['id']}-lut", "offset_dn": [-21.4, -18.0, -12.3], "reference": "dji-fc6310-rgb-flight-1",
                    "written": True, "frames_sampled": 12} if second else None,
            "reasons": ["3.23 cm against 2.12 cm of the finest payload: resampled 1.53-fold."] if scale != 1.0 else [],
        })  # fmt: skip
    return {
        "schema_version": "1.0",
        "verdict": "inconsistent",
        "ignored": {"hidden": 2, "not-image": 7},
        "frames": frames,
        "flights": sorted(flights, key=lambda f: str(f["id"])),
        "payloads": sorted(payloads, key=lambda p: str(p["id"])),
        "profiles": [profiles[p] for p in sorted(profiles)],
        "findings": findings,
        "actions": actions,
        "subprojects": subprojects,
        "odm": None,
        "thresholds": {"changed": {"min_inliers": 25}, "all": {**dataclasses.asdict(DEFAULTS), "min_inliers": 25}},
        "versions": {"sensorgate": "1.0.0", "pycolmap": "4.2.1", "numpy": "2.1.0", "opencv": None},
        "inputs": {
            "paths": ["survey"],
            "digest": "9f2c1e0b7a6d5c4f3e2d1c0b9a8f7e6d5c4b3a2f1e0d9c8b7a6f5e4d3c2b1a09",
            "options": {"gcp": "gcp_list.txt"},
            "gcp": [
                {"name": f"GCP{i}", "latitude": LATITUDE + dy / METRES_PER_DEGREE,
                 "longitude": LONGITUDE + dx / (METRES_PER_DEGREE * math.cos(math.radians(LATITUDE))),
                 "altitude_m": 401.0, "images": 5 + i}
                for i, (dx, dy) in enumerate(((40, 20), (380, 30), (210, 130), (60, 230), (400, 240), (500, 120)), 1)
            ],
        },
    }  # fmt: skip


def empty(verdict: str = "blocked") -> Json:
    """A report of a folder without a single readable image."""
    return {
        "schema_version": "1.0", "verdict": verdict, "ignored": {}, "frames": [], "flights": [], "payloads": [],
        "profiles": [], "findings": [_finding("no-frames", "error", ["survey"], "There is no image below survey.", "Check the path.")],
        "actions": [], "subprojects": [], "thresholds": {"changed": {}, "all": dataclasses.asdict(DEFAULTS)},
        "versions": {"sensorgate": "1.0.0"}, "inputs": {"paths": ["survey"], "digest": None},
    }  # fmt: skip
