"""Runs the main job on a rendered story and holds the result against the story's truth."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional, Set, Tuple

from PIL import Image
from sensorgate.plugin import pipeline

from tests import simulator
from tests.simulator.stories import WRONG_SHEET
from tests.simulator.truth import Truth

# A resampled frame's height is rounded to whole pixels, its marks to thousandths.
MARK_PX = 0.5


@dataclass(frozen=True)
class Outcome:
    """A story's truth, the report of ``run`` and where things are."""

    truth: Truth
    report: Dict[str, Any]
    exit_code: int
    survey: Path
    out: Path


def play(story: str, folder: Path, *, seed: int = 0, scale: float = 1.0, **settings: Any) -> Outcome:
    """Render a story below ``folder`` and run the main job on it."""
    survey = folder / "survey"
    truth = simulator.render(story, survey, seed=seed, frames_scale=scale)
    if truth.gcp_file and "gcp" not in settings:
        settings["gcp"] = str(survey / truth.gcp_file)
    if story == "wrong-sheet" and "calibration" not in settings:
        settings["calibration"] = str(folder / "sheet.csv")
        (folder / "sheet.csv").write_text(WRONG_SHEET, encoding="utf-8")
    out = folder / "out"
    result = pipeline.run([str(survey / "images")], out, pipeline.Settings(**settings))
    return Outcome(truth, result.report, result.exit_code, survey, out)


def wrong_routes(outcome: Outcome) -> List[str]:
    """Where routes or the sharing of projects differ from the truth, one sentence each."""
    said: List[str] = []
    projects: Dict[str, Dict[str, int]] = {}
    route_of = {s["name"]: s["route"] for s in outcome.report["subprojects"]}
    home: Dict[str, Optional[str]] = {_tail(f["path"]): f["subproject"] for f in outcome.report["frames"]}
    for frame in outcome.truth.frames:
        project = home.get(_tail(frame.path))
        # One frame of another size is another camera to every solver, and too little to prove anything.
        if "other-size" in frame.lies:
            continue
        if project is not None:
            counts = projects.setdefault(frame.payload, {})
            counts[project] = counts.get(project, 0) + 1
    main: Dict[str, str] = {}
    for payload in outcome.truth.payloads:
        counts = projects.get(payload.id, {})
        if not counts:
            said.append(f"{payload.id} is in no project")
            continue
        if len(counts) > 1:
            said.append(f"{payload.id} is spread over {sorted(counts)}")
        main[payload.id] = max(sorted(counts), key=lambda n: counts[n])
        route = route_of[main[payload.id]]
        if route != payload.route:
            said.append(f"{payload.id} is routed {route}, the truth says {payload.route}")
    for a in outcome.truth.payloads:
        for b in outcome.truth.payloads:
            if a.id < b.id and a.id in main and b.id in main:
                together, should = main[a.id] == main[b.id], a.project == b.project
                if together != should:
                    said.append(f"{a.id} and {b.id} {'share' if together else 'do not share'} a project")
    return said


def lost_frames(outcome: Outcome) -> List[str]:
    """Frames that are neither in one project nor left out with a reason."""
    inside = [p for s in outcome.report["subprojects"] for p in s["frames"]]
    doubled = {p for p in inside if inside.count(p) > 1}
    silent = [f["path"] for f in outcome.report["frames"] if not f["subproject"] and not f["reason"]]
    return sorted(doubled) + silent


def open_loops(outcome: Outcome) -> List[str]:
    """Projects whose images the gate does not call consistent."""
    said = []
    for project in outcome.report["subprojects"]:
        images = outcome.out / "projects" / project["name"] / "images"
        checked = pipeline.gate([str(images)])
        if checked.exit_code != 0:
            codes = [f["code"] for f in checked.report["findings"] if f["severity"] == "error"]
            said.append(f"{project['name']}: {checked.report['verdict']} {codes}")
    return said


@dataclass(frozen=True)
class Focal:
    """One written camera against the truth: ``error`` is its focal over the true one, less 1.

    ``fixed`` says that the focal was solved and that the report calls the block's geometry good enough for it.
    """

    profile: str
    source: str
    held: bool
    fixed: bool
    error: float


def focals(outcome: Outcome) -> List[Focal]:
    """Every camera of every project beside the true cameras of its frames, the worst of them."""
    true: Dict[str, Set[float]] = {}
    told = {_tail(f.path): f for f in outcome.truth.frames}
    for frame in outcome.report["frames"]:
        known = told.get(_tail(frame["path"]))
        if frame["profile"] and known is not None:
            camera = known.camera
            ratio = camera.focal_ratio * camera.width / max(camera.width, camera.height)
            true.setdefault(frame["profile"], set()).add(ratio)
    found = []
    for project in outcome.report["subprojects"]:
        for camera in project["calibration"]:
            ratio, known_ratios = camera["focal_ratio"], true.get(camera["profile"], set())
            if ratio is not None and known_ratios:
                error = max((ratio / t - 1.0 for t in known_ratios), key=abs)
                fixed = camera["source"] == "solved" and "the geometry fixes the focal" in camera["reason"]
                found.append(Focal(camera["profile"], camera["source"], camera["held"], fixed, error))
    return found


def check_points(outcome: Outcome) -> List[Tuple[str, int, float, float]]:
    """Project, number of check points, and what they miss by, horizontally and vertically, in GSD."""
    found = []
    gsd_m = {_tail(f.path): f.gsd_cm / 100.0 for f in outcome.truth.frames}
    for project in outcome.report["subprojects"]:
        control = (project["alignment"] or {}).get("control") or {}
        if not control.get("check_points"):
            continue
        gsd = statistics.median(gsd_m[_tail(p)] for p in project["frames"])
        flat, up = control["check_horizontal_m"] / gsd, control["check_vertical_m"] / gsd
        found.append((project["name"], control["check_points"], flat, up))
    return found


def misplaced_marks(outcome: Outcome) -> List[str]:
    """Marks of the written control lists that do not lie where the truth says, in pixels of the written frames."""
    said: List[str] = []
    told = {(_tail(m.path), p.id): m for p in outcome.truth.points for m in p.marks}
    size = {_tail(f.path): f.camera.width for f in outcome.truth.frames}
    sources = {f["output"]: _tail(f["path"]) for f in outcome.report["frames"] if f["output"]}
    for project in outcome.report["subprojects"]:
        folder = outcome.out / "projects" / project["name"]
        if not (folder / "gcp_list.txt").exists():
            continue
        for line in (folder / "gcp_list.txt").read_text(encoding="utf-8").splitlines()[1:]:
            _, _, _, x, y, name, point = line.split()
            source = sources[f"projects/{project['name']}/images/{name}"]
            mark = told[source, point]
            with Image.open(folder / "images" / name) as image:
                scale = image.width / size[source]
            miss = math.hypot((mark.x_px + 0.5) * scale - 0.5 - float(x), (mark.y_px + 0.5) * scale - 0.5 - float(y))
            if miss > MARK_PX:
                said.append(f"{point} in {name} lies {miss:.2f} px off")
    return said


def candidates(outcome: Outcome, project: int = 0) -> List[Dict[str, Any]]:
    """The calibrations that were tried on one project's matches."""
    alignment = outcome.report["subprojects"][project]["alignment"]
    return list(alignment["candidates"]) if alignment else []


def _tail(path: str) -> str:
    return "/".join(path.split("/")[path.split("/").index("images") + 1 :]) if "images" in path.split("/") else path
