"""What the router would do after an ODM run, why, and what a person can do (pure)."""

from __future__ import annotations

from typing import FrozenSet, List, Mapping, Optional, Sequence, Tuple

from ...stages.align.fit import called
from ...stages.align.judge import FAIL, PASS, UNPROVEN
from ...stages.align.model import AlignmentReport, PayloadAlignment
from ...stages.route import ISOLATE, PAIRWISE, PROCEED
from ...stages.thresholds import Thresholds
from .outcome_console import FAILED, FINISHED, UNFINISHED, ConsoleOutcome
from .outcome_model import CameraOutcome, PayloadRoute
from .outcome_read import RunLog


def payload_routes(
    report: Optional[AlignmentReport], limits: Thresholds, spectra: Mapping[str, str]
) -> Tuple[PayloadRoute, ...]:
    """What the router would do with each payload (pure).

    A refused payload beside one that stands is tried pairwise where it has
    any verified pair, else isolated; where nothing stands, every payload goes
    alone. A payload beside which no other has frames enough to stand has
    nobody to be separated from: its trouble is its own. Payloads of two
    spectra (``spectra`` is payload -> spectrum) are parted, never joined.
    """
    if report is None:
        return ()
    passes = any(p.verdict == PASS for p in report.payloads)

    def route(p: PayloadAlignment) -> str:
        own = spectra.get(p.payload)
        strangers = [q for q in report.payloads if own and spectra.get(q.payload, own) != own]
        others = [q for q in _able(report, limits) if q is not p and q not in strangers]
        if p.verdict == PASS:
            return PROCEED
        if strangers:
            return ISOLATE
        if p.verdict == UNPROVEN:
            return ISOLATE if passes else UNPROVEN
        if not others:
            return UNPROVEN
        return PAIRWISE if p.cross_pairs and any(q.verdict != FAIL for q in others) else ISOLATE

    return tuple(PayloadRoute(p.payload, p.verdict, route(p), p.reasons) for p in report.payloads)


def _able(report: AlignmentReport, limits: Thresholds) -> List[PayloadAlignment]:
    """Payloads with frames enough to stand by themselves."""
    return [p for p in report.payloads if p.verdict == PASS or p.frames >= limits.min_proof_frames]


def route_of(
    state: str,
    payloads: Sequence[PayloadRoute],
    log: RunLog,
    report: Optional[AlignmentReport],
    spectra: Mapping[str, str],
) -> Tuple[str, Tuple[str, ...]]:
    """The route of the whole project and its reasons (pure)."""
    placed = report is not None and report.registered > 0
    mixed = sorted({spectra[p.payload] for p in payloads if p.payload in spectra})
    if len(mixed) > 1:
        said = f"frames of {len(mixed)} spectra share the project ({', '.join(mixed)}): no solver matches across them"
        return ISOLATE, (*_ended(state, log), said, *(f"{p.payload}: {r}" for p in payloads for r in p.reasons[:2]))
    if placed:
        for route in (PAIRWISE, ISOLATE, UNPROVEN):
            mine = sorted((p for p in payloads if p.route == route), key=lambda p: p.verdict != FAIL)
            if mine:
                reasons = tuple(f"{p.payload}: {r}" for p in mine for r in p.reasons[:2])
                return route, _ended(state, log) + reasons
        if state == FINISHED and report is not None and report.components > report.areas:
            where = f"{report.areas} places" if report.areas > 1 else "one place"
            said = f"ODM made {report.components} separate pieces of {where}; only their GPS lays them together"
            return UNPROVEN, (said, *(f"{p.payload}: {r}" for p in payloads for r in p.reasons))
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
                f"{p.payload}: join it pairwise to {_standing(report, p, limits)}, with ground control where there is "
                "any (sensorgate run --gcp FILE)."
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
    if report and report.registered and report.areas > 1:
        said.append(
            f"The frames lie over {report.areas} places that cannot overlap: give each its own project (sensorgate run "
            "does); ODM lays them on one map by GPS alone."
        )
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
                "heights and areas are wrong by as much. Give ODM its calibration and hold it."
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
    for p in report.payloads if report else ():
        if p.verdict != FAIL or routes[p.payload] != UNPROVEN:
            continue
        if p.in_main_component < (1.0 - limits.unplaced_share) * p.frames:
            said.append(
                f"{p.payload}: separating helps nothing, its frames do not hold together by themselves. Try "
                "feature-quality high with min-num-features 20000, or fly with more overlap."
            )
        else:
            said.append(
                f"{p.payload}: its frames hold together, but the model contradicts what was measured. Check its "
                "positions, its control points and its focal length."
            )
    return tuple(dict.fromkeys(said))


def _standing(report: Optional[AlignmentReport], payload: PayloadAlignment, limits: Thresholds) -> str:
    """The payload that another is to be joined to: one that passed, the largest of them."""
    others = [p for p in _able(report, limits) if p is not payload and p.verdict != FAIL] if report else []
    best = min(others, key=lambda p: (p.verdict != PASS, -p.registered, p.payload), default=None)
    return best.payload if best is not None else "the largest"


def _fits(p: PayloadAlignment, limits: Thresholds) -> bool:
    """Whether a payload holds by itself: in one piece, its pixels and its GPS fit within their limits."""
    fit, error = p.alone, p.mean_reproj_error_px
    if fit.horizontal_m is None or fit.sigma_horizontal_m is None or fit.collinear:
        return False
    if fit.frames < limits.min_registered_share * p.frames or error is None or error > limits.max_reproj_error_px:
        return False
    return fit.horizontal_m <= limits.gps_sigma_factor * fit.sigma_horizontal_m
