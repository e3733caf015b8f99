"""From a request to a solver's job: working sizes, starting cameras, rung settings (pure)."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, List, Optional, Sequence, Tuple

from ..errors import UsageError
from ..intrinsics import Intrinsics
from ..thresholds import Thresholds
from .images import working_size
from .model import AlignCamera, AlignFrame, AlignRequest
from .pairs import PairPlan
from .solution import CameraSetting, EngineSettings, Job, JobFrame, Retrieval, in_work

RUNGS = ("quick", "alone", "reference", "mixed", "pairwise")
_VERIFY_PX_AT = (4.0, 1600.0)
# SIFT places a feature to about half a pixel; two of them and a lens that is not yet solved need this much.
_VERIFY_PX_LEAST = 1.5


def sorted_request(request: AlignRequest) -> AlignRequest:
    """Return the request with frames by path and cameras by profile and size: listing order changes nothing."""
    return replace(
        request,
        frames=tuple(sorted(request.frames, key=lambda f: f.path)),
        cameras=tuple(sorted(request.cameras, key=lambda c: (c.profile, c.width, c.height))),
        gcps=tuple(sorted(request.gcps, key=lambda g: (g.point, g.path))),
    )


def focal_over_side(camera: AlignCamera) -> Optional[float]:
    """Known focal length over max(width, height), ``None`` where the profile has none."""
    ratio = camera.intrinsics.focal_ratio
    return None if ratio is None else ratio * camera.width / max(camera.width, camera.height)


def known_distortion(camera: AlignCamera) -> Optional[Tuple[float, ...]]:
    """Brown distortion that is known of a profile: zero where the camera corrected it, else the sheet's or XMP's."""
    if camera.corrected_in_camera or camera.intrinsics.distortion_source == "corrected-in-camera":
        return (0.0, 0.0, 0.0, 0.0, 0.0)
    given = camera.intrinsics
    if given.distortion is None or given.projection != "brown" or given.distortion_source == "unknown":
        return None
    return tuple((*given.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5])


def holdable(camera: AlignCamera) -> bool:
    """A trusted focal and a known distortion: fit to be held, no guess among them."""
    return (
        camera.intrinsics.focal_trusted and focal_over_side(camera) is not None and known_distortion(camera) is not None
    )


def center_over_side(given: Intrinsics) -> Tuple[float, float]:
    """Principal point as the profile knows it, the image centre otherwise."""
    return given.center_ratio or (0.0, 0.0)


def starting_camera(camera: AlignCamera, max_dim: int, limits: Thresholds) -> CameraSetting:
    """The camera the mapping starts from: held where it may be, else a prior that is solved."""
    width, height = working_size(camera.width, camera.height, max_dim)
    focal = focal_over_side(camera)
    guess = limits.fallback_focal_ratio * camera.width / max(camera.width, camera.height)
    held = holdable(camera)
    bend = known_distortion(camera) or (0.0, 0.0, 0.0, 0.0, 0.0)
    setting = CameraSetting(
        profile=camera.profile,
        width=width,
        height=height,
        focal_ratio=focal if focal is not None else guess,
        center_ratio=center_over_side(camera.intrinsics),
        distortion=bend,
        solve_focal=not held,
        solve_distortion=not held,
        prior=focal is not None,
        aspect_ratio=camera.intrinsics.aspect_ratio,
        squash=height * camera.width / (width * camera.height),
    )
    return in_work(setting)


def engine_settings(rung: str, max_dim: int, threads: int, limits: Thresholds) -> EngineSettings:
    """The solver's numbers for a rung: the pairwise rung works with those of the mixed block.

    The reference rung is COLMAP as it comes: SIFT from a doubled image, its own
    cap, threshold and ratio. ``min_inliers`` was measured with it.
    """
    if rung not in RUNGS:
        raise UsageError(f"There is no rung {rung!r}; known: {', '.join(RUNGS)}.")
    mixed, reference = rung in ("mixed", "pairwise"), rung == "reference"
    quick_features = limits.reference_max_features if reference else limits.align_max_features
    error, at = _VERIFY_PX_AT
    return EngineSettings(
        max_features=limits.mixed_max_features if mixed else quick_features,
        peak_threshold=limits.mixed_peak_threshold if mixed else limits.quick_peak_threshold,
        max_ratio=limits.mixed_max_ratio if mixed else limits.quick_max_ratio,
        filter_max_reproj_error_px=limits.filter_max_reproj_error_px,
        upsample_below_px=max_dim + 1 if reference else limits.align_upsample_below_px,
        verify_error_px=round(error * max_dim / at, 3),
        threads=threads,
    )


def rung_max_dim(rung: str, limits: Thresholds) -> int:
    """Longer side in px that a rung works at unless the caller sets it."""
    return limits.align_max_dim_px if rung in ("quick", "alone") else limits.mixed_max_dim_px


def build_job(
    request: AlignRequest,
    plan: PairPlan,
    rung: str,
    max_dim: int,
    threads: int,
    limits: Thresholds,
    extra: Sequence[Retrieval] = (),
) -> Job:
    """Turn a sorted request into the engine's job."""
    shapes = {(c.profile, c.width, c.height): i for i, c in enumerate(request.cameras)}
    tables = {lut.id: lut.tables for lut in request.luts}
    frames: List[JobFrame] = []
    for frame in request.frames:
        camera = shapes.get((frame.profile, frame.width, frame.height))
        if camera is None:
            raise UsageError(
                f"{frame.path}: the request has no camera for {frame.profile} at {frame.width}x{frame.height}."
            )
        luts = tables.get(frame.lut, ()) if frame.lut is not None else ()
        frames.append(JobFrame(frame.path, frame.file, camera, frame.flight, luts))
    cameras = tuple(starting_camera(c, max_dim, limits) for c in request.cameras)
    settings = engine_settings(rung, max_dim, threads, limits)
    # A share of the picture, not of what it might have been: at 4 px in frames 700 px wide a fifth of
    # any wrong matches lie on some epipolar line, and 30 of them pass for a tie.
    share = max((max(c.width, c.height) for c in cameras), default=max_dim) / max_dim
    error = max(_VERIFY_PX_LEAST, round(settings.verify_error_px * share, 3))
    settings = replace(settings, verify_error_px=min(settings.verify_error_px, error))
    retrieval = list(extra)
    if plan.blind:
        everyone = tuple(range(len(frames)))
        retrieval.append(Retrieval(plan.blind, everyone, per_frame=max(1, limits.pairs_per_frame // 2)))
    return Job(
        frames=tuple(frames),
        cameras=cameras,
        pairs=plan.pairs,
        settings=settings,
        retrieval=tuple(retrieval),
        apart=captures(request.frames),
    )


def captures(frames: Sequence[AlignFrame]) -> Tuple[Tuple[int, ...], ...]:
    """Indices of frames that one trigger made, groups of two or more."""
    found: Dict[str, List[int]] = {}
    for index, frame in enumerate(frames):
        if frame.capture:
            found.setdefault(frame.capture, []).append(index)
    return tuple(tuple(v) for _, v in sorted(found.items()) if len(v) > 1)
