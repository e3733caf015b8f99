"""The real survey through the real solvers, at a reduced size."""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from sensorgate.stages.align import align
from sensorgate.stages.align.blocks import likeness
from sensorgate.stages.align.model import AlignmentReport
from sensorgate.stages.align.prepare import sorted_request
from sensorgate.stages.align.run import align_once
from sensorgate.stages.align.ties import ties_of
from sensorgate.stages.document import requests_for
from sensorgate.stages.read import scan
from sensorgate.stages.record import from_plain, to_plain
from sensorgate.stages.route import prove
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import build
from sensorgate.stages.thresholds import DEFAULTS

REAL = Path(__file__).resolve().parents[3].parent / "shared/data/real_frames"
SIZE = 960

pytestmark = [
    pytest.mark.skipif(not (REAL / "brighton_p3_rgb").is_dir(), reason="real frames are not here"),
]


def _requests(*folders):
    return requests_for(build(scan([str(REAL / f) for f in folders]), load_sheet(), DEFAULTS))


@pytest.fixture(scope="module")
def survey():
    pytest.importorskip("pycolmap")
    return next(r for r in _requests("brighton_p3_rgb") if r.name == "rgb")


@pytest.fixture(scope="module")
def space(tmp_path_factory):
    return tmp_path_factory.mktemp("align")


@pytest.fixture(scope="module")
def report(survey, space):
    return align(survey, space, max_dim=SIZE)


def test_the_survey_proceeds_on_its_gps(report):
    assert report.registered == 18 and report.components == 1 and report.verdict == "pass"
    assert report.gps.horizontal_m < 1.0 and report.gps.vertical_m < 1.0
    assert report.height_m == pytest.approx(40.0, rel=0.06)


def test_the_right_calibration_wins_against_the_better_reprojection(report):
    chosen = next(c for c in report.candidates if c.chosen)
    assert (chosen.focal_source, chosen.distortion_source, chosen.held) == ("sheet", "none", True)
    assert chosen.focal_ratio == pytest.approx(0.583, abs=0.005)
    assert abs(chosen.bowing.bowing_m) < 0.3
    best = min(report.candidates, key=lambda c: c.mean_reproj_error_px)
    assert best.distortion_source == "solved"
    assert abs(best.bowing.bowing_m) > 3 * best.bowing.se_m
    assert [d.hold for d in report.decisions] == [True]


def test_the_same_again_gives_the_same(report, survey, space):
    again = align(survey, space, max_dim=SIZE)
    assert again.verdict == report.verdict and again.pairs == report.pairs
    assert again.gps.horizontal_m == pytest.approx(report.gps.horizontal_m, abs=1e-3)


def test_pairs_alone_tell_of_ties_what_the_rung_tells(survey, space):
    half = replace(survey, frames=tuple(replace(f, payload="ab"[i % 2]) for i, f in enumerate(survey.frames)))
    extra = [likeness(sorted_request(half), "b", DEFAULTS)]
    whole = align_once(half, space, thresholds=DEFAULTS, max_dim=SIZE, extra=extra, lock=True).report
    alone = ties_of(half, ["b"], space, extra, rung="quick", thresholds=DEFAULTS, engine="pycolmap", max_dim=SIZE)
    (payload,) = [p for p in whole.payloads if p.payload == "b"]
    assert (alone["b"].verified, alone["b"].strong) == (payload.cross_pairs, payload.strong_cross_pairs)
    assert 0 < alone["b"].strong <= alone["b"].verified <= alone["b"].tried


def test_a_report_goes_to_json_and_back(report):
    assert from_plain(AlignmentReport, to_plain(report)) == report


def test_the_image_folder_is_left_as_it_was(survey, space, tmp_path):
    for frame in survey.frames[:7]:
        shutil.copy(frame.file, tmp_path)
    before = {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in tmp_path.iterdir()}
    (asked,) = requests_for(build(scan([str(tmp_path)]), load_sheet(), DEFAULTS))
    align(asked, space / "copy", max_dim=480, lock=True)
    assert {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in tmp_path.iterdir()} == before


def test_small_sets_are_unproven_and_named(space):
    pytest.importorskip("pycolmap")
    for asked in _requests("caliterra_canon_rgb", "garfield_sequoia_rgb_ms"):
        proof = prove(asked, space / asked.name, max_dim=SIZE)
        assert [g.route for g in proof.groups] == ["unproven"]
        assert any("fewer than 6" in r for r in proof.groups[0].reasons)


@pytest.mark.skipif(shutil.which("colmap") is None, reason="the COLMAP program is not installed")
def test_colmaps_program_says_the_same(survey, space, report):
    part = replace(survey, frames=survey.frames[:12])
    other = align(part, space / "cli", max_dim=SIZE, engine="colmap", lock=True)
    assert other.registered >= 11 and other.verdict == report.verdict
    assert other.height_m == pytest.approx(report.height_m, rel=0.05)
