"""What a project is built on where the alignment contradicts itself."""

from __future__ import annotations

from dataclasses import replace

from sensorgate.plugin.placing import believed
from sensorgate.stages.align.model import LockDecision
from sensorgate.stages.intrinsics import Intrinsics
from sensorgate.stages.profile import CameraProfile
from sensorgate.stages.proven import UNPROVEN, ProvenGroup

from tests.plugin.test_advice import REPORT

NONE = (0.0, 0.0, 0.0, 0.0, 0.0)
SOLVED = LockDecision("cam", False, 0.84, (0.0, 0.0), NONE, "solved", "every candidate is ruled out")
KNOWN = Intrinsics(focal_ratio=0.7793, focal_source="xmp-camera", distortion=NONE)


def camera(intrinsics: Intrinsics) -> CameraProfile:
    words = ("rgb", "", "Parrot", "Sequoia", "", "", "")
    return CameraProfile("cam", "family", *words, 4608, 3456, ("a.jpg",), intrinsics)


def group(verdict: str, decision: LockDecision = SOLVED) -> ProvenGroup:
    return ProvenGroup("rgb", ("a",), ("a.jpg",), UNPROVEN, (), replace(REPORT, verdict=verdict), (decision,))


def test_what_a_contradicted_alignment_solved_shows_nothing_of_the_lens() -> None:
    assert believed(group("fail"), [camera(KNOWN)]) == ()
    assert believed(group("pass"), [camera(KNOWN)]) == (SOLVED,)
    assert believed(group("unproven"), [camera(KNOWN)]) == (SOLVED,)


def test_without_any_source_the_solved_focal_is_better_than_none() -> None:
    assert believed(group("fail"), [camera(Intrinsics())]) == (SOLVED,)


def test_a_calibration_that_was_held_stays() -> None:
    held = replace(SOLVED, hold=True, source="focal from sheet")
    assert believed(group("fail", held), [camera(KNOWN)]) == (held,)
