"""Tone offsets between flights, learned from ground that both saw, and the tables that take them out.

Only 8-bit frames are compared: deeper pixels are raw measurements, and the
alignment stretches them per flight on its own copies.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from ..finding import INFO, WARNING, Finding, sort_key
from ..frame import Frame
from ..profile import THERMAL, CameraProfile, Flight, SurveyFrame
from ..progress import Cancel, Progress, check
from ..thresholds import Thresholds
from .ground import Pair, pairs_between, pairs_within, radius_m
from .model import Lut
from .plan import lut_id
from .tables import Histogram, match_table, mean_dn
from .tones import read_tones
from .units import Group, grounds, survey_groups

STAGE = "tones"
PathLike = Union[str, Path]


@dataclass(frozen=True)
class _Reader:
    """Reads each disc of each frame once."""

    sources: Mapping[str, PathLike]
    sample_px: int
    cancel: Optional[Cancel]
    seen: Dict[Tuple[str, int], Optional[Histogram]]

    def disc(self, path: str, share: float) -> Optional[Histogram]:
        check(self.cancel)
        key = (path, round(1000 * share))
        if key not in self.seen:
            self.seen[key] = read_tones(self.sources[path], share, self.sample_px)
        return self.seen[key]

    def compare(self, pairs: Sequence[Pair], shares: Tuple[float, float]) -> List[Tuple[Histogram, Histogram]]:
        """Histograms of the pairs that could be read and have the same channels."""
        read = [(self.disc(p.first, shares[0]), self.disc(p.second, shares[1])) for p in pairs]
        return [(a, b) for a, b in read if a is not None and b is not None and a.shape == b.shape]


def learn_luts(
    frames: Sequence[SurveyFrame],
    files: Mapping[str, Frame],
    sources: Mapping[str, PathLike],
    profiles: Sequence[CameraProfile],
    flights: Sequence[Flight],
    thresholds: Thresholds,
    *,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Tuple[Tuple[Lut, ...], Tuple[Finding, ...]]:
    """Compare every flight with the reference flight of its spectrum, band and ground.

    The reference is the one with most frames. Returns a table for each flight
    that is more than ``channel_offset_dn`` off in a channel, and findings:
    ``radiometry-offset``, ``radiometry-no-overlap``, ``light-varies``.
    """
    groups = [g for g in survey_groups(frames, files, flights) if _eight_bit(g, files)]
    ground_of = grounds(groups, profiles, flights, files, thresholds)
    pools: Dict[Tuple[str, str, str], List[Group]] = defaultdict(list)
    for group in groups:
        pools[(group.spectrum, group.band.lower(), ground_of[group.flight])].append(group)
    reader = _Reader(sources, thresholds.tone_sample_px, cancel, {})
    luts: List[Lut] = []
    findings: List[Finding] = []
    count = 0
    for key in sorted(pools):
        pool = sorted(pools[key], key=lambda g: (-len(g.frames), g.key))
        for group in pool:
            if group is not pool[0]:
                lut, found = _against(group, pool[0], files, reader, thresholds)
                luts.extend(lut)
                findings.extend(found)
            if group.spectrum != THERMAL:
                findings.extend(_light(group, files, reader, thresholds))
            count += 1
            if progress:
                progress(STAGE, count, len(groups))
    return tuple(sorted(luts, key=lambda t: t.id)), tuple(sorted(findings, key=sort_key))


def _eight_bit(group: Group, files: Mapping[str, Frame]) -> bool:
    return all(files[p].bits == 8 and files[p].channels in (1, 3) for p in group.frames)


def _against(
    group: Group, reference: Group, files: Mapping[str, Frame], reader: _Reader, limits: Thresholds
) -> Tuple[Tuple[Lut, ...], Tuple[Finding, ...]]:
    pairs = pairs_between(group, reference, files, limits)
    radii = (radius_m(group) or 1.0, radius_m(reference) or 1.0)
    shares = (min(radii) / radii[0], min(radii) / radii[1])
    read = reader.compare(pairs, shares) if len(pairs) >= limits.tone_min_pairs else []
    if len(read) < limits.tone_min_pairs:
        return (), (_no_overlap(group, reference, len(read), limits),)
    source = np.mean([a for a, _ in read], axis=0)
    wanted = np.mean([b for _, b in read], axis=0)
    offsets = tuple(mean_dn(a) - mean_dn(b) for a, b in zip(source, wanted))
    worst = max(abs(o) for o in offsets)
    if worst <= limits.channel_offset_dn:
        return (), ()
    lut = Lut(
        id=lut_id(group.profile, group.flight),
        tables=tuple(match_table(a, b, limits.lut_max_slope) for a, b in zip(source, wanted)),
        offset_dn=tuple(round(o, 2) for o in offsets),
        reference=lut_id(reference.profile, reference.flight),
        frames_sampled=2 * len(read),
    )
    shown = ", ".join(f"{o:+.0f}" for o in offsets)
    finding = Finding(
        code="radiometry-offset",
        severity=WARNING,
        subjects=(group.flight, reference.flight),
        message=f"Over the same ground this flight is {shown} DN of 255 off the reference flight (per channel).",
        remedy="sensorgate run brings its colours to the reference with one table per channel; originals stay.",
        measured=worst,
        threshold=limits.channel_offset_dn,
    )
    return (lut,), (finding,)


def _no_overlap(group: Group, reference: Group, pairs: int, limits: Thresholds) -> Finding:
    why = "no two frames show the same ground"
    if group.gsd_cm is None or reference.gsd_cm is None:
        why = "without a height above ground it is unknown which frames show the same ground"
    elif pairs:
        why = f"only {pairs} pairs of frames show the same ground"
    return Finding(
        code="radiometry-no-overlap",
        severity=INFO,
        subjects=(group.flight, reference.flight),
        message=f"The colours of these two flights were not compared: {why}. They stay as they are.",
        remedy="Nothing has to be done. Different ground has different colours, which is no fault of a camera.",
        measured=float(pairs),
        threshold=float(limits.tone_min_pairs),
    )


def _light(group: Group, files: Mapping[str, Frame], reader: _Reader, limits: Thresholds) -> Iterator[Finding]:
    """Warn when the same ground changes its tone within a flight: at once (a cloud), or slowly (a drift)."""
    close, strips = pairs_within(group, files, limits)
    changes: List[float] = []
    sudden = _differences(reader.compare(close, (1.0, 1.0)))
    if len(sudden) >= limits.tone_min_pairs:
        # The largest may be a passing car or a shadow; a cloud shows in two pairs.
        changes.append(float(np.sort(np.abs(sudden).max(axis=1))[-2]))
    slow = _differences(reader.compare(strips, (1.0, 1.0)))
    if len(slow) >= limits.tone_min_pairs:
        changes.append(float(np.abs(np.median(slow, axis=0)).max()))
    if changes and max(changes) > limits.channel_offset_dn:
        yield Finding(
            code="light-varies",
            severity=WARNING,
            subjects=(group.flight,),
            message=f"Within this flight the same ground changes by {max(changes):.0f} DN of 255: "
            "light or exposure was not steady.",
            remedy="One table per flight cannot repair this. Expect seams; fly with locked exposure in steady light.",
            measured=max(changes),
            threshold=limits.channel_offset_dn,
        )


def _differences(read: Sequence[Tuple[Histogram, Histogram]]) -> "np.ndarray[Tuple[int, int], np.dtype[np.float64]]":
    """(pairs, channels) of second minus first mean, in DN."""
    return np.asarray([[mean_dn(b) - mean_dn(a) for a, b in zip(*pair)] for pair in read])
