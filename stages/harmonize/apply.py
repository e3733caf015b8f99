"""Carry out a plan: every frame linked, retagged or resampled into its project folder.

Frames that nothing changes are hard-linked and never re-encoded. What was
finished is recognised by content: the journal holds, per frame, a digest of the
source with all settings and a digest of the output.
"""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, TextIO, Tuple, Union

from ..errors import SensorgateError, UsageError
from ..frame import BrokenFrame, Frame
from ..progress import Cancel, Progress, check
from ..thresholds import Thresholds
from .files import OutputError, output_error, put_link
from .model import FlightAction, HarmonizedFrame, HarmonizePlan
from .plan import scaled_size
from .pool import run_jobs
from .resample import missing_opencv
from .work import MASK, RETAG, REWRITE, FrameJob

STAGE = "harmonize"
PathLike = Union[str, Path]
_MASK_SUFFIX = " (mask)"


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
    that no action names (panels) are linked. ``journal`` is a file that lets a
    later run keep what this one finished. ``masks`` is frame path -> (file,
    target): they follow their frame's size, nearest neighbour.

    Raises ``UsageError`` where a target is an original or is named twice,
    ``OutputError`` (a ``UsageError``) for a full or read-only disk,
    ``MissingDependency`` without OpenCV where pixels must change,
    ``Cancelled``.
    """
    _check_targets(sources, targets, masks or {})
    action_of = {path: action for action in plan.actions for path in action.frames}
    tables = {lut.id: lut.tables for lut in plan.luts}
    known = _read_journal(journal)
    done: Dict[str, HarmonizedFrame] = {}
    broken: Dict[str, BrokenFrame] = {}
    links: List[Tuple[str, PathLike, Path]] = []
    jobs: List[FrameJob] = []
    for path in sorted(targets):
        frame, action = frames[path], action_of.get(path)
        job = _job(frame, action, tables, sources[path], targets[path], known)
        if job is None:
            links.append((path, sources[path], targets[path]))
        else:
            jobs.append(job)
        if masks and path in masks:
            mask, place = masks[path]
            size = _size(frame, action)
            if size == (frame.width, frame.height):
                links.append((path + _MASK_SUFFIX, mask, place))
            else:
                jobs.append(_mask_job(frame, size, mask, place, known))
    total = len(links) + len(jobs)
    count = 0
    for path, source, target in links:
        check(cancel)
        try:
            how = put_link(source, target, link=link)
        except FileNotFoundError:
            broken[path] = _vanished(path, frames)
        else:
            if path in targets:
                done[path] = _harmonized(frames[path], action_of.get(path), target, how)
        count += 1
        if progress:
            progress(STAGE, count, total)
    if jobs:
        with contextlib.ExitStack() as stack:
            log = _open_journal(journal)
            if log is not None:
                stack.enter_context(log)
            answers = stack.enter_context(
                contextlib.closing(run_jobs(jobs, thresholds, workers=workers, cancel=cancel))
            )
            for job, answer in answers:
                _take(job, answer, frames, action_of, targets, done, broken, log)
                count += 1
                if progress:
                    progress(STAGE, count, total)
    for path in broken:
        if path in targets and os.path.lexists(targets[path]):
            _remove_stale(targets[path])
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
    known: Mapping[str, Tuple[str, ...]],
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
    width_mm = action.sensor_width_mm if frame.focal_plane_x_res is not None else None
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
        known=known.get(frame.path, ()),
    )


def _mask_job(
    frame: Frame, size: Tuple[int, int], source: PathLike, target: Path, known: Mapping[str, Tuple[str, ...]]
) -> FrameJob:
    path = frame.path + _MASK_SUFFIX
    return FrameJob(
        path, str(source), str(target), MASK, 0, frame.width, frame.height, size[0], size[1], known=known.get(path, ())
    )


def _take(
    job: FrameJob,
    answer: Mapping[str, Any],
    frames: Mapping[str, Frame],
    action_of: Mapping[str, FlightAction],
    targets: Mapping[str, Path],
    done: Dict[str, HarmonizedFrame],
    broken: Dict[str, BrokenFrame],
    log: Optional[TextIO],
) -> None:
    """Record one answer; what ends the command is raised."""
    state = answer["state"]
    if state == "missing":
        raise missing_opencv()
    if state == "output":
        raise OutputError(answer["message"])
    if state == "broken":
        size = frames[job.path].size_bytes if job.path in frames else 0
        broken[job.path] = BrokenFrame(job.path, size, answer["code"], answer["message"])
        return
    if state != "ok":
        raise SensorgateError(f"A worker gave an answer that is not understood: {state!r}.")
    if job.known != (answer["key"], answer["digest"]):
        _note(log, (job.path, answer["key"], answer["digest"]))
    if job.path in targets:
        scaled = (job.width, job.height) != (job.out_width, job.out_height)
        how = "retagged" if job.what == RETAG else ("resampled" if scaled else "matched")
        done[job.path] = _harmonized(frames[job.path], action_of.get(job.path), targets[job.path], how)


def _harmonized(frame: Frame, action: Optional[FlightAction], target: Path, how: str) -> HarmonizedFrame:
    width, height = _size(frame, action)
    return HarmonizedFrame(frame.path, str(target), target.name, width, height, width / frame.width, how)


def _vanished(path: str, frames: Mapping[str, Frame]) -> BrokenFrame:
    size = frames[path].size_bytes if path in frames else 0
    return BrokenFrame(path, size, "frame-vanished", "The file was there when the folder was read and is gone now.")


def _remove_stale(target: Path) -> None:
    """Take away what an earlier run put for a frame that cannot be used now."""
    try:
        target.unlink()
    except OSError as error:
        raise output_error(target, error) from None


def _check_targets(
    sources: Mapping[str, PathLike], targets: Mapping[str, Path], masks: Mapping[str, Tuple[PathLike, Path]]
) -> None:
    originals = {os.path.realpath(s) for s in sources.values()} | {os.path.realpath(s) for s, _ in masks.values()}
    seen: Set[str] = set()
    for target in _all_targets(targets, masks):
        # The last name is not followed: a link that stands there is replaced, not written through.
        place = os.path.join(os.path.realpath(target.parent), target.name)
        if place in originals:
            raise UsageError(f"{target} is one of the originals, which are never written. Choose another --out.")
        if os.path.normcase(place) in seen:
            raise UsageError(f"Two frames would become {target}.")
        seen.add(os.path.normcase(place))


def _all_targets(targets: Mapping[str, Path], masks: Mapping[str, Tuple[PathLike, Path]]) -> Sequence[Path]:
    return [targets[p] for p in sorted(targets)] + [masks[p][1] for p in sorted(masks)]


def _read_journal(journal: Optional[PathLike]) -> Dict[str, Tuple[str, ...]]:
    """Path -> (key, output digest) of earlier runs; a line that was cut by a kill is passed over."""
    found: Dict[str, Tuple[str, ...]] = {}
    if journal is None:
        return found
    try:
        text = Path(journal).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return found
    for line in text.splitlines():
        try:
            path, key, digest = json.loads(line)
        except (ValueError, TypeError):
            continue
        if all(isinstance(v, str) for v in (path, key, digest)):
            found[path] = (key, digest)
    return found


def _open_journal(journal: Optional[PathLike]) -> Optional[TextIO]:
    if journal is None:
        return None
    place = Path(journal)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        return open(place, "a", encoding="utf-8", buffering=1)
    except OSError as error:
        raise output_error(place, error) from None


def _note(log: Optional[TextIO], line: Tuple[str, str, str]) -> None:
    """Append one line; the newline in front ends a line that a kill has cut."""
    if log is None:
        return
    try:
        log.write("\n" + json.dumps(line))
        log.flush()
    except OSError as error:
        raise output_error(Path(log.name), error) from None
