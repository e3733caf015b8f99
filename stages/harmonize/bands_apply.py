"""Carry out a band plan: secondary frames written on their primary's grid; primaries are never touched."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from ..frame import BrokenFrame, Frame
from ..profile import THERMAL, SurveyFrame
from ..progress import Cancel, Progress
from ..record import to_plain
from ..thresholds import Thresholds
from .bands_group import band_optics
from .bands_lens import lens_of
from .bands_model import NOTHING, WARP, BandFit, BandPlan
from .bands_work import ALWAYS, NEVER
from .bands_work import WARP as WARP_JOB
from .files import check_targets, remove_stale
from .journal import Journal
from .model import FlightAction, HarmonizedFrame
from .pool import BANDS, run_jobs
from .worker import BROKEN

STAGE = "bands"
PathLike = Union[str, Path]


def apply_bands(
    plan: BandPlan,
    frames: Sequence[SurveyFrame],
    files: Mapping[str, Frame],
    sources: Mapping[str, PathLike],
    targets: Mapping[str, Path],
    *,
    thresholds: Thresholds,
    actions: Sequence[FlightAction] = (),
    sizes: Optional[Mapping[str, Tuple[int, int]]] = None,
    workers: int = 2,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    journal: Optional[PathLike] = None,
) -> Tuple[Tuple[HarmonizedFrame, ...], Tuple[BrokenFrame, ...]]:
    """Warp the plan's frames that ``targets`` names; returns what was written and what could not be, by path.

    ``sources`` are the originals (of the primaries too), ``sizes`` primary
    path -> size of its copy where that was resampled: its bands come out in
    the same size. ``actions`` give the one focal tag of a profile's copies.
    ``journal`` lets a later run keep what this one finished. Raises like
    ``apply``: ``UsageError``, ``OutputError``, ``MissingDependency``,
    ``Cancelled``.
    """
    wanted = set(plan.warped()) & set(targets)
    check_targets(sources.values(), [targets[p] for p in sorted(wanted)])
    record = Journal(journal)
    at = {f.path: f for f in frames}
    action_of = {path: action for action in actions for path in action.frames}
    rigs = {r.payload: r for r in plan.rigs}
    jobs: List[Dict[str, Any]] = []
    for fitted in plan.fits:
        for primary, path in fitted.pairs if fitted.state == WARP else ():
            if path not in wanted:
                continue
            size = (sizes or {}).get(primary, (files[primary].width, files[primary].height))
            tagged = bool(files[path].radiometry) and at[path].spectrum != THERMAL
            way = rigs[fitted.payload].radiometry if tagged else NOTHING
            job = _job(fitted, at[primary], at[path], files, sources, targets[path], size, action_of.get(path))
            jobs.append({**job, "radiometry": way, "known": list(record.known(path))})
    jobs.sort(key=lambda j: str(j["path"]))
    done: Dict[str, HarmonizedFrame] = {}
    broken: Dict[str, BrokenFrame] = {}
    if not jobs:
        return (), ()
    running = run_jobs(jobs, thresholds, task=BANDS, workers=workers, cancel=cancel)
    with record, contextlib.closing(running) as answers:
        for count, (number, answer) in enumerate(answers, 1):
            job = jobs[number]
            if answer["state"] == BROKEN:
                file = files[job["path"]]
                broken[file.path] = BrokenFrame(file.path, file.size_bytes, answer["code"], answer["message"])
                remove_stale(Path(job["target"]))
            else:
                record.note(job["path"], answer["key"], answer["digest"])
                done[job["path"]] = _written(job)
            if progress:
                progress(STAGE, count, len(jobs))
    return tuple(done[p] for p in sorted(done)), tuple(broken[p] for p in sorted(broken))


def _job(
    fitted: BandFit,
    primary: SurveyFrame,
    band: SurveyFrame,
    files: Mapping[str, Frame],
    sources: Mapping[str, PathLike],
    target: Path,
    size: Tuple[int, int],
    action: Optional[FlightAction],
) -> Dict[str, Any]:
    file = files[band.path]
    optics = band_optics(primary, band, files)
    measured = [to_plain(lens_of(files[primary.path], primary.intrinsics)), to_plain(optics.lens)]
    prior = optics.rigs[0] if optics.rigs else np.eye(3)
    focal_mm = action.focal_mm if action is not None and action.focal_mm != file.focal_mm else None
    focal_35mm = action.focal_35mm if action is not None and action.focal_35mm != file.focal_35mm else None
    return {
        "what": WARP_JOB,
        "path": band.path,
        "source": str(sources[band.path]),
        "primary_source": str(sources[primary.path]),
        "target": str(target),
        "size_bytes": file.size_bytes,
        "matrix": list(fitted.matrix),
        "model": fitted.model,
        "lenses": fitted.lenses,
        "primary_lens": to_plain(fitted.primary_lens),
        "band_lens": to_plain(fitted.band_lens),
        "out_width": size[0],
        "out_height": size[1],
        "focal_mm": focal_mm,
        "focal_35mm": focal_35mm,
        "refine": fitted.refine,
        "points": fitted.source,
        "measure_lenses": measured if fitted.refine else [],
        "prior": [float(v) for v in prior.ravel()] if fitted.refine else [],
        "descriptors": ALWAYS if fitted.source == "features" else NEVER,
    }


def _written(job: Mapping[str, Any]) -> HarmonizedFrame:
    target = Path(job["target"])
    scale = job["out_width"] / job["band_lens"]["width"]
    return HarmonizedFrame(job["path"], str(target), target.name, job["out_width"], job["out_height"], scale, "warped")
