"""What is known of imagery before any pixel moves: settings in, survey, verdict and prediction out."""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Callable, Dict, Mapping, Optional, Sequence, Tuple, Union

from ..stages.calibrations import Entry, Key, read_store, store_digest
from ..stages.elevation import open_elevation
from ..stages.errors import UsageError
from ..stages.finding import Finding, sort_key
from ..stages.gate import BLOCKED, GateReport, assess, verdict_of
from ..stages.look import look
from ..stages.profile import THERMAL, CameraProfile
from ..stages.progress import Cancel, Progress
from ..stages.read import Found, Scan, scan
from ..stages.record import to_plain
from ..stages.sensors import load_sheet
from ..stages.survey import Survey, build
from ..stages.thresholds import DEFAULTS, Thresholds
from .control import Control, read_control
from .odm.bands import band_name
from .odm.masks import split_masks
from .odm.predict import Prediction, predict
from .odm.thermal import thermal_reading

_FILES = ("calibration", "control_points", "gcp", "geo")
_ARGUMENTS = {"dem": "ground", "ground_m": "ground", "align": "no-align"}


def argument(name: str) -> str:
    """How the command line spells a field of ``Settings``."""
    return "--" + _ARGUMENTS.get(name, name).replace("_", "-")


def _content_hash(file: str, option: str) -> str:
    """SHA-256, hex, of a small file: a list edited between two runs is another input."""
    digest = hashlib.sha256()
    try:
        with open(file, "rb") as stream:
            for block in iter(lambda: stream.read(1 << 20), b""):
                digest.update(block)
    except OSError as error:
        raise UsageError(f"{argument(option)}: {file} cannot be read ({error.strerror}).") from None
    return digest.hexdigest()


@dataclass(frozen=True)
class Settings:
    """Everything that decides the outcome besides the imagery; echoed in ``plan.json``.

    The ground is ``ground_m`` metres everywhere or the elevation model ``dem``, never both. ``stored`` is what a
    plan tells of a calibration store, ``calibrations`` the store's folder; the folder wins.
    """

    thresholds: Thresholds = DEFAULTS
    calibration: Optional[str] = None
    ground_m: Optional[float] = None
    gsd_target: Union[str, float] = "finest"
    gcp: Optional[str] = None
    force_gcp: bool = False
    check_points: Optional[str] = None
    geo: Optional[str] = None
    engine: str = "pycolmap"
    max_dim: Optional[int] = None
    align: bool = True
    look: bool = False
    control_points: Optional[str] = None
    dem: Optional[str] = None
    calibrations: Optional[str] = None
    stored: Optional[Tuple[Entry, ...]] = None

    def identity(self) -> Dict[str, Any]:
        """Everything that decides, thresholds too; two runs with equal inputs and identity give equal bytes."""
        return {**self.options(), "thresholds": to_plain(self.thresholds)}

    def options(self) -> Dict[str, Any]:
        """The arguments that differ from their default, thresholds apart, with the content hash of each file.

        Raises ``UsageError`` where a file that was named cannot be read.
        """
        changed = {
            f.name: getattr(self, f.name)
            for f in dataclasses.fields(self)
            if f.name not in ("thresholds", "stored") and getattr(self, f.name) != f.default
        }
        hashes = {f"{name}_sha256": _content_hash(changed[name], name) for name in _FILES if name in changed}
        store = self.store()
        if store is not None:
            hashes["calibrations_sha256"] = store_digest(store)
        return {**changed, **hashes}

    def store(self) -> Optional[Dict[Key, Entry]]:
        """What is known of single bodies from earlier surveys; ``None`` where nobody asked for it."""
        if self.calibrations is not None:
            return read_store(self.calibrations)
        return None if self.stored is None else {entry.key: entry for entry in self.stored}


DEFAULT_SETTINGS = Settings()


def _with_thermal_reading(profile: CameraProfile, survey: Survey) -> CameraProfile:
    """Say of a thermal profile what this ODM will read it as."""
    if profile.spectrum != THERMAL:
        return profile
    frame = survey.file_of()[profile.frames[0]]
    return replace(profile, thermal_reading=thermal_reading(frame, band_name(frame)))


@dataclass(frozen=True)
class Inspection:
    """The survey with all that is known before any pixel moves. ``masks`` is frame path -> mask path."""

    paths: Tuple[str, ...]
    settings: Settings
    survey: Survey
    assessed: GateReport
    prediction: Prediction
    control: Control
    masks: Mapping[str, str] = field(default_factory=dict)
    looked: Tuple[Finding, ...] = ()

    @property
    def findings(self) -> Tuple[Finding, ...]:
        """Ours and what ODM would say, worst first."""
        return tuple(
            sorted(
                [*self.assessed.findings, *self.prediction.findings, *self.control.findings, *self.looked], key=sort_key
            )
        )

    @property
    def verdict(self) -> str:
        """The verdict with ODM's part in it."""
        if self.assessed.verdict == BLOCKED:
            return BLOCKED
        return verdict_of(self.findings, sum(1 for f in self.survey.frames if f.excluded is None))


def inspect(
    paths: Sequence[str],
    settings: Settings = DEFAULT_SETTINGS,
    *,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    found: Optional[Found] = None,
) -> Inspection:
    """Read, group and assess; nothing is written."""
    everything = scan(list(paths), progress=progress, cancel=cancel, limits=settings.thresholds, found=found)
    return inspect_scan(everything, paths, settings, cancel=cancel)


def inspect_scan(
    everything: Scan,
    paths: Sequence[str],
    settings: Settings = DEFAULT_SETTINGS,
    *,
    cancel: Optional[Cancel] = None,
    open_path: Callable[[str], Path] = Path,
    masks: Optional[Mapping[str, str]] = None,
) -> Inspection:
    """Group and assess what was read elsewhere.

    ``open_path`` says where a frame's file lies; ``masks`` (image -> mask) are looked for on disk where not given.
    """
    elevation = open_elevation(settings.dem, settings.thresholds) if settings.dem is not None else None
    images, masks = split_masks(everything) if masks is None else (everything, masks)
    control = read_control(settings.gcp, settings.geo, images.frames, settings.thresholds, settings.check_points)
    survey = build(
        replace(images, frames=control.frames),
        load_sheet(settings.calibration, settings.thresholds),
        settings.thresholds,
        ground_m=settings.ground_m,
        elevation=elevation,
        stored=settings.store(),
        open_path=open_path,
    )
    survey = replace(survey, profiles=tuple(_with_thermal_reading(p, survey) for p in survey.profiles))
    assessed = assess(survey, settings.thresholds, gsd_target=settings.gsd_target)
    files = survey.file_of()
    present = [files[f.path] for f in survey.frames]
    prediction = predict(present, {f.path: f.profile for f in survey.frames}, survey.profiles, settings.thresholds)
    looked = look(survey, settings.thresholds, cancel=cancel) if settings.look else ()
    return Inspection(tuple(paths), settings, survey, assessed, prediction, control, masks, looked)
