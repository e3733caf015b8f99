"""Finds the frames and the place on earth that ground control lines speak of, and says what cannot be right."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.finding import ERROR, WARNING, Finding, sort_key
from ...stages.gcp import GcpLine, ToldTwice, told_twice
from ...stages.geo import distance_m
from ...stages.srs import LONLAT, UTM, Srs, to_lonlat
from ...stages.thresholds import DEFAULTS, Thresholds
from .gcp import GcpFile, GcpFrame, PlacedMark, as_odm_prints

_Point = Tuple[float, float, float]
_Place = Tuple[float, float]
_SHOWN = 6


@dataclass(frozen=True)
class PlacedGcps:
    """The marks that can be used, in the order of the file, and findings about the others."""

    srs: Srs
    marks: Tuple[PlacedMark, ...]
    findings: Tuple[Finding, ...] = ()


def _lonlat(srs: Srs, points: Sequence[_Point]) -> Dict[_Point, _Place]:
    """Point -> (latitude, longitude)."""
    return {p: (lat, lon) for p, (lon, lat) in zip(points, to_lonlat(srs, [(p[0], p[1]) for p in points]))}


def _candidates(
    line: GcpLine, by_name: Dict[str, List[GcpFrame]], by_folded: Dict[str, List[GcpFrame]]
) -> List[GcpFrame]:
    name = line.image.replace("\\", "/").rsplit("/", 1)[-1]
    return by_name.get(name) or by_folded.get(name.lower()) or []


def _nearest(found: List[GcpFrame], place: _Place, far_m: float) -> Optional[GcpFrame]:
    """The one frame near the point; ``None`` where two are or none is."""
    near = [f for f in found if f.position is not None and distance_m(f.position, place) <= far_m]
    return near[0] if len(near) == 1 else None


def place(gcp: GcpFile, frames: Sequence[GcpFrame], thresholds: Thresholds = DEFAULTS) -> PlacedGcps:
    """Match lines with the survey's frames and check where their points lie.

    A name in another case is taken (the rewritten list has the right one); a
    name that several payloads share is taken where only one of the frames
    stands near the point. Lines that name no frame, stand outside of their
    frame, speak of a point far from it or contradict each other are left out.
    """
    by_name: Dict[str, List[GcpFrame]] = defaultdict(list)
    by_folded: Dict[str, List[GcpFrame]] = defaultdict(list)
    for known in sorted(frames, key=lambda f: f.path):
        by_name[known.name].append(known)
        by_folded[known.name.lower()].append(known)
    points = list(dict.fromkeys(line.point for line in gcp.lines))
    places = _lonlat(gcp.srs, points)
    marks: List[PlacedMark] = []
    positions: Dict[_Point, List[_Place]] = defaultdict(list)
    findings: List[Finding] = []
    renamed: List[str] = []
    for line in gcp.lines:
        found = _candidates(line, by_name, by_folded)
        lat, lon = places[line.point]
        frame = found[0] if len(found) == 1 else _nearest(found, (lat, lon), thresholds.gcp_far_m)
        if frame is None:
            findings.append(_ambiguous(line, found) if found else _unknown(line))
            continue
        if frame.name != line.image:
            renamed.append(line.image)
        if not (-1.0 <= float(line.px) <= frame.width and -1.0 <= float(line.py) <= frame.height):
            findings.append(_outside(line, frame))
            continue
        marks.append(PlacedMark(line, frame.path, lat, lon))
        if frame.position is not None:
            positions[line.point].append(frame.position)
    if renamed:
        findings.append(_spelled(renamed))
    far = [p for p in points if positions[p] and _gap(places[p], positions[p]) > thresholds.gcp_far_m]
    findings += _far_findings(gcp, far, places, positions, thresholds)
    twice = told_twice([(m.line, m.path) for m in marks], thresholds)
    findings += _twice_findings({m.line.number: m for m in marks}, twice)
    gone = set(far)
    kept = tuple(m for m in marks if m.line.point not in gone and m.line.number not in twice.unusable)
    return PlacedGcps(gcp.srs, kept, tuple(sorted(findings, key=sort_key)))


def _twice_findings(marks: Mapping[int, PlacedMark], twice: ToldTwice) -> List[Finding]:
    findings: List[Finding] = []
    for numbers in twice.contradicting:
        first = marks[numbers[0]]
        pixels = ", ".join(f"{marks[n].line.px} {marks[n].line.py}" for n in numbers[:4])
        said = _some(numbers)
        findings.append(
            Finding(
                code="gcp-contradicting-marks",
                severity=ERROR,
                subjects=(first.line.label, first.path),
                message=f"Lines {said} of the ground control file mark {first.line.label} at different places of "
                f"{first.path.rsplit('/', 1)[-1]} ({pixels}). None of them is used.",
                remedy="Keep the line whose mark is right; where they are two points, give each its own coordinates.",
            )
        )
    if twice.repeated:
        findings.append(
            Finding(
                code="gcp-repeated-mark",
                severity=WARNING,
                subjects=tuple(sorted({marks[n].path for n in twice.repeated})),
                message=f"{len(twice.repeated)} ground control lines say again what an earlier line says (lines "
                f"{_some(twice.repeated)}). ODM would count such a mark twice; the written list has it once.",
                remedy="Nothing to do here; delete the lines where the file is used elsewhere.",
                measured=float(len(twice.repeated)),
            )
        )
    return findings


def _some(numbers: Sequence[int]) -> str:
    more = f" and {len(numbers) - _SHOWN} more" if len(numbers) > _SHOWN else ""
    return ", ".join(map(str, numbers[:_SHOWN])) + more


def _gap(place_: _Place, positions: Sequence[_Place]) -> float:
    return min((distance_m(place_, p) for p in positions), default=0.0)


def _far_findings(
    gcp: GcpFile,
    far: Sequence[_Point],
    places: Dict[_Point, _Place],
    positions: Dict[_Point, List[_Place]],
    thresholds: Thresholds,
) -> List[Finding]:
    if not far:
        return []
    labels = {line.point: line.label for line in gcp.lines}
    seen = [p for p in places if positions[p]]
    if 2 * len(far) >= len(seen):

        def fits(convert: Callable[[Sequence[_Point]], Dict[_Point, _Place]]) -> bool:
            moved = convert(far)
            return all(_gap(moved[p], positions[p]) <= thresholds.gcp_far_m for p in far)

        cause = _systematic(gcp.srs, fits)
        if cause is not None:
            code, message, remedy = cause
            return [Finding(code, ERROR, tuple(labels[p] for p in far), message, remedy)]
    return [
        Finding(
            code="gcp-far",
            severity=ERROR,
            subjects=(labels[p],),
            message=f"The point lies {_gap(places[p], positions[p]) / 1000.0:.1f} km from the frames it is marked on.",
            remedy="Check its coordinates and the coordinate system in the first line; it is left out until then.",
            measured=round(_gap(places[p], positions[p]), 1),
            threshold=thresholds.gcp_far_m,
        )
        for p in far
    ]


def _systematic(
    srs: Srs, fits: Callable[[Callable[[Sequence[_Point]], Dict[_Point, _Place]]], bool]
) -> Optional[Tuple[str, str, str]]:
    """Swapped columns or another zone, where that explains all the far points."""

    def swapped(points: Sequence[_Point]) -> Dict[_Point, _Place]:
        turned = to_lonlat(srs, [(p[1], p[0]) for p in points])
        return {p: (lat, lon) for p, (lon, lat) in zip(points, turned)}

    in_range = srs.kind in (LONLAT, UTM)
    if in_range and fits(swapped):
        wanted = "longitude before latitude" if srs.kind == LONLAT else "easting before northing"
        return (
            "gcp-axes-swapped",
            "The first two columns of the ground control file are swapped: turned round, the points lie on the block.",
            f"Swap the columns: ODM wants {wanted}.",
        )
    if srs.kind == UTM:
        for zone in range(1, 61):
            for north in (srs.north, not srs.north):
                other = Srs(f"WGS84 UTM {zone}{'N' if north else 'S'}", UTM, zone, north)
                if (zone, north) != (srs.zone, srs.north) and fits(lambda points, other=other: _lonlat(other, points)):  # type: ignore[misc]
                    return (
                        "gcp-wrong-zone",
                        f"The first line says {srs.header}, but in {other.header} the points lie on the block.",
                        f"Write {other.header} in the first line of the ground control file.",
                    )
    return None


def _unknown(line: GcpLine) -> Finding:
    return Finding(
        code="gcp-image-unknown",
        severity=WARNING,
        subjects=(line.image,),
        message=f"Line {line.number} of the ground control file marks {line.image}, which is not among the frames.",
        remedy="Correct the name (a name with blanks needs tabs between the columns) or add the frame.",
        odm_message=f"GCP line ignored (image not found): {as_odm_prints(line)}",
    )


def _ambiguous(line: GcpLine, found: Sequence[GcpFrame]) -> Finding:
    return Finding(
        code="gcp-image-ambiguous",
        severity=ERROR,
        subjects=tuple(f.path for f in found),
        message=f"Line {line.number} of the ground control file marks {line.image}, a name of {len(found)} frames.",
        remedy="Rename the frames so that each name is there once, and write the new name in the line.",
    )


def _outside(line: GcpLine, frame: GcpFrame) -> Finding:
    return Finding(
        code="gcp-pixel-outside",
        severity=ERROR,
        subjects=(frame.path,),
        message=f"Line {line.number} of the ground control file marks pixel {line.px}, {line.py} of {frame.name}, "
        f"which has {frame.width} x {frame.height}.",
        remedy="Mark the point on the frame as it is here: it may have been marked on a resized or rotated copy.",
    )


def _spelled(names: Sequence[str]) -> Finding:
    shown = tuple(sorted(set(names)))
    return Finding(
        code="gcp-image-case",
        severity=WARNING,
        subjects=shown,
        message=f"{len(names)} ground control lines spell a frame's name in another case or with a folder.",
        remedy="Nothing to do here: the written list has the right names. Without it ODM drops these lines.",
        odm_message="A GCP file was provided, but no valid GCP entries could be used. Note that the GCP file is case "
        'sensitive (".JPG" is not the same as ".jpg").',
    )
