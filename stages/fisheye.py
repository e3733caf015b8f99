"""Fisheye lenses as cameras write them and as solvers take them.

Parrot's XMP (Pix4D's camera namespace) gives the distance from the axis as a
polynomial of the angle, 90 degrees being 1. OpenCV and OpenSfM take
``f * (t + k1 t^3 + k2 t^5 + k3 t^7 + k4 t^9)``, across and down each with its
own f (C and F of the affine matrix). With the focal length free,
three coefficients follow the four Sequoia polynomials of real frames to 0.04 px.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np

_SAMPLES = 2000
_WIDEST = math.radians(100.0)


@dataclass(frozen=True)
class OpenCvFisheye:
    """Focal length (mean of across and down) and k1, k2, k3, with the conversion's largest error in the frame; px."""

    focal_px: float
    coefficients: Tuple[float, float, float]
    error_px: float


def as_opencv(
    polynomial: Sequence[float], affine: Sequence[float], width: int, height: int, tolerance_px: float
) -> Optional[OpenCvFisheye]:
    """Convert a polynomial (p0, p1, ...) and affine matrix (C, D, E, F; px), ``None`` where it cannot be said so.

    Least squares over angles from the axis to the frame's corner, C and F at
    their mean: their ratio is the aspect of what is found. A skewed affine
    part, or an error beyond ``tolerance_px``, is no conversion.
    """
    if len(affine) != 4 or len(polynomial) < 2 or not affine[0] > 0 or not affine[3] > 0:
        return None
    c, d, e, f = affine
    if abs(d) + abs(e) > tolerance_px / max(width, height) * c:
        return None
    mean = (c + f) / 2.0
    angle = np.linspace(_WIDEST / _SAMPLES, _WIDEST, _SAMPLES)
    unit = angle * 2.0 / math.pi
    radius = mean * np.polynomial.polynomial.polyval(unit, np.asarray(polynomial, dtype=float))
    inside = radius <= math.hypot(width * (mean / c), height * (mean / f)) / 2.0
    # Past its crest a polynomial turns back: only the branch from the axis is the lens.
    crest = np.nonzero(np.diff(radius) <= 0)[0]
    if len(crest):
        inside &= np.arange(len(angle)) <= crest[0]
    if inside.sum() < 10:
        return None
    angle, radius = angle[inside], radius[inside]
    design = np.stack([angle, angle**3, angle**5, angle**7], axis=1)
    solved = np.linalg.lstsq(design, radius, rcond=None)[0]
    error = float(np.abs(design @ solved - radius).max())
    focal = float(solved[0])
    if not focal > 0 or error > tolerance_px:
        return None
    k1, k2, k3 = (float(v) / focal for v in solved[1:])
    return OpenCvFisheye(focal, (k1, k2, k3), round(error, 4))
