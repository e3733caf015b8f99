"""ODM's working sizes against what real ODM 3.6 was seen to take, and what mixes cost inside it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.plugin.odm.sizes import depthmap_px, feature_px, loads, undistorted_px
from sensorgate.stages.harmonize.model import Gain, Outcome
from sensorgate.stages.thresholds import DEFAULTS


@pytest.mark.parametrize(
    "size, quality, side",
    [
        ((4000, 2250), "high", 2000),
        ((4000, 2250), "medium", 1000),
        ((5472, 3648), "ultra", 4480),  # never above
        ((8192, 5460), "high", 2048),  # above 42 MP half of it
        ((640, 512), "high", 640),  # below 2 MP twice, but never enlarged
        ((640, 512), "medium", 320),
        ((320, 240), "lowest", 320),  # never below
        ((1280, 960), "high", 1280),
    ],
)
def test_feature_size(size, quality, side):
    assert feature_px(*size, quality) == side


def test_undistorted_size_halves_while_the_orthophoto_asks_for_no_more():
    assert undistorted_px(5472, 3648, 4.0) == 5472
    assert undistorted_px(5472, 3648, 1.6) == 2736  # 2.4 cm of 5 needed: half
    assert undistorted_px(5472, 3648, 0.8) == 1368
    assert undistorted_px(5472, 3648, None) == 5472
    assert undistorted_px(5472, 3648, 0.01) == depthmap_px(5472, 3648) == 684


def outcome(scale, size, gsd):
    width, height = round(size[0] * scale), round(size[1] * scale)
    return Outcome(scale, width, height, gsd / scale, 1.0, 1.0, 1)


def gain(flight, gsd, size, ratio, chosen=True):
    native, better = outcome(1.0, size, gsd), outcome(ratio, size, gsd)
    return Gain("p", flight, "rgb", "area 1", 9, ratio, 0.05, chosen and ratio > 1, native, better)


def mix(ratio):
    """Frames of 4000 x 2250 and the same view with ``ratio`` times fewer pixels each way."""
    size = (round(4000 / ratio), round(2250 / ratio))
    return [gain("fine", 1.0, (4000, 2250), 1.0), gain("coarse", ratio, size, ratio)]


def test_up_to_its_own_reduction_a_mix_costs_odm_nothing():
    before, after = loads(mix(2.0), DEFAULTS)[("p", "coarse")]
    assert (before.feature_px, after.feature_px) == (2000, 2000)
    assert before.inliers == after.inliers == 1.0


def test_beyond_it_resampling_brings_what_was_measured():
    before, after = loads(mix(3.0), DEFAULTS)[("p", "coarse")]
    assert before.inliers == pytest.approx(193 / 361, abs=0.02)
    assert after.inliers == pytest.approx(1.0, abs=0.01)


def test_one_camera_at_two_heights_raises_the_feature_size_of_all():
    flights = [gain("low", 2.0, (4000, 2250), 1.0), gain("high", 4.0, (4000, 2250), 2.0)]
    before, after = loads(flights, DEFAULTS)[("p", "high")]
    assert (before.feature_px, after.feature_px) == (2000, 4000)
    assert before.inliers < after.inliers <= 1.0
    kept = [flights[0], replace(flights[1], chosen=False)]
    assert loads(kept, DEFAULTS)[("p", "high")] == (before, after)
    assert loads(kept, DEFAULTS)[("p", "low")][1] == before.__class__(2000, before.undistorted_px, 1.0)


def test_reducing_the_fine_frames_loses_their_matches():
    low, high = gain("low", 1.0, (4000, 2250), 1.0), gain("high", 4.0, (4000, 2250), 4.0, chosen=False)
    low = replace(low, chosen=True, resampled=outcome(0.25, (4000, 2250), 1.0))
    before, after = loads([low, high], DEFAULTS)[("p", "low")]
    assert before.inliers == 1.0 and after.inliers < 0.5
