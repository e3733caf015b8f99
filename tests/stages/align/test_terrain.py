"""An elevation model around a block, read into the frame of its positions."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
from sensorgate.stages.align.enu import enu
from sensorgate.stages.align.model import AlignFrame, AlignRequest
from sensorgate.stages.align.terrain import terrain_of
from sensorgate.stages.errors import UsageError
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.test_elevation import STEP, plane, write

pytestmark = pytest.mark.skipif(shutil.which("gdal_translate") is None, reason="GDAL's programs are not installed")

ORIGIN = (50.01, 10.01, 500.0)


def _request(elevation, degrees=0.001, position=True, level=None):
    places = [(ORIGIN[0] + degrees * i, ORIGIN[1] + degrees * j, 500.0) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    frames = tuple(
        AlignFrame(f"{i}.jpg", "", 400, 300, "p", "p/1", "p", "", position=p if position else None, height_m=100.0)
        for i, p in enumerate(places)
    )
    return AlignRequest("block", frames, (), elevation=elevation, elevation_level_m=level)


def test_heights_lie_where_the_model_has_them(tmp_path):
    terrain = terrain_of(_request(write(tmp_path), level=(1.5, 0.2)), ORIGIN, DEFAULTS)
    assert terrain.level_m == (1.5, 0.2)
    assert terrain.spacing_m == pytest.approx(STEP * 111_229, rel=1e-3)
    assert terrain.sigma_m == pytest.approx(0.1 * terrain.spacing_m)
    spots = [(50.0092, 10.0108), (50.0101, 10.0099), (50.0107, 10.0093)]
    for latitude, longitude in spots:
        height = plane(latitude, longitude)
        east, north, up = enu(np.asarray([[latitude, longitude, height]]), np.asarray(ORIGIN))[0]
        found = terrain.at(np.array([[east, north]]))[0]
        # One cell north is ten metres down, one east a metre up.
        assert found[0] == pytest.approx(up, abs=0.02)
        assert found[2] == pytest.approx(-10.0 / terrain.spacing_m, rel=0.01)


def test_what_the_model_does_not_reach_is_unknown(tmp_path):
    terrain = terrain_of(_request(write(tmp_path), degrees=0.012), ORIGIN, DEFAULTS)
    assert np.isnan(terrain.up_m).any() and np.isfinite(terrain.up_m).any()
    far = write(tmp_path, "far.tif", west=20.0, south=40.0)
    assert terrain_of(_request(far), ORIGIN, DEFAULTS) is None


def test_a_large_block_is_read_in_a_bounded_number_of_nodes(tmp_path):
    terrain = terrain_of(_request(write(tmp_path), degrees=0.004), ORIGIN, DEFAULTS.replaced({"dem_grid_nodes": 5}))
    assert max(terrain.up_m.shape) <= 5 + 3 and terrain.step_m > terrain.spacing_m


def test_without_a_model_or_positions_there_is_none(tmp_path):
    assert terrain_of(_request(""), ORIGIN, DEFAULTS) is None
    assert terrain_of(_request(write(tmp_path), position=False), None, DEFAULTS) is None
    gone = replace(_request(""), elevation=str(tmp_path / "gone.tif"))
    with pytest.raises(UsageError):
        terrain_of(gone, ORIGIN, DEFAULTS)
