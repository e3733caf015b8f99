"""A report dict made ready to be shown: cleaned text, indexes, one row per payload.

Everything that the page and the terminal both say is worked out here, so that
they never disagree. Pure: nothing is read or written.
"""

from __future__ import annotations

import re
import statistics
from dataclasses import dataclass, field
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

SPECTRUM_WORDS = {"rgb": "colour", "multispectral": "multispectral", "thermal": "thermal"}
ROUTE_WORDS = {"proceed": "proven", "pairwise": "joined pairwise", "isolate": "on its own", "unproven": "unproven"}
SOURCE_WORDS = {
    "user-sheet": "your sheet",
    "xmp-camera": "factory calibration in the file",
    "xmp-dewarp": "maker's dewarp data in the file",
    "stored-calibration": "proven by earlier surveys of this body",
    "xmp-calibrated": "maker's calibrated focal in the file",
    "focal-plane": "focal-plane tags",
    "sheet": "calibration sheet",
    "equivalent-35mm": "35 mm equivalent (rounded)",
    "generic-width": "guessed sensor width",
    "solved": "solved by the alignment",
    "unknown": "unknown",
}
# As the reasons of the stages name a source, in words that stand behind "from".
_PROSE = {
    "user-sheet": "your sheet",
    "xmp-camera": "the factory calibration in the file",
    "xmp-dewarp": "the maker's dewarp data",
    "stored-calibration": "earlier surveys of this body",
    "xmp-calibrated": "the maker's calibrated focal",
    "focal-plane": "the focal-plane tags",
    "sheet": "the calibration sheet",
    "equivalent-35mm": "the 35 mm equivalent",
    "generic-width": "a guessed sensor width",
}
_NAMED_SOURCE = re.compile(rf"\b(focal from|distortion(?: from)?) ({'|'.join(_PROSE)})(?![\w-])")
SHORT_SOURCES = {
    "user-sheet": "sheet",
    "xmp-camera": "xmp",
    "xmp-dewarp": "xmp",
    "stored-calibration": "stored",
    "xmp-calibrated": "xmp",
    "focal-plane": "tags",
    "sheet": "sheet",
    "equivalent-35mm": "35mm",
    "generic-width": "guess",
    "unknown": "?",
}
SEVERITY_ORDER = {"error": 0, "warning": 1, "info": 2}


def clean_text(text: str) -> str:
    """Replace what must reach neither a terminal nor a page: controls, bidi overrides, lone surrogates.

    Line breaks and exotic spaces become spaces.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if c.isprintable() else " " if c.isspace() else "\N{REPLACEMENT CHARACTER}" for c in text)


def in_words(text: str) -> str:
    """A reason of a stage for the eye: sources by their words, a capital first."""
    told = _NAMED_SOURCE.sub(lambda m: f"{m[1] if m[1].endswith('from') else m[1] + ' from'} {_PROSE[m[2]]}", text)
    return told[:1].upper() + told[1:] if told[:1].isascii() and " " in told else told


def cleaned(value: Any) -> Any:
    """The same JSON value with every string passed through ``clean_text``."""
    if isinstance(value, str):
        return clean_text(value)
    if isinstance(value, Mapping):
        return {clean_text(str(k)): cleaned(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [cleaned(v) for v in value]
    return value


def plural(count: int, one: str, many: str = "") -> str:
    """``1 frame``, ``12,000 frames``."""
    return f"{count:,} {one if count == 1 else many or one + 's'}"


def listing(items: Sequence[str], most: int = 4) -> str:
    """``a, b and c``; beyond ``most`` the rest is counted."""
    shown = list(items[:most])
    if len(items) > most:
        return f"{', '.join(shown)} and {len(items) - most:,} more"
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}" if shown else ""


def figure(value: Optional[float], digits: int = 2, unit: str = "") -> str:
    """A number for the eye; a dash where there is none."""
    if value is None:
        return "–"
    shown = f"{value:,.{digits}f}" if digits else f"{round(value):,}"
    return f"{shown.lstrip('-') if float(shown.replace(',', '')) == 0 else shown}{' ' + unit if unit else ''}"


def give_or_take(value: Optional[float], error: Optional[float]) -> str:
    """``-1.06 ± 1.53``: a signed figure with its standard error, where there is one."""
    if value is None:
        return "–"
    return f"{value:+.2f}" + (f" ± {error:.2f}" if error is not None else "")


def share(value: float) -> str:
    """A ratio as per cent."""
    return f"{100 * value:.1f} %"


def median(values: Iterable[Optional[float]]) -> Optional[float]:
    """Median of what is known, ``None`` when nothing is."""
    known = [v for v in values if v is not None]
    return statistics.median(known) if known else None


@dataclass(frozen=True)
class PayloadRow:
    """One line of the table that both the page and the terminal show."""

    id: str
    camera: str
    spectrum: str
    bands: Tuple[str, ...]
    frames: int
    used: int
    focal_mm: Optional[float]
    focal_ratio: Optional[float]
    focal_source: str
    focal_spread: float
    gsd_cm: Optional[float]
    gsd_after_cm: Optional[float]
    height_m: Optional[float]
    lock: bool
    lock_reason: str
    thermal_reading: str
    profiles: Tuple[str, ...]
    projects: Tuple[str, ...]


@dataclass(frozen=True)
class FindingLine:
    """One message and the payloads that it is about; none when it is about the whole folder."""

    message: str
    payloads: Tuple[str, ...]


@dataclass(frozen=True)
class FindingGroup:
    """Findings of one code and severity that say the same kind of thing."""

    code: str
    severity: str
    lines: Tuple[FindingLine, ...]
    payloads: Tuple[str, ...]
    count: int
    subjects: Tuple[str, ...]
    remedies: Tuple[str, ...]
    odm_messages: Tuple[str, ...]

    @property
    def message(self) -> str:
        """The first of its messages."""
        return self.lines[0].message


@dataclass
class View:
    """Indexes over one cleaned report."""

    report: Dict[str, Any]
    frames: Dict[str, Dict[str, Any]] = field(init=False)
    profiles: Dict[str, Dict[str, Any]] = field(init=False)
    subprojects: Dict[str, Dict[str, Any]] = field(init=False)
    owners: Dict[str, Tuple[str, ...]] = field(init=False)

    def __post_init__(self) -> None:
        self.report = cleaned(self.report)
        self.frames = {f["path"]: f for f in self.report["frames"]}
        self.profiles = {p["id"]: p for p in self.report["profiles"]}
        self.subprojects = {s["name"]: s for s in self.report["subprojects"]}
        self.owners = self._owners()

    def _owners(self) -> Dict[str, Tuple[str, ...]]:
        """What a finding may name (project, frame, flight, profile, payload) to the payloads that it belongs to."""
        known = {p["id"] for p in self.report["payloads"]}
        found = {s["name"]: tuple(p for p in s["payloads"] if p in known) for s in self.report["subprojects"]}
        found.update({f["path"]: (f["payload"],) for f in self.report["frames"] if f["payload"] in known})
        of_profile = {p: (payload["id"],) for payload in self.report["payloads"] for p in payload["profiles"]}
        for flight in self.report["flights"]:
            found[flight["id"]] = of_profile.get(flight["profile"], ())
        found.update(of_profile)
        found.update({p["id"]: (p["id"],) for p in self.report["payloads"]})
        return found

    @property
    def written(self) -> bool:
        """The projects stand on disk; else they are a proposal of the gate."""
        return any(f["output"] for f in self.report["frames"])

    @property
    def threshold(self) -> Mapping[str, float]:
        """All thresholds in force."""
        values: Mapping[str, float] = self.report["thresholds"]["all"]
        return values

    def excluded(self) -> List[Dict[str, Any]]:
        """Frames that go into no sub-project."""
        return [f for f in self.report["frames"] if f["reason"]]

    def spectra(self) -> List[str]:
        """The spectra present, in a fixed order."""
        present = {p["spectrum"] for p in self.report["payloads"]}
        return [s for s in SPECTRUM_WORDS if s in present]

    def camera(self, profile: Mapping[str, Any]) -> str:
        """Make and model without saying the make twice."""
        make, model = profile["make"].strip(), profile["model"].strip()
        name = model if make and model.lower().startswith(make.lower()) else f"{make} {model}".strip()
        return name or "unnamed camera"

    def payload_rows(self) -> List[PayloadRow]:
        """One row per payload, in the report's order."""
        by_payload: Dict[str, List[Dict[str, Any]]] = {}
        for frame in self.report["frames"]:
            if frame["payload"]:
                by_payload.setdefault(frame["payload"], []).append(frame)
        return [self._row(p, by_payload.get(p["id"], [])) for p in self.report["payloads"]]

    def _row(self, payload: Mapping[str, Any], frames: Sequence[Mapping[str, Any]]) -> PayloadRow:
        lead = self.profiles.get(payload["primary"])
        inner: Mapping[str, Any] = lead["intrinsics"] if lead else {}
        survey = [f for f in frames if not f["reason"]] or list(frames)
        names = {f["subproject"] for f in frames if f["subproject"]}
        projects = [s for s in self.report["subprojects"] if s["name"] in names or payload["id"] in s["payloads"]]
        members = [self.profiles[p] for p in payload["profiles"] if p in self.profiles]
        return PayloadRow(
            id=payload["id"],
            camera=self.camera(lead) if lead else "unnamed camera",
            spectrum=payload["spectrum"],
            bands=tuple(payload["bands"]),
            frames=len(frames),
            used=sum(1 for f in frames if not f["reason"]),
            focal_mm=inner.get("focal_mm"),
            focal_ratio=inner.get("focal_ratio"),
            focal_source=inner.get("focal_source", "unknown"),
            focal_spread=max((p["focal_variance"] for p in members), default=0.0),
            gsd_cm=median(f["gsd_cm"] for f in survey),
            gsd_after_cm=median(f.get("gsd_after_cm") for f in survey),
            height_m=median(f["height_m"] for f in survey),
            lock=bool(lead and lead["lock"]),
            lock_reason=lead["lock_reason"] if lead else "",
            thermal_reading=lead["thermal_reading"] if lead else "",
            profiles=tuple(payload["profiles"]),
            projects=tuple(s["name"] for s in projects),
        )

    def finding_groups(self) -> List[FindingGroup]:
        """Findings worst first; many of one code become one group that counts them."""
        groups: Dict[Tuple[int, str, str], List[Mapping[str, Any]]] = {}
        for finding in self.report["findings"]:
            key = (SEVERITY_ORDER[finding["severity"]], finding["severity"], finding["code"])
            groups.setdefault(key, []).append(finding)
        return [self._group(severity, code, groups[rank, severity, code]) for rank, severity, code in sorted(groups)]

    def _group(self, severity: str, code: str, found: Sequence[Mapping[str, Any]]) -> FindingGroup:
        about: Dict[str, List[str]] = {}
        for finding in found:
            named = about.setdefault(finding["message"], [])
            named.extend(p for subject in finding["subjects"] for p in self.owners.get(subject, ()))
        lines = tuple(FindingLine(message, tuple(dict.fromkeys(p))) for message, p in about.items())
        return FindingGroup(
            code=code,
            severity=severity,
            lines=lines,
            payloads=() if any(not i.payloads for i in lines) else _unique(p for i in lines for p in i.payloads),
            count=len(found),
            subjects=_unique(s for f in found for s in f["subjects"]),
            remedies=_unique(f["remedy"] for f in found),
            odm_messages=_unique(f["odm_message"] for f in found),
        )


def _unique(values: Iterable[Optional[str]]) -> Tuple[str, ...]:
    return tuple(dict.fromkeys(v for v in values if v))
