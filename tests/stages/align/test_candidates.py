from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.stages.align.candidates import loosened
from sensorgate.stages.align.solution import CameraSetting
from sensorgate.stages.align.trials import Trial

STANDING = CameraSetting("a", 1000, 750, 0.7, (0.0, 0.0), (0.0,) * 5, solve_focal=False, solve_distortion=False)
OTHERS = (replace(STANDING, profile="b"), replace(STANDING, profile="c"), replace(STANDING, profile="d"))
WHOLE = Trial("focal solved, distortion solved", "solved", "solved", None, None)


def _moving(cameras):
    return {c.profile for c in cameras if c.solve_focal and c.solve_distortion and c.solve_center}


def test_under_control_a_solved_camera_takes_its_centre_and_what_else_is_solved_along():
    variant = (replace(STANDING, solve_focal=True, solve_distortion=True), *OTHERS)
    # b was solved whole, c stands at a known focal, d was not tried yet.
    found = loosened(variant, WHOLE, "a", {"b": (True, True, False), "c": (False, True, False)})
    assert _moving(found) == {"a", "b", "d"}
    assert found[2] == variant[2]


@pytest.mark.parametrize(("focal", "distortion"), [(0.7, None), (None, (0.0,) * 5), (0.7, (0.0,) * 5)])
def test_a_trial_that_holds_something_leaves_the_others_standing(focal, distortion):
    variant = (replace(STANDING, solve_focal=focal is None, solve_distortion=distortion is None), *OTHERS)
    assert loosened(variant, replace(WHOLE, focal=focal, distortion=distortion), "a", {}) == variant
