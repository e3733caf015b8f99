"""Worlds, frames, ground control and truth, as a survey is written."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from tests.simulator import catalogue, render
from tests.simulator.camera import Camera, look, project
from tests.simulator.checks import exif_of, flown_by, strip_of
from tests.simulator.geo import utm
from tests.simulator.places import GROUND
from tests.simulator.run import render_shot, world_of

pytest.importorskip("cv2", reason="frames are rendered with OpenCV")


def digests(folder):
    files = sorted(p for p in Path(folder).rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_same_seed_same_bytes(tmp_path):
    survey = flown_by(*(catalogue.with_band_size(p, 0.25) for p in (catalogue.phantom4pro(), catalogue.micasense())))
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        render(survey, tmp_path / name, seed)
    assert digests(tmp_path / "a") == digests(tmp_path / "b")
    first, other = digests(tmp_path / "a"), digests(tmp_path / "c")
    assert set(first) == set(other)
    assert all(first[k] != other[k] for k in first)


def test_truth_says_nothing_of_this_machine(tiny):
    text = (Path(tiny.folder) / "truth.json").read_text(encoding="utf-8")
    assert tiny.folder not in text
    assert json.loads(text)["frames"][0]["path"] == "p4p/DJI_0001.JPG"
    assert len(tiny.frames) == 8


def test_gcp_file_is_odms(tiny):
    lines = (Path(tiny.folder) / "gcp_list.txt").read_text().splitlines()
    assert lines[0] == "WGS84 UTM 32N"
    marks = {(m.path.rsplit("/", 1)[-1], p.id): (p, m) for p in tiny.points for m in p.marks}
    assert len(lines) == 1 + len(marks)
    for line in lines[1:]:
        x, y, z, px, py, name, gcp = line.split()
        point, mark = marks[name, gcp]
        assert (float(x), float(y)) == pytest.approx(utm(point.latitude, point.longitude, 32), abs=1e-3)
        assert (float(z), float(px), float(py)) == pytest.approx((point.altitude_m, mark.x_px, mark.y_px), abs=1e-3)


def test_true_height_is_above_the_ground_that_is_seen(tiny):
    for frame in tiny.frames:
        assert frame.mean_height_m == pytest.approx(45.0, abs=9.0)
        width = frame.camera.focal_ratio * frame.camera.width
        assert frame.gsd_cm == pytest.approx(100 * frame.mean_height_m / width)


def test_scaled_frames_stay_true(tmp_path):
    camera = catalogue.compact()
    truth = render(flown_by(camera), tmp_path, frames_scale=0.3)
    frame = truth.frames[0]
    size, _, exif, _, _ = exif_of(truth.image_dir / frame.path)
    assert size == (frame.camera.width, frame.camera.height) == (400, 300)
    assert size[0] / float(exif[41486]) * 25.4 == pytest.approx(7.44, rel=1e-4)


def test_roofs_hide_what_lies_behind_them():
    survey = flown_by(catalogue.phantom4pro())
    world = world_of(survey, GROUND, 0)
    rows, columns = world.ground.height.shape
    # A block 12 m high across the ground, north of the camera's foot.
    world.ground.height[:] = 0.0
    row = rows // 2
    world.ground.height[row - 40 : row, :] = 12.0
    wall_north = world.north - row * world.cell_m
    east = world.west + columns / 2 * world.cell_m
    eye = np.array([east, wall_north - 6.0, 30.0])
    back = wall_north + 40 * world.cell_m
    assert not world.visible(np.array([east, back + 1.0, 0.0]), eye)
    assert world.visible(np.array([east, back + 40.0, 0.0]), eye)
    assert world.visible(np.array([east, wall_north - 1.0, 0.0]), eye)
    from tests.simulator.renderer import hit

    camera = Camera(600, 600, 0.6)
    z, _ = hit(world, camera, look(0.0, -90.0, 0.0), eye)
    assert z[300, 300] == pytest.approx(0.0, abs=0.01)
    top = project(np.array([[east, wall_north + 20 * world.cell_m, 12.0]]), camera, look(0.0, -90.0, 0.0), eye)[0]
    assert z[round(top[1]), round(top[0])] == pytest.approx(12.0, abs=0.01)


def test_one_frame_can_be_rendered_alone():
    survey = strip_of(2)
    world = world_of(survey, GROUND, 0)
    data, frame = render_shot(world, survey.payloads[0], survey.shots[1], 0)
    again, _ = render_shot(world, survey.payloads[0], survey.shots[1], 0)
    assert data == again and data[:2] == b"\xff\xd8"
    assert frame.path == survey.shots[1].path
