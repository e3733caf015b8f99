"""ODM's ``geo.txt``: read, rewritten for renamed frames, and made where accuracies or heights are mixed.

A header with the coordinate system, then per line ``image geo_x geo_y [geo_z]
[yaw pitch roll] [horizontal vertical]``. ODM counts columns, so accuracies
need height and angles before them; angles of ``nan`` leave those of the image
as they are. An entry replaces position, height and accuracies of its image
altogether: what a line leaves out is then unknown to ODM, whatever the image
says.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Mapping, Optional, Sequence, Tuple

from ...stages.finding import ERROR, WARNING, Finding
from ...stages.gcp import is_number, split_lines
from ...stages.srs import Srs, parse_srs
from ...stages.thresholds import DEFAULTS, Thresholds

_HEADER = "EPSG:4326"
_NAN = "nan nan nan"


@dataclass(frozen=True)
class GeoLine:
    """One image's entry, numbers as spelled; absent columns are ``None``, ``rest`` is what follows."""

    number: int
    image: str
    x: str
    y: str
    z: Optional[str] = None
    angles: Optional[Tuple[str, str, str]] = None
    accuracies: Optional[Tuple[str, str]] = None
    rest: str = ""


@dataclass(frozen=True)
class GeoFile:
    """An image geolocation file: its coordinate system, its usable lines, what was wrong with the others."""

    srs: Srs
    lines: Tuple[GeoLine, ...]
    findings: Tuple[Finding, ...] = ()


@dataclass(frozen=True)
class GeoFrame:
    """Where a written frame stands: degrees, metres, accuracies as standard deviations in metres.

    ``fixed`` is an RTK position with a fixed solution. ``odm_sigma_m`` is what
    ODM itself would take from the tags (horizontal, vertical), ``None`` where
    it would take its default of 10 m.
    """

    name: str
    latitude: float
    longitude: float
    altitude_m: Optional[float]
    sigma_horizontal_m: float
    sigma_vertical_m: float
    fixed: bool = False
    odm_sigma_m: Optional[Tuple[float, float]] = None


def read_geo(text: str) -> GeoFile:
    """Read an image geolocation file. Bad lines become findings; ``UsageError`` for a header that means nothing."""
    rows = split_lines(text)
    srs = parse_srs(rows[0][1])
    lines: List[GeoLine] = []
    findings: List[Finding] = []
    for number, row in rows[1:]:
        words = row.split()
        if len(words) < 3:
            findings.append(_malformed(number, "has fewer than three columns", f"Malformed geo line: {row}"))
            continue
        columns = min(len(words), 9 if len(words) >= 9 else 7 if len(words) >= 7 else 4)
        numbers = words[1:columns]
        if not all(is_number(n, allow_nan=3 <= i <= 5) for i, n in enumerate(numbers)):
            findings.append(_malformed(number, "has a word where a number must stand; ODM would stop on it", None))
            continue
        lines.append(
            GeoLine(
                number,
                words[0],
                words[1],
                words[2],
                words[3] if columns >= 4 else None,
                (words[4], words[5], words[6]) if columns >= 7 else None,
                (words[7], words[8]) if columns >= 9 else None,
                " ".join(words[columns:]),
            )
        )
    return GeoFile(srs, tuple(lines), tuple(findings))


def _malformed(number: int, what: str, odm_message: Optional[str]) -> Finding:
    return Finding(
        code="geo-malformed-line",
        severity=ERROR,
        subjects=(f"line {number}",),
        message=f"Line {number} of geo.txt {what}.",
        remedy="Write it as: image_name x y z yaw pitch roll horizontal_accuracy vertical_accuracy.",
        odm_message=odm_message,
    )


def check_geo(geo: GeoFile, names: Sequence[str]) -> Tuple[Finding, ...]:
    """What an image geolocation file would do to frames of these names: ODM says nothing of any of it."""
    findings = list(geo.findings)
    known = set(names)
    unknown = tuple(line.image for line in geo.lines if line.image not in known)
    if unknown:
        findings.append(
            Finding(
                code="geo-image-unknown",
                severity=WARNING,
                subjects=unknown,
                message=f"{len(unknown)} lines of geo.txt name images that are not there; ODM passes over them.",
                remedy="Correct the names; capital and small letters count, and names may hold no blanks.",
            )
        )
    flat = tuple(line.image for line in geo.lines if line.image in known and line.z is None)
    if flat:
        findings.append(
            Finding(
                code="geo-height-missing",
                severity=WARNING,
                subjects=flat,
                message=f"{len(flat)} lines of geo.txt have no height; ODM then drops the heights of all frames.",
                remedy="Add the height as the fourth column.",
            )
        )
    short = tuple(
        line.image for line in geo.lines if line.image in known and line.z is not None and not line.accuracies
    )
    if any(line.accuracies for line in geo.lines) and short:
        findings.append(
            Finding(
                code="geo-accuracy-missing",
                severity=WARNING,
                subjects=short,
                message=f"{len(short)} lines of geo.txt give no accuracy; ODM takes 10 m for them, "
                "even where the image says better.",
                remedy="Give both accuracies in every line (columns eight and nine; nan nan nan before them).",
            )
        )
    return tuple(findings)


def rewrite_geo(geo: GeoFile, outputs: Mapping[str, Sequence[str]]) -> Optional[str]:
    """The file for a project: ``outputs`` maps an image's name to its names there; ``None`` where no line is left."""
    rows: List[str] = []
    for line in geo.lines:
        for name in outputs.get(line.image, ()):
            words = [name, line.x, line.y, line.z or "", *(line.angles or ()), *(line.accuracies or ()), line.rest]
            rows.append(" ".join(w for w in words if w))
    return "\n".join([geo.srs.header, *rows]) + "\n" if rows else None


def accuracy_mixed(frames: Sequence[GeoFrame], thresholds: Thresholds = DEFAULTS) -> bool:
    """Whether the frames' accuracies differ by more than ``accuracy_ratio`` between the best and the worst."""
    if not frames:
        return False
    spread = [f.sigma_horizontal_m for f in frames]
    vertical = [f.sigma_vertical_m for f in frames]
    return any(max(s) > thresholds.accuracy_ratio * min(s) for s in (spread, vertical))


def uniform_accuracy_m(frames: Sequence[GeoFrame], thresholds: Thresholds = DEFAULTS) -> Optional[float]:
    """One accuracy for ``gps-accuracy``: all frames RTK fixed and alike, and ODM would not see it in the tags.

    ODM takes the worse of the two directions for both, and so does this.
    """
    if not frames or accuracy_mixed(frames, thresholds) or not all(f.fixed for f in frames):
        return None
    if all(f.odm_sigma_m is not None for f in frames):
        return None
    worst = max(max(f.sigma_horizontal_m, f.sigma_vertical_m) for f in frames)
    return round(worst, 3)


def geo_for(frames: Sequence[GeoFrame], thresholds: Thresholds = DEFAULTS) -> Optional[str]:
    """A ``geo.txt`` for a project whose frames' accuracies are mixed, else ``None``.

    Nine columns per frame, sorted by name. Frames without a height get none
    at all: a line without one would take the height from every frame.
    """
    if not accuracy_mixed(frames, thresholds):
        return None
    rows = [
        f"{f.name} {f.longitude:.9f} {f.latitude:.9f} {f.altitude_m:.3f} {_NAN} "
        f"{f.sigma_horizontal_m:.3f} {f.sigma_vertical_m:.3f}"
        for f in sorted(frames, key=lambda f: f.name)
        if f.altitude_m is not None
    ]
    return "\n".join([_HEADER, *rows]) + "\n" if rows else None
