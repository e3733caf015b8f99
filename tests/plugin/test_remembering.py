"""What runs leave in the calibration store and take from it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.plugin.remembering import learned
from sensorgate.stages.align.model import (
    AlignmentReport,
    Bowing,
    GpsFit,
    LockDecision,
    SolvedCamera,
)
from sensorgate.stages.calibrations import key_of, read_store
from sensorgate.stages.errors import UsageError
from sensorgate.stages.intrinsics import STORED
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import strip, survey_of

SURVEY = survey_of(strip(count=30, serial="A1"))
(PROFILE,) = SURVEY.profiles
BEND = (0.01, -0.02, 0.0, 0.0, 0.0)


def report(focal=0.668, sigma=0.0002, supported=True, verdict="pass"):
    camera = SolvedCamera(PROFILE.id, focal, (0.0, 0.0), BEND, False, 30, 0.4, sigma)
    decision = LockDecision(PROFILE.id, False, focal, (0.0, 0.0), BEND, "focal solved", "", supported)
    return AlignmentReport(
        "rgb", "pycolmap", "quick", (), 30, 1, 0.4, None, GpsFit(30), 60.0, Bowing(), (), (camera,), (), (), 0, None,
        verdict=verdict, decisions=(decision,),
    )  # fmt: skip


def learn(folder, found, survey):
    memory = learned(str(folder), [found], SURVEY.profiles, survey, DEFAULTS)
    memory.write()
    return [f.code for f in memory.findings]


def test_only_a_proven_focal_that_the_geometry_fixed_is_kept(tmp_path):
    for weak in (report(supported=False), report(verdict="fail"), report(sigma=0.01), report(sigma=None)):
        assert learn(tmp_path, weak, "s") == [] and read_store(tmp_path) == {}
    assert learn(tmp_path, report(), "s") == []
    assert read_store(tmp_path)[key_of(PROFILE)].best.focal_ratio == 0.668


def test_a_contradiction_is_said_and_three_replace(tmp_path):
    learn(tmp_path, report(), "good")
    assert [learn(tmp_path, report(0.70), name) for name in ("a", "b", "c")] == [
        ["calibration-differs"],
        ["calibration-differs"],
        ["calibration-replaced"],
    ]
    assert read_store(tmp_path)[key_of(PROFILE)].best.focal_ratio == 0.70


def test_the_next_survey_starts_from_what_was_proven(tmp_path):
    learn(tmp_path, report(PROFILE.intrinsics.focal_ratio * 1.01), "first")
    again = survey_of(strip(count=8, serial="A1"), stored=read_store(tmp_path))
    assert again.profiles[0].intrinsics.focal_source == STORED
    assert {f.intrinsics.focal_source for f in again.frames} == {STORED}
    assert again.frames[0].gsd_cm == pytest.approx(SURVEY.frames[0].gsd_cm / 1.01, rel=1e-6)
    other = survey_of(strip(count=8, serial="B2"), stored=read_store(tmp_path))
    assert other.profiles[0].intrinsics.focal_source != STORED


def test_a_store_that_cannot_be_written_is_a_sentence(tmp_path):
    file = tmp_path / "file"
    file.write_text("no folder")
    memory = replace(learned(str(tmp_path / "new"), [report()], SURVEY.profiles, "s", DEFAULTS), folder=str(file))
    with pytest.raises(UsageError, match="The projects are written"):
        memory.write()


def test_without_a_store_nothing_is_remembered():
    assert learned(None, [report()], SURVEY.profiles, "s", DEFAULTS).entries == ()
