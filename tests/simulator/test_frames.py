"""The frames show what the truth says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulator import Plan, catalogue, fly, render
from tests.simulator.camera import Camera, project, undistort
from tests.simulator.checks import flown_by
from tests.simulator.materials import ID
from tests.simulator.places import GROUND
from tests.simulator.run import world_of
from tests.simulator.survey import ControlPoint, Scene

cv2 = pytest.importorskip("cv2", reason="frames are rendered with OpenCV")


def mark_error(image, mark):
    """Distance (px) from a mark to the crossing that the frame shows there."""
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    gray = cv2.normalize(gray.astype(np.float32), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    start = np.array([[[mark.x_px, mark.y_px]]], np.float32)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 0.001)
    found = cv2.cornerSubPix(gray, start.copy(), (4, 4), (-1, -1), stop)
    return float(np.hypot(*(found - start).ravel()))


def test_targets_lie_where_the_truth_says(tmp_path):
    points = [ControlPoint(f"p{i}", GROUND.id, x, y) for i, (x, y) in enumerate([(0, 0), (-11, 6), (10, -7), (9, 8)])]
    cameras = (catalogue.phantom4pro(), catalogue.kestrel(), catalogue.micasense(folder="ms"))
    plan = Plan(height_m=42.0, strips=1, per_strip=2, forward=0.8)
    truth = render(flown_by(*cameras, plan=plan, points=points), tmp_path)
    errors = {}
    for point in truth.points:
        for mark in point.marks:
            image = cv2.imread(str(truth.image_dir / mark.path), cv2.IMREAD_UNCHANGED)
            errors.setdefault(truth.frame(mark.path).profile, []).append(mark_error(image, mark))
    assert len(errors) == 7
    for profile, found in errors.items():
        assert len(found) >= 4, profile
        assert np.median(found) < 0.15, profile
        assert max(found) < 0.3, profile


def test_rows_read_one_after_another_and_fisheyes_show_targets_where_the_truth_says(tmp_path):
    points = [ControlPoint(f"p{i}", GROUND.id, x, y) for i, (x, y) in enumerate([(0, 0), (-9, 5), (8, -6), (8, 6)])]
    slow = catalogue.with_band_size(catalogue.anafi(), 0.6)
    slow = replace(slow, bands=(replace(slow.bands[0], readout_s=0.4),))
    fish = catalogue.sequoia()
    fish = catalogue.with_band_size(replace(fish, bands=fish.bands[:1]), 0.6)
    plan = Plan(height_m=26.0, strips=1, per_strip=2, forward=0.8, speed_mps=10.0)
    survey = flown_by(slow, fish, plan=plan, points=points)
    truth = render(survey, tmp_path)
    still = replace(survey, shots=tuple(replace(s, velocity_mps=(0.0, 0.0)) for s in survey.shots))
    errors, moved = {}, []
    for point in truth.points:
        for mark in point.marks:
            image = cv2.imread(str(truth.image_dir / mark.path), cv2.IMREAD_UNCHANGED)
            errors.setdefault(truth.frame(mark.path).payload, []).append(mark_error(image, mark))
            shot = next(s for s in still.shots if s.path == mark.path)
            payload = survey.payload(shot.payload)
            xyz = np.array([[point.east_m, point.north_m, point.up_m]])
            there = project(xyz, shot.optics(payload), shot.rotation(payload), np.array(shot.position))[0]
            moved.append(float(np.hypot(*(there - (mark.x_px, mark.y_px)))))
    assert max(moved) > 10.0
    assert set(errors) == {"anafi", "sequoia"}
    for found in errors.values():
        assert len(found) >= 4
        assert np.median(found) < 0.15 and max(found) < 0.3


def features(path):
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image.dtype != np.uint8:
        image = np.clip(image / np.percentile(image, 99.5) * 255, 0, 255).astype(np.uint8)
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    keys, words = cv2.SIFT_create(4000, contrastThreshold=0.02).detectAndCompute(image, None)
    words = np.sqrt(words / (words.sum(axis=1, keepdims=True) + 1e-9))
    return np.array([k.pt for k in keys]), words


def matched(a, b, ratio=0.8):
    """Mutual nearest neighbours under Lowe's ratio, as pixel pairs."""
    there = cv2.BFMatcher().knnMatch(a[1], b[1], 2)
    back = {m.queryIdx: m.trainIdx for m in cv2.BFMatcher().match(b[1], a[1])}
    good = [m for m, n in there if m.distance < ratio * n.distance and back[m.trainIdx] == m.queryIdx]
    return a[0][[m.queryIdx for m in good]], b[0][[m.trainIdx for m in good]]


def verified(first, second):
    if len(first) < 8:
        return 0
    mask = cv2.findFundamentalMat(first, second, cv2.USAC_MAGSAC, 2.0, 0.999, 5000)[1]
    return 0 if mask is None else int(mask.sum())


def epipolar_px(truth_a, truth_b, first, second):
    """Distance (px) of matches to the epipolar lines of the *true* geometry."""

    def bearing(frame, pixels):
        c = frame.camera
        camera = Camera(c.width, c.height, c.focal_ratio, c.center_px, c.distortion)
        xy = undistort((pixels - np.array(camera.principal_px)) / camera.focal_px, camera.distortion)
        return np.column_stack((xy, np.ones(len(xy)))), camera.focal_px

    rays_a, _ = bearing(truth_a, first)
    rays_b, focal = bearing(truth_b, second)
    ra, rb = np.array(truth_a.rotation), np.array(truth_b.rotation)
    t = rb @ (np.array(truth_a.center_m) - np.array(truth_b.center_m))
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    lines = rays_a @ (cross @ rb @ ra.T).T
    return np.abs((lines * rays_b).sum(axis=1)) / np.hypot(lines[:, 0], lines[:, 1]) * focal


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    """Neighbours at 75 % overlap of three spectra at survey size, and frames of another scene."""
    payloads = (catalogue.phantom4pro(), catalogue.kestrel(), catalogue.thermal())
    survey = flown_by(*payloads, plan=Plan(height_m=60.0, strips=1, per_strip=3))
    other = Scene("other", GROUND.origin, key="other")
    stranger = catalogue.compact()
    flown = fly(stranger, Plan(height_m=55.0, strips=1, per_strip=2), other, 0)
    survey = replace(survey, scenes=(GROUND, other), payloads=(*payloads, stranger), shots=survey.shots + flown)
    return render(survey, tmp_path_factory.mktemp("strip"))


@pytest.mark.parametrize(("payload", "least"), [("p4p", 200), ("kestrel", 200), ("thermal", 120)])
def test_neighbours_match_and_agree_with_the_true_geometry(strip, payload, least):
    frames = strip.of(payload)
    found = [features(strip.image_dir / f.path) for f in frames]
    for a, b, fa, fb in zip(frames, frames[1:], found, found[1:]):
        first, second = matched(fa, fb)
        right = epipolar_px(a, b, first, second) < 1.5
        assert right.sum() >= least
        assert right.mean() > 0.85
        assert np.median(epipolar_px(a, b, first, second)[right]) < 0.35


def test_other_ground_and_other_spectrum_do_not_match(strip):
    here = [features(strip.image_dir / f.path) for f in strip.of("p4p")]
    there = [features(strip.image_dir / f.path) for f in strip.of("compact")]
    heat = [features(strip.image_dir / f.path) for f in strip.of("thermal")]
    assert max(verified(*matched(a, b)) for a in here for b in there) < 15
    assert max(verified(*matched(a, b)) for a, b in zip(here, heat)) < 30


def test_ground_far_apart_in_one_scene_does_not_match(tmp_path):
    camera = catalogue.phantom4pro()
    survey = flown_by(camera, plan=Plan(height_m=60.0, strips=1, per_strip=2, forward=-0.3))
    truth = render(survey, tmp_path)
    a, b = (features(truth.image_dir / f.path) for f in truth.frames)
    assert verified(*matched(a, b)) < 15


def test_vegetation_is_dark_in_red_and_bright_in_infrared_and_cool():
    survey = flown_by(catalogue.with_band_size(catalogue.micasense(), 0.25))
    world = world_of(survey, GROUND, 0)
    green = (world.ground.material == 0) & (world.ground.grass > 0.8) & (world.ground.dry < 0.2)
    bare = (world.ground.material == 0) & (world.ground.grass < 0.15)
    red, nir = (world.layer((c,), 1e-6)[0].astype(float) for c in ("ms-red", "ms-nir"))
    heat = world.layer(("thermal",), 1e-6)[0].astype(float)
    index = (nir - red) / (nir + red)
    assert np.median(index[green]) > 0.6
    assert np.median(index[bare]) < 0.3
    assert np.median(heat[green]) < np.median(heat[bare])
    road = world.ground.material == ID["asphalt"]
    if road.any():
        assert np.median(heat[road]) > np.median(heat[green])
