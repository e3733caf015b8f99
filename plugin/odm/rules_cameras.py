"""Which cameras ODM would see, and with which focal it would start."""

from __future__ import annotations

from collections import defaultdict
from typing import Dict, Iterator, List, Optional, Sequence, Tuple

from ...stages.finding import ERROR, INFO, WARNING, Finding
from ...stages.frame import Frame
from ...stages.profile import CameraProfile
from .camera_id import file_key, odm_make_model
from .cameras import own_focal_gap
from .folder import Folder, finding, several


def _solver_profiles(folder: Folder) -> Dict[str, List[Frame]]:
    return {k: v for k, v in folder.by_profile(folder.solver).items() if k in folder.profiles}


def merged(folder: Folder) -> Iterator[Finding]:
    """Several true cameras under one id share their intrinsics in ODM."""
    by_id: Dict[str, Dict[str, List[Frame]]] = defaultdict(lambda: defaultdict(list))
    for frame in folder.solver:
        profile = folder.profile(frame)
        if profile is not None and frame.path in folder.ids:
            by_id[folder.ids[frame.path]][profile.id].append(frame)
    for identity in sorted(by_id):
        users = by_id[identity]
        if len(users) < 2:
            continue
        profiles = [folder.profiles[p] for p in sorted(users)]
        gap = _spread([p.intrinsics.focal_ratio for p in profiles])
        limit = folder.thresholds.focal_variance
        apart = gap is not None and gap > limit
        frames = [f for p in sorted(users) for f in users[p]]
        yield finding(
            "odm-cameras-merged",
            ERROR if apart or len({p.spectrum for p in profiles}) > 1 else WARNING,
            frames,
            f"ODM would share one set of intrinsics among {len(users)} cameras ({', '.join(sorted(users))}): "
            f"they have one id, {file_key(identity)!r}."
            + (f" Their focals lie {gap:.1%} apart." if apart and gap is not None else ""),
            "Give each its own project; sensorgate run does so where it matters.",
            measured=None if gap is None else round(gap, 4),
            threshold=limit,
        )


def _spread(values: Sequence[Optional[float]]) -> Optional[float]:
    known = [v for v in values if v]
    return (max(known) - min(known)) / min(known) if len(known) > 1 else None


def split(folder: Folder) -> Iterator[Finding]:
    """One true camera under several ids is solved several times, from fewer frames each."""
    for name, frames in _solver_profiles(folder).items():
        ids = sorted({folder.ids[f.path] for f in frames if f.path in folder.ids})
        if len(ids) > 1:
            yield finding(
                "odm-camera-split",
                WARNING,
                frames,
                f"ODM would solve {name} as {len(ids)} cameras, because its focal tag or size changes from frame "
                "to frame.",
                "Nothing to do with sensorgate run: in its projects the frames of one camera carry one focal tag.",
                measured=float(len(ids)),
                threshold=1.0,
            )


def default_focal(folder: Folder) -> Iterator[Finding]:
    """ODM's silent default where it finds no focal."""
    for name, frames in _solver_profiles(folder).items():
        found = [f for f in frames if folder.focals[f.path].how == "default"]
        if found:
            true = _longer_side_ratio(folder.profiles[name], found[0])
            yield finding(
                "odm-focal-default",
                WARNING,
                found,
                f"ODM finds no focal length for {name} and silently takes 0.85 of the longer side"
                + (f"; it is about {true:.3f}." if true is not None else "."),
                "Use the cameras file that sensorgate run writes beside the project."
                if true is not None
                else "Give the camera's focal and sensor width in a calibration file (--calibration).",
                measured=0.85,
                threshold=None if true is None else round(true, 4),
            )


def _longer_side_ratio(profile: CameraProfile, frame: Frame) -> Optional[float]:
    ratio = profile.intrinsics.focal_ratio
    return None if ratio is None else ratio * frame.width / max(frame.width, frame.height)


def wrong_focal(folder: Folder) -> Iterator[Finding]:
    """ODM's focal against a source at least as good."""
    for name, frames in _solver_profiles(folder).items():
        known = folder.profiles[name].intrinsics
        odd: List[Frame] = []
        worst = 0.0
        for frame in frames:
            gap = own_focal_gap(
                folder.focals[frame.path], known.focal_ratio, known.focal_source, (frame.width, frame.height)
            )
            if gap is not None and gap > folder.thresholds.focal_source_gap:
                odd.append(frame)
                worst = max(worst, gap)
        if odd:
            own = folder.focals[odd[0].path]
            yield finding(
                "odm-focal-off",
                WARNING,
                odd,
                f"ODM would start {name} at a focal {worst:.1%} from the better one: {own.why} "
                f"Better known from {known.focal_source}.",
                "Use the cameras file that sensorgate run writes beside the project.",
                measured=round(worst, 4),
                threshold=folder.thresholds.focal_source_gap,
            )


def zoom(folder: Folder) -> Iterator[Finding]:
    """ODM ignores digital zoom."""
    by_id: Dict[str, List[Frame]] = defaultdict(list)
    for frame in folder.solver:
        by_id[folder.ids.get(frame.path, "")].append(frame)
    for identity in sorted(by_id):
        zoomed = [f for f in by_id[identity] if f.digital_zoom is not None and f.digital_zoom > 1.0]
        levels = {round(f.digital_zoom or 1.0, 3) for f in by_id[identity]}
        if zoomed and len(levels) > 1:
            yield finding(
                "odm-zoom-ignored",
                ERROR,
                zoomed,
                f"{several(zoomed, 'was', 'were')} taken with digital zoom. ODM ignores that and puts them under one "
                "camera with frames that were not: the block bends.",
                "Leave the zoomed frames out, or process them apart.",
                measured=max(levels),
                threshold=1.0,
            )


def anonymous(folder: Folder) -> Iterator[Finding]:
    """Without make and model every frame of one size is one camera."""
    found = [f for f in folder.solver if odm_make_model(f) == ("", "")]
    if found:
        yield finding(
            "odm-camera-anonymous",
            WARNING,
            found,
            f"{several(found, 'names', 'name')} no camera. ODM puts all such frames of one size under one camera.",
            "Write Make and Model into the frames: exiftool -Make=... -Model=... FILE.",
        )


def unsure(folder: Folder) -> Iterator[Finding]:
    """The id hangs on ODM's own sensor table."""
    found = [f for f in folder.solver if not folder.focals[f.path].sure]
    if found:
        yield finding(
            "odm-focal-from-table",
            INFO,
            found,
            f"The focal of {several(found)} hangs on ODM's own sensor table, which may or may not know the camera.",
            "Nothing to do with sensorgate run: its copies carry a focal tag that ODM reads itself.",
        )


def projection(folder: Folder) -> Iterator[Finding]:
    """Projections that do not survive ODM's undistortion."""
    found = [f for f in folder.solver if f.projection.lower() in ("dual", "equirectangular")]
    if found:
        kind = found[0].projection.lower()
        yield finding(
            "odm-projection-lost",
            ERROR if kind == "dual" else WARNING,
            found,
            f"{several(found, 'asks', 'ask')} for the {kind} projection, which ODM cannot carry through to the map.",
            "Write XMP Camera:ModelType perspective, or leave the frames out.",
            odm="KeyError: 'transition'" if kind == "dual" else "Not undistorting image with unknown camera type.",
        )


def feature_scale(folder: Folder) -> Iterator[Finding]:
    """The largest photo decides at which size features are found in all."""
    sizes: Dict[Tuple[int, int], List[Frame]] = defaultdict(list)
    for frame in folder.solver:
        sizes[frame.width, frame.height].append(frame)
    if len(sizes) < 2:
        return
    longest = {size: max(size) for size in sizes}
    largest, smallest = max(longest.values()), min(longest.values())
    if largest > 2 * smallest:
        small = [f for size in sorted(sizes) if longest[size] == smallest for f in sizes[size]]
        yield finding(
            "odm-feature-scale",
            INFO,
            small,
            f"The largest photo ({largest} px) decides at which size ODM finds features; {several(small)} with "
            f"{smallest} px stay at their own size while the others are halved.",
            "Nothing to do; matching between them is a little better than the sizes suggest.",
            measured=round(largest / smallest, 2),
            threshold=2.0,
        )


RULES = (merged, split, default_focal, wrong_focal, zoom, anonymous, unsure, projection, feature_scale)
