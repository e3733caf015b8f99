"""A folder as ODM 3.6 would take it: one flat heap of images. The ground on which the predictions stand."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import Dict, FrozenSet, List, Mapping, Optional, Sequence, Tuple

from ...stages.finding import Finding
from ...stages.frame import Frame
from ...stages.profile import CameraProfile
from ...stages.thresholds import DEFAULTS, Thresholds
from .bands import BandOutcome, OdmPhoto, band_outcome, odm_photo
from .camera_id import OdmFocal, camera_id, odm_focal_ratio

# What ODM opens as an image; anything else in the folder is passed over without a word.
EXTENSIONS = frozenset((".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".raw", ".dng", ".nef", ".jxl"))

SOLVER = "solver"
BAND = "band"
DROPPED = "dropped"
EXCLUDED = "excluded"
MASK = "mask"
PASSED_OVER = "passed-over"
STOPS = "stops-odm"


def extension(name: str) -> str:
    """The extension in lower case, with its dot."""
    dot = name.rfind(".")
    return name[dot:].lower() if dot > 0 else ""


def is_mask(name: str) -> bool:
    """ODM takes ``*_mask.jpg`` for a mask and never for an image."""
    return name[: name.rfind(".")].endswith("_mask") if "." in name else False


def stops_odm(frame: Frame, focal: OdmFocal) -> Optional[str]:
    """Why ODM would die when it reads this frame, or ``None``."""
    if focal.how == "crash":
        return focal.why
    if any(p.startswith("xmp-not-utf8:byte") for p in frame.problems):
        return "The XMP packet is not UTF-8: ODM stops with a UnicodeDecodeError when it reads this frame."
    return None


@dataclass(frozen=True)
class Folder:
    """The frames by path, with what ODM would make of each and of all.

    ``profiles`` and ``profile_of`` are what is true of the cameras, ``ids``
    and ``focals`` what ODM takes for true. ``fates`` maps a path to one of
    the names above.
    """

    frames: Tuple[Frame, ...]
    profile_of: Mapping[str, str]
    profiles: Mapping[str, CameraProfile]
    ids: Mapping[str, str]
    focals: Mapping[str, OdmFocal]
    photos: Mapping[str, OdmPhoto]
    bands: BandOutcome
    fates: Mapping[str, str]
    thresholds: Thresholds

    def with_fate(self, *fates: str) -> Tuple[Frame, ...]:
        """The frames of these fates."""
        return tuple(f for f in self.frames if self.fates[f.path] in fates)

    @property
    def solver(self) -> Tuple[Frame, ...]:
        """The frames that ODM would solve."""
        return self.with_fate(SOLVER)

    def profile(self, frame: Frame) -> Optional[CameraProfile]:
        """The frame's true camera, where it was placed in one."""
        return self.profiles.get(self.profile_of.get(frame.path, ""))

    def by_profile(self, frames: Sequence[Frame]) -> Dict[str, List[Frame]]:
        """Frames by profile id, sorted."""
        grouped: Dict[str, List[Frame]] = defaultdict(list)
        for frame in frames:
            grouped[self.profile_of.get(frame.path, "")].append(frame)
        return {k: grouped[k] for k in sorted(grouped)}


def paths(frames: Sequence[Frame]) -> Tuple[str, ...]:
    """Subjects of a finding."""
    return tuple(f.path for f in frames)


def several(frames: Sequence[Frame], one: str = "", many: str = "") -> str:
    """``IMG_1.jpg has`` or ``12 frames (first: IMG_1.jpg) have``: the frames with the verb in their number."""
    name = frames[0].name if len(frames) == 1 else f"{len(frames)} frames (first: {frames[0].name})"
    return f"{name} {one if len(frames) == 1 else many}".rstrip()


def finding(
    code: str,
    severity: str,
    frames: Sequence[Frame],
    message: str,
    remedy: str,
    *,
    measured: Optional[float] = None,
    threshold: Optional[float] = None,
    odm: Optional[str] = None,
) -> Finding:
    """A finding whose subjects are frames."""
    return Finding(code, severity, paths(frames), message, remedy, measured, threshold, odm)


def _unique_names(frames: Sequence[Frame]) -> Dict[str, str]:
    """Names in the flat folder; a name that is there twice is made one of its own, so that no frame is lost here."""
    count = Counter(f.name.lower() for f in frames)
    return {f.path: f.name if count[f.name.lower()] == 1 else f.path.replace("/", "_") for f in frames}


def read_folder(
    frames: Sequence[Frame],
    profile_of: Mapping[str, str],
    profiles: Sequence[CameraProfile],
    thresholds: Thresholds = DEFAULTS,
) -> Folder:
    """Let ODM's rules run over the frames; pure, and the order of the frames changes nothing."""
    ordered = tuple(sorted(frames, key=lambda f: f.path))
    focals = {f.path: odm_focal_ratio(f) for f in ordered}
    fates: Dict[str, str] = {}
    for frame in ordered:
        if extension(frame.name) not in EXTENSIONS:
            fates[frame.path] = PASSED_OVER
        elif is_mask(frame.name):
            fates[frame.path] = MASK
        elif stops_odm(frame, focals[frame.path]):
            fates[frame.path] = STOPS
    read = [f for f in ordered if f.path not in fates]
    names = _unique_names(read)
    photos = {f.path: odm_photo(f, names[f.path]) for f in read}
    outcome = band_outcome(list(photos.values()))
    fates.update(_band_fates(read, outcome))
    return Folder(
        frames=ordered,
        profile_of=profile_of,
        profiles={p.id: p for p in profiles},
        ids={f.path: camera_id(f) for f in ordered if camera_id(f)},
        focals=focals,
        photos=photos,
        bands=outcome,
        fates=fates,
        thresholds=thresholds,
    )


def _band_fates(read: Sequence[Frame], outcome: BandOutcome) -> Dict[str, str]:
    solver: FrozenSet[str] = frozenset(outcome.solver)
    kept = frozenset(outcome.kept)
    excluded = frozenset(outcome.excluded)
    return {
        f.path: SOLVER
        if f.path in solver
        else BAND
        if f.path in kept
        else EXCLUDED
        if f.path in excluded
        else STOPS
        if outcome.stop
        else DROPPED
        for f in read
    }
