"""Rules about files: what cannot be read, what is left out, what is damaged."""

from __future__ import annotations

from collections import defaultdict
from typing import Dict, Iterator, List, Tuple

from ..captures import seconds
from ..finding import ERROR, INFO, WARNING, Finding
from ..survey import Survey
from ..thresholds import Thresholds
from .text import named, plural

# Problems of a header that a healthy camera does not write; the others are oddities of makers.
_DAMAGE = {
    "exif-damaged": "their Exif block points outside of the file",
    "xmp-malformed": "their XMP packet is not well-formed",
    "xmp-extended-incomplete": "parts of their XMP are missing",
    "thermal-payload-incomplete": "parts of their raw temperatures are missing",
    "gps-out-of-range": "their position is not on Earth",
}
_CUT = "jpeg-end-missing:the last rows are cut"
# Fewer frames of a camera than this say nothing about its habits.
_HABIT = 3


def broken(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Files that cannot be read."""
    by_code: Dict[Tuple[str, str], List[str]] = defaultdict(list)
    for item in survey.broken:
        by_code[(item.code, item.message)].append(item.path)
    for (code, message), paths in sorted(by_code.items()):
        yield Finding(
            code=code,
            severity=ERROR,
            subjects=tuple(paths),
            message=f"{named(paths)}: {message}",
            remedy="Copy the file from the card again, or leave it out. sensorgate run leaves it out.",
            measured=float(len(paths)),
        )


_LEFT_OUT = {
    "duplicate-file": (
        ERROR,
        "{n} the same, byte for byte, as another file of this folder: {names}. Two equal frames have no base line.",
        "Delete the copies. sensorgate run leaves them out.",
    ),
    "panel-frame": (
        WARNING,
        "{n} of the calibration panel: {names}.",
        "Keep them out of the reconstruction; sensorgate run puts them beside the project.",
    ),
    "transit-frame": (
        WARNING,
        "{n} taken while climbing or landing, below half the flight's height: {names}.",
        "Keep them out of the reconstruction. sensorgate run leaves them out.",
    ),
    "horizon-frame": (
        WARNING,
        "{n} looking at the horizon: {names}.",
        "Keep them out of the reconstruction. sensorgate run leaves them out.",
    ),
}


def excluded(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Frames that are no survey frames: copies, panels, transit, horizon."""
    by_code: Dict[str, List[str]] = defaultdict(list)
    for frame in survey.frames:
        if frame.excluded in _LEFT_OUT:
            by_code[str(frame.excluded)].append(frame.path)
    for code, paths in sorted(by_code.items()):
        severity, text, remedy = _LEFT_OUT[code]
        count = plural(len(paths))
        if code == "duplicate-file":
            count += " is" if len(paths) == 1 else " are"
        message = text.format(n=count, names=named(paths))
        yield Finding(code, severity, tuple(paths), message, remedy, measured=float(len(paths)))


def cut_short(survey: Survey) -> Tuple[str, ...]:
    """JPEGs whose picture ends too early, sorted (pure).

    Where several frames of a camera, and all of them, lack the end marker,
    that is how the camera writes.
    """
    files = survey.file_of()
    usable = {f.path for f in survey.usable}
    found: List[str] = []
    for profile in survey.profiles:
        paths = [p for p in profile.frames if p in usable]
        cut = [p for p in paths if _CUT in files[p].problems]
        if len(cut) < len(paths) or len(paths) < _HABIT:
            found.extend(cut)
    return tuple(sorted(found))


def damaged(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Readable files with damage; what all frames of a camera show is how that camera writes."""
    files = survey.file_of()
    usable = {f.path for f in survey.usable}
    hurt: Dict[str, List[str]] = defaultdict(list)
    usual: Dict[str, List[str]] = defaultdict(list)
    for profile in survey.profiles:
        paths = [p for p in profile.frames if p in usable]
        for code in _DAMAGE:
            found = [p for p in paths if any(note.partition(":")[0] == code for note in files[p].problems)]
            if found:
                (usual if len(found) == len(paths) else hurt)[code].extend(found)
    cut = cut_short(survey)
    if cut:
        yield Finding(
            code="picture-cut-short",
            severity=ERROR,
            subjects=cut,
            message=f"The picture data of {plural(len(cut))} breaks off: {named(cut)}. One can end ODM's run.",
            remedy="Copy the files from the card again. sensorgate run leaves them out.",
            measured=float(len(cut)),
        )
    for severity, by_code in ((WARNING, hurt), (INFO, usual)):
        for code in sorted(set(by_code) & set(_DAMAGE)):
            paths = sorted(by_code[code])
            yield Finding(
                code="header-damaged",
                severity=severity,
                subjects=tuple(paths),
                message=f"{plural(len(paths))} can be read only in part, {_DAMAGE[code]}: {named(paths)}.",
                remedy="Copy the files from the card again."
                if severity == WARNING
                else "Nothing to do: all frames of this camera are like that. What is missing is taken from the sheet.",
                measured=float(len(paths)),
            )


def unusable(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Nothing is left for a reconstruction."""
    if not survey.usable:
        yield Finding(
            code="no-usable-frame",
            severity=ERROR,
            subjects=(),
            message="There is no frame in this folder that a reconstruction could use.",
            remedy="Point to the folder that holds the drone's images.",
            measured=0.0,
            threshold=1.0,
        )


def clock(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Frames without a capture time beside frames with one."""
    files = survey.file_of()
    missing = [f.path for f in survey.usable if seconds(files[f.path]) is None]
    if missing and len(missing) < len(survey.usable):
        yield Finding(
            code="time-missing",
            severity=INFO,
            subjects=tuple(missing),
            message=f"{plural(len(missing))} have no capture time: {named(missing)}.",
            remedy="Nothing to do unless bands or rolling shutter depend on it.",
            measured=float(len(missing)),
        )
