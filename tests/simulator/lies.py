"""Lies about a survey: pure functions from a survey to a survey.

What the frames show stays true; what the headers say, or which files are
there, changes. ``Shot.lies`` and ``truth.json`` name each lie that was told.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Callable, Iterable, Optional, Tuple

from .camera import Camera
from .geo import Origin
from .survey import FileLie, Reported, Shot, Survey, change_shots

Choice = Callable[[Shot, int], bool]


def _told(shot: Shot, lie: str, **changes: Any) -> Shot:
    reported: Reported = replace(shot.reported, **changes)
    return replace(shot, reported=reported, lies=(*shot.lies, lie))


def report(survey: Survey, lie: str, payload: Optional[str], only: Optional[Choice] = None, **changes: Any) -> Survey:
    """Set fields of ``Reported`` in the chosen shots; the general lie."""

    def change(shot: Shot, index: int) -> Shot:
        return _told(shot, lie, **changes) if only is None or only(shot, index) else shot

    return change_shots(survey, change, payload)


def drift_focal(survey: Survey, payload: str, share: float, from_index: Optional[int] = None, steps: int = 1) -> Survey:
    """The reported focal grows by ``share`` in ``steps`` jumps from a frame on (half way if not said)."""
    count = sum(1 for s in survey.shots if s.payload == payload)
    start = count // 2 if from_index is None else from_index

    def change(shot: Shot, index: int) -> Shot:
        if index < start:
            return shot
        step = min(steps, 1 + (index - start) * steps // max(1, count - start))
        factor = 1.0 + share * step / steps
        r = shot.reported
        return _told(
            shot,
            "drifted-focal",
            focal_mm=r.focal_mm * factor if r.focal_mm else None,
            focal_35mm=r.focal_35mm * factor if r.focal_35mm else None,
            software=r.software + ".1",
        )

    return change_shots(survey, change, payload)


def drop_tags(survey: Survey, payload: Optional[str], groups: Iterable[str], only: Optional[Choice] = None) -> Survey:
    """Leave groups of tags out (the groups are listed in ``dialects``)."""
    gone = tuple(groups)

    def change(shot: Shot, index: int) -> Shot:
        if only is not None and not only(shot, index):
            return shot
        return _told(shot, "dropped-" + "-".join(gone), drop=shot.reported.drop | frozenset(gone))

    return change_shots(survey, change, payload)


def shift_gps(
    survey: Survey, payload: str, east: float, north: float, up: float, only: Optional[Choice] = None
) -> Survey:
    """Move what a payload's headers say of its place, by metres."""

    def change(shot: Shot, index: int) -> Shot:
        r = shot.reported
        if (only is not None and not only(shot, index)) or r.latitude is None or r.longitude is None:
            return shot
        origin = Origin(r.latitude, r.longitude, r.altitude_m or 0.0)
        latitude, longitude, altitude = origin.to_geodetic(east, north, up)
        return _told(shot, "shifted-gps", latitude=latitude, longitude=longitude, altitude_m=altitude)

    return change_shots(survey, change, payload)


def zero_gps(survey: Survey, payload: str, only: Optional[Choice] = None) -> Survey:
    """The 0, 0 that cameras write before a fix."""
    return report(survey, "zero-gps", payload, only, latitude=0.0, longitude=0.0, altitude_m=0.0)


def resize_one(survey: Survey, path: str, factor: float) -> Survey:
    """One frame taken in another size mode: same lens, other pixels, no other tag changed."""

    def change(shot: Shot, _: int) -> Shot:
        if shot.path != path:
            return shot
        camera: Camera = shot.optics(survey.payload(shot.payload)).scaled(factor)
        return replace(shot, camera=camera, lies=(*shot.lies, "other-size"))

    return change_shots(survey, change)


def undefine(survey: Survey, payload: str, groups: Iterable[str], only: Optional[Choice] = None) -> Survey:
    """Write groups of rationals as 0/0 (the groups are listed in ``dialects``)."""
    gone = frozenset(groups)
    return report(survey, "undefined-" + "-".join(sorted(gone)), payload, only, undefined=gone)


def swap_captures(survey: Survey, payload: str, band: str, first: int, second: int) -> Survey:
    """One band's files of two captures carry each other's capture ids."""
    number = [b.name for b in survey.payload(payload).bands].index(band)
    own = [s for s in survey.shots if s.payload == payload and s.band == number]
    a, b = own[first], own[second]
    other = {a.path: b.reported.capture_id, b.path: a.reported.capture_id}

    def change(shot: Shot, _: int) -> Shot:
        return _told(shot, "swapped-capture", capture_id=other[shot.path]) if shot.path in other else shot

    return change_shots(survey, change, payload)


def offset_altitudes(survey: Survey, payload: str, metres: float, only: Optional[Choice] = None) -> Survey:
    """Another vertical datum, or a barometer set wrong: absolute altitudes are off as a whole."""
    return shift_gps(survey, payload, 0.0, 0.0, metres, only)


def zoom(survey: Survey, payload: str, factor: float, only: Choice) -> Survey:
    """Frames taken with digital zoom: the picture shows it, the zoom and the 35 mm tag tell it, the focal does not."""

    def change(shot: Shot, index: int) -> Shot:
        if not only(shot, index):
            return shot
        camera = shot.optics(survey.payload(shot.payload)).zoomed(factor)
        focal = shot.reported.focal_35mm
        told = replace(shot.reported, digital_zoom=factor, focal_35mm=focal * factor if focal else None)
        return replace(shot, camera=camera, reported=told, lies=(*shot.lies, "digital-zoom"))

    return change_shots(survey, change, payload)


def spoil(survey: Survey, path: str, kind: str, **arguments: Any) -> Survey:
    """Let something happen to a finished file (``filelies.KINDS``)."""
    return replace(survey, file_lies=(*survey.file_lies, FileLie(path, kind, arguments)))


def duplicate(survey: Survey, path: str, to: str) -> Survey:
    """The same bytes under a second name."""
    return spoil(survey, path, "copy", to=to)


def rename(survey: Survey, path: str, to: str) -> Survey:
    """The file is there under a wrong name."""
    return spoil(survey, path, "rename", to=to)


def lose(survey: Survey, *paths: str) -> Survey:
    """Files that never reached the folder."""
    return replace(survey, shots=tuple(s for s in survey.shots if s.path not in paths))


def panels(survey: Survey, payload: str, captures: Tuple[int, ...]) -> Survey:
    """Some captures become calibration-panel captures: taken by hand a good metre above the ground."""
    names = sorted({s.capture for s in survey.shots if s.payload == payload})
    chosen = {names[i] for i in captures}

    def change(shot: Shot, _: int) -> Shot:
        return replace(shot, role="panel") if shot.capture in chosen else shot

    return change_shots(survey, change, payload)
