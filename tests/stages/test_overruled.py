from __future__ import annotations

import pytest
from sensorgate.stages.align.model import LockDecision
from sensorgate.stages.finding import WARNING, Finding
from sensorgate.stages.intrinsics import Intrinsics
from sensorgate.stages.overruled import overruled, still_true
from sensorgate.stages.profile import CameraProfile
from sensorgate.stages.thresholds import DEFAULTS


def _said(chosen, given=0.7, source="user-sheet", size=(4000, 3000)):
    width, height = size
    profile = CameraProfile(
        "p", "p", "rgb", "RGB", "DJI", "FC6310", "", "", "", width, height, (),
        Intrinsics(focal_ratio=given, focal_source=source),
    )  # fmt: skip
    decision = LockDecision("p", False, chosen, (0.0, 0.0), (0.0,) * 5, "focal solved", "the geometry fixes the focal")
    return overruled([decision], [profile], DEFAULTS)


@pytest.mark.parametrize(("chosen", "told"), [(0.7, False), (0.681, False), (0.679, True), (0.722, True)])
def test_a_sheet_beyond_three_percent_is_named(chosen, told):
    found = _said(chosen)
    assert bool(found) is told
    if told:
        (finding,) = found
        assert (finding.code, finding.severity, finding.subjects) == ("sheet-contradicted", WARNING, ("p",))
        assert f"{0.7 / chosen - 1.0:+.1%}" in finding.message and "calibration file" in finding.message


def test_a_guess_is_not_contradicted_and_a_portrait_frame_is_measured_by_its_longer_side():
    assert _said(0.6, source="equivalent-35mm") == ()
    assert _said(0.6, given=0.8, size=(3000, 4000)) == ()


def test_nothing_is_said_on_the_strength_of_a_refuted_sheet():
    refuted = _said(0.66)
    off = Finding("odm-focal-off", WARNING, ("a.jpg",), "Better known from user-sheet.", "")
    other = Finding("odm-focal-off", WARNING, ("b.jpg",), "Better known from sheet.", "")
    profile_of = {"a.jpg": "p", "b.jpg": "q"}
    assert still_true([off, other], refuted, profile_of) == [other]
    assert still_true([off, other], (), profile_of) == [off, other]
