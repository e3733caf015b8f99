"""What aligning the bands of a rig plans and measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

from .bands_lens import Lens

WARP, ALIGNED, REFUSED = "warp", "aligned", "refused"
CALIBRATED, PLAIN = "calibrated", "plain"
# How pixel-bound radiometry of warped frames is dealt with.
APPLIED, KEPT, VOIDED, NOTHING = "applied", "kept", "none", ""
Matrix = Tuple[float, ...]


@dataclass(frozen=True)
class Residual:
    """Distance of held-out control points, in pixels of the coarser band."""

    points: int
    median_px: float
    p95_px: float


@dataclass(frozen=True)
class CaptureFit:
    """How one sampled capture's control points agree with its bin.

    ``matches`` were found, ``agreeing`` of them fit the bin's homography.
    ``pooled`` is the held-out residual of the bin's homography, ``own`` that
    of one fitted to this capture alone. ``mismatch`` is set where the capture
    has points and they contradict the bin: a file of another capture.
    """

    capture: str
    frame: str
    matches: int
    agreeing: int
    pooled: Optional[Residual] = None
    own: Optional[Residual] = None
    mismatch: bool = False


@dataclass(frozen=True)
class BandFit:
    """One band of one height bin against the primary.

    ``matrix`` (row by row) takes rays of the primary to rays of the band: the
    normalised coordinates that ``lenses`` undistort pixels to. ``lenses`` is
    ``calibrated`` or ``plain`` (no distortion known, or none that helps).
    ``model`` is ``homography``, ``affine`` or ``rig``; ``source`` is
    ``control-points``, ``features``, ``area`` or ``neighbour`` (borrowed from
    the next height bin). ``held_out`` is measured on points that the fit did
    not see, ``cross_check`` on all control points of the other kind (features
    for ``area`` and the reverse), ``plain_homography`` on the same kind of points for one homography
    between raw pixels. ``low_m`` and ``high_m`` are the bin's heights above
    ground, ``None`` where they are unknown.
    """

    payload: str
    primary: str
    profile: str
    band: str
    low_m: Optional[float]
    high_m: Optional[float]
    pairs: Tuple[Tuple[str, str], ...]
    state: str
    reason: str = ""
    matrix: Matrix = ()
    model: str = ""
    lenses: str = ""
    source: str = ""
    primary_lens: Optional[Lens] = None
    band_lens: Optional[Lens] = None
    control_points: int = 0
    inliers: int = 0
    held_out: Optional[Residual] = None
    cross_check: Optional[Residual] = None
    plain_homography: Optional[Residual] = None
    refine: bool = False
    sampled: Tuple[CaptureFit, ...] = ()


@dataclass(frozen=True)
class RigPlan:
    """What holds for one rig.

    ``aligned`` bands lie on the primary's grid after ``apply_bands`` or
    already did; ``refused`` ones do not and need a project of their own.
    ``skip_band_alignment`` is set where every band that stays is aligned.
    ``radiometry`` is ``applied`` (black level, vignette and row gradient go
    into warped pixels and their tags are neutralised), ``kept`` (they were
    taken off, the frame warped, and those of the new place put back: the tags
    stay true), ``none`` (they are void after warping: the project needs
    ``radiometric-calibration none``) or empty (there is nothing of the kind,
    or nothing is warped). ``mismatched`` are
    frames that belong to another capture.
    """

    payload: str
    primary: str
    primary_band: str
    aligned: Tuple[str, ...]
    refused: Tuple[str, ...]
    skip_band_alignment: bool
    radiometry: str = NOTHING
    mismatched: Tuple[str, ...] = ()


@dataclass(frozen=True)
class BandPlan:
    """All that aligning bands will do, before any frame is written."""

    rigs: Tuple[RigPlan, ...] = ()
    fits: Tuple[BandFit, ...] = ()

    def warped(self) -> Tuple[str, ...]:
        """Paths of the frames that ``apply_bands`` writes, sorted."""
        return tuple(sorted(band for fit in self.fits if fit.state == WARP for _, band in fit.pairs))
