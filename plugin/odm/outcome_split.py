"""A split run summed up: ODM solves its parts by themselves and lays them together, so each is judged alone (pure).

Parts overlap. A payload holds where it holds in every part that has enough
of its frames to say so, and fails where it fails in one.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Mapping, Sequence, Tuple

from ...stages.align.judge import FAIL, PASS, UNPROVEN, overall
from ...stages.align.model import AlignedFrame, AlignmentReport, PayloadAlignment
from ...stages.thresholds import Thresholds
from .outcome_frames import ProjectFrames
from .outcome_model import Outcome, SubmodelOutcome
from .outcome_read import RunLog
from .outcome_route import payload_routes, route_of

SUBMODELS = "submodels"
_PART = "submodel_"

Parts = Sequence[Tuple[str, Outcome]]


def submodels_of(folder: Path, limits: Thresholds) -> Tuple[str, ...]:
    """Names of the parts of a split run that are still in the folder, sorted."""
    try:
        found = sorted(p.name for p in (folder / SUBMODELS).iterdir() if p.name.startswith(_PART))
    except OSError:
        return ()
    return tuple(n for n in found if (folder / SUBMODELS / n / "opensfm").is_dir())[: limits.outcome_max_models]


def summed(whole: Outcome, parts: Parts, log: RunLog, project: ProjectFrames, limits: Thresholds) -> Outcome:
    """The outcome of a split run: ``whole`` knows all frames and how the run ended, ``parts`` what was placed."""
    payload_of = {f.path: f.payload for f in project.request.frames}
    placed = [(name, part) for name, part in parts if part.alignment is not None and part.registered]
    reports = [(name, part.alignment) for name, part in placed if part.alignment is not None]
    if whole.alignment is None or not reports:
        return replace(whole, notes=(*whole.notes, *_notes(parts)), submodels=tuple(_record(*p) for p in parts))
    report = _report(whole.alignment, reports, payload_of, limits)
    payloads = payload_routes(report, limits, project.spectra)
    route, reasons = route_of(whole.state, payloads, log, report, project.spectra)
    return replace(
        whole,
        route=route,
        reasons=reasons,
        advice=_advice(placed),
        payloads=payloads,
        alignment=report,
        registered=report.registered,
        components=tuple(sorted((n for _, part in placed for n in part.components), reverse=True)),
        missing=tuple(f.path for f in report.frames if not f.registered),
        cameras=tuple(replace(c, submodel=name) for name, part in placed for c in part.cameras),
        ties_from=placed[0][1].ties_from,
        notes=(*whole.notes, *_notes(parts)),
        submodels=tuple(_record(*p) for p in parts),
    )


def _notes(parts: Parts) -> Tuple[str, ...]:
    return tuple(f"{name}: {note}" for name, part in parts for note in part.notes)


def _record(name: str, part: Outcome) -> SubmodelOutcome:
    return SubmodelOutcome(name, part.state, part.frames, part.registered, part.components, part.alignment)


def _advice(parts: Parts) -> Tuple[str, ...]:
    """What can be done, with the parts that it was found in."""
    found: Dict[str, List[str]] = {}
    for name, part in parts:
        for text in part.advice:
            found.setdefault(text, []).append(name)
    return tuple(f"In {', '.join(names)}: {text}" for text, names in found.items())


def _report(
    whole: AlignmentReport,
    parts: Sequence[Tuple[str, AlignmentReport]],
    payload_of: Mapping[str, str],
    limits: Thresholds,
) -> AlignmentReport:
    """One report of all parts. Each part is a piece by design; more pieces than parts are a failure of one."""
    frames: Dict[str, AlignedFrame] = {f.path: AlignedFrame(f.path, False) for f in whole.frames}
    first = 0
    for _, report in parts:
        for frame in report.frames:
            if frame.registered and frame.path in frames and not frames[frame.path].registered:
                frames[frame.path] = replace(frame, component=first + (frame.component or 0))
        first += report.components
    largest = max((report for _, report in parts), key=lambda r: r.registered)
    placed = Counter(payload_of.get(f.path, "") for f in frames.values() if f.registered)
    main = {f.path for _, r in parts for f in r.frames if f.component == 0}
    inside = Counter(payload_of.get(path, "") for path in main)
    payloads = tuple(
        replace(
            _payload(p, parts, placed[p.payload], limits),
            frames=p.frames,
            registered=placed[p.payload],
            in_main_component=inside[p.payload],
        )
        for p in whole.payloads
    )
    weighed = [(r.mean_reproj_error_px, r.registered) for _, r in parts if r.mean_reproj_error_px is not None]
    total = sum(n for _, n in weighed)
    solved = {c.profile: c for _, r in reversed(parts) for c in r.cameras if c.frames}
    return replace(
        whole,
        engine=largest.engine,
        frames=tuple(frames[path] for path in sorted(frames)),
        registered=sum(f.registered for f in frames.values()),
        components=first,
        areas=sum(r.areas for _, r in parts),
        mean_reproj_error_px=round(sum(e * n for e, n in weighed) / total, 4) if total else None,
        anchor=largest.anchor,
        gps=largest.gps,
        height_m=largest.height_m,
        bowing=largest.bowing,
        payloads=payloads,
        cameras=tuple(solved[p] for p in sorted(solved)),
        pairs=tuple(sorted({p for _, r in parts for p in r.pairs}, key=lambda p: (p.a, p.b))),
        pairs_tried=sum(r.pairs_tried for _, r in parts),
        median_inliers=largest.median_inliers,
        control=largest.control,
        verdict=overall(payloads),
    )


def _payload(
    whole: PayloadAlignment, parts: Sequence[Tuple[str, AlignmentReport]], placed: int, limits: Thresholds
) -> PayloadAlignment:
    """One payload over all parts, which placed so many of its frames: by its worst part among those that can tell."""
    mine = [(name, p) for name, report in parts for p in report.payloads if p.payload == whole.payload]
    telling = [(name, p) for name, p in mine if p.frames >= limits.min_proof_frames] or mine
    if not telling:
        return whole
    verdicts = {p.verdict for _, p in telling}
    verdict = FAIL if FAIL in verdicts else UNPROVEN if UNPROVEN in verdicts else PASS
    bad = [(name, p) for name, p in telling if p.verdict == verdict]
    shown = max(bad, key=lambda x: x[1].registered)[1]
    if placed < limits.min_registered_share * whole.frames:
        return replace(shown, verdict=FAIL, reasons=(f"{placed} of its {whole.frames} frames are in any part",))
    if verdict == PASS:
        reasons = (f"holds in {len(telling)} of {len(parts)} parts of the run", *shown.reasons)
    else:
        reasons = tuple(f"in {name}: {reason}" for name, p in bad for reason in p.reasons)
    return replace(
        shown,
        verdict=verdict,
        reasons=reasons,
        close=any(p.close for _, p in telling),
    )
