"""What to do about a finding inside WebODM, where there is no command line: by the finding's code. Pure."""

from __future__ import annotations

import re
from typing import Dict, FrozenSet

from ...stages.finding import Finding

_APART = "The suggested tasks keep them apart."
_TOGETHER = "They are in one task now. Let the rules above part them, or leave out what does not belong."
_OUT = "The suggested tasks leave them out. Copy the files from the card again if you need them."
_SHEET = "Upload a calibration sheet with this camera on the Camera check page (in the menu on the left)."
_GEO = "Choose a geo.txt with their {} along with the images, or leave these frames out."
_RENAMED = "The suggested tasks give every file a name of its own."
_GEO_WRITTEN = "The suggested task brings a geo.txt with the true accuracy of each frame."

# Nobody has to harmonize for these: sorting, renaming, or the user's own files are enough.
REMEDIES: Dict[str, str] = {
    **dict.fromkeys(
        (
            "mixed-spectra",
            "mixed-rigs",
            "separate-areas",
            "odm-band-dropped",
            "odm-band-order",
            "odm-bands-too-many",
            "odm-crash-band-count",
            "odm-crash-bands-late",
            "odm-positions-apart",
            "odm-rigs-mixed",
            "odm-spectra-mixed",
        ),
        _APART,
    ),
    **dict.fromkeys(
        ("picture-cut-short", "capture-incomplete", "band-mostly-missing", "capture-misnumbered", "band-doubled"), _OUT
    ),
    "odm-captures-excluded": "The suggested tasks keep the cameras apart and leave incomplete captures out.",
    "odm-panel-solved": "The suggested tasks leave the panel pictures out.",
    "odm-name-collision": _RENAMED,
    "odm-name-mask": _RENAMED,
    **dict.fromkeys(("focal-unknown", "focal-guessed", "sensor-width-differs"), _SHEET),
    "focal-plane-missing": f"Nothing to do for a block with good overlap. Else: {_SHEET}",
    **dict.fromkeys(("gps-missing", "gps-zero", "odm-gps-exhaustive", "odm-gps-zero"), _GEO.format("positions")),
    "gps-none": "Choose a geo.txt with positions or a ground control file along with the images.",
    "odm-gps-none": "Choose a geo.txt with positions or a ground control file along with the images.",
    "gps-outlier": "Choose a geo.txt with their right positions along with the images, or leave these frames out.",
    "altitude-missing": "Choose a geo.txt with heights along with the images if the heights of the result matter.",
    "odm-altitude-missing": _GEO.format("heights"),
    "odm-altitude-zero": "Choose a geo.txt with the heights along with the images.",
    "altitude-bias": "If both took off from the same ground, choose a geo.txt with right altitudes or a ground control "
    "file along with the images. Nothing is shifted by itself.",
    "altitude-datum-mixed": "Choose a geo.txt with all altitudes in one height system, or a ground control file, along "
    "with the images.",
    "ground-datum": "Choose a geo.txt with altitudes in one height system along with the images.",
    "rtk-mixed": _GEO_WRITTEN,
    "odm-rtk-not-fixed": _GEO_WRITTEN,
    "odm-accuracy-mixed": _GEO_WRITTEN,
    "odm-xmp-blocks": "Harmless, unless you set the option sfm-algorithm to triangulation.",
    "gsd-unknown": "Nothing to do if all of them were flown at one height: they are processed as they are.",
    "gsd-native": "Nothing has to be done.",
    "hover-frames": "Leave all but one or two frames of each place out before you upload.",
    "projections-mixed": "Upload the frames of the fisheye camera as a task of their own.",
    "several-bodies": "Nothing to do.",
    "digital-zoom": "Leave the zoomed frames out, or upload them as a task of their own. Map without digital zoom.",
    "odm-zoom-ignored": "Leave the zoomed frames out, or upload them as a task of their own.",
    "odm-cameras-merged": "Where both matter, upload them as tasks of their own.",
    "block-bows": "Use ground control, or upload a calibration sheet of this camera on the Camera check page; next "
    "time fly cross strips at another height or some oblique frames.",
    "infrared-suspected": "If it was converted, upload its frames as a task of their own; if not, nothing "
    "has to be done.",
}
# What sorting alone cannot put right: a harmonized copy of the frames can.
HARMONIZED: FrozenSet[str] = frozenset(
    (
        "focal-jitter",
        "focal-variance",
        "gsd-mixed",
        "mixed-resolutions",
        "odm-camera-split",
        "odm-focal-default",
        "odm-focal-from-table",
        "odm-focal-off",
        "radiometry-offset",
        "stale-focal-plane",
    )
)
_CAN = "Harmonizing puts that right after the upload: open the task on the dashboard and choose Prepare on this server."
_NODE = "The processing node puts that right by itself."
_CANNOT = "Sorting the files cannot change that, and harmonizing is not possible here; process them as they are."
NODE, WORKER, GATE = "node", "worker", "gate"
_BY_ENGINE = {NODE: _NODE, WORKER: _CAN, GATE: _CANNOT}
# Words that mean nothing inside WebODM; a remedy with one of them has an entry above (a test holds it).
FOREIGN = ("--", "sensorgate run", "projects that", "cameras file")


_SENTENCES = re.compile(r"(?<=[.:]) (?=[A-Z])")


def remedy_here(finding: Finding, engine: str = WORKER, parted: bool = True) -> str:
    """A remedy as it applies inside WebODM; empty where the command line alone has one.

    ``engine`` says where harmonizing would run: on a ``node``, in the
    ``worker``, or nowhere (``gate``). ``parted`` is false where all frames
    are in one task.
    """
    if finding.code in HARMONIZED:
        return _BY_ENGINE[engine]
    if finding.code.startswith("gcp-"):
        return _control(finding.remedy)
    known = REMEDIES.get(finding.code)
    if known is not None:
        return _TOGETHER if known == _APART and not parted else known
    return " ".join(s for s in _SENTENCES.split(finding.remedy) if not any(sign in s for sign in FOREIGN))


def _control(remedy: str) -> str:
    """Ground control is chosen along with the images here, and results are laid on others in the task's form."""
    return remedy.partition(" Or run the project with --align")[0]
