"""What an alignment can give to the calibration store (pure)."""

from __future__ import annotations

from typing import List, Sequence, Tuple

from ..calibrations import Key, Measurement, key_of, worth_keeping
from ..profile import CameraProfile
from ..thresholds import Thresholds
from .judge import PASS
from .model import AlignmentReport


def offered(
    alignment: AlignmentReport, profiles: Sequence[CameraProfile], survey: str, limits: Thresholds
) -> Tuple[Tuple[Key, Measurement], ...]:
    """What a proven alignment can give to the store: focals that its geometry fixed, of bodies with a serial.

    ``survey`` is the digest of the survey's frames.
    """
    if alignment.verdict != PASS:
        return ()
    at = {p.id: p for p in profiles}
    solved = {c.profile: c for c in alignment.cameras}
    result: List[Tuple[Key, Measurement]] = []
    for decision in alignment.decisions:
        camera, profile = solved.get(decision.profile), at.get(decision.profile)
        key = key_of(profile) if profile is not None else None
        if not decision.supported or key is None or camera is None or camera.focal_sigma is None:
            continue
        k1, k2, p1, p2, k3 = camera.distortion
        new = Measurement(
            focal_ratio=camera.focal_ratio,
            focal_sigma=camera.focal_sigma,
            center_ratio=camera.center_ratio,
            distortion=(k1, k2, p1, p2, k3),
            frames=camera.frames,
            survey=survey,
            aspect_ratio=camera.aspect_ratio,
        )
        if worth_keeping(new, limits):
            result.append((key, new))
    return tuple(result)
