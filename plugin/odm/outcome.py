"""What became of an ODM run, in the terms of the router: the same verdict as the alignment's, and what to do next.

Reads a finished, failed or half-finished project, or what a node sends back of
one. Nothing is written.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, FrozenSet, List, Optional, Sequence, Set, Tuple, Union

import numpy as np

from ...stages.align.fit import called
from ...stages.align.judge import FAIL, PASS, UNPROVEN
from ...stages.align.model import AlignmentReport, PayloadAlignment
from ...stages.errors import BlockedError, UsageError
from ...stages.route import ISOLATE, PAIRWISE, PROCEED
from ...stages.thresholds import DEFAULTS, Thresholds
from .opensfm_cameras import OpenSfmCamera
from .opensfm_errors import ErrorFigures
from .opensfm_model import OdmModel
from .outcome_console import FAILED, FINISHED, NO_RECONSTRUCTION, UNFINISHED, ConsoleOutcome
from .outcome_control import marks_of_project
from .outcome_frames import ProjectFrames, opensfm_folder, project_frames
from .outcome_judge import PlacedFrames, focal_changes, judge_project
from .outcome_read import (
    CONSOLES,
    OdmFigures,
    RunLog,
    feature_side,
    read_figures,
    read_log,
    read_pairs,
    read_placed,
    start_cameras,
)

_SIGNS = ("opensfm", "log.json", "odm_report", "images.json", "reconstruction.json", *CONSOLES)


@dataclass(frozen=True)
class CameraOutcome:
    """One camera of ODM's: who shared it, how far its focal moved, its errors (``None`` without tracks)."""

    id: str
    frames: int
    profiles: Tuple[str, ...]
    focal_start: Optional[float]
    focal_solved: Optional[float]
    focal_change: Optional[float]
    errors: Optional[ErrorFigures]


@dataclass(frozen=True)
class PayloadRoute:
    """What the router would do with one payload."""

    payload: str
    verdict: str
    route: str
    reasons: Tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """A run judged.

    ``state`` is ``finished``, ``failed`` or ``unfinished``; ``route`` what the
    router would do: ``proceed``, ``pairwise``, ``isolate`` or ``unproven``
    (nothing proves it, or there is nobody to separate). ``alignment`` is the
    verdict in the alignment's own type, ``None`` where ODM named no frame.
    ``components`` are the frames of each true piece, the largest first.
    ``missing`` frames were given to ODM and not placed, ``dropped`` ones it
    never took. ``ties_from`` says what the ties were counted by.
    """

    state: str
    route: str
    reasons: Tuple[str, ...]
    advice: Tuple[str, ...]
    payloads: Tuple[PayloadRoute, ...]
    alignment: Optional[AlignmentReport]
    frames: int
    registered: int
    components: Tuple[int, ...]
    missing: Tuple[str, ...]
    dropped: Tuple[str, ...]
    cameras: Tuple[CameraOutcome, ...]
    odm: OdmFigures
    odm_version: str
    stage: str
    error: str
    console: ConsoleOutcome
    grouped_by: str
    ties_from: str
    notes: Tuple[str, ...]

    @property
    def exit_code(self) -> int:
        """0 done, 1 rerouted, unproven or failed."""
        return 0 if self.state == FINISHED and self.route == PROCEED else 1


def read_outcome(folder: Union[str, Path], limits: Thresholds = DEFAULTS) -> Outcome:
    """Read what ODM left in a project folder and judge it.

    Raises ``UsageError`` where there is no such folder and ``BlockedError``
    where it holds nothing of ODM. A damaged file is noted and leaves open what
    it would have said.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise UsageError(f"There is no folder {folder}.")
    if not any((folder / name).exists() for name in _SIGNS):
        raise BlockedError(f"{folder} holds nothing that ODM wrote: no opensfm folder, no log.json, no odm_report.")
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
    project = project_frames(folder, camera_of, {**(placed.cameras if placed else {}), **start}, limits)
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
    if (folder / "submodels").is_dir():
        notes.append("this was a split run: read each folder below submodels/ by itself")
    cameras = _cameras(project, placed, model, start, limits)
    payloads = payload_routes(report)
    route, reasons = route_of(state, payloads, log, report)
    trusted = frozenset(c.profile for c in project.request.cameras if c.intrinsics.focal_trusted)
    return Outcome(
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


def payload_routes(report: Optional[AlignmentReport]) -> Tuple[PayloadRoute, ...]:
    """What the router would do with each payload (pure).

    A refused payload beside one that stands is tried pairwise where it has
    any verified pair, else isolated; where nothing stands, every payload goes
    alone. A payload by itself has nobody to be separated from.
    """
    if report is None:
        return ()
    several = len(report.payloads) > 1
    verdicts = {p.verdict for p in report.payloads}
    stands = PASS in verdicts or (UNPROVEN in verdicts and FAIL in verdicts)

    def route(p: PayloadAlignment) -> str:
        if p.verdict == PASS:
            return PROCEED
        if not several:
            return UNPROVEN
        if p.verdict == UNPROVEN:
            return ISOLATE if PASS in verdicts else UNPROVEN
        return PAIRWISE if stands and p.cross_pairs else ISOLATE

    return tuple(PayloadRoute(p.payload, p.verdict, route(p), p.reasons) for p in report.payloads)


def route_of(
    state: str, payloads: Sequence[PayloadRoute], log: RunLog, report: Optional[AlignmentReport]
) -> Tuple[str, Tuple[str, ...]]:
    """The route of the whole project and its reasons (pure)."""
    placed = report is not None and report.registered > 0
    if placed:
        for route in (PAIRWISE, ISOLATE, UNPROVEN):
            mine = [p for p in payloads if p.route == route]
            if mine:
                reasons = tuple(f"{p.payload}: {r}" for p in mine for r in p.reasons[:2])
                return route, _ended(state, log) + reasons
        if state == FINISHED:
            return PROCEED, tuple(f"{p.payload}: {r}" for p in payloads for r in p.reasons)
        if state == FAILED and log.console.cause is None:
            return UNPROVEN, (*_ended(state, log), "its frames were placed well: mixing cameras is not the cause")
    cause = log.console.cause
    several = len(payloads) > 1
    if cause is not None:
        route = cause.route if several and cause.route else UNPROVEN
        return route, _ended(state, log)
    if not placed and several and log.console.stage == "opensfm" and state == FAILED:
        return PAIRWISE, _ended(state, log)
    return UNPROVEN, _ended(state, log) or ("no reconstruction is in this folder",)


def _ended(state: str, log: RunLog) -> Tuple[str, ...]:
    """How a run that did not finish ended, in one sentence."""
    if state == FINISHED:
        return ()
    where = f" in its {log.console.stage} stage" if log.console.stage else ""
    if state == UNFINISHED:
        return (f"ODM has not finished: it stopped or still works{where}",)
    cause = log.console.cause
    if cause is not None:
        return (f"ODM failed{where}: {cause.message}",)
    words = log.error or log.console.last
    return (f"ODM failed{where}" + (f"; its last words: {words[:160]}" if words else ""),)


def advice_of(
    report: Optional[AlignmentReport],
    payloads: Sequence[PayloadRoute],
    cameras: Sequence[CameraOutcome],
    console: ConsoleOutcome,
    limits: Thresholds,
    trusted: FrozenSet[str] = frozenset(),
) -> Tuple[str, ...]:
    """What a person can do, most useful first (pure); ``trusted`` are profiles whose calibration is known."""
    said: List[str] = []
    for fact in console.facts:
        if fact.remedy:
            said.append(f"{fact.message}: {fact.remedy}")
    routes = {p.payload: p.route for p in payloads}
    for p in report.payloads if report else ():
        if routes[p.payload] == PAIRWISE:
            said.append(
                f"{p.payload}: join it pairwise to {_standing(payloads)}, with ground control where there is any "
                "(sensorgate run --gcp FILE)."
            )
        elif routes[p.payload] == ISOLATE:
            said.append(f"{p.payload}: give it its own project (sensorgate run does).")
        if p.verdict == FAIL and _fits(p, limits) and len(payloads) > 1:
            said.append(
                f"{p.payload} holds by itself and lies apart from the rest: run it alone and lay it on the other "
                "result with ODM's align option."
            )
        if p.gps_offset_m is not None:
            said.append(f"{p.payload}: its positions are shifted; correct them in geo.txt before fusing.")
    if report and called(report.bowing, limits.bowing_sigma):
        said.append(
            f"The block bows by {report.bowing.bowing_m:+.2f} m: hold the cameras at a known calibration "
            "(sensorgate run chooses one), or add cross strips and ground control."
        )
    for solved in report.cameras if report else ():
        off = solved.prior_change
        if solved.profile in trusted and solved.frames and off is not None and abs(off) > limits.outcome_focal_change:
            said.append(
                f"The focal length that ODM used for {solved.profile} is {100 * off:+.1f} % off its calibration: "
                "heights and areas are wrong by as much. sensorgate run hands ODM the right one."
            )
    for camera in cameras:
        if camera.focal_change is not None and abs(camera.focal_change) > limits.outcome_focal_change:
            said.append(
                f"ODM moved the focal length of {camera.id} by {100 * camera.focal_change:+.1f} %: give it a "
                "calibration, or check its tags with sensorgate gate."
            )
        if len(camera.profiles) > 1:
            said.append(
                f"ODM solved {' and '.join(camera.profiles)} as one camera ({camera.id}): sensorgate run tells them "
                "apart."
            )
    if report and len(payloads) == 1 and payloads[0].verdict == FAIL and not console.facts:
        said.append(
            "There is one payload, so separating helps nothing: try feature-quality high with min-num-features "
            "20000, or fly with more overlap."
        )
    return tuple(dict.fromkeys(said))


def _standing(payloads: Sequence[PayloadRoute]) -> str:
    names = [p.payload for p in payloads if p.route == PROCEED] or [p.payload for p in payloads if p.verdict != FAIL]
    return names[0] if names else "the largest"


def _fits(p: PayloadAlignment, limits: Thresholds) -> bool:
    """Whether a payload's own fit is within its limit."""
    fit = p.alone
    if fit.horizontal_m is None or fit.sigma_horizontal_m is None or fit.collinear:
        return False
    return fit.horizontal_m <= limits.gps_sigma_factor * fit.sigma_horizontal_m


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
