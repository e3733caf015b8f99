from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sensorgate.stages.align.control import intersect, lay_by_control, rays, tie_by_control
from sensorgate.stages.align.model import GcpMark
from sensorgate.stages.align.models import camera_model, read_model
from sensorgate.stages.align.solution import CameraSetting
from sensorgate.stages.align.textmodel import project
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import frames, geographic, grid, job_for, request, solution

SPOTS = np.array([[0.0, 0.0, 0.0], [25.0, 10.0, 1.0], [-25.0, 12.0, 0.0], [20.0, -14.0, 2.0], [-18.0, -15.0, 0.5]])


def _marks(group, places, spots=SPOTS, noise_px=0.0):
    """Marks of spots in nadir frames of focal 0.6 * 4000 px, by the pinhole alone."""
    gen, found = np.random.default_rng(0), []
    for name, spot, position in zip("pqrst", spots, geographic(spots)):
        for frame, place in zip(group, places):
            local = spot - place
            u, v = local[0] / -local[2], -local[1] / -local[2]
            x, y = 2000 + 2400 * u, 1500 + 2400 * v
            if 0 < x < 4000 and 0 < y < 3000:
                x, y = np.array([x, y]) + gen.normal(0, noise_px, 2)
                found.append(GcpMark(name, frame.path, float(x), float(y), *position))
    return tuple(found)


def _apart(spots_b=SPOTS, noise_px=0.0, shift=(0.0, 0.0, 0.0)):
    """Two payloads in two models; marks in both."""
    a, b = grid(), grid(2, 6, 70.0)
    fa, fb = frames(a, "a"), frames(b, "b", 9000.0)
    asked = request(fa, fb)
    marks = _marks(fa, a, noise_px=noise_px) + _marks(fb, b, spots_b, noise_px)
    asked = replace(asked, gcps=marks)
    solved = solution(asked, np.concatenate([a, b + np.asarray(shift)]), model=[0] * 18 + [1] * 12)
    return SimpleNamespace(request=asked, job=job_for(asked), solution=solved)


def test_marks_intersect_at_their_points():
    scene = _apart()
    found = intersect(scene.request, scene.job, scene.solution, scene.request.gcps, 0)
    assert len(found) == 5 and all(count >= 2 for _, count in found.values())
    fit, count, miss = lay_by_control(scene.request, scene.job, scene.solution, scene.request.gcps, 0, DEFAULTS)
    assert fit is not None and count == 5 and miss < 1e-3
    assert fit.scale == pytest.approx(1 / 0.07, rel=1e-6)


def test_control_ties_what_matches_cannot():
    tie = tie_by_control(_apart(noise_px=2.0), "b", DEFAULTS)
    assert tie.holds and "5 ground control points" in tie.text


def test_wrong_marks_do_not_tie():
    wrong = SPOTS + np.array([[9.0, 0, 0], [0, -8.0, 0], [0, 0, 6.0], [-7.0, 0, 0], [0, 9.0, 0]])
    scene = _apart()
    b = [f for f in scene.request.frames if f.payload == "b"]
    moved = _marks(b, grid(2, 6, 70.0), wrong)
    truth = {m.point: m for m in scene.request.gcps}
    moved = tuple(
        replace(m, latitude=truth[m.point].latitude, longitude=truth[m.point].longitude, altitude_m=0.0) for m in moved
    )
    kept = tuple(m for m in scene.request.gcps if m.path.startswith("a/"))
    scene.request = replace(scene.request, gcps=kept + moved)
    assert not tie_by_control(scene, "b", DEFAULTS).holds


def test_it_says_what_is_missing():
    scene = _apart()
    scene.request = replace(scene.request, gcps=())
    assert "no ground control" in tie_by_control(scene, "b", DEFAULTS).text
    scene = _apart()
    scene.request = replace(scene.request, gcps=tuple(m for m in scene.request.gcps if m.point in "pq"))
    assert "2 control points" in tie_by_control(scene, "b", DEFAULTS).text


@pytest.mark.parametrize("bend", [(0.0,) * 5, (-0.1, 0.02, 0.001, -0.002, 0.01)])
def test_rays_undo_the_projection(bend):
    camera = CameraSetting("p", 1200, 900, 0.8, (0.01, -0.02), bend, solve_focal=False, solve_distortion=False)
    local = np.random.default_rng(1).uniform([-0.5, -0.4, 1.0], [0.5, 0.4, 1.0], (50, 3))
    name, values = camera_model(camera)
    seen = project(name, tuple(values), local)
    assert np.allclose(rays(camera, seen), local, atol=1e-7)
    assert read_model(camera, name, values) == camera


def test_what_may_move_decides_the_model():
    free = CameraSetting("p", 1200, 900, 0.8)
    assert camera_model(free)[0] == "RADIAL"
    assert camera_model(replace(free, solve_distortion=False))[0] == "SIMPLE_PINHOLE"
    bent = replace(free, solve_distortion=False, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    assert camera_model(bent)[0] == "FULL_OPENCV"
