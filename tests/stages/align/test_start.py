"""A model that is extended has its cameras as the job does."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.stages.align.engine_pycolmap import _start
from sensorgate.stages.align.models import camera_model
from sensorgate.stages.align.prepare import engine_settings
from sensorgate.stages.align.pycolmap_model import camera_of
from sensorgate.stages.align.solution import CameraSetting, Job, JobFrame
from sensorgate.stages.thresholds import DEFAULTS

pycolmap = pytest.importorskip("pycolmap")

BENT = CameraSetting("a", 1000, 750, 0.7, (0.002, -0.001), (-0.02, 0.01, 0.001, 0.0, 0.0))


@pytest.mark.parametrize("center", [False, True])
def test_a_solved_camera_is_held_in_the_model_that_is_extended(tmp_path, center):
    solved = replace(BENT, solve_center=center)
    held = replace(solved, solve_focal=False, solve_distortion=False)
    assert camera_model(solved)[0] != camera_model(held)[0]
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera_of(pycolmap, 1, solved))
    stored = tmp_path / "models" / "000"
    stored.mkdir(parents=True)
    model.write(str(stored))
    settings = engine_settings("pairwise", 1600, 1, DEFAULTS)
    job = Job((JobFrame("a", "a", 0, "a"),), (held,), (), settings, start=str(stored.parent))
    written = pycolmap.Reconstruction(str(_start(pycolmap, job, tmp_path / "start")))
    name, values = camera_model(held)
    assert written.cameras[1].model.name == name
    assert list(written.cameras[1].params) == pytest.approx(values)
