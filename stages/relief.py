"""Heights above take-off turned into heights above ground where an elevation model knows the relief (pure).

Relative altitude counts from the take-off. Over relief the ground lies higher
or lower than that: height = relative altitude + ground at take-off - ground
under the frame. The model's vertical datum cancels in it, and no GPS altitude
is needed. It is done only where the folder shows the take-off: frames near the
ground at an end of the session. Without them the heights stay, and their
spread says how far the relief may put them off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence

from .flights import PANEL, SURVEY, TRANSIT, Height
from .frame import Frame
from .geo import median
from .thresholds import Thresholds

CORRECTED = "relative-altitude+dem"


@dataclass(frozen=True)
class Ground:
    """Ground heights in metres under the frames that have one, by path, and their standard deviation."""

    under: Mapping[str, float]
    sigma_m: float

    @property
    def noise_m(self) -> float:
        """Standard deviation of the difference of two of the heights."""
        return math.sqrt(2.0) * self.sigma_m


def over_relief(
    session: Sequence[Frame],
    role: Mapping[str, str],
    heights: Mapping[str, Height],
    ground: Ground,
    limits: Thresholds,
) -> Dict[str, Height]:
    """The heights of a session's frames that change with the relief; empty where the ground is flat or unknown.

    Flat is what lies within twice the noise of the model: correcting by noise
    would only add it.
    """
    known = [f for f in session if heights[f.path].source == "relative-altitude" and f.path in ground.under]
    under = [ground.under[f.path] for f in known if role[f.path] == SURVEY]
    if not under:
        return {}
    start = _takeoff_m(known, role, heights, ground, limits)
    relief = max(under) - min(under)
    if start is None:
        if relief <= 2.0 * ground.noise_m:
            return {}
        # The take-off lay somewhere in that span: a uniform distribution.
        spread = relief / math.sqrt(12.0)
        return {f.path: _changed(heights[f.path], 0.0, spread, "relative-altitude") for f in known}
    if max(max(under) - start, start - min(under)) <= 2.0 * ground.noise_m:
        return {}
    return {f.path: _changed(heights[f.path], start - ground.under[f.path], ground.noise_m, CORRECTED) for f in known}


def _changed(height: Height, by_m: float, spread_m: float, source: str) -> Height:
    value = None if height.value_m is None else height.value_m + by_m
    return Height(value, source, math.hypot(height.sigma_m or 0.0, spread_m))


def _takeoff_m(
    known: Sequence[Frame],
    role: Mapping[str, str],
    heights: Mapping[str, Height],
    ground: Ground,
    limits: Thresholds,
) -> Optional[float]:
    """Ground at the take-off, where frames near it say so and agree."""
    low: List[float] = []
    for frame in known:
        height = heights[frame.path].value_m
        if role[frame.path] in (PANEL, TRANSIT) and height is not None and abs(height) <= limits.panel_height_m:
            low.append(ground.under[frame.path])
    if not low or max(low) - min(low) > 2.0 * ground.noise_m:
        return None
    return median(low)
