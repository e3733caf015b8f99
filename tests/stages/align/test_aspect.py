"""Focals across and down that differ: the solver holds or finds them, and what was decided of them is kept."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sensorgate.plugin.odm.cameras import entry
from sensorgate.plugin.placing import _decisions
from sensorgate.stages.align.model import LockDecision, SolvedCamera
from sensorgate.stages.align.models import camera_model
from sensorgate.stages.align.offer import offered
from sensorgate.stages.align.solution import AdjustJob, CameraSetting, EngineSettings, Job, JobFrame, in_frame, in_work
from sensorgate.stages.align.textmodel import rotation_of
from sensorgate.stages.calibrations import Entry, read_store, with_stored, write_entry
from sensorgate.stages.intrinsics import Intrinsics
from sensorgate.stages.thresholds import DEFAULTS

from tests.plugin.test_placing import camera, group

ASPECT = 0.998089
NONE = (0.0, 0.0, 0.0, 0.0, 0.0)
# 5472 x 3648 at 1600: the 1067 rows are a third of a pixel too many.
TRUTH = in_work(
    CameraSetting(
        "cam", 1600, 1067, 0.67, solve_focal=False, solve_distortion=False,
        aspect_ratio=ASPECT, squash=1067 * 5472 / (1600 * 3648),
    )
)  # fmt: skip


def stored_block(folder: Path) -> Job:
    """Twenty views of a rough field as a stored model of exact observations; returns the job that goes with it."""
    pycolmap = pytest.importorskip("pycolmap")
    gen = np.random.default_rng(1)
    name, values = camera_model(TRUTH)
    lens = pycolmap.Camera(camera_id=1, model=name, width=TRUTH.width, height=TRUTH.height, params=values)
    field = gen.uniform([-7, -5, -1.5], [7, 5, 1.5], (200, 3))
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(lens)
    ids = [model.add_point3D(place, pycolmap.Track()) for place in field]
    spots = [(x, y) for x in range(-8, 9, 4) for y in range(-6, 7, 4)]
    for number, (x, y) in enumerate(spots, start=1):
        yaw, (roll, pitch) = gen.uniform(0.0, math.pi), np.radians(gen.uniform(-10, 10, 2))
        turn = rotation_of(1.0, roll, pitch, 0.0) @ np.diag([1.0, -1.0, -1.0])
        turn = turn @ rotation_of(math.cos(yaw), 0.0, 0.0, math.sin(yaw))
        shift = -turn @ np.array([x, y, 10.0])
        seen = np.asarray(lens.img_from_cam(field @ turn.T + shift))
        rows = np.nonzero(((seen > 0) & (seen < [TRUTH.width, TRUTH.height])).all(axis=1))[0]
        image = pycolmap.Image(name=f"{number:06d}", camera_id=1, image_id=number)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(p) for p in seen[rows]])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(turn), shift))
        for at, row in enumerate(rows):
            model.add_observation(ids[row], pycolmap.TrackElement(number, at))
    for point in ids:
        if model.points3D[point].track.length() < 3:
            model.delete_point3D(point)
    (folder / "000").mkdir(parents=True)
    model.write(str(folder / "000"))
    frames = tuple(JobFrame(str(i), "", 0, "t") for i in range(len(spots)))
    return Job(frames, (TRUTH,), (), EngineSettings(1000, 0.01, 0.8, 4.0, 0, 4.0))


def test_the_solver_holds_and_finds_two_focals(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    from sensorgate.stages.align.pycolmap_adjust import adjust

    job = stored_block(tmp_path / "models")
    wrong = replace(TRUTH, focal_ratio=0.68, aspect_ratio=0.99, solve_focal=True)
    tries = (
        TRUTH,
        replace(TRUTH, aspect_ratio=1.0),
        wrong,
        replace(wrong, aspect_ratio=1.0, solve_distortion=True, solve_center=True),
    )
    task = AdjustJob(str(tmp_path / "models"), job, tuple((t,) for t in tries))
    held, square, solved, all_solved = adjust(task, lambda *_: None)
    assert np.nanmean(held.error_px) < 0.001 < 0.05 < np.nanmean(square.error_px)
    for found in (held, solved, all_solved):
        back = in_frame(found.cameras[0])
        assert (back.focal_ratio, back.aspect_ratio) == pytest.approx((0.67, ASPECT), abs=1e-5)


def test_what_was_decided_reaches_odm_and_the_store(tmp_path: Path) -> None:
    known = Intrinsics(focal_ratio=0.67, focal_source="equivalent-35mm")
    profile = replace(camera(known), serial="A1")
    said = LockDecision("cam", True, 0.67, (0.0, 0.0), NONE, "solved", "why", supported=True, aspect_ratio=ASPECT)
    proven = group("pass", said)
    made = entry(_decisions(proven, [profile])["cam"], profile.width, profile.height)
    assert made is not None and made["focal_y"] / made["focal_x"] == pytest.approx(ASPECT, abs=1e-7)
    assert (made["focal_x"] + made["focal_y"]) / 2.0 == pytest.approx(0.67, abs=1e-8)

    assert proven.alignment is not None
    lens = SolvedCamera("cam", 0.67, (0.0, 0.0), NONE, False, 60, focal_sigma=0.0001, aspect_ratio=ASPECT)
    report = replace(proven.alignment, cameras=(lens,), decisions=(said,))
    ((key, new),) = offered(report, [profile], "survey", DEFAULTS)
    write_entry(tmp_path, Entry(key, new, ("survey",)))
    (again,), _ = with_stored([profile], {"a.jpg": known}, read_store(tmp_path), DEFAULTS)
    assert (again.intrinsics.focal_source, again.intrinsics.aspect_ratio) == ("stored-calibration", ASPECT)
