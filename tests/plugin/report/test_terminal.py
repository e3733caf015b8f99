"""The terminal's lines: short, within the width, harmless."""

from __future__ import annotations

import re
from typing import Any, Dict

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.plugin.cli.common import screen
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
    for name in ("phantom-4-pro", "mavic-2-pro", "rededge", "xt2-thermal", "projects/rgb-phantom-3", "unproven"):
        assert name in text
    assert "8.80 sheet" in text and "3.25>2.12" in text
    said = " ".join(line.strip() for line in told[-3:])
    assert "Next: sensorgate submit 'out dir' --node URL" in said and "'out dir/projects/" in said
    assert text.index("mixed-spectra") < text.index("truncated-file") < text.index("focal-variance")


def test_what_is_unproven_is_sent_only_when_asked_for() -> None:
    report = sample()
    assert "--include-unproven" not in "\n".join(lines(report))
    for project in report["subprojects"]:
        project["route"] = "unproven"
    assert "--node URL --include-unproven" in "\n".join(lines(report))


def crowded(per_flight: int = 8) -> Dict[str, Any]:
    """More of everything than 25 lines hold."""
    report = sample(per_flight)
    finding, project, payload = report["findings"][0], report["subprojects"][0], report["payloads"][0]
    report["findings"] += [{**finding, "code": f"code-{i}", "message": "word " * 60} for i in range(30)]
    report["subprojects"] += [{**project, "name": f"more-{i}"} for i in range(12)]
    report["payloads"] += [{**payload, "id": f"more-{i}"} for i in range(20)]
    return report


@pytest.mark.parametrize("width", [80, 100])
def test_the_story_has_25_lines(width: int) -> None:
    for report in (sample(), crowded(), empty()):
        # run prints an empty line and the report's file below it.
        assert len(lines(report, width=width)) + 2 <= 25
    told = "\n".join(lines(crowded(), width=width))
    for counted in ("more payloads in the report", "more kinds in the report", "more projects in the report"):
        assert counted in told


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
    told = lines(report)
    shown = [line for line in told if line.startswith("error")]
    assert len(shown) >= 3
    assert f"and {30 - len(shown)} more kinds in the report" in "\n".join(told)


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
    assert "Resampling" in told and "Resampling" not in lines(sample(), width=width)
    at = told.index("Resampling")
    assert "coarser" in told[at + 1] or "flights in the report" in told[at + 1]
    if width == 100:
        assert told[at + 1].startswith("  ") and "2.50 × coarser" in told[at + 1]  # the coarsest comes first


def test_colour_and_width_follow_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "72")
    monkeypatch.setattr("sys.stdout.isatty", lambda: False, raising=False)
    assert screen() == {"width": 100, "colour": False}
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    assert screen() == {"width": 72, "colour": True}
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("NO_COLOR", "1")
    assert screen() == {"width": 100, "colour": False}
