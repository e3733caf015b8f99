"""What the alignment is asked and what it answers.

Both go to JSON and back, so the alignment can run in a worker process, on
another machine, or with the other engine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

from ..harmonize.model import Lut
from ..intrinsics import Intrinsics


@dataclass(frozen=True)
class AlignFrame:
    """One frame for the solver.

    ``file`` is where its pixels are (original or harmonized), ``path`` its
    name in the report. ``width`` and ``height`` are of ``file``. ``position``
    is latitude, longitude (degrees), altitude (m), or ``None``. ``sigma_m``
    is its GPS spread, horizontal and vertical, ``height_sigma_m`` that of ``height_m``. ``pitch_deg`` is -90 at nadir.
    ``lut`` names channel tables (``Lut.id`` in the request) to apply to the in-memory copy.
    """

    path: str
    file: str
    width: int
    height: int
    profile: str
    flight: str
    payload: str
    capture: str
    time_s: Optional[float] = None
    position: Optional[Tuple[float, float, float]] = None
    sigma_m: Optional[Tuple[float, float]] = None
    height_m: Optional[float] = None
    yaw_deg: Optional[float] = None
    pitch_deg: Optional[float] = None
    rtk: bool = False
    lut: Optional[str] = None
    height_sigma_m: Optional[float] = None


@dataclass(frozen=True)
class AlignCamera:
    """One profile at one frame size: the camera the solver shares among its frames.

    ``focal_variance`` is (max - min) / mean of the focals that its frames claim.
    """

    profile: str
    width: int
    height: int
    intrinsics: Intrinsics
    corrected_in_camera: bool = False
    focal_variance: float = 0.0


@dataclass(frozen=True)
class GcpMark:
    """A ground control point seen in one frame (pixels of ``AlignFrame.file``, 0, 0 the centre of the first one).

    ``name`` is the point's name in the user's file. A ``check`` point is held
    out: it moves nothing, its residual is measured.
    """

    point: str
    path: str
    x_px: float
    y_px: float
    latitude: float
    longitude: float
    altitude_m: float
    name: str = ""
    check: bool = False


@dataclass(frozen=True)
class AlignRequest:
    """A group of frames of one spectrum that may share a project.

    ``elevation`` is the file of an elevation model, ``""`` without one, and
    ``elevation_level_m`` how far the positions' zero lies above its own with
    the spread of that, ``None`` where nothing measured it.
    """

    name: str
    frames: Tuple[AlignFrame, ...]
    cameras: Tuple[AlignCamera, ...]
    gcps: Tuple[GcpMark, ...] = ()
    luts: Tuple[Lut, ...] = ()
    elevation: str = ""
    elevation_level_m: Optional[Tuple[float, float]] = None


@dataclass(frozen=True)
class PairInliers:
    """Verified matches of one pair of frames (paths, a < b)."""

    a: str
    b: str
    inliers: int


@dataclass(frozen=True)
class GpsFit:
    """Residual of a robust similarity from camera centres to GPS positions.

    RMS in metres over ``frames`` centres, corrected for the fit's seven
    degrees of freedom by sqrt(3n/(3n-7)). ``None`` where nothing was fitted.
    """

    frames: int
    horizontal_m: Optional[float] = None
    vertical_m: Optional[float] = None
    sigma_horizontal_m: Optional[float] = None
    sigma_vertical_m: Optional[float] = None
    collinear: bool = False


@dataclass(frozen=True)
class Bowing:
    """d*r^2 of solved minus measured camera heights at the block's radius, with its standard error."""

    bowing_m: Optional[float] = None
    se_m: Optional[float] = None
    radius_m: Optional[float] = None


@dataclass(frozen=True)
class ControlResidual:
    """Where one ground point came out against its coordinates, metres east, north, up, and from how many frames."""

    point: str
    check: bool
    images: int
    residual_m: Tuple[float, float, float]


@dataclass(frozen=True)
class ControlFit:
    """What ground control says of a model, or of one payload inside it.

    ``horizontal_m`` and ``vertical_m`` are the RMS of the free network's
    similarity to the control points, with its seven freedoms given back: the
    proof. ``held`` says that the model was then adjusted with the points held
    at their coordinates; ``points_m`` has what each point misses after that,
    and ``check_horizontal_m``, ``check_vertical_m`` the RMS over check points,
    which moved nothing. ``outliers`` are points that all the others
    contradict, ``astray`` marks (point, path) that miss the point's other
    ones. ``gps_offset_m`` is where GPS puts the anchor's cameras
    against ground control. ``bowing`` is the free network's, by point heights.
    ``verdict`` is ``pass`` (the points prove the model), ``fail`` (they
    contradict it) or ``unproven`` (too few to say), ``text`` the reason.
    """

    points: int
    horizontal_m: Optional[float] = None
    vertical_m: Optional[float] = None
    limit_m: Optional[float] = None
    held: bool = False
    check_points: int = 0
    check_horizontal_m: Optional[float] = None
    check_vertical_m: Optional[float] = None
    gps_offset_m: Optional[Tuple[float, float, float]] = None
    bowing: Bowing = Bowing()
    points_m: Tuple[ControlResidual, ...] = ()
    outliers: Tuple[str, ...] = ()
    verdict: str = "unproven"
    text: str = ""
    astray: Tuple[Tuple[str, str], ...] = ()


@dataclass(frozen=True)
class SolvedCamera:
    """A profile's camera as solved: ratios to max(width, height), distortion k1, k2, p1, p2, k3.

    ``aspect_ratio`` is focal down over focal across (fy / fx), ``focal_ratio`` of their mean.
    """

    profile: str
    focal_ratio: float
    center_ratio: Tuple[float, float]
    distortion: Tuple[float, ...]
    held: bool
    frames: int
    mean_reproj_error_px: Optional[float] = None
    focal_sigma: Optional[float] = None
    prior_change: Optional[float] = None
    aspect_ratio: float = 1.0


@dataclass(frozen=True)
class Candidate:
    """One calibration tried on the same matches, with what it cost and how it fared.

    ``height_scale`` is measured over solved differences of height under the
    horizontal scale of GPS, with its standard error and what measured them;
    ``None`` without heights that differ.
    """

    profile: str
    name: str
    focal_source: str
    distortion_source: str
    focal_ratio: float
    distortion: Tuple[float, ...]
    held: bool
    mean_reproj_error_px: Optional[float] = None
    gps_horizontal_m: Optional[float] = None
    gps_vertical_m: Optional[float] = None
    height_m: Optional[float] = None
    bowing: Bowing = Bowing()
    vetoed: str = ""
    chosen: bool = False
    center_ratio: Tuple[float, float] = (0.0, 0.0)
    height_scale: Optional[float] = None
    height_scale_sigma: Optional[float] = None
    height_scale_by: str = ""
    aspect_ratio: float = 1.0


@dataclass(frozen=True)
class LockDecision:
    """What a profile's camera should be in the project: held at these numbers, or only started from them.

    Ratios, aspect and distortion as in ``SolvedCamera``. ``source`` names where focal
    and distortion come from, ``reason`` says why in words. ``supported`` is
    set where the focal was solved and the block's geometry fixes it.
    """

    profile: str
    hold: bool
    focal_ratio: float
    center_ratio: Tuple[float, float]
    distortion: Tuple[float, ...]
    source: str
    reason: str
    supported: bool = False
    aspect_ratio: float = 1.0


@dataclass(frozen=True)
class PayloadAlignment:
    """How one payload fared inside a solved model.

    ``together`` is its residual under the similarity fitted on the anchor
    payload, ``alone`` under its own. ``cross_inliers`` is the median of its
    verified pairs with other payloads, ``strong_cross_pairs`` how many of them
    hold the required inliers. ``verdict`` is ``pass``, ``fail`` or
    ``unproven``. ``gps_offset_m`` is set where the geometry holds and the
    payload's positions are shifted against the anchor's: how far they lie east,
    north and up of where the anchor puts its cameras (measured minus solved).
    ``flight_offsets_m`` names flights whose altitudes lie that far above the
    payload's other ones; it was judged without.
    ``close`` says that a figure of a payload that passed stands near its limit.
    """

    payload: str
    frames: int
    registered: int
    in_main_component: int
    mean_reproj_error_px: Optional[float]
    together: GpsFit
    alone: GpsFit
    height_m: Optional[float] = None
    flown_height_m: Optional[float] = None
    bowing: Bowing = Bowing()
    cross_pairs: int = 0
    cross_inliers: Optional[int] = None
    capture_gap_m: Optional[Tuple[float, float]] = None
    verdict: str = "unproven"
    reasons: Tuple[str, ...] = ()
    strong_cross_pairs: int = 0
    gps_offset_m: Optional[Tuple[float, float, float]] = None
    control: Optional[ControlFit] = None
    flight_offsets_m: Tuple[Tuple[str, float], ...] = ()
    close: bool = False


@dataclass(frozen=True)
class AlignedFrame:
    """Where one frame ended: its component (0 is the largest) and its error."""

    path: str
    registered: bool
    component: Optional[int] = None
    mean_reproj_error_px: Optional[float] = None
    gps_residual_m: Optional[Tuple[float, float, float]] = None


@dataclass(frozen=True)
class AlignmentReport:
    """What one alignment showed. ``rung`` is ``quick``, ``alone``, ``reference``, ``mixed`` or ``pairwise``.

    ``areas`` counts the pieces of ground that by GPS cannot overlap: that many
    components are no failure. ``verdict`` sums up the payloads': ``pass``,
    ``fail`` or ``unproven``.
    """

    name: str
    engine: str
    rung: str
    frames: Tuple[AlignedFrame, ...]
    registered: int
    components: int
    mean_reproj_error_px: Optional[float]
    anchor: Optional[str]
    gps: GpsFit
    height_m: Optional[float]
    bowing: Bowing
    payloads: Tuple[PayloadAlignment, ...]
    cameras: Tuple[SolvedCamera, ...]
    candidates: Tuple[Candidate, ...]
    pairs: Tuple[PairInliers, ...]
    pairs_tried: int
    median_inliers: Optional[int]
    notes: Tuple[str, ...] = ()
    areas: int = 1
    verdict: str = "unproven"
    decisions: Tuple[LockDecision, ...] = ()
    control: Optional[ControlFit] = None
