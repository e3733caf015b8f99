"""What the harmonizing stage plans and what it did."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Iterable, Optional, Tuple

from ..frame import Frame


@dataclass(frozen=True)
class Lut:
    """One table per profile, flight and channel: 256 entries of 0..255 each, monotone."""

    id: str
    tables: Tuple[Tuple[int, ...], ...]
    offset_dn: Tuple[float, ...]
    reference: str
    frames_sampled: int


@dataclass(frozen=True)
class FlightAction:
    """What happens to the frames of one profile and flight.

    ``scale`` is linear, 1.0 leaves the pixels. ``write_lut`` is set where the
    table goes into what is written (8-bit RGB); otherwise it serves the
    in-memory copies of the alignment only. ``focal_mm`` and ``focal_35mm`` are
    the one focal tag that the project's copies carry (written where absent),
    ``None`` leaves the tags. ``radiometric_none`` is set where resampling voids
    black level, vignette or row gradient: the frames are no reflectance then.
    ``sensor_width_mm`` is set where the focal-plane tags are stale or 0/0: the copies'
    tags are set to say this width.
    """

    profile: str
    flight: str
    frames: Tuple[str, ...]
    gsd_cm: Optional[float]
    target_gsd_cm: Optional[float]
    scale: float
    width: int
    height: int
    out_width: int
    out_height: int
    lut: Optional[str] = None
    write_lut: bool = False
    focal_mm: Optional[float] = None
    focal_35mm: Optional[float] = None
    reasons: Tuple[str, ...] = ()
    radiometric_none: bool = False
    sensor_width_mm: Optional[float] = None


@dataclass(frozen=True)
class Outcome:
    """A flight's frames at one size: expected share of matches with the finest frames, and what they take.

    ``inliers`` is relative to frames of equal ground resolution;
    ``megapixels`` and ``size_bytes`` (estimated where resampled) are of all
    frames of the flight.
    """

    scale: float
    width: int
    height: int
    gsd_cm: Optional[float]
    inliers: float
    megapixels: float
    size_bytes: int


@dataclass(frozen=True)
class Gain:
    """What resampling one profile and flight brings and costs.

    ``ratio`` is its ground resolution over the finest of its spectrum and
    ``ground``. ``chosen`` is set where the plan resamples it: ``resampled`` is
    then what the plan writes, else what bringing it to the finest would mean.
    """

    profile: str
    flight: str
    spectrum: str
    ground: str
    frames: int
    ratio: float
    trigger: float
    chosen: bool
    native: Outcome
    resampled: Outcome


@dataclass(frozen=True)
class HarmonizePlan:
    """All that harmonizing will do, before any pixel moves."""

    actions: Tuple[FlightAction, ...]
    luts: Tuple[Lut, ...] = ()
    gains: Tuple[Gain, ...] = ()


@dataclass(frozen=True)
class HarmonizedFrame:
    """One frame as it goes into a project.

    ``how`` is ``linked``, ``copied``, ``retagged`` (header only), ``matched``
    (colours only, same size), ``resampled`` or ``warped`` (a band laid on its
    rig's primary).
    """

    path: str
    file: str
    name: str
    width: int
    height: int
    scale: float
    how: str
    kept: str = ""


def untouched(frames: Iterable[Frame]) -> Dict[str, HarmonizedFrame]:
    """Path -> the frame as it is, where nothing was harmonized."""
    return {f.path: HarmonizedFrame(f.path, f.path, f.name, f.width, f.height, 1.0, "linked") for f in frames}
