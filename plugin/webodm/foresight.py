"""What ODM would do with the folder as it is, in the words of somebody who never saw its log. Pure."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Dict, List, Set

from ...stages.finding import ERROR
from ...stages.rules.text import listed, plural
from ..inspection import Inspection
from ..odm.folder import BAND, DROPPED, EXCLUDED, MASK, PASSED_OVER, SOLVER, STOPS
from .naming import Names

# Said first: with one of these the rest does not matter.
_PAIRS = "odm-crash-band-count"
_STOPS = (_PAIRS, "odm-crash-focal-plane", "odm-crash-xmp-encoding", "odm-no-images")
_LATE = "odm-crash-bands-late"
_LOST = {
    EXCLUDED: "captures lack one of their bands",
    DROPPED: "ODM takes them for doubles of other bands",
    MASK: "their names end in _mask, so ODM takes them for masks",
    PASSED_OVER: "ODM does not open this kind of file",
}
_MOST_REASONS = 4


def as_it_is(inspection: Inspection, names: Names) -> List[str]:
    """Sentences on what happens when all files are uploaded as one task; what ends the processing comes first."""
    findings = inspection.prediction.findings
    fates = Counter(inspection.prediction.fates.values())
    total = sum(fates.values())
    if not total:
        return ["ODM would find no image here."]
    stops = [f for f in findings if f.code in _STOPS]
    if fates[STOPS] or (stops and not fates[SOLVER]):
        why = [_no_pairs(inspection, names) if f.code == _PAIRS else names.plain(f.message) for f in stops]
        return [*why[:_MOST_REASONS], f"So none of the {plural(total, 'frame')} would be processed."]
    said = [names.plain(f.message) for f in findings if f.code == _LATE]
    if said:
        return [*said, "You would wait for hours and get nothing."]
    used = fates[SOLVER] + fates[BAND]
    lost = [f"{fates[fate]} because {why}" for fate, why in _LOST.items() if fates[fate]]
    if lost:
        said.append(f"ODM would leave frames out: {', '.join(lost)}.")
    said.append(f"ODM would use {'all' if used == total else f'{used} of'} {plural(total, 'frame')}.")
    said += _cameras(inspection, names)
    harm = [
        names.plain(f.message)
        for f in inspection.findings
        if f.severity == ERROR and f.code != _LATE and "ODM" in f.message and f.code not in _STOPS
    ]
    return [*said, *list(dict.fromkeys(harm))[:_MOST_REASONS]]


def _no_pairs(inspection: Inspection, names: Names) -> str:
    cameras = sorted({names.camera(f.payload) for f in inspection.survey.frames})
    if len(cameras) == 1:
        return (
            f"ODM would stop while it loads the images: captures of {cameras[0]} lack a band, and it cannot tell "
            "which of the others belong together."
        )
    return (
        f"ODM would stop while it loads the images: it takes {len(cameras)} cameras ({listed(cameras)}) for the bands "
        "of one multispectral camera, and their frames do not pair up."
    )


def _cameras(inspection: Inspection, names: Names) -> List[str]:
    """How many cameras ODM would solve, against how many there are."""
    solver = {p for p, fate in inspection.prediction.fates.items() if fate == SOLVER}
    behind: Dict[str, Set[str]] = defaultdict(set)
    for frame in inspection.survey.frames:
        identity = inspection.prediction.camera_ids.get(frame.path)
        if frame.path in solver and identity:
            behind[identity].add(names.payload(frame.payload))
    said = [
        f"It would take {listed(sorted(members))} for one camera, with one focal length and one distortion."
        for _, members in sorted(behind.items())
        if len(members) > 1
    ]
    taken: Dict[str, int] = Counter(name for members in behind.values() for name in members)
    said += [
        f"It would take {name} for {count} cameras and solve each by itself, because its tags or picture sizes change."
        for name, count in sorted(taken.items())
        if count > 1
    ]
    return said
