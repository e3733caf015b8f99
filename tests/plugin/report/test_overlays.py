"""Bands over their primary: the same place, the true shift visible, bounded, and in the page with its residuals."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Tuple

import numpy as np
import pytest
from PIL import Image
from sensorgate.plugin.report import overlays, pictures
from sensorgate.plugin.report.bands import band_tables, bands_record
from sensorgate.plugin.report.html import render
from sensorgate.stages.harmonize.bands_model import BandFit, BandPlan, Residual, RigPlan
from sensorgate.stages.harmonize.model import HarmonizedFrame

from tests.plugin.report.sample import sample

SIZE = (1280, 960)


def ground() -> np.ndarray:
    """Blocks of 24 pixels in the lower right, even elsewhere."""
    gen = np.random.default_rng(5)
    blocks = np.kron(gen.integers(8000, 50000, (40, 54)), np.ones((24, 24)))[: SIZE[1], : SIZE[0]]
    blocks[:500] = blocks[:, :700] = 20000.0
    return blocks


def put(folder: Path, name: str, pixels: np.ndarray) -> Path:
    path = folder / name
    Image.fromarray(pixels.astype(np.uint16)).save(path)
    return path


def colours(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), float)


def files(folder: Path) -> Tuple[Tuple[Path, Path], Tuple[Path, Path]]:
    primary = put(folder, "green.tif", ground())
    apart = put(folder, "nir.tif", np.roll(ground(), 9, axis=1) * 0.5)
    laid = put(folder, "laid.tif", ground() * 0.5)
    return (primary, apart), (primary, laid)


def test_shift_shows_as_colour_and_is_gone_afterwards(tmp_path: Path) -> None:
    made = overlays.overlay_pair(*files(tmp_path))
    assert made is not None
    fringes = [np.abs(colours(p)[..., 0] - colours(p)[..., 1]).mean() for p in made]
    assert fringes[0] > 20 and fringes[1] < 3
    for data in made:
        assert len(data) <= pictures.MOST_BYTES
        assert colours(data).shape == (pictures.CROP_HEIGHT, pictures.CROP_WIDTH, 3)
    assert colours(made[1]).std() > 40, "the crop lies where there is something to see"


def test_a_smaller_band_is_shown_over_the_same_ground(tmp_path: Path) -> None:
    (primary, _), _ = files(tmp_path)
    small = np.asarray(Image.fromarray(ground().astype(np.float32)).resize((320, 240), Image.Resampling.BOX))
    made = overlays.overlay_pair((primary, put(tmp_path, "small.tif", small)), (primary, primary))
    assert made is not None
    assert np.corrcoef(colours(made[0])[..., 0].ravel(), colours(made[0])[..., 1].ravel())[0, 1] > 0.8


@pytest.mark.filterwarnings("ignore:Corrupt EXIF")
@pytest.mark.parametrize("content", [b"", b"II*\x00\x08\x00\x00\x00\xff\xff"])
def test_unreadable_gives_no_overlay(tmp_path: Path, content: bytes) -> None:
    (primary, band), _ = files(tmp_path)
    (tmp_path / "bad.tif").write_bytes(content)
    assert overlays.overlay_pair((primary, tmp_path / "bad.tif"), (primary, band)) is None
    assert overlays.overlay_pair((primary, band), (primary, tmp_path / "bad.tif")) is None


def with_bands(report: Dict[str, Any]) -> Dict[str, Any]:
    """The sample's rig with one band laid on, one refused."""
    rig = next(p for p in report["payloads"] if len(p["profiles"]) > 2)
    primary, first, second = rig["primary"], *[p for p in rig["profiles"] if p != rig["primary"]][:2]
    laid = BandFit(
        payload=rig["id"], primary=primary, profile=first, band="NIR", low_m=58.0, high_m=61.0, pairs=(("a", "b"),),
        state="warp", source="area", model="homography", control_points=900, inliers=880,
        held_out=Residual(300, 0.214, 0.655),
    )  # fmt: skip
    told = "only 9 of 80 control points agree <b>"
    refused = replace(laid, profile=second, band="LWIR", state="refused", reason=told, held_out=None, source="")
    plan = RigPlan(rig["id"], primary, "Green", (first,), (second,), True, "kept")
    report["bands"] = bands_record(BandPlan((plan,), (laid, refused)))
    for frame in report["frames"]:
        if frame["payload"] == rig["id"] and frame["profile"] == first and frame["output"]:
            size = {"width": frame["width"], "height": frame["height"]}
            frame["change"] = {**(frame.get("change") or {}), **size, "how": "warped", "scale": 1.0}
    return report


def test_page_tells_residuals_and_shows_the_bands(tmp_path: Path) -> None:
    report = with_bands(sample())
    pairs = overlays.chosen_bands(report)
    assert len(pairs) == 1
    primary, band = pairs[0]
    at = {f["path"]: f for f in report["frames"]}
    assert at[primary]["capture"] == at[band]["capture"] and at[primary]["profile"] != at[band]["profile"]
    pair = files(tmp_path)
    made = overlays.overlay_pair(*pair)
    assert made is not None
    shown = {pictures.preview_key(band, w): d for w, d in zip((overlays.BAND_BEFORE, overlays.BAND_AFTER), made)}
    page = render(report, shown)
    section = page[page.index('id="bands"') : page.index("</section>", page.index('id="bands"'))]
    assert "0.21" in section and "0.66" in section and "58–61" in section
    assert "refused: only 9 of 80 control points agree &lt;b&gt;" in section
    assert section.count("<img ") == 2 and section.count('alt="Green in red and NIR in cyan') == 2
    assert "tags hold" in section
    assert render(report).count('id="bands"') == 1 and "<img" not in render(report)


def test_without_rigs_there_is_no_section() -> None:
    report = sample()
    report["bands"] = []
    assert 'id="bands"' not in render(report)
    assert band_tables(report, 10) == []


def test_pictures_are_taken_of_copies_only(tmp_path: Path) -> None:
    report = with_bands(sample())
    assert overlays.band_overlays(report, {}) == {}
    primary, band = overlays.chosen_bands(report)[0]
    gone = {p: HarmonizedFrame(p, str(tmp_path / "gone.tif"), "gone.tif", 1, 1, 1.0, "warped") for p in (primary, band)}
    assert overlays.band_overlays(report, gone) == {}
