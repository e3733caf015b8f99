"""What ODM 3.6 makes of the bands of a folder: which frames it drops, which one band it solves, where it stops.

ODM groups a whole folder by band name alone, whatever the cameras, and counts.
The rules were read from ODM 3.6.0 and compared with it on real and made-up
folders.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.frame import Frame
from .camera_id import odm_make_model

MAX_BANDS = 10
_BY_NAME = re.compile(r"^(.+)[-_]\w+(\.[A-Za-z]{3,4})$")
_QUANTIX = re.compile(r"IMG_(\d+)_(\w+)\.\w+", re.IGNORECASE)
_QUANTIX_BANDS = {"GRN": "Green", "NIR": "Nir", "RED": "Red", "RGB": "RedGreenBlue"}
_BAND_PREFIXES = frozenset(("Camera", "FLIR"))
_RGB = ("rgb", "redgreenblue")
_PRIMARY_ALIASES = (_RGB, ("green", "g"), ("blue", "b"))
_ORDER = {
    **dict.fromkeys(("RGB", "REDGREENBLUE"), "0"),
    **dict.fromkeys(("RED", "R"), "1"),
    **dict.fromkeys(("GREEN", "G"), "2"),
    **dict.fromkeys(("BLUE", "B"), "3"),
    **dict.fromkeys(("NIR", "N"), "4"),
    **dict.fromkeys(("REDEDGE", "RE"), "5"),
    "PANCHRO": "6",
    **dict.fromkeys(("LWIR", "L"), "7"),
}
_UNIFORM = "make sure to name your files [filename]_band[.ext] uniformly"


class BandStop(Exception):
    """ODM ends the run here; the text is its own."""


@dataclass(frozen=True)
class OdmPhoto:
    """A frame as ODM's band rules see it. ``capture`` is a capture id or time, ``""`` where it finds neither."""

    path: str
    name: str
    band: str
    band_index: str
    make: str
    model: str
    capture: str
    width: int
    height: int

    @property
    def is_m3m(self) -> bool:
        """A Mavic 3 Multispectral, for which ODM has a rule of its own."""
        return (self.make.lower(), self.model.lower()) == ("dji", "m3m")

    @property
    def is_rgb(self) -> bool:
        """ODM takes the frame for a colour image."""
        return self.band.lower() in _RGB


@dataclass(frozen=True)
class BandOutcome:
    """What ODM does with the folder.

    ``bands`` are the names in ODM's order, empty where it sees one camera.
    ``primary`` is the band it solves. ``counts`` are the frames per band
    before anything is dropped. ``excluded`` are paths of incomplete captures,
    ``skipped`` the paths of redundant bands by name. ``solver`` are the paths
    that enter the solver, ``kept`` all that are used. ``messages`` are ODM's
    own warnings, ``stop`` the text with which it ends before the solver,
    ``late_stop`` after it. ``order_matters`` is set where the outcome hangs on
    which file the disk lists first.
    """

    bands: Tuple[str, ...]
    primary: Optional[str]
    counts: Mapping[str, int]
    solver: Tuple[str, ...]
    kept: Tuple[str, ...]
    excluded: Tuple[str, ...] = ()
    skipped: Mapping[str, Tuple[str, ...]] = field(default_factory=dict)
    messages: Tuple[str, ...] = ()
    stop: Optional[str] = None
    late_stop: Optional[str] = None
    late_messages: Tuple[str, ...] = ()
    by_filename: bool = False
    order_matters: bool = False


def band_name(frame: Frame) -> str:
    """The band as ODM names it: XMP BandName without blanks and signs, ``RGB`` where it reads none."""
    make, model = odm_make_model(frame)
    if (make.lower(), model.lower()) == ("aerovironment", "quantix"):
        found = _QUANTIX.match(frame.name)
        if found:
            return re.sub("[^A-Za-z0-9]+", "", _QUANTIX_BANDS.get(found.group(2), found.group(2)))
    if not _BAND_PREFIXES & set(frame.xmp_namespaces):
        return "RGB"  # the band stands in a tag that ODM does not look up, such as DJI:BandName
    return re.sub("[^A-Za-z0-9]+", "", "".join(frame.bands)) or "RGB"


def odm_photo(frame: Frame, name: Optional[str] = None) -> OdmPhoto:
    """The frame as ODM's band rules see it, under the file name it will have (default: its own)."""
    make, model = odm_make_model(frame)
    capture = frame.capture_id or frame.time or ""
    quantix = _QUANTIX.match(frame.name) if (make.lower(), model.lower()) == ("aerovironment", "quantix") else None
    return OdmPhoto(
        path=frame.path,
        name=name or frame.name,
        band=band_name(frame),
        band_index=str(frame.rig_index if frame.rig_index is not None else 0),
        make=make,
        model=model,
        capture=quantix.group(1) if quantix else capture,
        width=frame.width,
        height=frame.height,
    )


@dataclass
class _Band:
    name: str
    photos: List[OdmPhoto]


def primary_band(names: Sequence[str]) -> str:
    """The band ODM solves by default: RGB, else green, else blue, else its first."""
    for aliases in _PRIMARY_ALIASES:
        for name in names:
            if name.lower() in aliases:
                return name
    return names[0]


def _band_maps(bands: Sequence[_Band], wanted: str, messages: List[str]) -> Tuple[Dict[str, List[OdmPhoto]], bool]:
    """Primary file name -> secondary photos, and whether that went by file name. Raises ``BandStop``."""
    name = next((b.name for b in bands if b.name.lower() == wanted.lower()), bands[0].name)
    primary = next(b.photos for b in bands if b.name == name)
    reason = _unreliable(bands, primary)
    if reason is None:
        by_capture = {p.capture: p for p in primary}
        maps: Dict[str, List[OdmPhoto]] = {}
        for band in bands:
            for photo in band.photos:
                if band.name != name:
                    maps.setdefault(by_capture[photo.capture].name, []).append(photo)
        return maps, False
    messages.append(f"{reason}, will use filenames instead")
    by_file = {_without_band(p): p for p in primary}
    maps = {}
    for band in bands:
        for photo in band.photos:
            key = _without_band(photo)
            if key not in by_file:
                raise BandStop(
                    f"Cannot match bands by filename on {photo.name}, {_UNIFORM}, check that your images have the "
                    "appropriate CaptureUUID XMP tag and that no images are missing."
                )
            if band.name != name:
                maps.setdefault(by_file[key].name, []).append(photo)
    return maps, True


def _unreliable(bands: Sequence[_Band], primary: Sequence[OdmPhoto]) -> Optional[str]:
    seen = set()
    for photo in primary:
        if not photo.capture:
            return f"Cannot use capture time (no information in {photo.name})"
        if photo.capture in seen:
            return "Unreliable UUID/capture time detected (duplicate)"
        seen.add(photo.capture)
    for band in bands:
        for photo in band.photos:
            if not photo.capture:
                return f"Cannot use UUID/capture time (no information in {photo.name})"
            if photo.capture not in seen:
                return "Unreliable UUID/capture time detected (no primary band match)"
    return None


def _without_band(photo: OdmPhoto) -> str:
    key = _BY_NAME.sub("\\1\\2", photo.name)
    if key == photo.name:
        raise BandStop(f"Cannot match bands by filename on {photo.name}, {_UNIFORM}.")
    return key


def _incomplete(
    bands: List[_Band], photos: List[OdmPhoto], fullest: str, messages: List[str]
) -> Tuple[List[OdmPhoto], List[str]]:
    """Drop the captures that lack a band, as ODM does where bands differ in number. Raises ``BandStop``."""
    maps, _ = _band_maps(bands, fullest, messages)
    most = max((len(m) for m in maps.values()), default=0)
    out = [n for name, others in maps.items() if len(others) < most for n in (*(p.name for p in others), name)]
    messages.extend(f"Excluding {n}" for n in out)
    gone = set(out)
    for band in bands:
        band.photos = [p for p in band.photos if p.name not in gone]
    return [p for p in photos if p.name not in gone], [p.path for p in photos if p.name in gone]


def _redundant(names: Sequence[str], first_is_m3m: bool) -> List[str]:
    """Names that ODM trims where colour frames and single bands share a folder."""
    by_lower = {n.lower(): n for n in names}
    rgb = next((by_lower[n] for n in _RGB if n in by_lower), None)
    if rgb is None:
        return []
    if all(n in by_lower for n in ("red", "green", "blue")):
        return [rgb]
    if first_is_m3m and "red" in by_lower and "green" in by_lower:
        return [rgb]
    return [by_lower[n] for n in ("red", "green", "blue") if n in by_lower]


def band_outcome(photos: Sequence[OdmPhoto]) -> BandOutcome:
    """Run ODM's band rules on a folder; ``photos`` in the order in which the disk lists them."""
    present = list(photos)
    grouped: Dict[str, List[OdmPhoto]] = defaultdict(list)
    index: Dict[str, str] = {}
    for photo in present:
        grouped[photo.band].append(photo)
        index.setdefault(photo.band, photo.band_index)
    counts = {name: len(members) for name, members in grouped.items()}
    everything = tuple(p.path for p in present)
    if not 2 <= len(grouped) <= MAX_BANDS:
        return BandOutcome((), None, counts, everything, everything)
    bands = [_Band(name, list(members)) for name, members in grouped.items()]
    fullest = max(counts, key=lambda n: counts[n])
    messages = [
        f'Multi-camera setup detected, but band "{name}" (identified from "{grouped[name][0].name}") has only '
        f"{counts[name]} images (instead of {counts[fullest]}), perhaps images are missing or are corrupted."
        for name in grouped
        if counts[name] < counts[fullest]
    ]
    excluded: List[str] = []
    if messages:
        try:
            present, excluded = _incomplete(bands, present, fullest, messages)
        except BandStop as stop:
            return BandOutcome((), None, counts, (), (), messages=tuple(messages), stop=str(stop))
    bands.sort(key=lambda b: _ORDER.get(b.name.upper(), "9" + index[b.name]))
    names = [b.name for b in bands]
    trims = {m: _redundant(names, m) for m in {p.is_m3m for p in present}}
    first = present[0].is_m3m if present else False
    gone = trims.get(first, [])
    skipped = {name: tuple(p.path for p in present if p.band == name) for name in gone}
    if gone:
        messages.append(
            "Redundant bands detected, probably because RGB images are mixed with single band images. "
            "We will trim some bands as needed"
        )
        messages += [f"Skipping {name} band ({len(skipped[name])} images)" for name in gone]
        bands = [b for b in bands if b.name not in gone]
        present = [p for p in present if p.band not in gone]
    primary = primary_band([b.name for b in bands])
    solver = tuple(p.path for b in bands if b.name == primary for p in b.photos)
    late_stop, late_messages, by_filename = _after_solver(bands, primary)
    return BandOutcome(
        bands=tuple(b.name for b in bands),
        primary=primary,
        counts=counts,
        solver=solver,
        kept=tuple(p.path for p in present),
        excluded=tuple(excluded),
        skipped=skipped,
        messages=tuple(messages),
        late_stop=late_stop,
        late_messages=late_messages,
        by_filename=by_filename,
        order_matters=len({tuple(t) for t in trims.values()}) > 1,
    )


def _after_solver(bands: Sequence[_Band], primary: str) -> Tuple[Optional[str], Tuple[str, ...], bool]:
    """What happens when ODM brings the other bands in, after hours of solving."""
    messages: List[str] = []
    try:
        maps, by_filename = _band_maps(bands, primary, messages)
    except BandStop as stop:
        return str(stop), tuple(messages), True
    lonely: List[str] = []
    for photo in next(b.photos for b in bands if b.name == primary):
        others = {p.band for p in maps.get(photo.name, ())}
        if not others:
            messages.append(f"Cannot find secondary photos for {photo.name}")
        if not others or any(b.name not in others for b in bands if b.name != primary):
            lonely.append(photo.name)
    text = "Cannot write reconstruction_<band>.nvm, not all band images have been matched" if lonely else None
    return text, tuple(messages), by_filename
