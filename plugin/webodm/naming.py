"""Cameras as a pilot names and counts them: a rig is one, and so is a body that wrote two picture sizes. Pure."""

from __future__ import annotations

import re
from collections import defaultdict
from typing import Dict, List, Sequence, Tuple

from ...stages.finding import Finding
from ...stages.grouping import camera_name
from ...stages.profile import MULTISPECTRAL, RGB, THERMAL, CameraProfile, Payload
from ...stages.rules.text import SPECTRUM_WORD
from ...stages.survey import Survey

_ZOOM = re.compile(r"^zoom([0-9.]+)$")


class Names:
    """What to call the cameras and payloads of a survey."""

    def __init__(self, survey: Survey) -> None:
        profiles = survey.profile_of()
        self._payload: Dict[str, str] = {}
        self._camera: Dict[str, str] = {}
        self._plain: Dict[str, str] = {}
        self._frames: Dict[str, Tuple[str, ...]] = {p.id: p.frames for p in survey.profiles}
        self._frames.update({f.id: f.frames for f in survey.flights})
        self._payload_of = {member: p.id for p in survey.payloads for member in p.profiles}
        leads = {p.id: profiles[p.primary] for p in survey.payloads}
        cameras: Dict[Tuple[str, str, str], List[Payload]] = defaultdict(list)
        for payload in survey.payloads:
            lead = leads[payload.id]
            cameras[camera_name(lead.make, lead.model), payload.spectrum, lead.serial].append(payload)
        for (name, spectrum, serial), members in sorted(cameras.items()):
            same = [key for key in cameras if key[0] == name]
            label = name + _kind(spectrum, {key[1] for key in same})
            if len({key[2] for key in same}) > 1 and serial:
                label += f" no. {serial[-6:]}"
            for payload in members:
                self._camera[payload.id] = label
                self._payload[payload.id] = _with(label, _part(leads[payload.id], [leads[m.id] for m in members]))
        for payload in survey.payloads:
            self._frames[payload.id] = tuple(f for p in payload.profiles for f in profiles[p].frames)
            for member in payload.profiles:
                profile = profiles[member]
                band = [f"{profile.band} band"] if len(payload.profiles) > 1 else []
                self._plain[member] = _with(self._payload[payload.id], band)
                self._plain[profile.family] = self._camera[payload.id]
            self._plain[payload.id] = self._payload[payload.id]
        found = sorted((k for k in self._plain if k), key=lambda k: (-len(k), k))
        # An id is made of these signs; one that is the beginning of another is not it.
        self._ids = re.compile(rf"(?<![\w@/.-])(?:{'|'.join(map(re.escape, found))})(?![\w@/-])") if found else None

    def payload(self, payload: str) -> str:
        """The name of a payload; its id where it is none."""
        return self._payload.get(payload, payload)

    def camera(self, payload: str) -> str:
        """The name of the camera that a payload belongs to; equal for all payloads of one camera."""
        return self._camera.get(payload, payload)

    def camera_of_profile(self, profile: str) -> str:
        """The name of the camera that took a profile's frames."""
        return self.camera(self._payload_of.get(profile, profile))

    def plain(self, text: str) -> str:
        """The text with names in place of ids."""
        return self._ids.sub(lambda found: self._plain[found.group(0)], text) if self._ids else text

    def frames(self, finding: Finding) -> int:
        """How many frames a finding is about: its subjects are frames, profiles, payloads or flights."""
        return len({f for s in finding.subjects for f in self._frames.get(s, (s,))})

    def subjects(self, findings: Sequence[Finding]) -> List[str]:
        """The cameras that these findings are about, each once, in order."""
        return list(dict.fromkeys(self._plain[s] for f in findings for s in f.subjects if s in self._plain))


def _kind(spectrum: str, beside: "set[str]") -> str:
    """A colour camera is what everybody expects; a rig is named where the same body has a colour camera as well."""
    if spectrum == THERMAL or (spectrum == MULTISPECTRAL and RGB in beside):
        return f" ({SPECTRUM_WORD[spectrum]})"
    return ""


def _part(lead: CameraProfile, others: Sequence[CameraProfile]) -> List[str]:
    """What parts a payload from the others of its camera."""
    said = []
    if len({(o.width, o.height) for o in others}) > 1:
        said.append(f"{lead.width} x {lead.height}")
    if len({o.intrinsics.focal_mm for o in others}) > 1 and lead.intrinsics.focal_mm:
        said.append(f"{lead.intrinsics.focal_mm:g} mm")
    if len({o.mode for o in others}) > 1 and lead.mode:
        said += [_ZOOM.sub(r"\1x digital zoom", part) for part in re.split(r"[+-]", lead.mode)]
    return said


def _with(label: str, said: Sequence[str]) -> str:
    """``DJI M30T (thermal, 640 x 512)``: all that is said of a name in one pair of brackets."""
    if not said:
        return label
    return f"{label[:-1]}, {', '.join(said)})" if label.endswith(")") else f"{label} ({', '.join(said)})"
