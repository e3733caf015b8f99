"""What ODM's own words say about a run (pure): how far it came, what it found, why it ended.

The words are those that ODM 3.5 to 3.6 prints, with the generic endings of
its sub-processes; every rule looks for a short unmistakable part.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Dict, Iterable, List, Optional, Tuple

from ...stages.route import ISOLATE, PAIRWISE

FINISHED, FAILED, UNFINISHED = "finished", "failed", "unfinished"
FATAL, WARNING = "fatal", "warning"
NO_RECONSTRUCTION = "no-reconstruction"

_COLOUR = re.compile(r"\x1b?\[[0-9;]*m")
_MAX_LINE = 2000
_SHOWN = 200


@dataclass(frozen=True)
class ConsoleFact:
    """One thing that ODM said: ``odm_message`` in its words, ``message`` and ``remedy`` in ours.

    ``route`` is what the router would try (``pairwise``, ``isolate``), ``""``
    where no route helps. ``count`` is how often it was said.
    """

    code: str
    severity: str
    message: str
    remedy: str
    route: str
    odm_message: str
    count: int = 1


@dataclass(frozen=True)
class ConsoleOutcome:
    """What the console tells of a run.

    ``components`` is the number of reconstructions that ODM found before it
    merged them, ``sizes`` their frames. ``stage`` is the last that it began.
    """

    state: str
    stage: str
    components: Optional[int]
    sizes: Tuple[int, ...]
    facts: Tuple[ConsoleFact, ...]
    last: str

    @property
    def cause(self) -> Optional[ConsoleFact]:
        """Why it ended, where its words say so."""
        return next((f for f in self.facts if f.severity == FATAL), None)


# code, severity, pattern, what it means, what to do, what the router would try; specific causes before general ones
_RULES: Tuple[Tuple[str, str, str, str, str, str], ...] = (
    (
        "bands-unmatched",
        FATAL,
        r"Cannot match bands by filename|not all band images have been matched",
        "ODM could not put the bands of its captures together",
        "Captures are incomplete, or cameras of different kinds share the folder: sensorgate run writes one project "
        "per rig with complete captures.",
        ISOLATE,
    ),
    (
        "band-without-frames",
        FATAL,
        r"Not enough images in selected band",
        "the band that ODM was to solve has too few frames",
        "Choose another primary-band, or leave the choice to ODM.",
        ISOLATE,
    ),
    (
        NO_RECONSTRUCTION,
        FATAL,
        r"could not process this dataset using the current settings",
        "ODM found no two frames that it could reconstruct together",
        "Cameras that do not match each other may be mixed (sensorgate run), or the frames overlap too little.",
        PAIRWISE,
    ),
    (
        "no-images",
        FATAL,
        r"There are no images in |Not enough supported images|Not enough photos in photos array",
        "ODM found no frame that it could read",
        "Check the images folder with sensorgate gate.",
        "",
    ),
    (
        "gcp-unusable",
        FATAL,
        r"GCP file does not have any entries|Could not project GCP file|no valid GCP entries could be used"
        r"|Bad SRS supplied|has no attribute 'gcp_path'",
        "ODM could not use the ground control file",
        "Check its first line (coordinate system) and the names in it; sensorgate run --gcp checks and rewrites it.",
        "",
    ),
    (
        "option-refused",
        FATAL,
        r"unrecognized arguments|error: argument --|invalid choice:",
        "ODM does not know an option, or not its value",
        "This ODM is another version than the options were written for: write them again for it.",
        "",
    ),
    (
        "bad-metadata",
        FATAL,
        r"'<=' not supported between instances of 'NoneType'|UnicodeDecodeError",
        "a frame's metadata stopped ODM",
        "sensorgate gate names the frame; sensorgate run writes it with sound tags.",
        "",
    ),
    (
        "out-of-memory",
        FATAL,
        r"You ran out of memory|MemoryError|std::bad_alloc|Cannot allocate memory|oom-kill",
        "the machine ran out of memory",
        "Use a larger machine, or a lower feature-quality and pc-quality.",
        "",
    ),
    (
        "disk-full",
        FATAL,
        r"No space left on device|ENOSPC",
        "the disk is full",
        "Free some space and run it again.",
        "",
    ),
    (
        "program-missing",
        FATAL,
        r"can't find a program that is required|CPU is not supported",
        "ODM's installation does not work on this machine",
        "Repair or replace the ODM installation; the imagery is not the cause.",
        "",
    ),
    (
        "strange-values",
        FATAL,
        r"strange values in the reconstruction",
        "a step of ODM ended without saying why; wrong geometry is the usual cause",
        "See whether its payloads reconstruct apart: sensorgate run proves that before ODM starts.",
        PAIRWISE,
    ),
    (
        "several-components",
        WARNING,
        r"Multiple reconstructions detected",
        "the block fell into pieces that nothing ties together",
        "ODM lays the pieces by GPS alone; its report then counts one.",
        PAIRWISE,
    ),
    (
        "frames-corrupt",
        WARNING,
        r"seems corrupted and will not be used",
        "ODM could not read some frames and went on without them",
        "sensorgate gate names them.",
        "",
    ),
    (
        "captures-excluded",
        WARNING,
        r"Multi-camera setup detected, but band|^Excluding ",
        "ODM left out captures whose bands are incomplete, or cameras that it took for such",
        "Cameras of different kinds share the folder, or frames are missing: sensorgate run sorts them.",
        ISOLATE,
    ),
    (
        "rgb-dropped",
        WARNING,
        r"Redundant bands detected",
        "ODM dropped bands because RGB and single-band frames share the folder",
        "sensorgate run gives each its own project.",
        ISOLATE,
    ),
    (
        "calibration-ignored",
        WARNING,
        r"Cannot set camera_models_overrides|Invalid camera key ignored",
        "ODM did not take the cameras file, or a part of it",
        "The cameras were solved without it: check the file's keys.",
        "",
    ),
    (
        "gcp-lines-ignored",
        WARNING,
        r"GCP line ignored|Malformed GCP line",
        "ODM ignored lines of the ground control file",
        "The names in it are not those of the frames; case counts.",
        "",
    ),
    (
        "few-gcps",
        WARNING,
        r"Low number of GCPs detected",
        "ODM found few ground control points",
        "Five or more, each in three frames, hold a block.",
        "",
    ),
    (
        "not-georeferenced",
        WARNING,
        r"Could not generate coordinates file|No images seem to have GPS information",
        "the result is not georeferenced",
        "Without GPS or ground control nothing proves the model.",
        "",
    ),
)
_COMPILED = tuple((re.compile(rule[2]), rule) for rule in _RULES)
_STAGE = re.compile(r"\bRunning (\S+) stage")
_PIECES = re.compile(r"Multiple reconstructions detected \((\d{1,6})\)")
_PIECE = re.compile(r"Reconstruction \d+: (\d{1,6}) images")
_PARTIAL = re.compile(r"(\d{1,6}) partial reconstructions in total")
_DONE = re.compile(r"ODM app finished|No more stages to run")
_ENDED = re.compile(r"^\[(?:ERROR|EXCEPTION)\]|^Traceback \(most recent call last\)")


def outcome_of_console(lines: Iterable[str]) -> ConsoleOutcome:
    """Judge a run by what it printed; ``lines`` are the console's, or the messages of ``log.json``."""
    stage, last = "", ""
    pieces: Optional[int] = None
    sizes: List[int] = []
    done = broken = False
    found: List[Tuple[int, ConsoleFact]] = []
    place = {rule[0]: i for i, rule in enumerate(_RULES)}
    seen: Dict[str, int] = {}
    for raw in lines:
        line = _COLOUR.sub("", raw[:_MAX_LINE]).strip()
        if not line:
            continue
        last = line
        began = _STAGE.search(line)
        stage = began.group(1) if began else stage
        counted = _PIECES.search(line)
        pieces = int(counted.group(1)) if counted else pieces
        size = _PIECE.search(line)
        if size:
            sizes.append(int(size.group(1)))
        partial = _PARTIAL.search(line)
        if partial and int(partial.group(1)):
            # A run corrected for rolling shutter reconstructs twice; the last one counts.
            sizes = sizes[-int(partial.group(1)) :]
        done = bool(_DONE.search(line)) or done
        broken = bool(_ENDED.search(line)) or broken
        text = re.sub(r"^\[[A-Z]+\]\s*", "", line)
        for pattern, (code, severity, _, message, remedy, route) in _COMPILED:
            if pattern.search(text):
                seen[code] = seen.get(code, 0) + 1
                if seen[code] == 1:
                    found.append((place[code], ConsoleFact(code, severity, message, remedy, route, text[:_SHOWN])))
                break
    facts = [
        ConsoleFact(f.code, f.severity, f.message, f.remedy, f.route, f.odm_message, seen[f.code])
        for _, f in sorted(found, key=lambda item: item[0])
    ]
    fatal = any(f.severity == FATAL for f in facts)
    state = FAILED if fatal or (broken and not done) else FINISHED if done else UNFINISHED
    components = pieces if pieces is not None else len(sizes) or None
    return ConsoleOutcome(state, stage, components, tuple(sorted(sizes, reverse=True)), tuple(facts), last[:_SHOWN])
