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
from typing import Any, List

from sensorgate.stages.thresholds import DEFAULTS

from tests.plugin.report.sample_parts import (
    LATITUDE,
    LONGITUDE,
    METRES_PER_DEGREE,
    PLAN,
    PROFILES,
    Json,
    frame_of,
    grid,
)
from tests.plugin.report.sample_projects import subprojects


def _finding(code: str, severity: str, subjects: List[str], message: str, remedy: str, **more: Any) -> Json:
    return {
        "code": code, "severity": severity, "subjects": subjects, "measured": more.get("measured"),
        "threshold": more.get("threshold"), "message": message, "remedy": remedy, "odm_message": more.get("odm"),
    }  # fmt: skip


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
                    frame_of(f"survey/{name}/F{leg}/{'IMG' if len(members) > 1 else 'DJI'}_{i:04d}"
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
        "subprojects": subprojects(frames),
        "odm": None,
        "thresholds": {"changed": {"min_inliers": 25}, "all": {**dataclasses.asdict(DEFAULTS), "min_inliers": 25}},
        "versions": {"sensorgate": "1.0.0", "pycolmap": "4.2.1", "numpy": "2.1.0", "opencv": None},
        "inputs": {
            "paths": ["survey"],
            "digest": "9f2c1e0b7a6d5c4f3e2d1c0b9a8f7e6d5c4b3a2f1e0d9c8b7a6f5e4d3c2b1a09",
            "options": {"gcp": "gcp_list.txt"},
            "gcp": [
                {"name": name, "latitude": LATITUDE + dy / METRES_PER_DEGREE,
                 "longitude": LONGITUDE + dx / (METRES_PER_DEGREE * math.cos(math.radians(LATITUDE))),
                 "altitude_m": 401.0, "images": 5 + i, "check": name.startswith("CP")}
                for i, (name, dx, dy) in enumerate(
                    (("GCP1", 40, 20), ("GCP2", 380, 30), ("GCP3", 210, 130), ("GCP4", 60, 230), ("GCP5", 400, 240),
                     ("GCP6", 500, 120), ("CP1", 130, 80), ("CP2", 300, 190)), 1)
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
