"""``--ground FILE`` on rendered blocks with known truth: relief refuses a wrong focal, flat ground leaves it open."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest
from sensorgate.plugin import pipeline

from tests import simulator
from tests.simulator import catalogue
from tests.simulator.flight import RTK, Plan, fly
from tests.simulator.run import world_of
from tests.simulator.stories import HOME, small
from tests.simulator.survey import Scene, Survey

pytest.importorskip("cv2")
pytest.importorskip("pycolmap")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("gdal_translate") is None, reason="GDAL's programs are not installed"),
]

TRUE = 8.8 / 13.2
# Four percent longer than the lens is.
SHEET = "make,model,width,height,sensor_width_mm,focal_mm\nDJI,FC6310,684,456,13.2,9.152\n"
CELL_M = 1.0


def _elevation_model(survey, scene, folder):
    """The scene's bare heights every metre, a decimetre rough, on another vertical datum."""
    world = world_of(survey, scene, 0)
    rows, columns = (int(n * world.cell_m / CELL_M) for n in world.ground.height.shape)
    east = world.west + (np.arange(columns) + 0.5) * CELL_M
    north = world.north - (np.arange(rows) + 0.5) * CELL_M
    heights = world.heights(*np.meshgrid(east, north)) + scene.origin.altitude_m - 47.0
    heights += np.random.default_rng(0).normal(0.0, 0.1, heights.shape)
    south, west, _ = scene.origin.to_geodetic(world.west, world.north - rows * CELL_M, 0.0)
    top, right, _ = scene.origin.to_geodetic(world.west + columns * CELL_M, world.north, 0.0)
    head = f"ncols {columns}\nnrows {rows}\nxllcorner {west:.10f}\nyllcorner {south:.10f}\n"
    head += f"dx {(right - west) / columns:.14f}\ndy {(top - south) / rows:.14f}\n"
    cells = "\n".join(" ".join(f"{h:.3f}" for h in row) for row in heights)
    (folder / "cells.asc").write_text(head + cells + "\n", encoding="ascii")
    command = ["gdal_translate", "-q", "-a_srs", "EPSG:4326", str(folder / "cells.asc"), str(folder / "dem.tif")]
    subprocess.run(command, check=True)
    return str(folder / "dem.tif")


def _run(folder, relief):
    camera = small(catalogue.phantom4pro())
    scene = Scene("ground", HOME, key="hills", relief=relief)
    survey = Survey("hills", (scene,), (camera,), fly(camera, Plan(85.0, 4, 6), scene, 0, RTK))
    simulator.render(survey, folder / "survey")
    (folder / "sheet.csv").write_text(SHEET, encoding="utf-8")
    settings = pipeline.Settings(calibration=str(folder / "sheet.csv"), dem=_elevation_model(survey, scene, folder))
    report = pipeline.run([str(folder / "survey/images")], folder / "out", settings).report
    (project,) = report["subprojects"]
    return project["calibration"][0], project["alignment"]["candidates"]


def test_over_hills_the_model_refuses_a_sheet_that_is_four_percent_off(tmp_path):
    camera, candidates = _run(tmp_path, 3.0)
    (chosen,) = [c for c in candidates if c["chosen"]]
    assert chosen["height_scale_sigma"] < 0.005
    assert camera["focal_ratio"] == pytest.approx(TRUE, rel=3.0 * chosen["height_scale_sigma"])
    assert "measured heights (the elevation model" in camera["reason"]
    assert chosen["focal_source"] == "heights" and chosen["height_scale_by"] == "the elevation model"
    refused = [c for c in candidates if c["focal_source"] == "user-sheet"]
    assert refused and all("off the measured ones" in c["vetoed"] for c in refused)


def test_over_flat_ground_it_leaves_the_focal_open_and_says_so(tmp_path):
    camera, candidates = _run(tmp_path, 0.3)
    assert "the elevation model cannot choose it" in camera["reason"]
    assert all("elevation model" not in c["vetoed"] for c in candidates)
    assert "heights" not in {c["focal_source"] for c in candidates}
