"""Rules about cameras: focal lengths, sizes, modes and where their intrinsics come from."""

from __future__ import annotations

from collections import defaultdict
from typing import Dict, Iterator, List, Set, Tuple

from ..finding import ERROR, INFO, WARNING, Finding
from ..profile import CameraProfile
from ..survey import Survey
from ..thresholds import Thresholds
from .text import listed, plural

_STALE = "stale-focal-plane"


def focal(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Focal tags that vary within one camera."""
    for profile in survey.profiles:
        variance = profile.focal_variance
        low, high = profile.focal_mm_min, profile.focal_mm_max
        if low is None or high is None or low == high:
            continue
        span = f"{low:g} to {high:g} mm"
        if variance > limits.focal_variance:
            yield Finding(
                code="focal-variance",
                severity=ERROR,
                subjects=(profile.id,),
                message=f"{profile.id} reports focal lengths from {span}, {100 * variance:.1f} % apart, "
                "though lens, zoom and size are the same: the tag drifts, not the lens.",
                remedy="Treat it as one camera with one focal. sensorgate run gives its copies one focal tag and "
                "locks the intrinsics where a calibration is known.",
                measured=variance,
                threshold=limits.focal_variance,
            )
        else:
            yield Finding(
                code="focal-jitter",
                severity=WARNING,
                subjects=(profile.id,),
                message=f"{profile.id} reports focal lengths from {span}: autofocus jitter. "
                "ODM would make a camera of each value.",
                remedy="sensorgate run gives the copies one focal tag.",
                measured=variance,
                threshold=limits.focal_variance,
            )


def two_lenses(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """One name, size and mode, several focal clusters."""
    families: Dict[Tuple[str, str, int, int, str], List[CameraProfile]] = defaultdict(list)
    for profile in survey.profiles:
        families[(profile.family, profile.serial, profile.width, profile.height, profile.mode)].append(profile)
    for _, members in sorted(families.items()):
        if len(members) < 2:
            continue
        ids = tuple(p.id for p in members)
        yield Finding(
            code="two-lenses",
            severity=WARNING,
            subjects=ids,
            message=f"{members[0].family} was used with {len(members)} focal lengths: {listed(ids)}. "
            "They are kept apart as different cameras.",
            remedy="Nothing to do if the lens was changed or zoomed on purpose.",
            measured=members[0].family_focal_variance,
            threshold=limits.focal_split,
        )


def bodies(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Several serials of one family."""
    families: Dict[str, Set[str]] = defaultdict(set)
    ids: Dict[str, List[str]] = defaultdict(list)
    for profile in survey.profiles:
        if profile.serial:
            families[profile.family].add(profile.serial)
            ids[profile.family].append(profile.id)
    for family, serials in sorted(families.items()):
        if len(serials) > 1:
            yield Finding(
                code="several-bodies",
                severity=WARNING,
                subjects=tuple(ids[family]),
                message=f"{len(serials)} bodies of {family} made these frames. Each is a camera of its own.",
                remedy="Nothing to do: sensorgate keeps them apart and says where ODM cannot.",
                measured=float(len(serials)),
                threshold=1.0,
            )


def sizes(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """One camera, several frame sizes."""
    families: Dict[Tuple[str, str], List[CameraProfile]] = defaultdict(list)
    for profile in survey.profiles:
        families[(profile.family, profile.serial)].append(profile)
    for (family, _), members in sorted(families.items()):
        shapes = sorted({(p.width, p.height) for p in members})
        if len(shapes) < 2:
            continue
        aspects = [w / h for w, h in shapes]
        same = max(aspects) / min(aspects) - 1.0 <= limits.aspect_tolerance
        shown = listed([f"{w}x{h}" for w, h in shapes])
        why = "the same picture scaled" if same else "cut differently, so with different principal points"
        yield Finding(
            code="mixed-resolutions",
            severity=WARNING,
            subjects=tuple(p.id for p in members),
            message=f"{family} wrote frames of {len(shapes)} sizes ({shown} px): {why}.",
            remedy="They are kept apart as different cameras; sensorgate run brings them to one ground resolution.",
            measured=max(aspects) / min(aspects) - 1.0,
            threshold=limits.aspect_tolerance,
        )


def modes(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """One camera in several modes: digital zoom, raw beside JPEG, dewarping switched."""
    families: Dict[Tuple[str, str], List[CameraProfile]] = defaultdict(list)
    for profile in survey.profiles:
        families[(profile.family, profile.serial)].append(profile)
    for (family, _), members in sorted(families.items()):
        found = sorted({p.mode for p in members})
        parts = {part for mode in found for part in mode.split("+") if part}
        zooms = sorted(part for part in parts if part.startswith("zoom") and part[4:5].isdigit())
        if zooms:
            levels = listed([f"{z[4:]}x" for z in zooms])
            mixed = len(found) > 1
            yield Finding(
                code="digital-zoom",
                severity=WARNING if mixed else INFO,
                subjects=tuple(p.id for p in members),
                message=f"{family} used digital zoom ({levels})"
                + (" in some frames and not in others" if mixed else "")
                + ": the frame shows a part of the sensor, and the focal tag does not tell.",
                remedy="sensorgate run keeps each zoom step as a camera of its own. Map without digital zoom.",
                measured=float(len(zooms)),
                threshold=0.0,
            )
        others = {"+".join(p for p in mode.split("+") if p not in zooms) for mode in found}
        if len(others) > 1 and len({p.width * p.height for p in members}) == 1:
            yield Finding(
                code="mixed-modes",
                severity=WARNING,
                subjects=tuple(p.id for p in members),
                message=f"{family} was used in {len(others)} modes: {listed(m or 'plain' for m in sorted(others))}. "
                "Each has its own distortion.",
                remedy="They are kept apart as different cameras. If one is the other saved twice (raw and JPEG), "
                "keep one kind.",
                measured=float(len(others)),
                threshold=1.0,
            )


def projections(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Fisheye and perspective frames in one spectrum."""
    by_spectrum: Dict[str, Dict[str, List[str]]] = defaultdict(lambda: defaultdict(list))
    for profile in survey.profiles:
        by_spectrum[profile.spectrum][profile.intrinsics.projection].append(profile.id)
    for spectrum, found in sorted(by_spectrum.items()):
        if len(found) > 1:
            yield Finding(
                code="projections-mixed",
                severity=WARNING,
                subjects=tuple(sorted(p for ids in found.values() for p in ids)),
                message=f"The {spectrum} frames mix fisheye and perspective lenses: {listed(found['fisheye'])} "
                "is fisheye. ODM's camera-lens option is one for the whole project.",
                remedy="Keep the fisheye frames in a project of their own.",
                measured=float(len(found)),
                threshold=1.0,
            )


def sensor_width(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Sensor widths of one family that differ."""
    families: Dict[Tuple[str, str], List[CameraProfile]] = defaultdict(list)
    for profile in survey.profiles:
        if profile.intrinsics.sensor_width_mm is not None:
            families[(profile.family, profile.mode)].append(profile)
    for (family, _), members in sorted(families.items()):
        widths = sorted(p.intrinsics.sensor_width_mm or 0.0 for p in members)
        if widths[-1] - widths[0] > limits.sensor_width_mm and len({p.width / p.height for p in members}) == 1:
            yield Finding(
                code="sensor-width-differs",
                severity=WARNING,
                subjects=tuple(p.id for p in members),
                message=f"{family} claims sensors {widths[0]:.2f} to {widths[-1]:.2f} mm wide. One of them is wrong.",
                remedy="Give the right width with --calibration, or set right the focal-plane tags.",
                measured=widths[-1] - widths[0],
                threshold=limits.sensor_width_mm,
            )


def sources(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Intrinsics that rest on stale tags, guesses, or nothing."""
    by_path = {f.path: f for f in survey.frames}
    files = survey.file_of()
    for profile in survey.profiles:
        stale = [
            p for p in profile.frames if any(n.startswith("stale-focal-plane") for n in by_path[p].intrinsics.notes)
        ]
        if stale:
            yield Finding(
                code="stale-focal-plane",
                severity=ERROR,
                subjects=tuple(stale),
                message=f"{plural(len(stale))} of {profile.id} came with focal-plane tags of another picture size "
                "(they were resized after the flight). Software that believes them gets a wrong focal.",
                remedy="sensorgate run sets the tags right in the project's copies.",
                measured=float(len(stale)),
            )
        source = profile.intrinsics.focal_source
        if source == "unknown":
            yield Finding(
                code="focal-unknown",
                severity=WARNING,
                subjects=(profile.id,),
                message=f"Nothing tells the focal length of {profile.id}: no tag, no calibration, not in the sheet. "
                "ODM would start from its guess of 0.85.",
                remedy="Add the camera with --calibration FILE (sensor width and focal length in mm).",
            )
        elif source == "generic-width":
            yield Finding(
                code="focal-guessed",
                severity=WARNING,
                subjects=(profile.id,),
                message=f"The focal of {profile.id} rests on a general table of sensor widths.",
                remedy="Add the camera with --calibration FILE if you know its sensor.",
            )
        elif source == "equivalent-35mm" and all(files[p].focal_plane_x_res is None for p in profile.frames):
            yield Finding(
                code="focal-plane-missing",
                severity=INFO,
                subjects=(profile.id,),
                message=f"{profile.id} has no focal-plane tags (41486, 41487) and is not in the calibration sheet in "
                "this size: its field of view comes from the 35 mm equivalent, good to a few percent.",
                remedy="Nothing to do for a block with good overlap. Else add the camera with --calibration FILE.",
            )
