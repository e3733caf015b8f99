"""What became of an ODM run, in the terms of the router: the same verdict as the alignment's, and what to do next.

Reads a finished, failed or half-finished project, or what a node sends back of
one. Nothing is written.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Optional, Set, Tuple, Union

import numpy as np

from ...stages.align.judge import FAIL, UNPROVEN
from ...stages.align.model import AlignmentReport
from ...stages.errors import BlockedError, UsageError
from ...stages.thresholds import DEFAULTS, Thresholds
from .opensfm_cameras import OpenSfmCamera
from .opensfm_model import OdmModel
from .outcome_console import FINISHED, NO_RECONSTRUCTION, UNFINISHED, ConsoleOutcome
from .outcome_control import marks_of_project
from .outcome_frames import ProjectFrames, opensfm_folder, project_frames
from .outcome_judge import PlacedFrames, focal_changes, judge_project
from .outcome_model import CameraOutcome, Outcome
from .outcome_read import (
    CONSOLES,
    RunLog,
    feature_side,
    read_figures,
    read_log,
    read_pairs,
    read_placed,
    start_cameras,
)
from .outcome_route import advice_of, payload_routes, route_of
from .outcome_split import SUBMODELS, submodels_of, summed

_SIGNS = ("opensfm", "log.json", "odm_report", "images.json", "reconstruction.json", *CONSOLES)


def read_outcome(folder: Union[str, Path], limits: Thresholds = DEFAULTS) -> Outcome:
    """Read what ODM left in a project folder and judge it; of a split run every part that is still there.

    Raises ``UsageError`` where there is no such folder and ``BlockedError``
    where it holds nothing of ODM. A damaged file is noted and leaves open what
    it would have said.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise UsageError(f"There is no folder {folder}.")
    if not any((folder / name).exists() for name in _SIGNS):
        raise BlockedError(f"{folder} holds nothing that ODM wrote: no opensfm folder, no log.json, no odm_report.")
    whole, log, project = _read(folder, folder, limits)
    parts = [(name, _read(folder / SUBMODELS / name, folder, limits)[0]) for name in submodels_of(folder, limits)]
    if not parts:
        gone = "this was a split run, and its parts are gone: nothing tells how they were placed"
        return replace(whole, notes=(*whole.notes, gone)) if (folder / SUBMODELS).is_dir() else whole
    return summed(whole, parts, log, project, limits)


def _read(folder: Path, home: Path, limits: Thresholds) -> Tuple[Outcome, RunLog, ProjectFrames]:
    """One model's outcome, how its run ended, its frames; ``home`` is the project that a split run's part is of."""
    notes: List[str] = []
    opensfm = opensfm_folder(folder)
    log = read_log(folder, limits, notes)
    figures = read_figures(folder, limits, notes)
    pairs, ties_from = read_pairs(opensfm, limits, notes)
    placed, model = read_placed(folder, figures, limits, pairs is None, notes)
    if pairs is None and model is not None and model.shared:
        pairs, ties_from = model.shared, "shared points"
    start = start_cameras(opensfm, limits, notes)
    camera_of = dict(zip(placed.names, placed.camera_of)) if placed else {}
    project = project_frames(folder, camera_of, {**(placed.cameras if placed else {}), **start}, limits, home)
    report = None
    if project.request.frames:
        report = judge_project(
            project,
            placed,
            pairs,
            engine=f"odm {log.version}".strip(),
            feature_side_px=feature_side(opensfm, limits),
            held=log.held,
            limits=limits,
            marks=marks_of_project(folder, project.request, project.name_of, notes),
            gcp_used=figures.gcp is not None,
        )
        report = _with_console_pieces(report, log.console, placed, model, limits)
        if placed is None:
            report = _never_placed(report, log)
    state = log.state
    if state == UNFINISHED and opensfm == folder and placed is not None:
        state = FINISHED  # a bare OpenSfM data set has no log of ODM's
    cameras = _cameras(project, placed, model, start, limits)
    payloads = payload_routes(report, limits, project.spectra)
    route, reasons = route_of(state, payloads, log, report, project.spectra)
    trusted = frozenset(c.profile for c in project.request.cameras if c.intrinsics.focal_trusted)
    outcome = Outcome(
        state=state,
        route=route,
        reasons=reasons,
        advice=advice_of(report, payloads, cameras, log.console, limits, trusted),
        payloads=payloads,
        alignment=report,
        frames=len(project.request.frames),
        registered=report.registered if report else 0,
        components=_sizes(report, log.console, model),
        missing=tuple(f.path for f in report.frames if not f.registered) if report else (),
        dropped=project.dropped,
        cameras=cameras,
        odm=figures,
        odm_version=log.version,
        stage=log.console.stage,
        error=log.error,
        console=log.console,
        grouped_by=project.grouped_by,
        ties_from=ties_from,
        notes=tuple(dict.fromkeys([*notes, *project.notes, *(placed.notes if placed else ())])),
    )
    return outcome, log, project


def _with_console_pieces(
    report: AlignmentReport,
    console: ConsoleOutcome,
    placed: Optional[PlacedFrames],
    model: Optional[OdmModel],
    limits: Thresholds,
) -> AlignmentReport:
    """Pieces that only the console tells of: which frames are in them is lost, that there are several is not."""
    pieces = console.components or 0
    told = bool(model and model.counted_by) or report.components > 1
    if placed is None or told or pieces <= max(report.components, report.areas):
        return report
    report = replace(report, components=pieces)
    total = sum(console.sizes)
    if total and console.sizes[0] >= limits.min_registered_share * total:
        return report
    said = f"ODM found {pieces} separate reconstructions and laid them by GPS alone"
    payloads = tuple(replace(p, verdict=FAIL, reasons=(said, *p.reasons)) for p in report.payloads)
    return replace(report, payloads=payloads, verdict=FAIL)


def _never_placed(report: AlignmentReport, log: RunLog) -> AlignmentReport:
    """A run that ended before it tried to place a frame says nothing of any payload, and solved no camera."""
    tried = log.console.cause is not None and log.console.cause.code == NO_RECONSTRUCTION
    payloads = report.payloads
    if not tried:
        said = ("ODM ended before it placed any frame",)
        payloads = tuple(replace(p, verdict=UNPROVEN, reasons=said) for p in payloads)
    return replace(report, cameras=(), payloads=payloads, verdict=FAIL if tried else UNPROVEN)


def _sizes(report: Optional[AlignmentReport], console: ConsoleOutcome, model: Optional[OdmModel]) -> Tuple[int, ...]:
    if report is None:
        return console.sizes
    if model is None and len(console.sizes) == report.components > 1:
        return console.sizes
    count: Dict[int, int] = {}
    for frame in report.frames:
        if frame.component is not None:
            count[frame.component] = count.get(frame.component, 0) + 1
    return tuple(sorted(count.values(), reverse=True))


def _cameras(
    project: ProjectFrames,
    placed: Optional[PlacedFrames],
    model: Optional[OdmModel],
    start: Dict[str, OpenSfmCamera],
    limits: Thresholds,
) -> Tuple[CameraOutcome, ...]:
    """Every camera that ODM solved."""
    if placed is None:
        return ()
    changes = focal_changes(placed, start)
    profile = {project.name_of[f.path]: f.profile for f in project.request.frames}
    found = []
    for camera in sorted(changes):
        rows = np.asarray([i for i, c in enumerate(placed.camera_of) if c == camera], dtype=np.int64)
        shared: Set[str] = {profile[placed.names[i]] for i in rows}
        solved = placed.cameras[camera]
        errors = model.errors.figures(rows, limits) if model is not None and model.errors is not None else None
        prior = start.get(camera)
        found.append(
            CameraOutcome(
                id=camera,
                frames=len(rows),
                profiles=tuple(sorted(shared)),
                focal_start=round(prior.focal_ratio, 6) if prior is not None else None,
                focal_solved=round(solved.focal_ratio, 6) if solved.known else None,
                focal_change=changes[camera],
                errors=errors if errors is not None and errors.observations else None,
            )
        )
    return tuple(found)
