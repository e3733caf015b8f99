"""The tasks that a folder should become: frames, new names, options, control texts. Pure.

What harmonizing and alignment would add is not in it: this is what the gate
alone can stand for, and what a browser can carry out.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Dict, FrozenSet, List, Mapping, Optional, Sequence, Set, Tuple

from ...stages.assemble import groups_of, left_out
from ...stages.finding import Finding
from ...stages.gate import is_rtk_fixed
from ...stages.harmonize.model import HarmonizedFrame, untouched
from ...stages.survey import Survey
from ..inspection import Inspection
from ..odm.folder import SOLVER
from ..odm.names import mask_name, output_names
from ..odm.options import OptionNeeds, as_node_options, options_for
from ..placing import project_names, without_alignment

SPLIT, LEAVE_OUT, OPTIONS, CONTROL = "split", "leave-out", "options", "control"
RULES = (SPLIT, LEAVE_OUT, OPTIONS, CONTROL)
TAG = "sensorgate"
GCP_FILE, GEO_FILE = "gcp_list.txt", "geo.txt"
_WHOLE = "all"


@dataclass(frozen=True)
class Choices:
    """What the user changed: rules that are off, and payload -> task key (``""``: not sent)."""

    off: FrozenSet[str] = frozenset()
    moves: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Proposed:
    """One task. ``names`` is path -> name to upload it under, masks among them; ``texts`` are files to add.

    ``calibration`` is in ODM's cameras format, empty where nothing is known;
    ``None`` says that the frames were not harmonized.
    """

    key: str
    name: str
    spectrum: str
    payloads: Tuple[str, ...]
    frames: Tuple[str, ...]
    names: Mapping[str, str]
    options: Tuple[Mapping[str, Any], ...]
    reasons: Mapping[str, str]
    texts: Mapping[str, str]
    findings: Tuple[Finding, ...] = ()
    calibration: Optional[Mapping[str, Any]] = None

    @property
    def tags(self) -> Tuple[str, ...]:
        """Tags of the task."""
        return (TAG, self.spectrum) if self.spectrum else (TAG,)


@dataclass(frozen=True)
class Proposal:
    """The tasks, and path -> finding code of what is not sent. ``affected`` is rule -> frames that it decides on."""

    tasks: Tuple[Proposed, ...]
    left_out: Mapping[str, str]
    affected: Mapping[str, int]


def propose(inspection: Inspection, choices: Choices = Choices()) -> Proposal:
    """Cut the frames into tasks as the gate's rules and the user's choices say."""
    survey = inspection.survey
    payload_of = {f.path: f.payload for f in survey.frames}
    members, names, out = _members(survey, choices)
    gone = {p for p, key in choices.moves.items() if key == "" and any(payload_of[f] == p for f in payload_of)}
    for key, frames in list(members.items()):
        for path in frames:
            if payload_of[path] in gone:
                out[path] = "not-wanted"
        members[key] = [p for p in frames if payload_of[p] not in gone]
    members = {key: sorted(frames) for key, frames in members.items() if frames}
    wanted = {path: payload_of[path] for frames in members.values() for path in frames}
    unique = output_names(wanted)
    by_path = {f.path: f for f in survey.files}
    copies = {
        path: replace(copy, name=unique[path]) for path, copy in untouched(by_path[path] for path in wanted).items()
    }
    spectrum_of = {p.id: p.spectrum for p in survey.payloads}
    tasks = tuple(
        _task(key, names[key], members[key], copies, inspection, choices, payload_of, spectrum_of)
        for key in sorted(members)
    )
    held_back = sum(1 for f in survey.frames if f.excluded) + len(left_out(survey))
    control = len(wanted) if any(t.texts for t in tasks) or CONTROL in choices.off else 0
    affected = {
        SPLIT: len(wanted) if len(groups_of(survey)) > 1 else 0,
        LEAVE_OUT: held_back,
        OPTIONS: sum(len(t.frames) for t in tasks if t.options) or (len(wanted) if OPTIONS in choices.off else 0),
        CONTROL: control,
    }
    return Proposal(tasks, out, affected)


def _members(survey: Survey, choices: Choices) -> Tuple[Dict[str, List[str]], Dict[str, str], Dict[str, str]]:
    """Key -> frames, key -> name, and path -> code of what the rules leave out."""
    groups = groups_of(survey)
    placed = [item for group in groups for item in without_alignment(group, survey)]
    names = {group.name: name for group, name in zip(groups, project_names(placed, survey))}
    members = {group.name: list(group.frames) for group in groups}
    out = {f.path: f.excluded for f in survey.frames if f.excluded is not None}
    out.update(left_out(survey))
    home: Dict[str, str] = {}
    payload_of = {f.path: f.payload for f in survey.frames}
    for group in groups:
        for path in group.frames:
            home.setdefault(payload_of[path], group.name)
    if LEAVE_OUT in choices.off:
        first = groups[0].name if groups else _WHOLE
        for path in sorted(out):
            members.setdefault(home.get(payload_of[path], first), []).append(path)
            names.setdefault(first, _WHOLE)
        out = {}
    if SPLIT in choices.off and members:
        members = {_WHOLE: [path for frames in members.values() for path in frames]}
        names = {_WHOLE: _WHOLE}
    for payload, key in sorted(choices.moves.items()):
        if key == "" or key not in members:
            continue
        moved = [p for frames in members.values() for p in frames if payload_of[p] == payload]
        members = {k: [p for p in frames if payload_of[p] != payload] for k, frames in members.items()}
        members[key].extend(moved)
    return members, names, out


def _task(
    key: str,
    name: str,
    paths: Sequence[str],
    copies: Mapping[str, HarmonizedFrame],
    inspection: Inspection,
    choices: Choices,
    payload_of: Mapping[str, str],
    spectrum_of: Mapping[str, str],
) -> Proposed:
    payloads = tuple(sorted({payload_of[p] for p in paths}))
    spectra = {spectrum_of[p] for p in payloads}
    names = {p: copies[p].name for p in paths}
    names.update(
        {inspection.masks[p]: mask_name(copies[p].name, inspection.masks[p]) for p in paths if p in inspection.masks}
    )
    texts, needs, said = control_for(inspection, name, paths, copies)
    if CONTROL in choices.off:
        texts, needs = {}, OptionNeeds()
    options = () if OPTIONS in choices.off else options_for(needs)
    return Proposed(
        key=key,
        name=name,
        spectrum=next(iter(spectra)) if len(spectra) == 1 else "",
        payloads=payloads,
        frames=tuple(paths),
        names=names,
        options=tuple(as_node_options(options)),
        reasons={o.name: o.reason for o in options},
        texts=texts,
        findings=said,
    )


def control_for(
    inspection: Inspection, name: str, paths: Sequence[str], copies: Mapping[str, HarmonizedFrame]
) -> Tuple[Dict[str, str], OptionNeeds, Tuple[Finding, ...]]:
    """Ground control and positions of one task under its frames' new names, and what follows for its options."""
    survey = inspection.survey
    own: Set[str] = set(paths)
    fates = inspection.prediction.fates
    primary = {p for p in own if fates.get(p) == SOLVER} or own
    ground = inspection.control.for_project(
        name, paths, copies, survey, inspection.settings.thresholds, primary=primary
    )
    texts = {}
    if ground.gcp_text is not None:
        texts[GCP_FILE] = ground.gcp_text
    if ground.geo_text is not None:
        texts[GEO_FILE] = ground.geo_text
    fixed = all(is_rtk_fixed(f.rtk_flag) for f in survey.files if f.path in own)
    needs = OptionNeeds(
        has_gcp=ground.gcp_text is not None,
        keep_gps=ground.gcp_text is not None and fixed,
        gps_accuracy_m=ground.accuracy_m,
        geo_has_accuracies=ground.geo_text is not None,
    )
    return texts, needs, ground.findings
