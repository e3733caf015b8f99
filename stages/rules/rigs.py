"""Rules about spectra, rigs and captures: which bands of which trigger are there."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Dict, Iterator, List, Sequence, Set, Tuple

from ..finding import ERROR, WARNING, Finding
from ..profile import MULTISPECTRAL, Payload, SurveyFrame
from ..survey import Survey
from ..thresholds import Thresholds
from .text import SPECTRUM_WORD, listed, plural


def mixed_spectra(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """More than one spectrum in the folder."""
    groups: Dict[str, List[Payload]] = defaultdict(list)
    for payload in survey.payloads:
        groups[payload.spectrum].append(payload)
    if len(groups) < 2:
        return
    counts = Counter(f.payload for f in survey.usable)
    parts = [f"{plural(sum(counts[p.id] for p in groups[s]), SPECTRUM_WORD[s] + ' frame')}" for s in sorted(groups)]
    yield Finding(
        code="mixed-spectra",
        severity=ERROR,
        subjects=tuple(sorted(p.id for members in groups.values() for p in members)),
        message=f"The folder mixes {' and '.join(parts)}. A solver cannot match features across spectra.",
        remedy="One project per spectrum: sensorgate run writes them.",
        measured=float(len(groups)),
        threshold=1.0,
    )


def mixed_rigs(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """More than one kind of multispectral rig."""
    rigs = [p for p in survey.payloads if p.spectrum == MULTISPECTRAL]
    kinds = {rig_kind(p, survey) for p in rigs}
    if len(kinds) > 1:
        yield Finding(
            code="mixed-rigs",
            severity=ERROR,
            subjects=tuple(p.id for p in rigs),
            message=f"{len(kinds)} kinds of multispectral camera are in the folder: {listed([p.id for p in rigs])}. "
            "ODM sorts bands by name over the whole folder and would mix them.",
            remedy="One project per camera: sensorgate run writes them.",
            measured=float(len(kinds)),
            threshold=1.0,
        )


def rig_kind(payload: Payload, survey: Survey) -> Tuple[str, str, Tuple[str, ...]]:
    """Make, model and band set: only rigs of one kind may share a project."""
    profile = survey.profile_of()[payload.primary]
    return (profile.make, profile.model, payload.bands)


def _captures(survey: Survey, payload: Payload) -> Dict[str, List[SurveyFrame]]:
    captures: Dict[str, List[SurveyFrame]] = defaultdict(list)
    for frame in survey.usable_of(payload.id):
        captures[frame.capture].append(frame)
    return captures


def kept_bands(survey: Survey, payload: Payload) -> Tuple[str, ...]:
    """Bands that at least half of a rig's captures have; a band below that is given up, not the captures."""
    captures = [{f.band for f in members} for members in _captures(survey, payload).values()]
    have = Counter(b for bands in captures for b in bands)
    multi = sum(1 for bands in captures if len(bands) > 1) or len(captures)
    kept = tuple(sorted(b for b in payload.bands if 2 * have[b] >= multi))
    return kept or payload.bands


def incomplete_captures(survey: Survey, payload: Payload) -> Tuple[str, ...]:
    """Frames of a rig that cannot enter its project: a band of their capture is missing or doubled, or given up."""
    kept = set(kept_bands(survey, payload))
    out: List[str] = []
    for members in _captures(survey, payload).values():
        bands = Counter(f.band for f in members)
        whole = all(bands[b] == 1 for b in kept)
        out.extend(f.path for f in members if not whole or f.band not in kept)
    return tuple(sorted(out))


def _capture_name(members: Sequence[SurveyFrame]) -> str:
    """A capture as a pilot knows it: by the name of its first file."""
    return min(f.path for f in members).rsplit("/", 1)[-1]


def captures_complete(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Bands that are missing throughout, and captures that lack one, have one twice, or are a single file."""
    for payload in survey.payloads:
        if len(payload.profiles) < 2:
            continue
        kept = set(kept_bands(survey, payload))
        lost_bands = sorted(set(payload.bands) - kept)
        if lost_bands:
            yield Finding(
                code="band-mostly-missing",
                severity=ERROR,
                subjects=(payload.id,),
                message=f"Most captures of {payload.id} have no {listed(lost_bands)} frame.",
                remedy="Copy the missing band from the card. sensorgate run goes on without that band.",
            )
        lacking: List[str] = []
        doubled: List[str] = []
        says_lacking: List[str] = []
        says_doubled: List[str] = []
        for _, members in sorted(_captures(survey, payload).items(), key=lambda c: _capture_name(c[1])):
            bands = Counter(f.band for f in members if f.band in kept)
            missing = sorted(kept - set(bands))
            twice = sorted(b for b, n in bands.items() if n > 1)
            paths = [f.path for f in members if f.band in kept]
            if twice:
                doubled.extend(paths)
                says_doubled.append(f"{_capture_name(members)} has {listed(twice)} twice")
            elif missing and paths:
                lacking.extend(paths)
                alone = "stands alone" if len(bands) == 1 else f"lacks {listed(missing)}"
                says_lacking.append(f"{_capture_name(members)} {alone}")
        if lacking:
            yield Finding(
                code="capture-incomplete",
                severity=ERROR,
                subjects=tuple(sorted(lacking)),
                message=f"{plural(len(says_lacking), 'capture')} of {payload.id} not complete: "
                f"{listed(says_lacking)}. ODM leaves such captures out, or stops.",
                remedy="Copy the missing band files from the card. sensorgate run leaves these captures out.",
                measured=float(len(says_lacking)),
                threshold=0.0,
            )
        if doubled:
            yield Finding(
                code="band-doubled",
                severity=ERROR,
                subjects=tuple(sorted(doubled)),
                message=f"{plural(len(says_doubled), 'capture')} of {payload.id} with more than one file of a band: "
                f"{listed(says_doubled)}. Nothing says which of them is right.",
                remedy="Delete the wrong files. sensorgate run leaves these captures out.",
                measured=float(len(says_doubled)),
                threshold=0.0,
            )


def misnumbered(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    """Frames whose capture id belongs to another trigger than the one their time and place show."""
    files = survey.file_of()
    carried: Dict[str, Set[str]] = defaultdict(set)
    for frame in survey.usable:
        if files[frame.path].capture_id:
            carried[frame.capture].add(files[frame.path].capture_id)
    wrong = [
        f
        for f in survey.usable
        if files[f.path].capture_id and files[f.path].capture_id != f.capture and len(carried[f.capture]) > 1
    ]
    if wrong:
        shown = [f"{f.path.rsplit('/', 1)[-1]} ({f.band})" for f in wrong]
        yield Finding(
            code="capture-misnumbered",
            severity=WARNING,
            subjects=tuple(f.path for f in wrong),
            message=f"{plural(len(wrong))} came with the capture id of another trigger: {listed(shown)}. "
            "They were put to the capture that has their time.",
            remedy="ODM goes by the id and would lay these bands over other ground: leave these captures out, or set "
            "right the id in the files.",
            measured=float(len(wrong)),
            threshold=0.0,
        )
