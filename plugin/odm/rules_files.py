"""What ODM would do with single files: die on them, pass over them, misread them."""

from __future__ import annotations

from collections import defaultdict
from typing import Dict, Iterator, List

from ...stages.finding import ERROR, INFO, WARNING, Finding
from ...stages.frame import Frame
from .folder import MASK, PASSED_OVER, STOPS, Folder, extension, finding, paths, several

_STRIP_XMP = "Rewrite or remove the XMP packet (exiftool -XMP:all= FILE); sensorgate run leaves the frame out."


def focal_plane_crash(folder: Folder) -> Iterator[Finding]:
    """A focal-plane resolution of 0/0 ends the whole run."""
    found = [f for f in folder.with_fate(STOPS) if folder.focals[f.path].how == "crash"]
    if found:
        yield finding(
            "odm-crash-focal-plane",
            ERROR,
            found,
            f"ODM would stop on {several(found)}: FocalPlaneXResolution is 0/0.",
            "Remove the tag (exiftool -FocalPlaneXResolution= -FocalPlaneYResolution= FILE) or leave the frame out.",
            odm="TypeError: '<=' not supported between instances of 'NoneType' and 'int'",
        )


def xmp_crash(folder: Folder) -> Iterator[Finding]:
    """An XMP packet that is not UTF-8 ends the whole run."""
    found = [f for f in folder.frames if any(p.startswith("xmp-not-utf8:byte") for p in f.problems)]
    if found:
        yield finding(
            "odm-crash-xmp-encoding",
            ERROR,
            found,
            f"ODM would stop on {several(found)}: the XMP packet is not UTF-8.",
            _STRIP_XMP,
            odm="UnicodeDecodeError: 'utf-8' codec can't decode byte",
        )


def xmp_malformed(folder: Folder) -> Iterator[Finding]:
    """ODM repairs broken XMP with a parser that it does not install itself."""
    found = [f for f in folder.frames if any(p.startswith("xmp-malformed") for p in f.problems)]
    if found:
        yield finding(
            "odm-xmp-malformed",
            WARNING,
            found,
            f"The XMP of {several(found)} is malformed. ODM repairs it where lxml is installed, and may misread band, "
            "heights and RTK accuracy; where it is not, the run stops.",
            "Write the packet anew with the maker's software, or remove it if the frames are plain colour.",
            odm=f"{found[0].name} has malformed XMP XML (but we fixed it)",
        )


def masks(folder: Folder) -> Iterator[Finding]:
    """A frame whose name ends in ``_mask`` is no image for ODM."""
    found = folder.with_fate(MASK)
    if found:
        yield finding(
            "odm-name-mask",
            WARNING,
            found,
            f"ODM would take {several(found)} for a mask: a name that ends in _mask is no photo to it.",
            "Rename it if it is a photo; sensorgate run does so in its copies.",
        )


def passed_over(folder: Folder) -> Iterator[Finding]:
    """Formats that ODM does not open."""
    found = folder.with_fate(PASSED_OVER)
    if found:
        kinds = ", ".join(sorted({extension(f.name) or "no extension" for f in found}))
        yield finding(
            "odm-format-unknown",
            WARNING,
            found,
            f"ODM would pass over {several(found)} without a word: it does not open {kinds}.",
            "Rename .jpe to .jpg; convert anything else to JPEG or TIFF with its metadata.",
            odm="Not enough supported images in images" if len(found) == len(folder.frames) else None,
        )


def unreadable_tiff(folder: Folder) -> Iterator[Finding]:
    """TIFFs that ODM's image library refuses: more than four channels, or three of float."""
    found = [
        f
        for f in folder.frames
        if extension(f.name) in (".tif", ".tiff")
        and (f.channels > 4 or (f.channels == 3 and f.bits == 32 and f.sample_format == "float"))
    ]
    if found:
        yield finding(
            "odm-tiff-unreadable",
            ERROR,
            found,
            f"ODM cannot open {several(found)} ({found[0].channels} channels of {found[0].bits} bits) "
            "and goes on without it.",
            "Write one file per band, or three channels of 8 or 16 bits.",
            odm=f"{found[0].name} seems corrupted and will not be used",
        )


def same_names(folder: Folder) -> Iterator[Finding]:
    """ODM has one flat folder: files of one name overwrite each other on the way into it."""
    named: Dict[str, List[Frame]] = defaultdict(list)
    for frame in folder.frames:
        named[frame.name.lower()].append(frame)
    found = [f for name in sorted(named) if len(named[name]) > 1 for f in named[name]]
    if found:
        lost = len(found) - len({f.name.lower() for f in found})
        yield finding(
            "odm-name-collision",
            WARNING,
            found,
            f"{len(found)} frames in several folders share their names. ODM has one flat folder, so up to {lost} "
            "would be overwritten, or renamed at random by the node.",
            "Use the projects that sensorgate run writes: there every name is unique.",
            measured=float(lost),
            threshold=0.0,
        )


def nothing_usable(folder: Folder) -> Iterator[Finding]:
    """No image at all for ODM."""
    if folder.frames and not folder.with_fate("solver", "band", "dropped", "excluded") and not folder.bands.stop:
        yield Finding(
            "odm-no-images",
            ERROR,
            paths(folder.frames),
            "ODM would find no usable image in this folder.",
            "Look at the other findings of these frames.",
            odm_message="Not enough supported images in images",
        )


def panels(folder: Folder) -> Iterator[Finding]:
    """ODM solves calibration-panel captures along with the survey."""
    found = [f for f in folder.solver if f.panel]
    if found:
        yield finding(
            "odm-panel-solved",
            INFO,
            found,
            f"ODM knows no calibration panels: it would solve {several(found)} along with the survey.",
            "Keep panel captures out of the images folder; sensorgate run lays them beside the project.",
        )


def panorama_shape(folder: Folder) -> Iterator[Finding]:
    """Frames exactly twice as wide as high are taken for panoramas when features are found."""
    found = [f for f in folder.solver if f.width == 2 * f.height]
    if found:
        yield finding(
            "odm-panorama-shape",
            INFO,
            found,
            f"{several(found, 'is', 'are')} exactly twice as wide as high; ODM takes that for a panorama and scales "
            "its features otherwise.",
            "Nothing to do, unless matching is poor: then crop the frames by one row.",
        )


RULES = (
    focal_plane_crash,
    xmp_crash,
    xmp_malformed,
    masks,
    passed_over,
    unreadable_tiff,
    same_names,
    nothing_usable,
    panels,
    panorama_shape,
)
