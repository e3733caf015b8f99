"""Which frames of a rig are compared with which: captures, height bins, samples (pure)."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from ..frame import Frame
from ..geo import median
from ..profile import THERMAL, Payload, SurveyFrame
from ..thresholds import Thresholds
from .bands_lens import Lens, Points, lens_of, rig_matrix


@dataclass(frozen=True)
class RigCapture:
    """One trigger of a rig: its primary frame and the other bands' frames by profile."""

    capture: str
    primary: SurveyFrame
    bands: Tuple[Tuple[str, SurveyFrame], ...]


@dataclass(frozen=True)
class HeightBin:
    """Captures flown at one height; heights are ``None`` where unknown, then ``flight`` keeps them apart."""

    low_m: Optional[float]
    high_m: Optional[float]
    captures: Tuple[RigCapture, ...]

    @property
    def height_m(self) -> Optional[float]:
        """Median height of the captures."""
        known = [c.primary.height_m for c in self.captures if c.primary.height_m]
        return median(known) if known else None


@dataclass(frozen=True)
class BandOptics:
    """A band's lens, whether descriptors can be compared with the primary's, and what the rig's tags say.

    ``rigs`` are primary rays to band rays, in both senses in which makers
    write the angles; empty without tags.
    """

    lens: Lens
    descriptors: bool
    rigs: Tuple[Points, ...]


def rig_captures(payload: Payload, frames: Sequence[SurveyFrame], files: Mapping[str, Frame]) -> Tuple[RigCapture, ...]:
    """The payload's captures that have a primary frame and another band's, by path of the primary."""
    by_capture: Dict[str, Dict[str, SurveyFrame]] = defaultdict(dict)
    for frame in sorted(frames, key=lambda f: f.path):
        if frame.payload == payload.id and frame.role == "survey" and not frame.excluded and frame.path in files:
            by_capture[frame.capture].setdefault(frame.profile, frame)
    found = []
    for name in by_capture:
        members = by_capture[name]
        primary = members.pop(payload.primary, None)
        if primary is not None and members:
            found.append(RigCapture(name, primary, tuple(sorted(members.items()))))
    return tuple(sorted(found, key=lambda c: c.primary.path))


def height_bins(captures: Sequence[RigCapture], limits: Thresholds) -> Tuple[HeightBin, ...]:
    """Bins whose greatest height is at most ``band_height_bin`` above the least, counted from the lowest capture."""
    known = sorted((c for c in captures if c.primary.height_m), key=lambda c: (c.primary.height_m, c.primary.path))
    groups: List[List[RigCapture]] = []
    for capture in known:
        height = capture.primary.height_m or 0.0
        if not groups or height > (groups[-1][0].primary.height_m or 0.0) * (1.0 + limits.band_height_bin):
            groups.append([])
        groups[-1].append(capture)
    bins = [
        HeightBin(g[0].primary.height_m, g[-1].primary.height_m, tuple(sorted(g, key=lambda c: c.primary.path)))
        for g in groups
    ]
    unknown: Dict[str, List[RigCapture]] = defaultdict(list)
    for capture in captures:
        if not capture.primary.height_m:
            unknown[capture.primary.flight].append(capture)
    bins += [HeightBin(None, None, tuple(unknown[flight])) for flight in sorted(unknown)]
    return tuple(bins)


def sample(captures: Sequence[RigCapture], count: int) -> Tuple[RigCapture, ...]:
    """At most ``count`` captures, spread evenly over the bin."""
    if len(captures) <= count:
        return tuple(captures)
    return tuple(captures[(2 * i + 1) * len(captures) // (2 * count)] for i in range(count))


def band_optics(primary: SurveyFrame, band: SurveyFrame, files: Mapping[str, Frame]) -> BandOptics:
    """The optics of a band by the tags of one of its frames."""
    mine, other = files[primary.path], files[band.path]
    relative = rig_matrix(mine.rotation_deg, other.rotation_deg)
    rigs = () if relative is None else (relative, relative.T)
    descriptors = THERMAL not in (primary.spectrum, band.spectrum)
    return BandOptics(lens_of(other, band.intrinsics), descriptors, rigs)


@dataclass(frozen=True)
class Rig:
    """One payload with all that is known of it before anything is measured."""

    payload: Payload
    bins: Tuple[HeightBin, ...]
    primary_lens: Lens
    optics: Mapping[str, BandOptics]
    band_of: Mapping[str, str]
    primary_band: str
    tagged: Tuple[str, ...]

    def prior(self, profile: str) -> Points:
        """Where the search starts: the rig's tags, else both bands look the same way."""
        rigs = self.optics[profile].rigs
        return rigs[0] if rigs else np.eye(3)


def find_rig(
    payload: Payload, frames: Sequence[SurveyFrame], files: Mapping[str, Frame], limits: Thresholds
) -> Optional[Rig]:
    """The payload as a rig; ``None`` where there is nothing to align."""
    if len(payload.profiles) < 2:
        return None
    captures = rig_captures(payload, frames, files)
    if not captures:
        return None
    first = captures[0].primary
    optics: Dict[str, BandOptics] = {}
    band_of: Dict[str, str] = {}
    tagged = set()
    for capture in captures:
        for profile, band in capture.bands:
            # Thermal counts are temperatures: nobody levels them.
            if files[band.path].radiometry and band.spectrum != THERMAL:
                tagged.add(profile)
            if profile not in optics:
                optics[profile] = band_optics(capture.primary, band, files)
                band_of[profile] = _label(files[band.path], band)
    lens = lens_of(files[first.path], first.intrinsics)
    bins = height_bins(captures, limits)
    return Rig(payload, bins, lens, optics, band_of, _label(files[first.path], first), tuple(sorted(tagged)))


def _label(file: Frame, frame: SurveyFrame) -> str:
    """The band's name as the file spells it: that is what later readers go by."""
    return file.bands[0] if len(file.bands) == 1 else frame.band
