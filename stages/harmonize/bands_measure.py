"""Control points of the sampled captures: the user's, or measured by worker processes."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from ..profile import SurveyFrame
from ..progress import Cancel, Progress
from ..record import to_plain
from ..thresholds import Thresholds
from .bands_group import Rig, sample
from .bands_lens import Points
from .bands_work import ALWAYS, FALLBACK, MEASURE, NEVER
from .control_points import ControlPair
from .pool import BANDS, run_jobs

STAGE = "bands"
PathLike = Union[str, Path]
Measured = Dict[str, Dict[str, Points]]


def user_points(
    rigs: Sequence[Rig], control: Sequence[ControlPair]
) -> Tuple[Dict[Tuple[str, str], Points], Tuple[str, ...]]:
    """(Payload, profile) -> the user's points (n, 4), and which pairs of names fit nothing here."""
    found: Dict[Tuple[str, str], List[Points]] = {}
    unused = []
    for pair in control:
        used = False
        for turned in (pair, pair.turned()):
            for rig in rigs:
                for profile in _profiles_meant(rig, turned):
                    found.setdefault((rig.payload.id, profile), []).append(np.array(turned.points, np.float64))
                    used = True
            if used:
                break
        if not used:
            unused.append(f"{pair.a} / {pair.b}")
    return {key: np.vstack(parts) for key, parts in found.items()}, tuple(sorted(set(unused)))


def _profiles_meant(rig: Rig, pair: ControlPair) -> List[str]:
    """Bands of ``rig`` that ``b`` names where ``a`` names the primary."""
    if pair.a.lower() == rig.primary_band.lower():
        return [p for p, name in sorted(rig.band_of.items()) if name.lower() == pair.b.lower()]
    for height_bin in rig.bins:
        for capture in height_bin.captures:
            if _is_named(capture.primary.path, pair.a):
                return [p for p, frame in capture.bands if _is_named(frame.path, pair.b)]
    return []


def _is_named(path: str, name: str) -> bool:
    return path == name or path.endswith("/" + name)


def measure(
    rigs: Sequence[Rig],
    sources: Mapping[str, PathLike],
    user: Mapping[Tuple[str, str], Points],
    limits: Thresholds,
    workers: int,
    progress: Optional[Progress],
    cancel: Optional[Cancel],
) -> Measured:
    """Band path -> its control points by each method, from the sampled captures."""
    jobs: List[Dict[str, Any]] = []
    for rig in rigs:
        for height_bin in rig.bins:
            for count, capture in enumerate(sample(height_bin.captures, int(limits.band_captures))):
                bands = [
                    _measure_band(rig, profile, frame, sources, count < limits.band_check_captures)
                    for profile, frame in capture.bands
                    if (rig.payload.id, profile) not in user
                ]
                if bands:
                    primary = {"source": str(sources[capture.primary.path]), "lens": to_plain(rig.primary_lens)}
                    jobs.append({"what": MEASURE, "path": capture.primary.path, "primary": primary, "bands": bands})
    found: Measured = {}
    if not jobs:
        return found
    with contextlib.closing(run_jobs(jobs, limits, task=BANDS, workers=workers, cancel=cancel)) as answers:
        for count, (_, answer) in enumerate(answers, 1):
            for path, points in answer.get("points", {}).items():
                found[path] = {k: np.array(v, np.float64).reshape(-1, 4) for k, v in points.items()}
            if progress:
                progress(STAGE, count, len(jobs))
    return found


def _measure_band(
    rig: Rig, profile: str, frame: SurveyFrame, sources: Mapping[str, PathLike], check: bool
) -> Dict[str, Any]:
    optics = rig.optics[profile]
    return {
        "path": frame.path,
        "source": str(sources[frame.path]),
        "lens": to_plain(optics.lens),
        "prior": [float(v) for v in rig.prior(profile).ravel()],
        "descriptors": (ALWAYS if check else FALLBACK) if optics.descriptors else NEVER,
    }
