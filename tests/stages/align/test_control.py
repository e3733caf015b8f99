from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sensorgate.stages.align.control import (
    Controlled,
    holds_of,
    lay_by_control,
    lays_of,
    of_payload,
    residuals,
)
from sensorgate.stages.align.judge import judge
from sensorgate.stages.align.measure import measure
from sensorgate.stages.align.model import GcpMark
from sensorgate.stages.align.models import camera_model, read_model
from sensorgate.stages.align.run import Aligned, assemble_report
from sensorgate.stages.align.sights import intersect, rays
from sensorgate.stages.align.solution import CameraSetting
from sensorgate.stages.align.textmodel import project
from sensorgate.stages.align.tie import joined_by_control, tie_by_control
from sensorgate.stages.align.world import ground_of
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import frames, geographic, grid, job_for, neighbours, request, solution

SPOTS = np.array([[0.0, 0.0, 0.0], [25.0, 10.0, 1.0], [-25.0, 12.0, 0.0], [20.0, -14.0, 2.0], [-18.0, -15.0, 0.5]])


WIDE = np.array([[0.0, 0.0, 0.0], [38.0, 20.0, 1.0], [-38.0, 18.0, 0.0], [36.0, -22.0, 2.0], [-35.0, -20.0, 0.5]])


def _marks(group, places, spots=SPOTS, noise_px=0.0):
    """Marks of spots in nadir frames of focal 0.6 * 4000 px, by the pinhole alone."""
    gen, found = np.random.default_rng(0), []
    for name, spot, position in zip("pqrst", spots, geographic(spots)):
        for frame, place in zip(group, places):
            local = spot - place
            u, v = local[0] / -local[2], -local[1] / -local[2]
            x, y = 1999.5 + 2400 * u, 1499.5 + 2400 * v
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
    return SimpleNamespace(request=asked, job=job_for(asked), solution=solved, ground=_ground(asked))


def _ground(asked):
    return ground_of(asked.frames, asked.cameras, 1200, DEFAULTS, asked.gcps)


def _block(positions=True, spots=WIDE, noise_px=0.0, warp=lambda places: places):
    """One payload of 18 frames with marks; ``warp`` bends the solved centres."""
    places = grid()
    group = frames(places)
    marks = _marks(group, places, spots, noise_px)
    if not positions:
        group = [replace(f, position=None, height_m=None) for f in group]
    asked = replace(request(group), gcps=marks)
    solved = solution(asked, warp(places), pairs=neighbours(18))
    return SimpleNamespace(request=asked, job=job_for(asked), solution=solved, ground=_ground(asked))


def _lay(scene, model=0):
    return lay_by_control(scene.request, scene.job, scene.solution, scene.ground, model, DEFAULTS)


def _verdict(scene):
    lays = lays_of(scene.request, scene.job, scene.solution, scene.ground, DEFAULTS)
    fit = of_payload(scene.request, scene.job, scene.solution, scene.ground, lays, "a", DEFAULTS)
    control = Controlled({m: lay.similarity for m, lay in lays.items() if lay.holds}, fit, {"a": fit})
    areas = [0] * len(scene.request.frames)
    return judge(measure(scene.request.frames, scene.solution, scene.ground, areas, DEFAULTS, control), DEFAULTS)[0]


def test_marks_intersect_at_their_points():
    scene = _apart()
    found = intersect(scene.request, scene.job, scene.solution, scene.request.gcps, 0)
    assert len(found) == 5 and all(count >= 2 for _, count in found.values())
    lay = _lay(scene)
    assert lay.similarity is not None and lay.fit.points == 5 and lay.fit.horizontal_m < 1e-3
    assert lay.similarity.scale == pytest.approx(1 / 0.07, rel=1e-6)


def test_a_block_without_gps_is_proven_by_its_ground_control():
    scene = _block(positions=False, noise_px=1.0)
    found = _verdict(scene)
    assert found.verdict == "pass" and any("control points fit" in r for r in found.reasons)
    assert found.height_m == pytest.approx(60.0, abs=0.5)
    assert found.control is not None and found.control.points == 5


def test_without_gps_few_points_prove_nothing_but_may_be_held():
    scene = _block(positions=False)
    scene.request = replace(scene.request, gcps=tuple(m for m in scene.request.gcps if m.point in "qrs"))
    lay = _lay(scene)
    assert lay.fit.verdict == "unproven" and lay.holds
    assert _verdict(scene).verdict == "unproven"


def test_without_gps_a_model_that_control_contradicts_fails():
    def stretched(places):
        return places * np.array([1.12, 1.0, 1.0])

    scene = _block(positions=False, warp=stretched)
    assert _lay(scene).fit.verdict == "fail"
    assert _verdict(scene).verdict == "fail"


def test_points_in_one_corner_are_not_held():
    spots = np.array([[0.0, 0.0, 0.0], [6.0, 2.0, 1.0], [-5.0, 4.0, 0.0], [4.0, -6.0, 2.0], [-5.0, -5.0, 0.5]])
    lay = _lay(_block(spots=spots))
    assert not lay.holds and "span" in lay.fit.text


def test_one_wrong_point_is_named_and_left_out():
    scene = _block()
    wrong = {m.point: geographic(np.array([[38.0, 20.0, 9.0]]))[0] for m in scene.request.gcps if m.point == "q"}
    scene.request = replace(
        scene.request,
        gcps=tuple(
            replace(m, name=f"P-{m.point}", altitude_m=wrong.get(m.point, (0, 0, m.altitude_m))[2])
            for m in scene.request.gcps
        ),
    )
    scene.ground = _ground(scene.request)
    lay = _lay(scene)
    assert lay.fit.outliers == ("P-q",) and lay.fit.horizontal_m < 0.01


def test_coordinates_in_another_unit_are_contradicted_by_gps():
    scene = _block()
    centre = WIDE.mean(axis=0)
    feet = dict(zip("pqrst", geographic((WIDE - centre) * 1.6 + centre)))
    scene.request = replace(
        scene.request,
        gcps=tuple(
            replace(m, latitude=feet[m.point][0], longitude=feet[m.point][1], altitude_m=feet[m.point][2])
            for m in scene.request.gcps
        ),
    )
    scene.ground = _ground(scene.request)
    lay = _lay(scene)
    assert lay.fit.verdict == "fail" and not lay.holds and "GPS contradicts" in lay.fit.text
    assert _verdict(scene).verdict == "pass"


def test_another_datum_is_an_offset_and_no_contradiction():
    scene = _block()
    scene.request = replace(
        scene.request, gcps=tuple(replace(m, altitude_m=m.altitude_m - 31.0) for m in scene.request.gcps)
    )
    scene.ground = _ground(scene.request)
    lays = lays_of(scene.request, scene.job, scene.solution, scene.ground, DEFAULTS)
    assert lays[0].holds
    control = Controlled({0: lays[0].similarity}, lays[0].fit, {"a": lays[0].fit})
    areas = [0] * 18
    measured = measure(scene.request.frames, scene.solution, scene.ground, areas, DEFAULTS, control)
    assert measured.control.gps_offset_m == pytest.approx((0.0, 0.0, 31.0), abs=0.01)
    assert judge(measured, DEFAULTS)[0].verdict == "pass"


def test_check_points_move_nothing_and_are_measured():
    scene = _block()
    scene.request = replace(
        scene.request,
        gcps=tuple(
            replace(m, check=m.point == "p", altitude_m=m.altitude_m + (0.4 if m.point == "p" else 0.0))
            for m in scene.request.gcps
        ),
    )
    scene.ground = _ground(scene.request)
    lay = _lay(scene)
    assert lay.fit.points == 4
    held = holds_of(scene.request, scene.job, scene.solution, scene.ground, {0: replace(lay, holds=True)})
    assert len(held[0].points) == 4
    told = residuals(scene.request, scene.job, scene.solution, scene.ground, lay, lay.similarity)
    assert told.check_points == 1 and told.check_vertical_m == pytest.approx(0.4, abs=0.01)
    assert [r.point for r in told.points_m if r.check] == ["p"]


def test_control_ties_what_matches_cannot():
    tie = tie_by_control(_apart(noise_px=2.0), "b", DEFAULTS)
    assert tie.holds and "5 ground control points" in tie.text


def test_what_control_ties_is_one_model_and_its_report_agrees():
    scene = _apart()
    asked, solved, ground = scene.request, scene.solution, scene.ground
    pairs = np.asarray(neighbours(18) + neighbours(12, start=18), dtype=np.int64)
    solved = replace(solved, pairs=pairs, point_xyz=np.zeros((0, 3)), point_model=np.zeros(0, dtype=np.int64))
    areas = (0,) * 30
    control = Controlled({}, None, {})
    measured = measure(asked.frames, solved, ground, areas, DEFAULTS, control)
    report = assemble_report(asked, "pairwise", "pycolmap", scene.job, solved, measured, ground, (), DEFAULTS)
    assert {p.payload: p.verdict for p in report.payloads}["b"] == "fail"
    plan = SimpleNamespace(areas=areas)
    aligned = Aligned(report, asked, scene.job, solved, measured, plan, ground, control)
    joined = joined_by_control(aligned, "b", DEFAULTS)
    assert joined.report.components == 1
    assert {p.payload: p.verdict for p in joined.report.payloads} == {"a": "pass", "b": "pass"}


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
    # One whose focals across and down differ.
    camera = replace(camera, aspect_ratio=0.9981)
    name, values = camera_model(camera)
    assert name == ("FULL_OPENCV" if any(bend) else "PINHOLE") and values[1] / values[0] == pytest.approx(0.9981)
    assert np.allclose(rays(camera, project(name, tuple(values), local)), local, atol=1e-7)
    back = read_model(camera, name, values)
    assert (back.focal_ratio, back.aspect_ratio) == pytest.approx((0.8, 0.9981), abs=1e-12)
    # With one focal alone what is solved is what comes back.
    name, values = camera_model(replace(camera, solve_distortion=True))
    assert name == "RADIAL" and read_model(camera, name, values).aspect_ratio == 1.0


def test_what_may_move_decides_the_model():
    free = CameraSetting("p", 1200, 900, 0.8)
    assert camera_model(free)[0] == "RADIAL"
    tilted = replace(free, solve_center=True, center_ratio=(0.01, -0.02), distortion=(-0.1, 0.02, 0.001, -0.002, 0.0))
    name, values = camera_model(tilted)
    assert name == "OPENCV"
    back = read_model(replace(free, solve_center=True), name, values)
    assert np.allclose((*back.center_ratio, *back.distortion), (*tilted.center_ratio, *tilted.distortion), atol=1e-12)
    local = np.random.default_rng(1).uniform([-0.5, -0.4, 1.0], [0.5, 0.4, 1.0], (50, 3))
    assert np.allclose(rays(back, project(name, tuple(values), local)), local, atol=1e-7)
    assert camera_model(replace(free, solve_distortion=False))[0] == "SIMPLE_PINHOLE"
    bent = replace(free, solve_distortion=False, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    assert camera_model(bent)[0] == "FULL_OPENCV"


def _mistaken(scene, changes):
    """The scene with some marks moved onto the pixel of another point's mark in the same frame."""
    at = {(m.point, m.path): m for m in scene.request.gcps}
    marks = []
    for mark in scene.request.gcps:
        other = at.get((changes.get((mark.point, mark.path), ""), mark.path))
        marks.append(mark if other is None else replace(mark, x_px=other.x_px + 1.0, y_px=other.y_px))
    scene.request = replace(scene.request, gcps=tuple(marks))
    return scene


def _shared(scene, point, other):
    """Frames on which both are marked."""
    seen = {n: {m.path for m in scene.request.gcps if m.point == n} for n in (point, other)}
    return sorted(seen[point] & seen[other])


@pytest.mark.parametrize(("point", "other"), [("p", "q"), ("q", "p"), ("r", "p")])
def test_a_mark_on_another_target_is_found_and_spoils_nothing(point, other):
    scene = _block(noise_px=0.5)
    path = _shared(scene, point, other)[0]
    clean = _lay(scene).fit
    lay = _lay(_mistaken(scene, {(point, path): other}))
    assert lay.astray == ((point, path),) == lay.fit.astray
    assert lay.fit.verdict == clean.verdict == "pass" and lay.fit.outliers == ()
    assert lay.fit.horizontal_m == pytest.approx(clean.horizontal_m, abs=0.05)
    (hold,) = holds_of(scene.request, scene.job, scene.solution, scene.ground, {0: lay})
    rows = {r for p in hold.points for r, _, _ in p.marks if np.allclose(p.place, scene.ground.control[point])}
    assert scene.request.frames[[f.path for f in scene.request.frames].index(path)].path == path
    assert [f.path for f in scene.request.frames].index(path) not in rows and len(rows) >= 2


def test_right_marks_are_none_of_them_astray():
    for noise_px in (0.0, 0.5, 2.0):
        assert _lay(_block(noise_px=noise_px)).astray == ()


def test_where_many_marks_miss_the_model_is_wrong_and_not_the_marks():
    aside = np.array([[15.0 * (i % 2), 0.0, 0.0] for i in range(18)])
    assert _lay(_block(warp=lambda places: places + aside)).astray == ()
