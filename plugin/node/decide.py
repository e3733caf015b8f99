"""What a policy makes of what the gate and the alignment found. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, List, Mapping, Sequence, Tuple

from .options import AUTO, REPORT, STRICT
from .workplace import Part

AS_IS, PREPARE, REFUSE = "as-is", "prepare", "refuse"

# The best view of a survey first, where parts are equal in captures.
_SPECTRA = ("rgb", "multispectral", "thermal")
_PROVEN = ("proceed", "pairwise")
_MOST_ERRORS = 4


@dataclass(frozen=True)
class Seen:
    """What the gate saw.

    ``findings`` counts warnings and errors, ``changes`` what harmonizing
    would alter; ``errors`` are the messages of the errors, worst first.
    """

    verdict: str
    frames: int
    profiles: int
    flights: int
    groups: int
    findings: int
    changes: int
    errors: Tuple[str, ...] = ()

    @property
    def clean(self) -> bool:
        """One camera, one flight, nothing to say: ODM takes it as it is."""
        return (
            self.verdict == "consistent"
            and self.profiles == 1
            and self.flights == 1
            and not self.findings
            and not self.changes
        )


@dataclass(frozen=True)
class Decision:
    """What to do, and why in sentences for the console."""

    do: str
    reasons: Tuple[str, ...] = ()


def after_gate(policy: str, seen: Seen, *, harmonized: bool, videos: bool) -> Decision:
    """What follows from the gate. ``harmonized`` is a project that comes prepared with its calibration."""
    if policy == REPORT:
        return Decision(AS_IS, ("Policy report: nothing is changed.",))
    if seen.verdict == "blocked" and policy == STRICT and not videos:
        return Decision(REFUSE, ("None of the frames is usable for a survey.",))
    if videos:
        return Decision(AS_IS, ("There is a film among the images: ODM takes its frames by itself.",))
    if seen.verdict == "blocked":
        return Decision(AS_IS, ("No frame is usable for a survey as far as can be seen here; ODM decides.",))
    if seen.clean:
        return Decision(AS_IS, ("One camera, one flight, nothing to correct: ODM takes the images as they are.",))
    if harmonized:
        if policy == AUTO or seen.verdict == "consistent":
            return Decision(AS_IS, ("The project was prepared before it was sent: ODM takes it as it is.",))
        return Decision(REFUSE, ("The project was prepared before it was sent, and still its frames do not fit.",))
    if policy == STRICT and seen.groups > 1:
        return Decision(
            REFUSE,
            (
                f"The {seen.frames} frames are {seen.groups} separate groups that cannot share one project.",
                *seen.errors[:_MOST_ERRORS],
            ),
        )
    return Decision(PREPARE)


def ordered(parts: Sequence[Part]) -> Tuple[Part, ...]:
    """The parts with the main one first: proven before unproven, then the one with the most captures."""

    def rank(part: Part) -> Tuple[Any, ...]:
        spectrum = _SPECTRA.index(part.spectrum) if part.spectrum in _SPECTRA else len(_SPECTRA)
        return (part.route not in _PROVEN, -part.captures, spectrum, part.name)

    return tuple(sorted(parts, key=rank))


def after_alignment(policy: str, parts: Sequence[Part]) -> Decision:
    """Whether the parts may be processed under this policy."""
    if policy != STRICT:
        return Decision(PREPARE)
    bad = [p for p in parts if p.route not in _PROVEN]
    if len(parts) == 1 and not bad:
        return Decision(PREPARE)
    why: List[str] = []
    if len(parts) > 1:
        why.append(f"The frames do not belong together: they are {len(parts)} parts.")
    for part in parts:
        said = f" {part.reasons[0]}" if part.reasons else ""
        why.append(f"{part.name}: {part.frames} frames, {part.route}.{said}")
    return Decision(REFUSE, tuple(why))


def parts_from(report: Mapping[str, Any]) -> Tuple[Part, ...]:
    """The parts of a main job's report, the main one first."""
    captures = {f["path"]: (f["payload"], f["capture"] or f["path"]) for f in report["frames"]}
    parts = []
    for project in report["subprojects"]:
        seen = [captures[p] for p in project["frames"]]
        parts.append(
            Part(
                name=project["name"],
                spectrum=project["spectrum"],
                route=project["route"],
                frames=len(seen),
                captures=len(set(seen)),
                reasons=tuple(project["reasons"]),
                options=tuple({"name": o["name"], "value": o["value"]} for o in project["options"]),
            )
        )
    return ordered(parts)
