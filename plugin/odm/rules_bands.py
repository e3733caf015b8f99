"""What ODM would do with the bands of a folder: stop, drop, mix, misalign."""

from __future__ import annotations

from collections import defaultdict
from typing import Dict, Iterator, List, Optional, Set, Tuple

from ...stages.finding import ERROR, INFO, WARNING, Finding
from ...stages.frame import Frame
from ...stages.profile import MULTISPECTRAL, THERMAL
from .bands import MAX_BANDS
from .folder import BAND, DROPPED, EXCLUDED, SOLVER, STOPS, Folder, finding, several

_APART = "Run sensorgate run: it writes one project per spectrum."
_THERMAL_CAMERAS = (("DJI", "MAVIC2-ENTERPRISE-ADVANCED"), ("DJI", "ZH20T"))


def _named(folder: Folder, name: str) -> List[Frame]:
    """The frame that ODM's text names, as the subject."""
    return [f for f in folder.frames if f.path in folder.photos and f" {folder.photos[f.path].name}," in f" {name} "]


def stop(folder: Folder) -> Iterator[Finding]:
    """Bands differ in number and cannot be matched: ODM ends in its first minute."""
    text = folder.bands.stop
    if text is None:
        return
    counts = ", ".join(f"{n} {b}" for b, n in sorted(folder.bands.counts.items()))
    yield finding(
        "odm-crash-band-count",
        ERROR,
        _named(folder, text) or folder.with_fate(STOPS),
        f"ODM would stop while loading: it takes the folder for one multi-band camera, but the bands differ in number "
        f"({counts}) and neither capture ids nor file names match them.",
        f"Do not mix these cameras in one folder, and leave out incomplete captures. {_APART}",
        odm=text,
    )


def late_stop(folder: Folder) -> Iterator[Finding]:
    """The same, found out only after hours of solving."""
    text = folder.bands.late_stop
    if text is None:
        return
    said = "; ".join(folder.bands.late_messages[:3])
    yield finding(
        "odm-crash-bands-late",
        ERROR,
        _named(folder, text) or folder.with_fate(SOLVER, BAND),
        f"ODM would solve the {folder.bands.primary} band and stop afterwards, when it brings the other bands in: "
        "they do not match it capture by capture.",
        f"Leave out incomplete captures, keep the XMP and the original file names, and do not mix cameras. {_APART}",
        odm=f"{said}; {text}" if said else text,
    )


def excluded(folder: Folder) -> Iterator[Finding]:
    """Captures that lack a band are dropped whole."""
    found = folder.with_fate(EXCLUDED)
    if not found:
        return
    share = len(found) / len(folder.frames)
    lost = folder.thresholds.odm_lost_share
    yield finding(
        "odm-captures-excluded",
        ERROR if share > lost else WARNING,
        found,
        f"ODM would leave out {len(found)} of {len(folder.frames)} frames: their captures lack a band of others.",
        "Two multi-band cameras in one folder do this as well as lost files: process each camera apart, "
        "or copy the missing files from the card.",
        measured=round(share, 4),
        threshold=lost,
        odm=next((m for m in folder.bands.messages if m.startswith(("Multi-camera", "Excluding"))), None),
    )


def skipped(folder: Folder) -> Iterator[Finding]:
    """Bands that ODM trims because colour frames lie beside single bands."""
    dropped = folder.with_fate(DROPPED)
    if not dropped:
        return
    kept = {(folder.photos[f.path].make, folder.photos[f.path].model) for f in folder.with_fate(SOLVER, BAND)}
    foreign = [f for f in dropped if (folder.photos[f.path].make, folder.photos[f.path].model) not in kept]
    names = ", ".join(sorted(folder.bands.skipped))
    yield finding(
        "odm-band-dropped",
        ERROR if foreign else WARNING,
        dropped,
        f"ODM would drop the {names} frames ({len(dropped)}) without asking: it takes them for a double of "
        "the other bands." + (f" {len(foreign)} of them come from another camera altogether." if foreign else ""),
        f"Process colour and multispectral frames apart. {_APART}",
        odm=next((m for m in folder.bands.messages if m.startswith("Skipping")), None),
    )
    if folder.bands.order_matters:
        yield finding(
            "odm-band-order",
            WARNING,
            dropped,
            "Which of the bands ODM drops hangs on which file the disk happens to list first: "
            "a Mavic 3 Multispectral lies beside another camera.",
            f"Process the cameras apart. {_APART}",
        )


def many_bands(folder: Folder) -> Iterator[Finding]:
    """More than ten band names: ODM no longer sees bands at all."""
    counts = folder.bands.counts
    if len(counts) > MAX_BANDS:
        yield finding(
            "odm-bands-too-many",
            ERROR,
            folder.solver,
            f"The folder holds {len(counts)} band names. Beyond {MAX_BANDS} ODM takes every band image for a photo of "
            "its own and mixes all of them in one texture.",
            f"Process each multi-band camera apart. {_APART}",
            measured=float(len(counts)),
            threshold=float(MAX_BANDS),
        )


def unnamed_bands(folder: Folder) -> Iterator[Finding]:
    """Multispectral frames without a readable band name count as colour."""
    found = [
        f
        for f in folder.with_fate(SOLVER, BAND)
        if folder.photos[f.path].is_rgb and _spectrum(folder, f) == MULTISPECTRAL
    ]
    if found:
        yield finding(
            "odm-band-unnamed",
            ERROR if len({folder.profile_of.get(f.path) for f in found}) > 1 else WARNING,
            found,
            f"ODM reads no band name from {several(found)} and takes them for colour: the bands would be solved "
            "and textured as one.",
            "Write XMP Camera:BandName into the frames with the maker's software before they are processed.",
        )


def mixed_spectra(folder: Folder) -> Iterator[Finding]:
    """Thermal (or any unnamed band) and colour frames enter one solution without a word."""
    solved = folder.solver
    spectra: Dict[str, List[Frame]] = defaultdict(list)
    for frame in solved:
        spectra[_spectrum(folder, frame) or "unknown"].append(frame)
    known = sorted(s for s in spectra if s != "unknown")
    if len(known) > 1:
        fewest = min(known, key=lambda s: (len(spectra[s]), s))
        counts = ", ".join(f"{len(spectra[s])} {s}" for s in known)
        yield finding(
            "odm-spectra-mixed",
            ERROR,
            spectra[fewest],
            f"ODM would solve {counts} frames as one camera set: they carry no band name that parts them. "
            "The orthophoto mixes them patch by patch.",
            _APART,
        )


def _spectrum(folder: Folder, frame: Frame) -> Optional[str]:
    profile = folder.profile(frame)
    return profile.spectrum if profile else None


def thermal_picture(folder: Folder) -> Iterator[Finding]:
    """Thermal frames that ODM does not know as thermal stay palette pictures."""
    found = []
    for frame in folder.with_fate(SOLVER, BAND):
        photo = folder.photos[frame.path]
        known = (photo.make, photo.model) in _THERMAL_CAMERAS and (frame.width, frame.height) == (640, 512)
        if _spectrum(folder, frame) == THERMAL and not known and photo.band.upper() != "LWIR":
            found.append(frame)
    if found:
        yield finding(
            "odm-thermal-picture",
            INFO,
            found,
            f"ODM does not know {several(found)} as thermal: the orthophoto shows its colours, not temperatures.",
            "Convert the frames to temperature TIFFs with the maker's tool first, if temperatures are wanted.",
        )


def _rows(folder: Folder) -> Dict[str, Dict[Tuple[int, int], List[Frame]]]:
    """Band -> size -> frames, of the frames that are used."""
    rows: Dict[str, Dict[Tuple[int, int], List[Frame]]] = defaultdict(lambda: defaultdict(list))
    for frame in folder.with_fate(SOLVER, BAND):
        rows[folder.photos[frame.path].band][frame.width, frame.height].append(frame)
    return rows


def band_sizes(folder: Folder) -> Iterator[Finding]:
    """ODM's band alignment is right only where secondary and primary have one size."""
    primary = folder.bands.primary
    if primary is None:
        return
    rows = _rows(folder)
    sizes = set(rows[primary])
    odd = [
        f
        for band in sorted(rows)
        if band != primary
        for size in rows[band]
        if size not in sizes
        for f in rows[band][size]
    ]
    if odd:
        bands = ", ".join(sorted({folder.photos[f.path].band for f in odd}))
        width, height = sorted(sizes)[0]
        yield finding(
            "odm-band-size",
            WARNING,
            odd,
            f"The {bands} frames are not of the {primary} band's size ({width} x {height}). ODM measures the shift "
            "between bands at one size and applies it at the other, so these bands lie off.",
            "Check these bands against the others in the orthophoto before you measure in them.",
        )


def two_rigs(folder: Folder) -> Iterator[Finding]:
    """Two multi-band cameras with the same bands count as one: one alignment per band for both."""
    if folder.bands.primary is None or folder.bands.stop:
        return
    bands: Dict[Tuple[str, str], Set[str]] = defaultdict(set)
    frames: Dict[Tuple[str, str], List[Frame]] = defaultdict(list)
    for frame in folder.with_fate(SOLVER, BAND):
        photo = folder.photos[frame.path]
        bands[photo.make, photo.model].add(photo.band)
        frames[photo.make, photo.model].append(frame)
    rigs = sorted(c for c in bands if len(bands[c]) > 1 and folder.bands.primary in bands[c])
    if len(rigs) > 1:
        fewest = min(rigs, key=lambda c: (len(frames[c]), c))
        yield finding(
            "odm-rigs-mixed",
            WARNING,
            frames[fewest],
            f"ODM takes {' and '.join(' '.join(c).strip() for c in rigs)} for one multi-band camera: it aligns each "
            "band of both with one shift.",
            "Process each camera apart.",
        )


def by_filename(folder: Folder) -> Iterator[Finding]:
    """Capture ids fail and ODM goes by file name."""
    if folder.bands.by_filename and folder.bands.late_stop is None and len(folder.bands.bands) > 1:
        reason = next((m for m in folder.bands.late_messages if "will use filenames" in m), None)
        yield finding(
            "odm-bands-by-name",
            INFO,
            folder.solver,
            "ODM would match the bands by file name, because capture ids or times do not match: names must not change.",
            "Keep the original names ([capture]_[band].tif), or copy the frames from the card with their XMP.",
            odm=reason,
        )


RULES = (
    stop,
    late_stop,
    excluded,
    skipped,
    many_bands,
    unnamed_bands,
    mixed_spectra,
    thermal_picture,
    band_sizes,
    two_rigs,
    by_filename,
)
