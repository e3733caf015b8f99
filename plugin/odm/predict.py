"""What ODM 3.6 would do with a folder as it is, said before anything is uploaded."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Callable, Iterator, List, Mapping, Sequence, Tuple

from ...stages.finding import Finding, sort_key
from ...stages.frame import Frame
from ...stages.profile import CameraProfile
from ...stages.thresholds import DEFAULTS, Thresholds
from . import rules_bands, rules_cameras, rules_files, rules_positions
from .camera_id import file_key
from .folder import BAND, SOLVER, Folder, read_folder

Rule = Callable[[Folder], Iterator[Finding]]
RULES: Tuple[Rule, ...] = (*rules_files.RULES, *rules_bands.RULES, *rules_cameras.RULES, *rules_positions.RULES)


@dataclass(frozen=True)
class Prediction:
    """The findings, and per frame its camera id and fate in ODM.

    ``camera_ids`` lacks the frames on which ODM would die. ``fates`` are
    ``solver``, ``band`` (used, not solved), ``dropped``, ``excluded``,
    ``mask``, ``passed-over`` and ``stops-odm``. ``notes`` are plain sentences
    on the whole.
    """

    findings: Tuple[Finding, ...]
    camera_ids: Mapping[str, str]
    fates: Mapping[str, str]
    notes: Tuple[str, ...] = ()


def predict(
    frames: Sequence[Frame],
    profile_of: Mapping[str, str],
    profiles: Sequence[CameraProfile] = (),
    thresholds: Thresholds = DEFAULTS,
) -> Prediction:
    """Run every rule on all ``frames`` laid into one project; ``profile_of`` maps paths to true cameras.

    Pure; the order of the frames changes nothing.
    """
    folder = read_folder(frames, profile_of, profiles, thresholds)
    found = [item for rule in RULES for item in rule(folder)]
    return Prediction(tuple(sorted(found, key=sort_key)), folder.ids, folder.fates, tuple(_notes(folder)))


def _notes(folder: Folder) -> List[str]:
    if not folder.frames:
        return []
    used = folder.with_fate(SOLVER, BAND)
    notes = [f"ODM would use {len(used)} of {len(folder.frames)} frames."]
    if folder.bands.stop:
        notes.append(f"It would stop while loading them: {folder.bands.stop}")
        return notes
    if folder.bands.bands:
        notes.append(
            f"It would see {len(folder.bands.bands)} bands ({', '.join(folder.bands.bands)}) and solve "
            f"{len(folder.solver)} frames of {folder.bands.primary}; the others take over its cameras and poses."
        )
    cameras = Counter(folder.ids[f.path] for f in folder.solver if f.path in folder.ids)
    notes += [f"It would solve a camera {file_key(i)!r} from {cameras[i]} frames." for i in sorted(cameras)]
    if folder.bands.late_stop:
        notes.append(f"It would stop after solving: {folder.bands.late_stop}")
    return notes
