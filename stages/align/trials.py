"""Which calibrations of a profile are tried, what of a block could hold them, and how each fared (pure)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Optional, Sequence, Tuple

from ..thresholds import Thresholds
from .model import AlignCamera, Bowing
from .prepare import focal_over_side, known_distortion
from .solution import CameraSetting, in_frame, in_work
from .vertical import DISAGREE, FLYING, MODEL, MODEL_DISAGREES, VerticalScale

SOLVED = "solved"
HEIGHTS = "heights"
NONE = "none"
STRAIGHT = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Trial:
    """One calibration to try: a focal ratio (over the longer side) and a distortion, ``None`` where solved."""

    name: str
    focal_source: str
    distortion_source: str
    focal: Optional[float]
    distortion: Optional[Tuple[float, ...]]


@dataclass(frozen=True)
class Geometry:
    """What of a block can hold a self-calibration: oblique share, control points, measured heights.

    ``height_sigma`` is the standard error of the vertical scale by measured
    differences of height, ``None`` where there are none, and ``height_by``
    what measured them.
    """

    oblique_share: float
    control: bool = False
    height_sigma: Optional[float] = None
    height_by: str = FLYING

    def tilted(self, limits: Thresholds) -> bool:
        """Enough tilted views. Straight down, the place and tilt of each camera take up a shifted principal point."""
        return self.oblique_share >= limits.oblique_share

    def strong(self, limits: Thresholds) -> bool:
        """Obliques, ground control or well measured flying heights: the block itself supports what it solves.

        An elevation model fixes a focal, but nothing that solves the block again has it.
        """
        return self.control or self.tilted(limits) or (self.by_heights(limits) and self.height_by != MODEL)

    def by_heights(self, limits: Thresholds) -> bool:
        """Differences of height are known well enough to fix a focal, and nothing else does.

        So well that candidates told apart by ``focal_source_gap`` lie ``solved_focal_sigma`` standard errors apart.
        """
        if (
            self.control
            or self.tilted(limits)
            or self.height_sigma is None
            or (self.height_by in (DISAGREE, MODEL_DISAGREES))
        ):
            return False
        return limits.solved_focal_sigma * self.height_sigma <= limits.focal_source_gap


@dataclass(frozen=True)
class Outcome:
    """How a trial fared. ``misfit`` is residual over allowed, the larger of horizontal and vertical.

    ``solved_focal``, ``solved_center``, ``solved_distortion`` and
    ``solved_aspect`` are its camera after the adjustment, ``focal_sigma`` the standard error of a solved
    focal, ``scale`` what measured heights say of it.
    """

    trial: Trial
    error_px: Optional[float]
    gps_horizontal_m: Optional[float]
    gps_vertical_m: Optional[float]
    misfit: Optional[float]
    height_m: Optional[float]
    relief_m: Optional[float]
    bowing: Bowing
    solved_focal: float
    solved_distortion: Tuple[float, ...]
    focal_sigma: Optional[float] = None
    solved_center: Tuple[float, float] = (0.0, 0.0)
    scale: Optional[VerticalScale] = None
    solved_aspect: float = 1.0


def trials_for(camera: AlignCamera) -> Tuple[Trial, ...]:
    """Return a profile's candidates: its own focal or a solved one, times distortion none, known or solved.

    A focal from an untrusted source is tried as well, because a weak block
    solves a worse one; it is never locked.
    """
    focals: List[Tuple[str, Optional[float]]] = [(SOLVED, None)]
    known_focal = focal_over_side(camera)
    if known_focal is not None:
        focals.insert(0, (camera.intrinsics.focal_source, known_focal))
    bends: List[Tuple[str, Optional[Tuple[float, ...]]]] = [(NONE, STRAIGHT)]
    known = known_distortion(camera)
    if known is not None and any(known):
        bends.append((camera.intrinsics.distortion_source, known))
    bends.append((SOLVED, None))
    return tuple(
        Trial(f"focal {focal_name}, distortion {bend_name}", focal_name, bend_name, focal, bend)
        for focal_name, focal in focals
        for bend_name, bend in bends
    )


def trials_by_heights(outcomes: Sequence[Outcome], geometry: Geometry, limits: Thresholds) -> Tuple[Trial, ...]:
    """Return further candidates: solved focals put right by measured differences of height.

    Straight down a focal and all heights scale together, so the vertical scale
    is the focal's error. Only where it is known well enough, and nothing else
    fixes the focal. Such candidates among ``outcomes`` are put right once more.
    """
    if not geometry.by_heights(limits):
        return ()
    earlier = [o for o in outcomes if o.trial.focal_source == HEIGHTS]
    return tuple(
        Trial(
            f"focal {HEIGHTS}, distortion {o.trial.distortion_source}",
            HEIGHTS,
            o.trial.distortion_source,
            round(o.solved_focal * o.scale.ratio, 6),
            o.trial.distortion,
        )
        for o in (earlier or [o for o in outcomes if o.trial.focal is None])
        if o.scale is not None
    )


def setting_for(trial: Trial, current: CameraSetting, tilted: bool = False) -> CameraSetting:
    """The camera that an adjustment starts from under a trial; with ``tilted`` views its centre is solved as well."""
    if trial.focal is not None:
        current = in_work(replace(in_frame(current), focal_ratio=trial.focal))
    return replace(
        current,
        distortion=trial.distortion if trial.distortion is not None else (*current.distortion[:2], 0.0, 0.0, 0.0),
        solve_focal=trial.focal is None,
        solve_distortion=trial.distortion is None,
        solve_center=tilted and trial.distortion is None,
    )


def frozen(setting: CameraSetting) -> CameraSetting:
    """The same camera, not moving: how the other profiles stand while one is tried."""
    return replace(setting, solve_focal=False, solve_distortion=False, solve_center=False)
