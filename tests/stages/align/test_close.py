"""What passes close to a limit, through the true solver: decided by the reference settings, and the same again."""

from __future__ import annotations

import pytest
from sensorgate.stages.document import requests_for
from sensorgate.stages.read import scan
from sensorgate.stages.route import prove
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import build
from sensorgate.stages.thresholds import DEFAULTS

from tests import simulator

pytest.importorskip("cv2")
pytest.importorskip("pycolmap")

# All of its eight frames are placed: 1 is within a tenth of this share.
NEAR = DEFAULTS.replaced({"min_registered_share": 0.95})


def test_it_is_decided_by_the_reference_and_stays_decided(tmp_path):
    simulator.render("tiny", tmp_path / "survey")
    survey = build(scan([str(tmp_path / "survey/images")]), load_sheet(), NEAR)
    (asked,) = requests_for(survey)
    proof = prove(asked, tmp_path / "work", thresholds=NEAR)
    quick, reference = proof.attempts
    assert (quick.rung, reference.rung) == ("quick", "reference")
    assert quick.payloads[0].close and quick.payloads[0].reasons[0].endswith("(close)")
    (group,) = proof.groups
    assert group.route == "proceed" and group.alignment == reference
    assert quick.verdict == reference.verdict == "pass" and reference.registered == 8
    # Another extractor and another adjustment give the same block.
    assert reference.height_m == pytest.approx(quick.height_m, rel=0.05)
    assert reference.median_inliers > quick.median_inliers
