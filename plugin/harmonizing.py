"""From a survey to matchable frames in the scratch: tones learned, bands laid on each other, copies written."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, Iterator, List, Mapping, Optional, Sequence, Set, Tuple

from ..stages.assemble import Group, groups_of, left_out, primary_of
from ..stages.finding import Finding
from ..stages.frame import BrokenFrame
from ..stages.harmonize.bands_model import BandPlan
from ..stages.harmonize.model import HarmonizedFrame
from ..stages.progress import Cancel, Progress
from ..stages.record import from_plain
from ..stages.survey import Survey
from .inspection import Inspection
from .odm.names import mask_name, output_names
from .workfolder import WorkFolder

LOG = logging.getLogger("sensorgate.harmonizing")
_KEPT = "bands.json"


@dataclass(frozen=True)
class Harmonized:
    """What the solver gets to see.

    ``inspection`` carries the plan with the learned tables. ``copies`` is
    path -> the frame as it was put into the scratch, ``dropped`` path ->
    finding code of survey frames that no project can take, ``groups`` what is
    left of the candidates for projects.
    """

    inspection: Inspection
    groups: Tuple[Group, ...]
    copies: Mapping[str, HarmonizedFrame]
    bands: BandPlan
    dropped: Mapping[str, str]
    findings: Tuple[Finding, ...]


def harmonize(
    inspection: Inspection, folder: WorkFolder, progress: Optional[Progress] = None, cancel: Optional[Cancel] = None
) -> Harmonized:
    """Write every usable frame's copy into the scratch ``folder``; the originals are never touched."""
    survey = inspection.survey
    dropped = left_out(survey)
    inspection, findings = _learn_radiometry(inspection, progress, cancel)
    bands, said = _plan_bands(inspection, folder, dropped, progress, cancel)
    findings.extend(said)
    dropped.update({path: "band-capture-mismatch" for rig in bands.rigs for path in rig.mismatched})
    groups = groups_of(survey, {rig.payload: rig.refused for rig in bands.rigs})
    wanted = sorted(path for group in groups for path in group.frames if path not in dropped)
    copies, failed = _write(inspection, folder, bands, wanted, progress, cancel)
    for item in failed:
        dropped[item.path] = item.code
        findings.append(_failed(item))
    findings.extend(kept_native(copies))
    dropped.update(_orphaned(groups, survey, copies))
    left = (_left_of(group, copies, dropped) for group in groups)
    return Harmonized(inspection, tuple(g for g in left if g.frames), copies, bands, dropped, tuple(findings))


def _learn_radiometry(
    inspection: Inspection, progress: Optional[Progress], cancel: Optional[Cancel]
) -> Tuple[Inspection, List[Finding]]:
    """Learn channel tables from ground that two profiles share, and plan again with them."""
    from ..stages.harmonize import learn_luts, plan

    survey, settings = inspection.survey, inspection.settings
    usable = [f for f in survey.frames if f.excluded is None]
    files = survey.file_of()
    luts, findings = learn_luts(
        usable,
        files,
        {f.path: Path(f.path) for f in usable},
        survey.profiles,
        survey.flights,
        settings.thresholds,
        progress=progress,
        cancel=cancel,
    )
    planned, _ = plan(
        usable,
        files,
        survey.profiles,
        survey.flights,
        settings.thresholds,
        gsd_target=settings.gsd_target,
        luts=luts,
    )
    return replace(inspection, assessed=replace(inspection.assessed, plan=planned)), list(findings)


def _plan_bands(
    inspection: Inspection,
    folder: WorkFolder,
    dropped: Mapping[str, str],
    progress: Optional[Progress],
    cancel: Optional[Cancel],
) -> Tuple[BandPlan, Tuple[Finding, ...]]:
    """How the bands of every rig come onto its primary, or what an interrupted run found of it."""
    survey, settings = inspection.survey, inspection.settings
    if settings.control_points is None and all(len(p.profiles) < 2 for p in survey.payloads):
        return BandPlan(), ()
    from ..stages.harmonize.bands import plan_bands
    from ..stages.harmonize.control_points import read_control_points

    control = read_control_points(settings.control_points, settings.thresholds) if settings.control_points else ()
    kept = folder.load(_KEPT)
    if isinstance(kept, dict):
        try:
            said = tuple(from_plain(Finding, f) for f in kept["findings"])
            return from_plain(BandPlan, kept["plan"]), said
        except (TypeError, ValueError, KeyError):
            LOG.info("%s of the interrupted run does not fit; measuring again", _KEPT)
    planned, said = plan_bands(
        [replace(f, excluded=f.excluded or dropped.get(f.path)) for f in survey.frames],
        survey.file_of(),
        [replace(p, primary=primary_of(survey, p)) for p in survey.payloads],
        {f.path: Path(f.path) for f in survey.frames},
        settings.thresholds,
        control=control,
        progress=progress,
        cancel=cancel,
    )
    folder.keep(_KEPT, {"plan": planned, "findings": said})
    return planned, said


def _write(
    inspection: Inspection,
    folder: WorkFolder,
    bands: BandPlan,
    wanted: Sequence[str],
    progress: Optional[Progress],
    cancel: Optional[Cancel],
) -> Tuple[Dict[str, HarmonizedFrame], Tuple[BrokenFrame, ...]]:
    """Frames as the plan says, then the bands on the grid of their primaries' copies."""
    from ..stages.harmonize import apply
    from ..stages.harmonize.bands_apply import apply_bands

    survey, limits = inspection.survey, inspection.settings.thresholds
    files = survey.file_of()
    payload_of = {f.path: f.payload for f in survey.frames}
    names = output_names({path: payload_of[path] for path in wanted})
    images = folder.folder("images")
    warped = set(bands.warped()) & set(wanted)
    straight = [path for path in wanted if path not in warped]
    keep = set(straight)
    plan = inspection.assessed.plan
    actions = (replace(a, frames=tuple(p for p in a.frames if p in keep)) for a in plan.actions)
    done, failed = apply(
        replace(plan, actions=tuple(a for a in actions if a.frames)),
        files,
        {path: Path(path) for path in straight},
        {path: images / names[path] for path in straight},
        thresholds=limits,
        journal=folder.scratch / "harmonized.json",
        masks={
            path: (Path(mask), images / mask_name(names[path], Path(mask).name))
            for path, mask in inspection.masks.items()
            if path in keep
        },
        progress=progress,
        cancel=cancel,
    )
    laid, lost = apply_bands(
        bands,
        survey.frames,
        files,
        {f.path: Path(f.path) for f in survey.frames},
        {path: images / names[path] for path in sorted(warped)},
        thresholds=limits,
        actions=plan.actions,
        sizes={h.path: (h.width, h.height) for h in done},
        journal=folder.scratch / "warped.json",
        progress=progress,
        cancel=cancel,
    )
    return {h.path: h for h in (*done, *laid)}, (*failed, *lost)


def _failed(item: BrokenFrame) -> Finding:
    return Finding(
        code=item.code,
        severity="error",
        subjects=(item.path,),
        message=f"{item.path.rsplit('/', 1)[-1]}: {item.message}",
        remedy="Copy the file from the card again and run once more with --resume.",
    )


def kept_native(copies: Mapping[str, HarmonizedFrame]) -> Iterator[Finding]:
    """Frames that should have been changed but are of a kind that is not rewritten: they go in as they are."""
    by_code: Dict[str, List[str]] = {}
    for path in sorted(copies):
        if copies[path].kept:
            by_code.setdefault(copies[path].kept, []).append(path)
    for code, paths in sorted(by_code.items()):
        yield Finding(
            code=code,
            severity="warning",
            subjects=tuple(paths),
            message=f"{len(paths)} frames are of a kind of file that is not rewritten; they go in as they are.",
            remedy="Save them as plain TIFF or JPEG with their tags, if they are to be harmonized too.",
        )


def _orphaned(groups: Sequence[Group], survey: Survey, copies: Mapping[str, HarmonizedFrame]) -> Dict[str, str]:
    """Bands of a capture whose other bands could not be written."""
    capture = {f.path: (f.payload, f.capture) for f in survey.frames}
    orphans: Dict[str, str] = {}
    for group in groups:
        lost: Set[Tuple[str, str]] = {capture[p] for p in group.frames if p not in copies}
        orphans.update({p: "capture-incomplete" for p in group.frames if p in copies and capture[p] in lost})
    return orphans


def _left_of(group: Group, copies: Mapping[str, HarmonizedFrame], dropped: Mapping[str, str]) -> Group:
    def keep(paths: Sequence[str]) -> Tuple[str, ...]:
        return tuple(p for p in paths if p in copies and p not in dropped)

    return replace(group, frames=keep(group.frames), solver_frames=keep(group.solver_frames))
