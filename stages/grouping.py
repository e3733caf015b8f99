"""Frames to profiles: which frames one true camera made (pure).

A *family* is make, model, lens, spectrum and band. A *profile* is a family
split by serial, size, mode and focal cluster. Rules and their numbers:
``thresholds.py``, section profiles and intrinsics.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from .frame import Frame
from .intrinsics import Intrinsics
from .profile import CameraProfile
from .thresholds import Thresholds

_NO_SERIAL = re.compile(r"^(0+|n/?a|none|null|unknown|-+|x+)$", re.IGNORECASE)
_ZOOM_LENS = re.compile(r"\d+(?:\.\d+)?\s*-\s*\d+(?:\.\d+)?\s*mm", re.IGNORECASE)


@dataclass(frozen=True)
class Sighting:
    """One frame with what the pure stages made of it; the input of ``group``."""

    frame: Frame
    spectrum: str
    band: str
    intrinsics: Intrinsics
    corrected_in_camera: bool = False
    zoom_lens: bool = False


def clean_serial(serial: str) -> str:
    """The serial, or ``""`` where the camera wrote a placeholder."""
    text = serial.strip().strip("\x00").strip()
    return "" if _NO_SERIAL.match(text) else text


def slug(*parts: str) -> str:
    """Join parts to a lower-case name that is safe in a file name."""
    text = "-".join(re.sub(r"[^a-z0-9.]+", "-", part.lower()).strip("-.") for part in parts if part)
    return re.sub(r"-{2,}", "-", text).strip("-.") or "unknown"


def camera_name(make: str, model: str) -> str:
    """Make and model without the make said twice (``Canon Canon PowerShot``)."""
    make, model = make.strip(), model.strip()
    first = make.split(" ")[0]
    if first and model.lower().startswith(first.lower()):
        return model
    return f"{make} {model}".strip() or "unknown camera"


def _family(make: str, model: str, lens: str, spectrum: str, band: str) -> str:
    """The family in words; a band that is named like its spectrum (colour, thermal) stands once."""
    parts = (camera_name(make, model), lens, spectrum, "" if band == spectrum else band)
    return " / ".join(p for p in parts if p)


def _mode(sight: Sighting) -> str:
    """What the camera did differently between frames of one family, besides size and focal."""
    frame = sight.frame
    parts = []
    if frame.image_source:
        parts.append(slug(frame.image_source))
    if frame.digital_zoom is not None and frame.digital_zoom > 1.005:
        parts.append(f"zoom{frame.digital_zoom:.2f}".rstrip("0").rstrip("."))
    if frame.format == "dng":
        parts.append("raw")
    if frame.dewarp_flag is not None and frame.calibration is not None:
        parts.append("dewarped" if frame.dewarp_flag else "not-dewarped")
    if frame.projection == "fisheye" or sight.intrinsics.projection == "fisheye":
        parts.append("fisheye")
    return "+".join(parts)


def is_zoom(sight: Sighting) -> bool:
    """The lens can change its focal length, so every 2 % bin is a camera of its own."""
    if sight.zoom_lens or "zoom" in sight.frame.image_source.lower():
        return True
    match = _ZOOM_LENS.search(sight.frame.lens)
    return match is not None


def cluster_focals(values: Mapping[float, int], limits: Thresholds) -> List[List[float]]:
    """Split distinct focal values (value -> frames) into clusters of one lens each.

    Values with gaps up to ``focal_variance`` are jitter and stay together;
    what then lies within ``focal_split`` of a neighbouring centre is drift of
    one lens. Closest centres merge first, so order does not matter.
    """
    clusters: List[List[float]] = []
    for value in sorted(values):
        if clusters and value <= clusters[-1][-1] * (1.0 + limits.focal_variance):
            clusters[-1].append(value)
        else:
            clusters.append([value])

    def centre(cluster: Sequence[float]) -> float:
        weight = sum(values[v] for v in cluster)
        return sum(v * values[v] for v in cluster) / weight

    while len(clusters) > 1:
        centres = [centre(c) for c in clusters]
        gaps = [(b - a) / a for a, b in zip(centres, centres[1:])]
        closest = min(range(len(gaps)), key=lambda i: (gaps[i], i))
        if gaps[closest] > limits.focal_split:
            break
        clusters[closest : closest + 2] = [clusters[closest] + clusters[closest + 1]]
    return clusters


def bin_zoom(values: Sequence[float], limits: Thresholds) -> List[List[float]]:
    """Bins of at most ``focal_bin`` for a zoom lens, from the shortest focal up."""
    bins: List[List[float]] = []
    for value in sorted(set(values)):
        if bins and value <= bins[-1][0] * (1.0 + limits.focal_bin):
            bins[-1].append(value)
        else:
            bins.append([value])
    return bins


def _tag_value(sight: Sighting, use_mm: bool) -> Optional[float]:
    frame = sight.frame
    value = frame.focal_mm if use_mm else frame.focal_35mm
    return value if value is not None and value > 0 else None


def _split_by(sights: List[Sighting], use_mm: bool, limits: Thresholds) -> List[List[Sighting]]:
    counts: Dict[float, int] = defaultdict(int)
    for sight in sights:
        value = _tag_value(sight, use_mm)
        if value is not None:
            counts[value] += 1
    if not counts:
        return [sights]
    zoom = any(is_zoom(s) for s in sights)
    # Whole-millimetre equivalents cannot be binned at 2 %: their own step is larger.
    clusters = bin_zoom(list(counts), limits) if zoom and use_mm else cluster_focals(counts, limits)
    if len(clusters) == 1:
        return [sights]
    where = {value: i for i, cluster in enumerate(clusters) for value in cluster}
    parts: List[List[Sighting]] = [[] for _ in clusters]
    unknown: List[Sighting] = []
    for sight in sights:
        value = _tag_value(sight, use_mm)
        (unknown if value is None else parts[where[value]]).append(sight)
    return [p for p in [*parts, unknown] if p]


def focal_variance(frames: Sequence[Frame]) -> Tuple[float, Optional[float], Optional[float]]:
    """(max-min)/mean of the focal tags in mm (35 mm equivalents where no mm is given), with min and max in mm."""
    values = [f.focal_mm for f in frames if f.focal_mm is not None and f.focal_mm > 0]
    if not values:
        return 0.0, None, None
    low, high = min(values), max(values)
    return (high - low) / (math.fsum(values) / len(values)), low, high


def family_of(sight: Sighting) -> Tuple[str, str, str, str, str]:
    """The family key: make, model, lens, spectrum and band."""
    frame = sight.frame
    return (frame.make.strip(), frame.model.strip(), frame.lens.strip(), sight.spectrum, sight.band)


def _bodies(sights: List[Sighting]) -> Dict[str, List[Sighting]]:
    """Split by serial; frames that lost their serial join the only body there is."""
    bodies: Dict[str, List[Sighting]] = defaultdict(list)
    for sight in sights:
        bodies[clean_serial(sight.frame.serial)].append(sight)
    if "" in bodies and len(bodies) == 2:
        only = next(s for s in bodies if s)
        bodies[only].extend(bodies.pop(""))
    return dict(bodies)


def _intrinsics_of(sights: Sequence[Sighting]) -> Intrinsics:
    """The best-sourced intrinsics of the profile; among equals the median focal."""
    from .intrinsics import SOURCES

    best = min(SOURCES.index(s.intrinsics.focal_source) for s in sights)
    pool = sorted(
        (s.intrinsics for s in sights if SOURCES.index(s.intrinsics.focal_source) == best),
        key=lambda i: (i.focal_ratio or 0.0, i.focal_mm or 0.0),
    )
    return pool[(len(pool) - 1) // 2]


def group(sights: Sequence[Sighting], limits: Thresholds) -> Tuple[CameraProfile, ...]:
    """Group frames into profiles, each with a stable readable id.

    The id names make, model and band, and only as much of lens, size, serial,
    mode and focal as is needed to tell it from its siblings in this survey.
    """
    families: Dict[Tuple[str, str, str, str, str], List[Sighting]] = defaultdict(list)
    for sight in sorted(sights, key=lambda s: s.frame.path):
        families[family_of(sight)].append(sight)
    found: List[Tuple[CameraProfile, Tuple[str, ...]]] = []
    for key in sorted(families):
        make, model, lens, spectrum, band = key
        variance, _, _ = focal_variance([s.frame for s in families[key]])
        for serial, body in sorted(_bodies(families[key]).items()):
            by_shape: Dict[Tuple[int, int, str], List[Sighting]] = defaultdict(list)
            for sight in body:
                by_shape[(sight.frame.width, sight.frame.height, _mode(sight))].append(sight)
            for (width, height, mode), shape in sorted(by_shape.items()):
                for by_mm in _split_by(shape, True, limits):
                    for cluster in _split_by(by_mm, False, limits):
                        own, low, high = focal_variance([s.frame for s in cluster])
                        focal = _intrinsics_of(cluster)
                        equivalents = sorted(s.frame.focal_35mm for s in cluster if s.frame.focal_35mm)
                        profile = CameraProfile(
                            id="",
                            family=_family(make, model, lens, spectrum, band),
                            spectrum=spectrum,
                            band=band,
                            make=make,
                            model=model,
                            lens=lens,
                            serial=serial,
                            mode=mode,
                            width=width,
                            height=height,
                            frames=tuple(s.frame.path for s in cluster),
                            intrinsics=focal,
                            focal_mm_min=low,
                            focal_mm_max=high,
                            focal_variance=own,
                            family_focal_variance=variance,
                            corrected_in_camera=all(s.corrected_in_camera for s in cluster),
                        )
                        shown = f"{low:g}mm" if low else (f"{equivalents[0]:g}mm-eq" if equivalents else "no-focal")
                        if low and equivalents:
                            shown += f"-{equivalents[0]:g}eq"
                        found.append((profile, (lens, serial, f"{width}x{height}", mode, shown)))
    return tuple(sorted(_named(found), key=lambda p: p.id))


def _named(found: Sequence[Tuple[CameraProfile, Tuple[str, ...]]]) -> List[CameraProfile]:
    """Give each profile the shortest id that its siblings do not have."""
    siblings: Dict[str, List[int]] = defaultdict(list)
    for index, (profile, _) in enumerate(found):
        name = slug(camera_name(profile.make, profile.model))
        suffix = {"rgb": "", "thermal": "thermal"}.get(profile.spectrum, profile.band)
        siblings[f"{name}/{slug(suffix)}" if suffix else name].append(index)
    named: List[CameraProfile] = []
    marks = ("{}", "sn{}", "{}", "{}", "{}")
    for base, members in siblings.items():
        differing = [k for k in range(5) if len({found[i][1][k] for i in members}) > 1]
        for index in members:
            profile, traits = found[index]
            extra = [slug(marks[k].format(traits[k])) for k in differing if traits[k]]
            named.append(replace(profile, id="@".join([base, *extra])))
    seen: Dict[str, int] = defaultdict(int)
    result = []
    for profile in sorted(named, key=lambda p: (p.id, p.frames)):
        seen[profile.id] += 1
        tail = f"#{seen[profile.id]}" if seen[profile.id] > 1 else ""
        result.append(replace(profile, id=profile.id + tail))
    return result
