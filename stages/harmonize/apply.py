"""Carry out a plan: every frame linked, retagged or resampled into its project folder.

Frames that nothing changes are hard-linked and never re-encoded. What was
finished is recognised by content: the journal holds, per frame, a digest of the
source with all settings and a digest of the output.
"""

from __future__ import annotations

import contextlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple, Union

from ..errors import FrameError
from ..frame import BrokenFrame, Frame
from ..progress import Cancel, Progress, check
from ..thresholds import Thresholds
from .files import check_targets, put_link, remove_stale
from .journal import Journal
from .model import FlightAction, HarmonizedFrame, HarmonizePlan
from .plan import has_empty_plane, scaled_size
from .pool import FRAMES, run_jobs
from .work import MASK, RETAG, REWRITE, FrameJob
from .worker import BROKEN

STAGE = "harmonize"
PathLike = Union[str, Path]
_MASK_SUFFIX = " (mask)"
# Verdicts on what was asked, not on the frame: it is as good as it was and goes in as it is.
_KEPT_NATIVE = {(REWRITE, "pixels-not-supported"), (RETAG, "tags-not-rewritable")}


def apply(
    plan: HarmonizePlan,
    frames: Mapping[str, Frame],
    sources: Mapping[str, PathLike],
    targets: Mapping[str, Path],
    *,
    thresholds: Thresholds,
    workers: int = 2,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    link: bool = True,
    journal: Optional[PathLike] = None,
    masks: Optional[Mapping[str, Tuple[PathLike, Path]]] = None,
) -> Tuple[Tuple[HarmonizedFrame, ...], Tuple[BrokenFrame, ...]]:
    """Put every frame of ``targets`` where it belongs; returns what was put and what could not be, by path.

    ``sources`` and ``targets`` are frame path -> file. Frames of ``targets``
    that no action names (panels) are linked, and so are those whose kind of
    file cannot be rewritten (BigTIFF, rare compressions): ``kept`` says why. ``journal`` is a file that lets a
    later run keep what this one finished. ``masks`` is frame path -> (file,
    target): they follow their frame's size, nearest neighbour.

    Raises ``UsageError`` where a target is an original or is named twice,
    ``OutputError`` (a ``UsageError``) for a full or read-only disk,
    ``MissingDependency`` without OpenCV where pixels must change,
    ``Cancelled``.
    """
    shaded = masks or {}
    check_targets(
        [*sources.values(), *(mask for mask, _ in shaded.values())],
        [*(targets[p] for p in sorted(targets)), *(shaded[p][1] for p in sorted(shaded))],
    )
    action_of = {path: action for action in plan.actions for path in action.frames}
    tables = {lut.id: lut.tables for lut in plan.luts}
    record = Journal(journal)
    done: Dict[str, HarmonizedFrame] = {}
    broken: Dict[str, BrokenFrame] = {}
    links: List[Tuple[str, PathLike, Path]] = []
    jobs: List[FrameJob] = []
    native: Dict[str, str] = {}
    for path in sorted(targets):
        frame, action = frames[path], action_of.get(path)
        job = _job(frame, action, tables, sources[path], targets[path], record)
        if job is None:
            links.append((path, sources[path], targets[path]))
        else:
            jobs.append(job)
        if path in shaded:
            mask, place = shaded[path]
            size = _size(frame, action)
            if size == (frame.width, frame.height):
                links.append((path + _MASK_SUFFIX, mask, place))
            else:
                jobs.append(_mask_job(frame, size, mask, place, record))
    total = len(links) + len(jobs)
    count = 0
    for path, source, target in links:
        check(cancel)
        try:
            how = put_link(source, target, link=link)
        except FileNotFoundError:
            broken[path] = _vanished(path, frames)
        except FrameError as error:
            broken[path] = BrokenFrame(path, _bytes(path, frames), error.code, error.message)
        else:
            if path in targets:
                done[path] = _harmonized(frames[path], action_of.get(path), target, how)
        count += 1
        if progress:
            progress(STAGE, count, total)
    if jobs:
        plain = [asdict(job) for job in jobs]
        running = run_jobs(plain, thresholds, task=FRAMES, workers=workers, cancel=cancel)
        with record, contextlib.closing(running) as answers:
            for number, answer in answers:
                job = jobs[number]
                if (job.what, answer.get("code")) in _KEPT_NATIVE:
                    native[job.path] = answer["code"]
                else:
                    _take(job, answer, frames, action_of, targets, done, broken, record)
                count += 1
                if progress:
                    progress(STAGE, count, total)
    for path in sorted(native):
        check(cancel)
        try:
            how = put_link(sources[path], targets[path], link=link)
            if path in shaded:
                put_link(*shaded[path], link=link)
                broken.pop(path + _MASK_SUFFIX, None)
        except FileNotFoundError:
            broken[path] = _vanished(path, frames)
        except FrameError as error:
            broken[path] = BrokenFrame(path, _bytes(path, frames), error.code, error.message)
        else:
            done[path] = replace(_harmonized(frames[path], None, targets[path], how), kept=native[path])
    for path in broken:
        if path in targets:
            remove_stale(targets[path])
    return tuple(done[p] for p in sorted(done)), tuple(broken[p] for p in sorted(broken))


def _size(frame: Frame, action: Optional[FlightAction]) -> Tuple[int, int]:
    """Size that a frame is written at; a frame of another size than its flight keeps the flight's scale."""
    if action is None or action.scale == 1.0:
        return frame.width, frame.height
    if (frame.width, frame.height) == (action.width, action.height):
        return action.out_width, action.out_height
    return scaled_size(frame.width, frame.height, action.scale)


def _job(
    frame: Frame,
    action: Optional[FlightAction],
    tables: Mapping[str, Tuple[Tuple[int, ...], ...]],
    source: PathLike,
    target: Path,
    record: Journal,
) -> Optional[FrameJob]:
    """What is to be done with a frame; ``None`` when it goes in as it is."""
    if action is None:
        return None
    size = _size(frame, action)
    lut: Tuple[Tuple[int, ...], ...] = ()
    if action.write_lut and action.lut is not None:
        lut = tables[action.lut]
    focal_mm = action.focal_mm if action.focal_mm != frame.focal_mm else None
    focal_35mm = action.focal_35mm if action.focal_35mm != frame.focal_35mm else None
    told = frame.focal_plane_x_res is not None or has_empty_plane(frame)
    width_mm = action.sensor_width_mm if told else None
    pixels = bool(lut) or size != (frame.width, frame.height)
    if not pixels and focal_mm is None and focal_35mm is None and width_mm is None:
        return None
    return FrameJob(
        path=frame.path,
        source=str(source),
        target=str(target),
        what=REWRITE if pixels else RETAG,
        size_bytes=frame.size_bytes,
        width=frame.width,
        height=frame.height,
        out_width=size[0],
        out_height=size[1],
        tables=lut,
        focal_mm=focal_mm,
        focal_35mm=focal_35mm,
        sensor_width_mm=width_mm,
        known=record.known(frame.path),
    )


def _mask_job(frame: Frame, size: Tuple[int, int], source: PathLike, target: Path, record: Journal) -> FrameJob:
    path = frame.path + _MASK_SUFFIX
    return FrameJob(
        path, str(source), str(target), MASK, 0, frame.width, frame.height, size[0], size[1], known=record.known(path)
    )


def _take(
    job: FrameJob,
    answer: Mapping[str, Any],
    frames: Mapping[str, Frame],
    action_of: Mapping[str, FlightAction],
    targets: Mapping[str, Path],
    done: Dict[str, HarmonizedFrame],
    broken: Dict[str, BrokenFrame],
    record: Journal,
) -> None:
    """Record one answer."""
    if answer["state"] == BROKEN:
        broken[job.path] = BrokenFrame(job.path, _bytes(job.path, frames), answer["code"], answer["message"])
        return
    record.note(job.path, answer["key"], answer["digest"])
    if job.path in targets:
        scaled = (job.width, job.height) != (job.out_width, job.out_height)
        how = "retagged" if job.what == RETAG else ("resampled" if scaled else "matched")
        done[job.path] = _harmonized(frames[job.path], action_of.get(job.path), targets[job.path], how)


def _harmonized(frame: Frame, action: Optional[FlightAction], target: Path, how: str) -> HarmonizedFrame:
    width, height = _size(frame, action)
    return HarmonizedFrame(frame.path, str(target), target.name, width, height, width / frame.width, how)


def _vanished(path: str, frames: Mapping[str, Frame]) -> BrokenFrame:
    return BrokenFrame(
        path, _bytes(path, frames), "frame-vanished", "The file was there when the folder was read and is gone now."
    )


def _bytes(path: str, frames: Mapping[str, Frame]) -> int:
    """Size of a frame's file; a mask's is not known."""
    return frames[path].size_bytes if path in frames else 0
