from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sensorgate.stages.align.heights import levelled
from sensorgate.stages.align.judge import PASS, judge
from sensorgate.stages.align.measure import measure
from sensorgate.stages.align.pairs import plan_pairs
from sensorgate.stages.align.vertical import vertical_scale
from sensorgate.stages.align.world import ground_of
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import frames, grid, moved, neighbours, request, solution

ROWS = np.arange(24)
RTK = (0.02, 0.03)


def _flights(low_m=60.0, high_m=90.0, shift=(0.0, 0.0, 0.0), pause_s=5000.0, sigma=None):
    """One payload's two flights of 12 frames at two heights; the second one's positions are shifted."""
    a, b = grid(2, 6, low_m), grid(3, 4, high_m)
    second = [
        replace(f, path=f"a/1{i:02d}.jpg", flight="a/2", payload="a", profile="a", time_s=pause_s + i)
        for i, f in enumerate(frames(b, "b"))
    ]
    group = [replace(f, sigma_m=sigma) for f in frames(a, "a") + moved(second, shift)]
    return request(group), np.concatenate([a, b])


def _noisy(asked, metres, seed=0):
    draw = np.random.default_rng(seed)
    group = [moved([f], draw.normal(0.0, metres, 3))[0] for f in asked.frames]
    return replace(asked, frames=tuple(group))


def _ground(asked):
    return ground_of(asked.frames, asked.cameras, 1200, DEFAULTS)


@pytest.mark.parametrize("error", [0.0, 0.05, -0.08])
def test_a_wrong_focal_shows_in_the_vertical_scale(error):
    """Straight down a focal that is too long by 5 % makes every height 5 % too large, and nothing else."""
    asked, places = _flights(sigma=RTK)
    asked = _noisy(asked, 0.03)
    solved = solution(asked, places * [1.0, 1.0, 1.0 + error])
    found = vertical_scale(asked.frames, solved, _ground(asked), ROWS, DEFAULTS)
    assert found.sigma < 0.01
    assert found.ratio == pytest.approx(1.0 / (1.0 + error), abs=3.0 * found.sigma)


def test_plain_gps_between_two_flights_fixes_no_focal():
    asked, places = _flights()
    found = vertical_scale(asked.frames, solution(asked, places), _ground(asked), ROWS, DEFAULTS)
    # Two altitudes of 5 m each, 30 m apart.
    assert found.sigma == pytest.approx(5.0 * np.sqrt(2.0) / 30.0, rel=0.25)


def test_one_session_has_one_zero():
    apart = vertical_scale(*_scaled(5000.0))
    together = vertical_scale(*_scaled(60.0))
    assert together.sigma < 0.6 * apart.sigma


def _scaled(pause_s):
    asked, places = _flights(pause_s=pause_s)
    return asked.frames, solution(asked, places), _ground(asked), ROWS, DEFAULTS


def test_one_height_says_nothing():
    asked, places = _flights(60.0, 64.0, sigma=RTK)
    assert vertical_scale(asked.frames, solution(asked, places), _ground(asked), ROWS, DEFAULTS) is None


def test_an_offset_flight_leaves_only_the_heights_within_flights():
    asked, places = _flights(60.0, 90.0, (0.0, 0.0, 47.0), sigma=(0.02, 0.03))
    solved = solution(asked, places)
    level = levelled(asked.frames, solved, _ground(asked), DEFAULTS)
    assert level.offsets == {"a/2": pytest.approx(47.0, abs=0.1)}
    found = vertical_scale(asked.frames, solved, level, ROWS, DEFAULTS)
    assert found is None or found.sigma > 0.05


@pytest.mark.parametrize("up", [47.0, -30.0])
def test_a_flight_from_another_zero_is_judged_by_its_shape(up):
    asked, places = _flights(60.0, 60.0, (0.0, 0.0, up))
    asked = _noisy(asked, 1.0)
    solved = solution(asked, places, pairs=neighbours(24))
    level = levelled(asked.frames, solved, _ground(asked), DEFAULTS)
    assert level.offsets == {"a/2": pytest.approx(up, abs=1.5)}
    areas = plan_pairs(asked.frames, asked.cameras, DEFAULTS).areas
    (payload,) = judge(measure(asked.frames, solved, level, areas, DEFAULTS), DEFAULTS)
    assert payload.verdict == PASS
    assert payload.flight_offsets_m == (("a/2", level.offsets["a/2"]),)
    (raw,) = judge(measure(asked.frames, solved, _ground(asked), areas, DEFAULTS), DEFAULTS)
    assert raw.verdict != PASS


def test_what_is_no_rigid_shift_stays_wrong():
    """A second flight solved at half its size is no offset, nor is one that GPS noise or a wrong focal explains."""
    asked, places = _flights(60.0, 60.0, (0.0, 0.0, 47.0))
    bent = places.copy()
    bent[12:] = bent[12:] * [0.4, 0.4, 0.4]
    assert levelled(asked.frames, solution(asked, bent), _ground(asked), DEFAULTS).offsets == {}
    near, places = _flights(60.0, 60.0, (0.0, 0.0, 8.0))
    assert levelled(near.frames, solution(near, places), _ground(near), DEFAULTS).offsets == {}
    long, places = _flights(60.0, 150.0, sigma=RTK)
    stretched = solution(long, places * [1.0, 1.0, 1.15])
    assert levelled(long.frames, stretched, _ground(long), DEFAULTS).offsets == {}


def test_few_frames_carry_no_offset_of_their_own():
    asked, places = _flights(60.0, 60.0, (0.0, 0.0, 47.0))
    few = replace(asked, frames=asked.frames[:17])
    assert levelled(few.frames, solution(few, places[:17]), _ground(few), DEFAULTS).offsets == {}
