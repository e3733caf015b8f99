"""Ground heights from rasters written by GDAL, against the function that filled them."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace

import pytest
from sensorgate.stages import elevation, gdal_tools
from sensorgate.stages.elevation import open_elevation
from sensorgate.stages.errors import MissingDependency, UsageError
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import strip, survey_of

pytestmark = pytest.mark.skipif(shutil.which("gdal_translate") is None, reason="GDAL's programs are not installed")

# A plane in cells: column + 10 * row + 100 metres at the centre of each cell.
SIDE, STEP, WEST, SOUTH = 40, 0.0005, 10.0, 50.0


def plane(latitude: float, longitude: float) -> float:
    column = (longitude - WEST) / STEP - 0.5
    row = (SOUTH + SIDE * STEP - latitude) / STEP - 0.5
    return 100.0 + column + 10.0 * row


def write(folder, name="dem.tif", *options, value=lambda x, y: 100 + x + 10 * y, west=WEST, south=SOUTH, step=STEP):
    head = f"ncols {SIDE}\nnrows {SIDE}\nxllcorner {west}\nyllcorner {south}\ncellsize {step}\nNODATA_value -9999\n"
    rows = "\n".join(" ".join(str(float(value(x, y))) for x in range(SIDE)) for y in range(SIDE))
    (folder / "cells.asc").write_text(head + rows + "\n", encoding="ascii")
    command = ["gdal_translate", "-q", "-of", "GTiff", *(options or ("-a_srs", "EPSG:4326"))]
    subprocess.run([*command, str(folder / "cells.asc"), str(folder / name)], check=True)
    return str(folder / name)


@pytest.fixture(params=["programs", "bindings"])
def way(request, monkeypatch):
    """Both ways to GDAL answer alike."""
    if request.param == "bindings":
        pytest.importorskip("osgeo.gdal", reason="GDAL's Python bindings are not installed")
    else:
        monkeypatch.setattr(elevation, "_cells", elevation._Programs)


def test_bilinear_in_a_geographic_raster(tmp_path, way):
    dem = open_elevation(write(tmp_path))
    points = [(50.0101, 10.0099), (50.0023, 10.0151), (50.01, 10.01), (50.0187, 10.0004)]
    for point, height in zip(points, dem.sample(points)):
        assert height == pytest.approx(plane(*point), abs=1e-3)
    assert dem.spacing_m(points[0]) == pytest.approx(STEP * 111_229, rel=1e-3)
    assert dem.sample([]) == ()


def test_a_projected_raster_in_reprojected_places(tmp_path, way):
    write(tmp_path)
    warp = ["gdalwarp", "-q", "-t_srs", "EPSG:32632", "-tr", "20", "20", "-r", "bilinear", "-dstnodata", "-9999"]
    subprocess.run([*warp, str(tmp_path / "dem.tif"), str(tmp_path / "utm.tif")], check=True)
    dem = open_elevation(str(tmp_path / "utm.tif"))
    points = [(50.0101, 10.0099), (50.0073, 10.0121)]
    for point, height in zip(points, dem.sample(points)):
        assert height == pytest.approx(plane(*point), abs=2.0)  # two bilinear steps on a slope of 10 m per cell
    assert dem.spacing_m(points[0]) == pytest.approx(20.0, rel=0.01)


def test_outside_and_voids_are_unknown(tmp_path, way):
    void = write(tmp_path, value=lambda x, y: -9999 if x < 20 else -32768 if y < 20 else 7)
    dem = open_elevation(void)
    assert dem.sample([(50.005, 10.005), (50.015, 10.015), (50.005, 10.015)]) == (None, None, 7.0)
    assert dem.sample([(49.0, 10.0), (50.01, 9.99), (50.01, 10.0201), (95.0, 10.0), (-10.0, 250.0)]) == (None,) * 5
    assert dem.sample([(50.00001, 10.01999)]) == (7.0,)  # the outer half of a cell has its height


def test_units_scales_and_vertical_datums(tmp_path, way):
    scaled = write(tmp_path, "scaled.tif", "-a_srs", "EPSG:4326", "-ot", "Int16", "-a_scale", "0.1", "-a_offset", "50")
    assert open_elevation(scaled).sample([(50.01, 10.01)])[0] == pytest.approx(50 + 0.1 * plane(50.01, 10.01), abs=0.01)
    named = open_elevation(write(tmp_path, "named.tif", "-a_srs", "EPSG:4326+5773"))
    assert named.source.vertical == "EGM96 height"
    assert open_elevation(write(tmp_path)).source.vertical == ""
    feet = open_elevation(write(tmp_path, "feet.tif", "-a_srs", "EPSG:4326+6360"))  # NAVD88 height (ftUS)
    assert feet.sample([(50.01, 10.01)])[0] == pytest.approx(plane(50.01, 10.01) * 1200 / 3937, abs=0.01)


def test_files_that_cannot_serve_are_usage_errors_with_the_way_out(tmp_path):
    bare = write(tmp_path, "bare.tif", "-of", "GTiff")
    with pytest.raises(UsageError, match="gdal_translate -a_srs"):
        open_elevation(bare)
    with pytest.raises(UsageError, match="no file"):
        open_elevation(str(tmp_path / "none.tif"))
    (tmp_path / "text.tif").write_text("no raster", encoding="ascii")
    with pytest.raises(UsageError, match=r"text\.tif"):
        open_elevation(str(tmp_path / "text.tif"))
    picture = tmp_path / "picture.tif"
    subprocess.run(
        ["gdal_translate", "-q", "-b", "1", "-b", "1", "-b", "1", "-ot", "Byte", "-co", "PHOTOMETRIC=RGB", "-a_srs",
         "EPSG:4326", str(tmp_path / "cells.asc"), str(picture)], check=True
    )  # fmt: skip
    with pytest.raises(UsageError, match="picture"):
        open_elevation(str(picture))
    with pytest.raises(UsageError, match="TILED=YES"):
        open_elevation(write(tmp_path), replace(DEFAULTS, dem_block_mb=0))


def test_without_gdal_the_command_is_named(tmp_path, monkeypatch):
    (tmp_path / "dem.tif").write_bytes(b"")
    monkeypatch.setitem(__import__("sys").modules, "osgeo", None)
    monkeypatch.setattr(gdal_tools.shutil, "which", lambda name: None)
    with pytest.raises(MissingDependency, match="apt-get install gdal-bin"):
        open_elevation(str(tmp_path / "dem.tif"))


def test_the_digest_follows_the_content_and_not_the_folder(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    first, second = (open_elevation(write(tmp_path / n)).source for n in "ab")
    assert first == second
    other = open_elevation(write(tmp_path / "b", value=lambda x, y: 1 if (x, y) == (3, 3) else 100 + x + 10 * y)).source
    assert other.digest != first.digest


def test_a_survey_on_a_real_model(tmp_path):
    frames = strip(count=12, latitude=50.005, longitude=10.01, altitude_m=500.0, relative_altitude_m=None)
    survey = survey_of(frames, elevation=open_elevation(write(tmp_path)))
    for frame, placed in zip(frames, survey.frames):
        assert placed.height_source == "dem"
        assert placed.height_m == pytest.approx(500.0 - plane(frame.latitude, frame.longitude), abs=1e-3)
        assert placed.gsd_cm is not None
    assert survey.elevation is not None and survey.flights[0].relief_m == pytest.approx(22.0, abs=0.01)
