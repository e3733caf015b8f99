"""Orthophotos fused on one grid: pixels, names, no data and the distance between payloads, read back by GDAL."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.stages import gdal_tools
from sensorgate.stages.errors import BlockedError, Cancelled, FrameError, MissingDependency, UsageError
from sensorgate.stages.rasters import (
    Raster,
    RasterBand,
    common_crs,
    common_type,
    described,
    fuse_rasters,
    fused_bands,
    overlap,
    together,
)
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.harmonize.samples import texture

gdal = pytest.mark.skipif(shutil.which("gdalwarp") is None, reason="GDAL's programs are not installed")
KINDS = {"uint8": (1, "Byte"), "uint16": (12, "UInt16"), "float32": (4, "Float32")}
UTM = "EPSG:32632"
WEST, NORTH = 500_000.0, 5_230_000.0


def ortho(
    path: Path,
    layers: Sequence[np.ndarray],
    pixel: float,
    *,
    west: float = WEST,
    north: float = NORTH,
    names: Sequence[str] = (),
    nodata: Optional[float] = None,
    alpha: bool = False,
    srs: str = UTM,
) -> Path:
    """Write a GeoTIFF by GDAL from plain layers (h, w)."""
    raw = path.with_suffix(".img")
    path.parent.mkdir(parents=True, exist_ok=True)
    stack = np.stack(layers)
    stack.astype(stack.dtype.newbyteorder("<")).tofile(raw)
    count, height, width = stack.shape
    named = f"band names = {{{', '.join(names)}}}\n" if names else ""
    raw.with_suffix(".hdr").write_text(
        f"ENVI\nsamples = {width}\nlines = {height}\nbands = {count}\nheader offset = 0\nfile type = ENVI Standard\n"
        f"data type = {KINDS[str(stack.dtype)][0]}\ninterleave = bsq\nbyte order = 0\n{named}"
    )
    place = [str(v) for v in (west, north, west + width * pixel, north - height * pixel)]
    command = ["gdal_translate", "-q", "-of", "GTiff", "-a_ullr", *place]
    command += ["-a_srs", srs] if srs else []
    command += ["-a_nodata", str(nodata)] if nodata is not None else []
    command += ["-colorinterp_" + str(count), "alpha"] if alpha else []
    subprocess.run([*command, str(raw), str(path)], check=True)
    raw.unlink()
    raw.with_suffix(".hdr").unlink()
    return path


def read(path: Path) -> Tuple[Dict[str, Any], np.ndarray]:
    """gdalinfo's view of a file and its pixels as floats."""
    info = json.loads(subprocess.run(["gdalinfo", "-json", str(path)], check=True, capture_output=True).stdout)
    raw = path.with_suffix(".raw")
    subprocess.run(
        ["gdal_translate", "-q", "-of", "ENVI", "-co", "INTERLEAVE=BSQ", "-ot", "Float64", str(path), str(raw)],
        check=True,
    )
    width, height = info["size"]
    return info, np.fromfile(raw, "<f8").reshape(-1, height, width)


def ground(width: int, height: int) -> np.ndarray:
    return texture(width, height, 1, seed=4)[:, :, 0]


@pytest.fixture
def site(tmp_path: Path) -> List[Tuple[str, Path]]:
    """RGB with alpha at 5 cm; two 16-bit bands of the same ground at 10 cm, with no data in one corner."""
    picture = ground(800, 600)
    alpha = np.full_like(picture, 255)
    alpha[:, :100] = 0
    rgb = ortho(tmp_path / "rgb.tif", [picture, picture // 2, 255 - picture, alpha], 0.05, alpha=True,
                names=["Red", "Green", "Blue", ""])  # fmt: skip
    coarse = picture.reshape(300, 2, 400, 2).mean(axis=(1, 3))
    nir = (coarse * 200 + 500).astype(np.uint16)
    nir[:40, 360:] = 0
    ms = ortho(tmp_path / "ms.tif", [nir, nir // 2], 0.10, names=["NIR", "Green"], nodata=0)
    return [("rgb", rgb), ("ms", ms)]


@gdal
def test_bands_lie_on_one_grid_with_names_and_no_data(site: List[Tuple[str, Path]], tmp_path: Path) -> None:
    out = tmp_path / "out" / "fused.tif"
    before = {p: p.read_bytes() for _, p in site}
    fusion = fuse_rasters(site, out, DEFAULTS)
    assert {p: p.read_bytes() for _, p in site} == before
    assert [p.name for p in out.parent.iterdir()] == ["fused.tif"]
    info, pixels = read(out)
    names = [b["description"] for b in info["bands"]]
    assert names == ["NIR", "ms: Green", "Red", "rgb: Green", "Blue"] == [b.name for b in fusion.bands]
    assert {b["type"] for b in info["bands"]} == {"Float32"} and fusion.kind == "Float32"
    assert {b["noDataValue"] for b in info["bands"]} == {-99999.0}
    assert all(b["block"] == [256, 256] for b in info["bands"])
    structure = info["metadata"]["IMAGE_STRUCTURE"]
    assert structure["COMPRESSION"] == "LZW" and structure["LAYOUT"] == "COG"
    assert info["size"] == [800, 600] and info["geoTransform"] == [WEST, 0.05, 0.0, NORTH, 0.0, -0.05]
    assert fusion.pixel == 0.05
    picture = ground(800, 600).astype(float)
    red, blue, nir = pixels[2], pixels[4], pixels[0]
    assert np.array_equal(red[:, 100:], picture[:, 100:]) and (red[:, :100] == -99999).all()
    assert np.array_equal(blue[:, 100:], 255 - picture[:, 100:])
    assert (nir[:76, 724:] == -99999).all() and (nir[100:, :] > 0).all()
    wanted = picture.reshape(300, 2, 400, 2).mean(axis=(1, 3)) * 200 + 500
    assert abs(nir[100:500, 100:700].mean() / wanted[50:250, 50:350].mean() - 1) < 0.002


@gdal
@pytest.mark.parametrize("east_north", [(0.0, 0.0), (0.32, -0.21)])
def test_distance_between_payloads_is_measured(tmp_path: Path, east_north: Tuple[float, float]) -> None:
    picture = ground(1000, 800)
    first = ortho(tmp_path / "a.tif", [picture], 0.05)
    coarse = picture.reshape(400, 2, 500, 2).mean(axis=(1, 3))
    # Other light: inverted, bent, and moved on the map.
    other = (np.sqrt(255 - coarse) * 3000).astype(np.uint16)
    second = ortho(tmp_path / "b.tif", [other], 0.10, west=WEST + east_north[0], north=NORTH + east_north[1])
    fusion = fuse_rasters([("a", first), ("b", second)], tmp_path / "out.tif", DEFAULTS)
    (shift,) = fusion.shifts
    assert (shift.raster, shift.reference) == ("b", "a") and shift.points > 50
    assert shift.east == pytest.approx(east_north[0], abs=0.015)
    assert shift.north == pytest.approx(east_north[1], abs=0.015)
    assert shift.residual_p95 is not None and shift.residual_p95 < 0.05
    assert [f.code for f in fusion.findings] == (["raster-shifted"] if any(east_north) else [])


@gdal
def test_strangers_on_the_same_place_are_unknown_not_wrong(tmp_path: Path) -> None:
    first = ortho(tmp_path / "a.tif", [ground(600, 500)], 0.05)
    second = ortho(tmp_path / "b.tif", [texture(600, 500, 1, seed=77)[:, :, 0]], 0.05)
    fusion = fuse_rasters([("a", first), ("b", second)], tmp_path / "out.tif", DEFAULTS)
    assert [s.points for s in fusion.shifts] == [0]
    assert [f.code for f in fusion.findings] == ["raster-shift-unknown"]


@gdal
def test_what_has_no_place_is_named_and_left_out(tmp_path: Path) -> None:
    good = ortho(tmp_path / "good.tif", [ground(300, 200)], 0.05)
    lost = ortho(tmp_path / "lost.tif", [ground(300, 200)], 0.05, srs="")
    text = tmp_path / "text.tif"
    text.write_text("<VRTDataset rasterXSize='1' rasterYSize='1'/>")
    cut = tmp_path / "cut.tif"
    cut.write_bytes(good.read_bytes()[:6])
    fusion = fuse_rasters(
        [("good", good), ("lost", lost), ("text", text), ("cut", cut), ("gone", tmp_path / "gone.tif")],
        tmp_path / "out.tif",
        DEFAULTS,
    )
    assert {(f.subjects[0], f.code) for f in fusion.findings} == {
        ("lost", "raster-without-crs"),
        ("text", "raster-unusable"),
        ("cut", "raster-unusable"),
        ("gone", "raster-unusable"),
    }
    assert [b.source for b in fusion.bands] == ["good"]
    assert fusion.kind == "UInt16" and fusion.nodata == 65535
    with pytest.raises(BlockedError, match="coordinate system"):
        fuse_rasters([("lost", lost)], tmp_path / "none.tif", DEFAULTS)
    assert not (tmp_path / "none.tif").exists()


@gdal
def test_another_coordinate_system_is_told_and_reprojected(tmp_path: Path) -> None:
    first = ortho(tmp_path / "a.tif", [ground(600, 500)], 0.5)
    second = ortho(tmp_path / "c.tif", [ground(600, 500)], 0.5)
    third = tmp_path / "b.tif"
    subprocess.run(["gdalwarp", "-q", "-t_srs", "EPSG:3857", "-r", "cubic", str(first), str(third)], check=True)
    fusion = fuse_rasters([("a", first), ("b", third), ("c", second)], tmp_path / "out.tif", DEFAULTS)
    assert "raster-crs-differs" in [f.code for f in fusion.findings]
    assert "32632" in fusion.crs
    for shift in fusion.shifts:
        assert shift.median is not None and shift.median < 0.15


@gdal
def test_a_site_elsewhere_is_left_out(tmp_path: Path) -> None:
    first = ortho(tmp_path / "a.tif", [ground(300, 200)], 0.05)
    far = ortho(tmp_path / "far.tif", [ground(200, 100)], 0.05, west=WEST + 3000.0)
    fusion = fuse_rasters([("a", first), ("far", far)], tmp_path / "out.tif", DEFAULTS)
    assert [(f.code, f.subjects) for f in fusion.findings] == [("raster-apart", ("far",))]
    assert (fusion.width, fusion.height) == (300, 200)


@gdal
def test_a_source_is_never_overwritten_and_work_can_be_stopped(site: List[Tuple[str, Path]], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="Choose another"):
        fuse_rasters(site, site[0][1], DEFAULTS)
    with pytest.raises(Cancelled):
        fuse_rasters(site, tmp_path / "out" / "x.tif", DEFAULTS, cancel=lambda: True)
    assert not list((tmp_path / "out").iterdir())
    with pytest.raises(UsageError, match="pixels"):
        fuse_rasters(site, tmp_path / "x.tif", DEFAULTS.replaced({"fuse_max_gigapixels": 1e-6}))


def test_without_gdal_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gdal_tools.shutil, "which", lambda name: None)
    monkeypatch.setitem(__import__("sys").modules, "osgeo", None)
    with pytest.raises(MissingDependency, match="apt-get install gdal-bin"):
        gdal_tools.find_gdal()


def band(kind: str, nodata: Optional[float] = None, name: str = "x") -> RasterBand:
    return RasterBand(1, name, kind, nodata)


@given(
    st.lists(
        st.tuples(st.sampled_from(["Byte", "UInt16", "Int16", "Float32"]), st.sampled_from([None, 0.0, 255.0, -1.0])),
        min_size=1,
        max_size=6,
    )
)
def test_type_holds_every_value_and_no_pixel_is_no_data(told: List[Tuple[str, Optional[float]]]) -> None:
    kind, hole = common_type([band(k, n) for k, n in told])
    code = {"Byte": "B", "UInt16": "H", "Int16": "h", "Float32": "f", "Float64": "d"}[kind]
    ends = {"Byte": (0, 255), "UInt16": (0, 65535), "Int16": (-32768, 32767), "Float32": (-1e6, 1e6)}
    for source, _ in told:
        for value in (*ends[source], hole):
            packed = struct.pack(code, value if code in "fd" else int(value))
            assert struct.unpack(code, packed)[0] == value
    shared = {n for _, n in told}
    if shared == {hole}:
        return
    for source, _ in told:
        if source != "Float32":
            assert not ends[source][0] <= hole <= ends[source][1]


def raster(name: str, extent: Tuple[float, float, float, float], crs: str = "A", bands: Tuple[str, ...] = ()) -> Raster:
    return Raster(name, name, crs, tuple(band("Byte", name=b) for b in bands), 1.0, extent)


def test_pure_rules() -> None:
    a, b, c = raster("a", (0, 0, 2, 2)), raster("b", (1, 1, 3, 3)), raster("c", (9, 9, 12, 12))
    assert overlap(a.extent, b.extent) == (1, 1, 2, 2) and overlap(a.extent, c.extent) is None
    assert together([c, a, b]) == ([a, b], [c])
    bridge = raster("d", (3, 3, 10, 10))
    assert together([a, b, c, raster("e", (2.5, 2.5, 9.5, 9.5))])[1] == [] and bridge.name == "d"
    assert common_crs([raster("a", (0, 0, 1, 1), "X"), raster("b", (0, 0, 1, 1), "Y"), c, a]) == "A"
    named = fused_bands([raster("rgb", a.extent, bands=("Red", "Green")), raster("ms", a.extent, bands=("Green",))])
    assert [b.name for b in named] == ["Red", "rgb: Green", "ms: Green"]


def test_odd_descriptions_are_refused_not_guessed() -> None:
    place = {"coordinateSystem": {"wkt": "X"}, "geoTransform": [0, 1, 0, 0, 0, -1]}
    one = {"band": 1, "type": "Byte", "colorInterpretation": "Gray"}
    assert described("a", Path("a.tif"), {**place, "bands": [one]}).bands[0].name == "band 1"
    for wrong in (
        {**place, "bands": []},
        {**place, "bands": [{**one, "type": "CFloat32"}]},
        {**place, "bands": [{**one, "colorInterpretation": "Alpha"}]},
        {"bands": [one]},
        {**place, "geoTransform": None, "bands": [one]},
    ):
        with pytest.raises(FrameError):
            described("a", Path("a.tif"), wrong)
