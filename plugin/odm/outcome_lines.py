"""An outcome in a few lines, for somebody who is tired, and as JSON."""

from __future__ import annotations

from typing import Any, Dict, List, Sequence

from ...stages.align.model import PayloadAlignment
from ...stages.record import to_plain
from ...stages.route import ISOLATE, PAIRWISE, PROCEED
from ..report.view import clean_text
from .outcome_console import FAILED, FINISHED
from .outcome_model import CameraOutcome, Outcome, SubmodelOutcome

_SHOWN = 6
_ROUTES = {
    PROCEED: "PROCEED: the payloads belong together.",
    PAIRWISE: "PAIRWISE: part of it must be joined again, payload by payload.",
    ISOLATE: "ISOLATE: part of it needs a project of its own.",
}


def record(outcome: Outcome) -> Dict[str, Any]:
    """The outcome as JSON values."""
    return {"schema_version": 1, "exit_code": outcome.exit_code, **to_plain(outcome)}


def lines(outcome: Outcome, name: str) -> List[str]:
    """What became of the project ``name``, what the router would do, and what a person can do."""
    said = [_headline(outcome, name)]
    said += _placed(outcome)
    said += [_submodel(s) for s in outcome.submodels]
    if outcome.alignment is not None and outcome.registered:
        for payload in outcome.alignment.payloads:
            said.append(_payload(payload))
            said += [f"      {r}" for r in (payload.reasons if payload.verdict != "pass" else ())[:_SHOWN]]
    elif outcome.alignment is not None:
        counts = [f"{p.payload} ({p.frames})" for p in outcome.alignment.payloads]
        said.append(f"  Payloads: {_some(counts)}")
    said += [_camera(c) for c in outcome.cameras]
    control = outcome.alignment.control if outcome.alignment is not None else None
    if control is not None:
        said.append(f"  Ground control, laid on the solved cameras: {control.text}")
    if outcome.odm.gcp is not None and outcome.odm.gcp.mean_m is not None:
        points = f"{outcome.odm.gcp.points} points, " if outcome.odm.gcp.points else ""
        said.append(f"  Ground control by ODM's report: {points}{outcome.odm.gcp.mean_m:.3f} m after the adjustment")
    said += ["", f"Route: {_route(outcome)}"]
    said += [f"  {r}" for r in outcome.reasons[:_SHOWN]] if outcome.route != PROCEED else []
    if outcome.advice:
        said += ["", "What to do:", *(f"  - {a}" for a in outcome.advice)]
    if outcome.notes:
        said += ["", "Not everything could be read:", *(f"  - {n}" for n in outcome.notes[:_SHOWN])]
        if len(outcome.notes) > _SHOWN:
            said.append(f"  - and {len(outcome.notes) - _SHOWN} more (--json has all)")
    return [clean_text(line) for line in said]


def _route(outcome: Outcome) -> str:
    if outcome.route in _ROUTES:
        return _ROUTES[outcome.route]
    failed = any(p.verdict == "fail" for p in outcome.payloads)
    return "UNPROVEN: " + (
        "it does not hold, and there is no payload to take away."
        if failed
        else "nothing in this folder proves it, and nothing speaks for another route."
    )


def _headline(outcome: Outcome, name: str) -> str:
    version = f" {outcome.odm_version}" if outcome.odm_version else ""
    if outcome.state == FINISHED:
        return f"{name}: ODM{version} finished."
    where = f" in its {outcome.stage} stage" if outcome.stage else ""
    ended = "failed" if outcome.state == FAILED else "has not finished; it stopped or still works"
    return f"{name}: ODM{version} {ended}{where}."


def _submodel(part: SubmodelOutcome) -> str:
    verdict = f", {part.alignment.verdict}" if part.alignment is not None and part.registered else ""
    pieces = f" in {len(part.components)} pieces" if len(part.components) > 1 else ""
    return f"  Part {part.name}: {part.registered} of {part.frames} frames placed{pieces}{verdict}"


def _placed(outcome: Outcome) -> List[str]:
    if not outcome.frames:
        return ["  No list of frames is in this folder."]
    pieces = len(outcome.components)
    text = f"  {outcome.registered} of {outcome.frames} frames placed"
    if outcome.submodels:
        text += f", in {len(outcome.submodels)} parts that ODM split the run into"
    elif pieces > 1:
        text += f", in {pieces} separate pieces of {', '.join(map(str, outcome.components[:_SHOWN]))} frames"
        text += " (ODM's report says 1)" if outcome.odm.components == 1 else ""
    found = [text]
    if outcome.missing and outcome.registered:
        found.append(f"  Not placed: {_some(outcome.missing)}")
    if outcome.dropped:
        found.append(f"  Never taken by ODM: {_some(outcome.dropped)}")
    return found


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more


def _payload(p: PayloadAlignment) -> str:
    parts = [f"{p.in_main_component}/{p.frames} frames"]
    if p.mean_reproj_error_px is not None:
        parts.append(f"{p.mean_reproj_error_px:.2f} px")
    if p.together.horizontal_m is not None:
        parts.append(f"{p.together.horizontal_m:.2f} m off its GPS")
    if p.bowing.bowing_m is not None and p.bowing.se_m is not None:
        parts.append(f"bow {p.bowing.bowing_m:+.2f} ± {p.bowing.se_m:.2f} m")
    if p.cross_pairs:
        parts.append(f"{p.strong_cross_pairs} strong ties")
    return f"  {p.verdict.upper():9}{p.payload}: {', '.join(parts)}"


def _camera(c: CameraOutcome) -> str:
    where = f" in {c.submodel}" if c.submodel else ""
    text = f"  Camera {c.id}{where}: {c.frames} frames"
    if c.focal_solved is not None:
        text += f", focal {c.focal_solved:.4f}"
        text += f" ({100 * c.focal_change:+.2f} % from its start)" if c.focal_change is not None else ""
    if c.errors is not None and c.errors.mean_px is not None and c.errors.beyond is not None:
        text += f", {c.errors.mean_px:.2f} px, {100 * c.errors.beyond:.0f} % of its ties beyond ODM's cut of 4 px"
    return text
