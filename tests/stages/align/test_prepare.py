from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.stages.align.features import workers
from sensorgate.stages.align.pairs import plan_pairs
from sensorgate.stages.align.prepare import build_job, engine_settings, rung_max_dim
from sensorgate.stages.errors import UsageError
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import frames, grid, request


def _settings(rung, threads=8):
    return engine_settings(rung, rung_max_dim(rung, DEFAULTS), threads, DEFAULTS)


def test_the_reference_is_colmap_as_it_comes():
    settings = _settings("reference")
    assert (settings.max_features, settings.max_ratio) == (8192, 0.8)
    assert settings.peak_threshold == pytest.approx(0.02 / 3, abs=1e-4)
    assert rung_max_dim("reference", DEFAULTS) < settings.upsample_below_px, "SIFT starts from a doubled image"
    assert settings.max_features > _settings("quick").max_features


def test_a_payload_alone_is_solved_as_quickly_as_the_whole():
    assert _settings("alone") == _settings("quick")
    assert rung_max_dim("alone", DEFAULTS) == rung_max_dim("quick", DEFAULTS)


def test_an_unknown_rung_is_refused():
    with pytest.raises(UsageError):
        engine_settings("slow", 1200, 1, DEFAULTS)


def test_extraction_takes_as_many_threads_as_memory_holds():
    quick, reference = _settings("quick"), _settings("reference")
    assert workers([(1200, 900)], quick) == 8
    assert 1 <= workers([(1600, 1200)], reference) <= 2
    assert workers([(1600, 1600), (600, 400)], reference) == 1
    assert workers([(1200, 900)], _settings("quick", threads=1)) == 1
    assert workers([], quick) == 8


@pytest.mark.parametrize(("width", "height", "error"), [(4000, 3000, 4.0), (800, 600, 2.0), (320, 240, 1.5)])
def test_small_frames_are_verified_by_a_share_of_their_own_size(width, height, error):
    block = request([replace(f, width=width, height=height) for f in frames(grid())])
    plan = plan_pairs(block.frames, block.cameras, DEFAULTS)
    assert build_job(block, plan, "mixed", 1600, 1, DEFAULTS).settings.verify_error_px == error
