"""Models of an engine become one solution: the first model speaks, small rests do not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.stages.align.collected import Part, Pose, assembled
from sensorgate.stages.align.prepare import engine_settings
from sensorgate.stages.align.solution import UNPLACED, CameraSetting, Job, JobFrame
from sensorgate.stages.thresholds import DEFAULTS

CAMERAS = tuple(CameraSetting(name, 400, 300, 0.8) for name in "ab")
SETTINGS = replace(engine_settings("quick", 1000, 1, DEFAULTS), min_model_frames=3)
JOB = Job(tuple(JobFrame(f"{i}", f"{i}.jpg", i % 2, "") for i in range(10)), CAMERAS, (), SETTINGS)


def pose(row: int, errors=(0.5, 1.5)) -> Pose:
    return Pose(np.eye(3), np.array([row, 0.0, 60.0]), np.asarray(errors, dtype=float))


def part(rows, focal: float = 0.7, points=(7, 3)) -> Part:
    cameras = {i: replace(c, focal_ratio=focal) for i, c in enumerate(CAMERAS)}
    return Part({r: pose(r) for r in rows}, cameras, {i: np.array([i, 0.0, 0.0]) for i in points})


def test_a_frame_in_two_models_counts_in_the_first_and_its_camera_speaks():
    solution, kept = assembled(JOB, CAMERAS, [part(range(5), 0.7), part(range(3, 9), 0.9)])
    assert kept == (0, 1)
    assert solution.model.tolist() == [0] * 5 + [1] * 4 + [UNPLACED]
    assert [c.focal_ratio for c in solution.cameras] == [0.7, 0.7]
    assert np.isnan(solution.center[9]).all() and solution.center[8][0] == 8.0
    assert solution.error_px[0] == 1.0 and solution.observations[0] == 2


def test_a_rest_below_the_smallest_model_is_no_model():
    solution, kept = assembled(JOB, CAMERAS, [part(range(6)), part(range(4, 8)), part([0, 8, 9, 7])])
    assert kept == (0, 2)
    assert solution.model.tolist() == [0] * 6 + [UNPLACED] + [1] * 3
    assert solution.models == 2 and solution.point_model.tolist() == [0, 0, 1, 1]


def test_points_stand_in_the_order_of_their_ids():
    solution, _ = assembled(JOB, CAMERAS, [part(range(4), points=(9, 1, 5))])
    assert solution.point_id.tolist() == [1, 5, 9] and solution.point_xyz[:, 0].tolist() == [1.0, 5.0, 9.0]


def test_a_camera_that_only_unplaced_frames_have_stays_as_it_was():
    solution, _ = assembled(JOB, CAMERAS, [part([0, 2, 4])])
    assert [c.focal_ratio for c in solution.cameras] == [0.7, 0.8]


def test_a_frame_without_observations_has_no_error():
    whole = part(range(4))
    blind = replace(whole, poses={**whole.poses, 2: pose(2, ())})
    solution, _ = assembled(JOB, CAMERAS, [blind])
    assert np.isnan(solution.error_px[2]) and solution.observations[2] == 0 and solution.model[2] == 0


@given(st.lists(st.sets(st.integers(0, 9)), max_size=5))
def test_every_frame_is_in_one_model_at_most_and_models_are_numbered_without_gaps(groups):
    solution, kept = assembled(JOB, CAMERAS, [part(rows) for rows in groups])
    placed = solution.model[solution.model != UNPLACED]
    assert sorted(set(placed.tolist())) == list(range(len(kept)))
    assert all((placed == place).sum() >= 3 for place in range(len(kept)))
    for row in range(10):
        if solution.model[row] != UNPLACED:
            assert row in groups[kept[solution.model[row]]]
