"""Rules about damaged files: what one camera always writes is no damage."""

from __future__ import annotations

from dataclasses import replace

from sensorgate.stages.gate import assess
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import strip, survey_of

CUT = "jpeg-end-missing:the last rows are cut"


def found(frames):
    return {f.code: f.severity for f in assess(survey_of(frames), DEFAULTS).findings}


def test_a_cut_picture_among_whole_ones():
    frames = strip(count=12)
    assert found([replace(frames[3], problems=(CUT,)), *frames[:3], *frames[4:]]) == {"picture-cut-short": "error"}
    assert found([replace(f, problems=(CUT,)) for f in frames]) == {}
    assert "picture-cut-short" in found([replace(frames[3], problems=(CUT,))])
    sent = "jpeg-end-missing:not among the header bytes"
    assert found([replace(frames[3], problems=(sent,)), *frames[:3], *frames[4:]]) == {}


def test_a_damaged_header_among_whole_ones_and_a_camera_that_always_writes_so():
    frames = strip(count=12)
    note = ("xmp-malformed:duplicate attribute",)
    assert found([replace(frames[3], problems=note), *frames[:3], *frames[4:]]) == {"header-damaged": "warning"}
    assert found([replace(f, problems=note) for f in frames]) == {"header-damaged": "info"}


def test_a_makers_oddities_are_nobodys_business():
    assert found([replace(f, problems=("exif-rational-zero:DigitalZoomRatio",)) for f in strip(count=12)]) == {}
