"""ODM's ``gcp_list.txt``: read, rewritten for renamed and resampled frames.

A header with the coordinate system, then per line ``geo_x geo_y geo_z px py
image [name] [extras]``, parted by blanks or tabs. ODM tells points apart by
their coordinates, images by their exact name, and dies on a number that it
cannot read. Numbers are kept as they were spelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

from ...stages.align.model import GcpMark
from ...stages.finding import ERROR, Finding
from ...stages.gcp import GcpLine, parse_gcp
from ...stages.srs import Srs

_SCALED_DECIMALS = 3


@dataclass(frozen=True)
class GcpFile:
    """A ground control file: its coordinate system, its usable lines, and what was wrong with the others."""

    srs: Srs
    lines: Tuple[GcpLine, ...]
    findings: Tuple[Finding, ...] = ()


@dataclass(frozen=True)
class GcpFrame:
    """A frame that marks may stand on.

    ``path`` is its path in the report, ``output`` its name in the project,
    sizes are in pixels of the original and of the written file. ``position``
    is latitude and longitude. ``primary`` is false for bands that ODM keeps
    out of its solver: it passes over marks on them without a word.
    """

    path: str
    output: str
    width: int
    height: int
    out_width: int
    out_height: int
    position: Optional[Tuple[float, float]] = None
    primary: bool = True

    @property
    def name(self) -> str:
        """The original file name."""
        return self.path.rsplit("/", 1)[-1]


@dataclass(frozen=True)
class PlacedMark:
    """A line whose image was found, with the point's place on earth in degrees. A ``check`` point is held out."""

    line: GcpLine
    path: str
    latitude: float
    longitude: float
    check: bool = False


def read_gcp(text: str) -> GcpFile:
    """Read a ground control list. Bad lines become findings; ``UsageError`` for a header that means nothing."""
    parsed = parse_gcp(text)
    findings = [
        _malformed(b.number, "has fewer than six columns", f"Malformed GCP line: {b.row}")
        if b.short
        else _malformed(b.number, "has a word where a number must stand; ODM would stop on it", None)
        for b in parsed.bad
    ]
    if not parsed.lines:
        findings.append(
            Finding(
                code="gcp-no-entries",
                severity=ERROR,
                subjects=("gcp_list.txt",),
                message="The ground control file has no usable line.",
                remedy="Each line must read: geo_x geo_y geo_z pixel_x pixel_y image_name, parted by blanks.",
                odm_message="This GCP file does not have any entries. Are the entries entered in the proper format?",
            )
        )
    return GcpFile(parsed.srs, parsed.lines, tuple(findings))


def as_odm_prints(line: GcpLine) -> str:
    """The line as ODM's own messages show it."""
    numbers = " ".join(str(float(v)) for v in (line.x, line.y, line.z, line.px, line.py))
    return f"{numbers} {line.image} {line.extras}".rstrip()


def _malformed(number: int, what: str, odm_message: Optional[str]) -> Finding:
    return Finding(
        code="gcp-malformed-line",
        severity=ERROR,
        subjects=(f"line {number}",),
        message=f"Line {number} of the ground control file {what}.",
        remedy="Write it as: geo_x geo_y geo_z pixel_x pixel_y image_name, with points in numbers and blanks between.",
        odm_message=odm_message,
    )


def scaled(pixel: str, size: int, out_size: int) -> str:
    """A pixel coordinate after resampling, spelled with at least the digits it had.

    ODM counts pixels from the centre of the first one, so the half pixel at
    the border scales along: its own normalised coordinate stays the same.
    """
    if size == out_size:
        return pixel
    value = (float(pixel) + 0.5) * out_size / size - 0.5
    decimals = len(pixel.partition(".")[2]) if pixel.replace(".", "").lstrip("+-").isdigit() else 0
    return f"{value:.{max(decimals, _SCALED_DECIMALS)}f}"


def write_gcp(srs: Srs, marks: Sequence[Tuple[GcpLine, GcpFrame]]) -> str:
    """The list for a project, in the order of the lines given."""
    rows = [srs.header]
    for line, frame in marks:
        px = scaled(line.px, frame.width, frame.out_width)
        py = scaled(line.py, frame.height, frame.out_height)
        rows.append(" ".join([line.x, line.y, line.z, px, py, frame.output, line.extras]).rstrip())
    return "\n".join(rows) + "\n"


def align_marks(placed: Sequence[PlacedMark], frames: Sequence[GcpFrame]) -> Tuple[GcpMark, ...]:
    """The marks for the alignment, in pixels of the written files; marks on frames not given are left out."""
    by_path = {f.path: f for f in frames}
    ids = {point: f"gcp-{i:04d}" for i, point in enumerate(dict.fromkeys(m.line.point for m in placed))}
    return tuple(
        GcpMark(
            point=ids[m.line.point],
            path=m.path,
            x_px=float(scaled(m.line.px, by_path[m.path].width, by_path[m.path].out_width)),
            y_px=float(scaled(m.line.py, by_path[m.path].height, by_path[m.path].out_height)),
            latitude=m.latitude,
            longitude=m.longitude,
            altitude_m=m.line.point[2],
            name=m.line.label,
            check=m.check,
        )
        for m in placed
        if m.path in by_path and math.isfinite(m.line.point[2])
    )
