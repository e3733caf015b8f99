"""ODM's ``gcp_list.txt``: read, rewritten for renamed and resampled frames.

A header with the coordinate system, then per line ``geo_x geo_y geo_z px py
image [name] [extras]``, parted by blanks or tabs. ODM tells points apart by
their coordinates, images by their exact name, and dies on a number that it
cannot read. Numbers are kept as they were spelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

from ...stages.align.model import GcpMark
from ...stages.errors import UsageError
from ...stages.finding import ERROR, Finding
from ...stages.thresholds import DEFAULTS
from .srs import Srs, parse_srs

_COLUMNS = 6
_SCALED_DECIMALS = 3


@dataclass(frozen=True)
class GcpLine:
    """One mark: the numbers as spelled, the image as named, the rest untouched."""

    number: int
    x: str
    y: str
    z: str
    px: str
    py: str
    image: str
    extras: str = ""

    @property
    def point(self) -> Tuple[float, float, float]:
        """The coordinates, by which ODM tells points apart."""
        return float(self.x), float(self.y), float(self.z)

    @property
    def label(self) -> str:
        """The point's name where the line has one, else its coordinates."""
        return self.extras.split()[0] if self.extras.split() else f"{self.x} {self.y} {self.z}"

    @property
    def as_odm_prints(self) -> str:
        """The line as ODM's own messages show it."""
        numbers = " ".join(str(float(v)) for v in (self.x, self.y, self.z, self.px, self.py))
        return f"{numbers} {self.image} {self.extras}".rstrip()


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
    """A line whose image was found, with the point's place on earth in degrees."""

    line: GcpLine
    path: str
    latitude: float
    longitude: float


def read_text(file: Path) -> str:
    """The file's text, UTF-8 with or without a mark; ``UsageError`` where ODM could not read it."""
    try:
        if file.stat().st_size > DEFAULTS.max_text_bytes:
            raise UsageError(
                f"{file.name} is larger than {DEFAULTS.max_text_bytes // 1024**2} MB; that is no such list."
            )
        return file.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"{file.name} cannot be read: {error.strerror or error}.") from None
    except UnicodeDecodeError:
        raise UsageError(f"{file.name} is not UTF-8 text, ODM would stop on it. Save it again as UTF-8.") from None


def split_lines(text: str) -> List[Tuple[int, str]]:
    """(line number, stripped line) as ODM counts them; the first is the header. Comments and empty lines are out."""
    rows = text.replace("\ufeff", "").strip().split("\n")
    kept = [(1, rows[0].strip())]
    return kept + [(i, r.strip()) for i, r in enumerate(rows[1:], start=2) if r.strip() and r.strip()[0] != "#"]


def _fields(row: str) -> List[str]:
    """Six columns and the rest. A row with tabs is cut at them, so that names with blanks survive."""
    by_tab = [p.strip() for p in row.split("\t")]
    if len(by_tab) >= _COLUMNS and all(by_tab[:_COLUMNS]):
        return [*by_tab[:_COLUMNS], " ".join(" ".join(by_tab[_COLUMNS:]).split())]
    words = row.split()
    return [*words[:_COLUMNS], " ".join(words[_COLUMNS:])] if len(words) >= _COLUMNS else words


def is_number(text: str, allow_nan: bool = False) -> bool:
    """Whether ODM reads ``text`` as a number that means something."""
    try:
        value = float(text)
    except ValueError:
        return False
    return "_" not in text and (math.isfinite(value) or (allow_nan and math.isnan(value)))


def read_gcp(text: str) -> GcpFile:
    """Read a ground control list. Bad lines become findings; ``UsageError`` for a header that means nothing."""
    rows = split_lines(text)
    srs = parse_srs(rows[0][1])
    lines: List[GcpLine] = []
    findings: List[Finding] = []
    for number, row in rows[1:]:
        parts = _fields(row)
        if len(parts) < _COLUMNS:
            findings.append(_malformed(number, "has fewer than six columns", f"Malformed GCP line: {row}"))
        elif not all(is_number(p, allow_nan=i == 2) for i, p in enumerate(parts[:5])):
            findings.append(_malformed(number, "has a word where a number must stand; ODM would stop on it", None))
        else:
            lines.append(GcpLine(number, *parts))
    if not lines:
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
    return GcpFile(srs, tuple(lines), tuple(findings))


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
        )
        for m in placed
        if m.path in by_path and math.isfinite(m.line.point[2])
    )
