"""The terminal's lines: short, within the width, harmless."""

from __future__ import annotations

import re
from typing import Any, Dict

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.plugin.report.terminal import columns_of, lines

from tests.plugin.report.sample import empty, sample

ANSI = re.compile(r"\x1b\[[0-9;]*m")
SURVEY = sample(20)


@pytest.mark.parametrize("width", [40, 60, 80, 100, 160])
def test_fits_the_width(width: int) -> None:
    for colour in (False, True):
        told = lines(SURVEY, width=width, colour=colour)
        assert max(columns_of(ANSI.sub("", line)) for line in told) <= width


def test_tells_the_story() -> None:
    told = lines(sample(), out="out dir")
    text = "\n".join(told)
    assert len(told) <= 35
    for name in ("phantom-4-pro", "mavic-2-pro", "rededge", "xt2-thermal", "projects/rgb-phantom-3", "unproven"):
        assert name in text
    assert "8.80 sheet" in text and "3.25>2.12" in text
    said = " ".join(line.strip() for line in told[-3:])
    assert "Next: sensorgate submit 'out dir' --node URL" in said and "'out dir/projects/" in said
    assert text.index("mixed-spectra") < text.index("focal-variance") < text.index("not-temperature")


def test_colour_adds_nothing_but_colour() -> None:
    assert [ANSI.sub("", line) for line in lines(SURVEY, colour=True)] == lines(SURVEY)


def test_is_pure() -> None:
    report = sample(20)
    lines(report)
    assert report == SURVEY


def test_caps_findings_and_counts_the_rest() -> None:
    report = sample(20)
    one = report["findings"][0]
    report["findings"] = [{**one, "code": f"code-{i}"} for i in range(30)]
    text = "\n".join(lines(report))
    assert "and 22 more kinds in the report" in text and "code-15" in text and "code-16" not in text


def test_no_frames() -> None:
    assert lines(empty())[0].startswith("Blocked")
    assert "Next:" not in "\n".join(lines(empty()))


def test_a_gate_names_run_next() -> None:
    report = sample(20)
    report["subprojects"] = []
    for frame in report["frames"]:
        frame.update(output=None, subproject=None)
    told = lines(report)
    assert told[-1] == "Next: sensorgate run survey --out DIR"
    assert not any("route" in line for line in told)


def hostile(report: Dict[str, Any], text: str) -> Dict[str, Any]:
    for frame in report["frames"]:
        frame["make"] = text
    for profile in report["profiles"]:
        profile.update(make=text, model=text)
    for finding in report["findings"]:
        finding["message"] = text or "x"
    report["subprojects"][3]["reasons"] = [text]
    return report


@settings(max_examples=25, deadline=None)
@given(text=st.text(max_size=80), width=st.integers(40, 120))
def test_whatever_a_camera_writes_stays_text(text: str, width: int) -> None:
    for line in lines(hostile(sample(8), text), width=width):
        assert columns_of(line) <= width
        assert line.isprintable()
        line.encode("utf-8")


@pytest.mark.parametrize("width", [40, 100])
def test_a_gate_tells_what_resampling_brings_within_the_width(width: int) -> None:
    report = sample()
    report["subprojects"] = []
    for frame in report["frames"]:
        frame.update(subproject=None, output=None, change=None, gsd_after_cm=None)
    side = {"scale": 1.0, "width": 4000, "height": 3000, "inliers": 0.5, "megapixels": 240.0, "size_bytes": 10**8}
    side.update(odm_inliers=1.0, odm_feature_px=2736, odm_undistorted_px=5472)
    for number, action in enumerate(report["actions"][:6]):
        ratio = 2.0 + number / 10
        action["gain"] = {"ratio": ratio, "trigger": 0.05, "chosen": True, "native": side, "resampled": side}
    told = lines(report, width=width)
    assert max(columns_of(line) for line in told) <= width
    text = " ".join(" ".join(told).split())
    assert "Resampling" in told and "expected matches 50 %" in text
    shown = min(4, len(report["actions"]))
    assert text.count("coarser than the finest") == shown
    assert "Resampling" not in lines(sample(), width=width)
