"""Rules about captures: which band of which capture."""

from __future__ import annotations

from dataclasses import replace

from sensorgate.stages.gate import assess, incomplete_captures
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import survey_of
from tests.stages.test_flights import rig_flight


def found(frames, code):
    return [f for f in assess(survey_of(frames), DEFAULTS).findings if f.code == code]


def test_a_complete_rig_is_clean():
    report = assess(survey_of(rig_flight()), DEFAULTS)
    assert report.verdict == "consistent", report.findings
    assert not [f for f in report.findings if f.severity != "info"], report.findings


def test_a_lost_band_is_named_with_its_capture():
    frames = [f for f in rig_flight() if f.name != "IMG_0003_2.tif"]
    (finding,) = found(frames, "capture-incomplete")
    assert "IMG_0003_1.tif lacks red" in finding.message
    assert finding.subjects == ("in/IMG_0003_1.tif", "in/IMG_0003_3.tif")


def test_an_orphan_stands_alone():
    frames = [f for f in rig_flight() if f.name not in ("IMG_0003_1.tif", "IMG_0003_2.tif")]
    (finding,) = found(frames, "capture-incomplete")
    assert "IMG_0003_3.tif stands alone" in finding.message


def test_a_doubled_band_is_named_and_its_capture_left_out():
    frames = rig_flight()
    frames.append(replace(frames[4], path="in/IMG_0001_2 (1).tif", size_bytes=77))
    (finding,) = found(frames, "band-doubled")
    assert "red twice" in finding.message
    survey = survey_of(frames)
    assert set(finding.subjects) == set(incomplete_captures(survey, survey.payloads[0]))


def test_a_band_missing_from_most_captures_is_given_up():
    frames = [f for f in rig_flight() if not f.name.endswith("_3.tif") or f.capture_id < "c0004"]
    assert found(frames, "band-mostly-missing")
    assert not found(frames, "capture-incomplete")


def test_exchanged_ids_are_put_right_and_said():
    swap = {"in/IMG_0005_3.tif": "c0006", "in/IMG_0006_3.tif": "c0005"}
    frames = [replace(f, capture_id=swap.get(f.path, f.capture_id)) for f in rig_flight()]
    (finding,) = found(frames, "capture-misnumbered")
    assert finding.severity == "warning"
    assert finding.subjects == tuple(sorted(swap))
    assert "(nir)" in finding.message
    assert not found(frames, "capture-incomplete")
    assert not found(rig_flight(), "capture-misnumbered")
