"""The calibration store: what earlier surveys proved of a camera body, one small JSON file per body and mode.

An entry is keyed by make, model, serial, frame size and mode; a body without a
serial is not kept, for it could be any. Only a calibration that a block's
geometry fixed is offered to the store. Rule of update:

- nothing kept yet: the new one is kept;
- the new one agrees (both focals within ``stored_sigma`` of their standard
  errors, or ``stored_gap``): the better determined of the two is kept whole
  (focal and distortion belong together and are never averaged);
- it contradicts: the kept one stays and the new one is noted as a doubt. When
  ``stored_doubts`` surveys in a row contradict it and agree with each other,
  the lens has changed, and the best of them takes its place.

A survey counts once, however often it is run.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple, Union

from .errors import UsageError
from .frame import Frame
from .intrinsics import SOURCES, STORED, Intrinsics
from .profile import CameraProfile
from .record import dumps, from_plain, to_plain, write_text
from .thresholds import Thresholds

_MAX_ENTRY_BYTES = 1 << 16
_MAX_ENTRIES = 10_000
_SIGNS = re.compile(r"[^a-z0-9]+")

KEPT, BETTER, AGREES, DOUBTED, REPLACED, KNOWN = "kept", "better", "agrees", "doubted", "replaced", "known"


@dataclass(frozen=True)
class Key:
    """Which body, in which mode: pixels of the frame as the camera wrote it."""

    make: str
    model: str
    serial: str
    width: int
    height: int
    mode: str = ""


@dataclass(frozen=True)
class Measurement:
    """One survey's calibration: ratios to the longer side, distortion k1, k2, p1, p2, k3.

    ``focal_sigma`` is the standard error of ``focal_ratio``; ``survey`` the
    digest of the survey's inputs; ``aspect_ratio`` focal down over focal across.
    """

    focal_ratio: float
    focal_sigma: float
    center_ratio: Tuple[float, float]
    distortion: Tuple[float, float, float, float, float]
    frames: int
    survey: str
    aspect_ratio: float = 1.0


@dataclass(frozen=True)
class Entry:
    """What is kept of one body: the best measurement, the surveys that agree, and those that contradict."""

    key: Key
    best: Measurement
    surveys: Tuple[str, ...]
    doubts: Tuple[Measurement, ...] = ()


def key_of(profile: CameraProfile) -> Optional[Key]:
    """The profile's key; ``None`` for a body without a serial."""
    if not profile.serial.strip():
        return None
    names = (profile.make.strip(), profile.model.strip(), profile.serial.strip())
    return Key(*names, profile.width, profile.height, profile.mode)


def agree(a: Measurement, b: Measurement, limits: Thresholds) -> bool:
    """Whether two measurements are of one lens: their focals differ by less than chance or ``stored_gap`` allows."""
    apart = abs(a.focal_ratio - b.focal_ratio)
    chance = limits.stored_sigma * math.hypot(a.focal_sigma, b.focal_sigma)
    return apart <= max(chance, limits.stored_gap * min(a.focal_ratio, b.focal_ratio))


def updated(entry: Optional[Entry], key: Key, new: Measurement, limits: Thresholds) -> Tuple[Entry, str]:
    """The entry after a survey, and what happened to it (pure)."""
    if entry is None:
        return Entry(key, new, (new.survey,)), KEPT
    if new.survey in entry.surveys or any(d.survey == new.survey for d in entry.doubts):
        return entry, KNOWN
    if agree(entry.best, new, limits):
        better = _rank(new)[:2] < _rank(entry.best)[:2]
        best = new if better else entry.best
        return Entry(key, best, tuple(sorted({*entry.surveys, new.survey}))), BETTER if better else AGREES
    doubts = (*(d for d in entry.doubts if agree(d, new, limits)), new)
    if len(doubts) >= limits.stored_doubts:
        return Entry(key, min(doubts, key=_rank), tuple(sorted(d.survey for d in doubts))), REPLACED
    return replace(entry, doubts=doubts), DOUBTED


def _rank(found: Measurement) -> Tuple[float, int, str]:
    return (found.focal_sigma / found.focal_ratio, -found.frames, found.survey)


def worth_keeping(new: Measurement, limits: Thresholds) -> bool:
    """Enough frames, and a focal known well enough to help another survey."""
    return new.frames >= limits.stored_min_frames and 0.0 < new.focal_sigma <= limits.stored_focal_error * (
        new.focal_ratio
    )


def survey_digest(frames: Iterable[Frame]) -> str:
    """SHA-256 of which frames a survey has, wherever their folder lies: a survey is told from another by it."""
    told = sorted(json.dumps([f.name, f.size_bytes, f.serial, f.time, f.width, f.height]) for f in frames)
    return hashlib.sha256("\n".join(told).encode("utf-8")).hexdigest()


def with_stored(
    profiles: Sequence[CameraProfile],
    intrinsics_of: Mapping[str, Intrinsics],
    store: Mapping[Key, Entry],
    limits: Thresholds,
) -> Tuple[Tuple[CameraProfile, ...], Dict[str, Intrinsics]]:
    """Give profiles what the store knows of their bodies, where their own source ranks below it (pure).

    Left alone: a body that shows two focal lengths in one mode (a zoom), and a
    profile whose own tags tell of another lens.
    """
    result: List[CameraProfile] = []
    known = dict(intrinsics_of)
    seen = Counter(key_of(p) for p in profiles)
    for profile in profiles:
        key = key_of(profile)
        entry = store.get(key) if key is not None and seen[key] == 1 else None
        if entry is None or not _helps(profile, entry, limits):
            result.append(profile)
            continue
        known.update({path: _as_intrinsics(known[path], entry, profile) for path in profile.frames})
        result.append(replace(profile, intrinsics=_as_intrinsics(profile.intrinsics, entry, profile)))
    return tuple(result), known


def _helps(profile: CameraProfile, entry: Entry, limits: Thresholds) -> bool:
    own = profile.intrinsics
    if SOURCES.index(own.focal_source) <= SOURCES.index(STORED) or own.projection != "brown":
        return False
    if own.focal_ratio is None:
        return True
    return abs(own.focal_ratio / _over_width(entry, profile) - 1.0) <= limits.intrinsics_disagreement


def _over_width(entry: Entry, profile: CameraProfile) -> float:
    return entry.best.focal_ratio * max(profile.width, profile.height) / profile.width


def _as_intrinsics(own: Intrinsics, entry: Entry, profile: CameraProfile) -> Intrinsics:
    ratio = _over_width(entry, profile)
    focal_mm = own.focal_mm
    if own.sensor_width_mm is not None:
        focal_mm = ratio * own.sensor_width_mm
    count = len(entry.surveys)
    note = f"Focal and distortion as {count} earlier survey{'s' * (count > 1)} of this body proved them."
    return replace(
        own,
        focal_ratio=ratio,
        focal_source=STORED,
        focal_mm=focal_mm,
        center_ratio=entry.best.center_ratio,
        distortion=entry.best.distortion,
        distortion_source=STORED,
        aspect_ratio=entry.best.aspect_ratio,
        notes=(*own.notes, note),
    )


def entry_name(key: Key) -> str:
    """File name of an entry: readable, and one per key."""
    plain = _SIGNS.sub("-", f"{key.make} {key.model}".lower()).strip("-")[:60] or "camera"
    digest = hashlib.sha256(json.dumps(to_plain(key), sort_keys=True).encode("utf-8")).hexdigest()[:16]
    return f"{plain}-{digest}.json"


def read_store(folder: Union[str, Path]) -> Dict[Key, Entry]:
    """All entries below ``folder``; a folder that is not there is an empty store.

    Raises ``UsageError`` that names a file which is no entry, or a folder that
    cannot be read.
    """
    place = Path(folder)
    if not place.exists():
        return {}
    try:
        files = sorted(p for p in place.iterdir() if p.suffix == ".json" and not p.name.startswith("."))
    except OSError as error:
        raise UsageError(f"The calibration store {place} cannot be read: {error.strerror or error}.") from None
    if len(files) > _MAX_ENTRIES:
        raise UsageError(f"{place} holds {len(files)} JSON files: this is no calibration store.")
    entries = (_read_entry(file) for file in files)
    return {entry.key: entry for entry in entries}


def _read_entry(file: Path) -> Entry:
    wrong = f"{file} is no entry of a calibration store. Move it away; the survey that wrote it can be run again."
    try:
        if file.stat().st_size > _MAX_ENTRY_BYTES:
            raise UsageError(wrong)
        entry = entry_of(json.loads(file.read_text(encoding="utf-8")))
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror or error}.") from None
    except (ValueError, RecursionError):
        raise UsageError(wrong) from None
    if entry is None or file.name != entry_name(entry.key):
        raise UsageError(wrong)
    return entry


def entry_of(value: Any) -> Optional[Entry]:
    """An entry from plain JSON, or ``None`` where the value is none or not believable."""
    try:
        entry = from_plain(Entry, value)
        believable = all(_believable(m) for m in (entry.best, *entry.doubts))
        whole = all(isinstance(s, str) for s in (*entry.surveys, *_texts(entry.key)))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    return entry if believable and whole else None


def _texts(key: Key) -> Tuple[Any, ...]:
    return (key.make, key.model, key.serial, key.mode)


def _believable(found: Measurement) -> bool:
    numbers = (found.focal_ratio, found.focal_sigma, found.aspect_ratio, *found.center_ratio, *found.distortion)
    counted = isinstance(found.frames, int) and isinstance(found.survey, str)
    shaped = len(found.center_ratio) == 2 and len(found.distortion) == 5
    finite = all(isinstance(n, (int, float)) and math.isfinite(n) for n in numbers)
    return counted and shaped and finite and min(found.focal_ratio, found.focal_sigma, found.aspect_ratio) > 0


def write_entry(folder: Union[str, Path], entry: Entry) -> None:
    """Write one entry beside and rename. Raises ``OSError``."""
    write_text(Path(folder) / entry_name(entry.key), dumps(entry))


def store_digest(store: Mapping[Key, Entry]) -> str:
    """SHA-256 of what the store offers: two runs with equal stores decide alike."""
    offered = sorted(json.dumps(to_plain((e.key, e.best)), sort_keys=True) for e in store.values())
    return hashlib.sha256("\n".join(offered).encode("utf-8")).hexdigest()
