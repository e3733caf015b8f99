"""Crops show the same ground, stay small, and never stop a report."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from sensorgate.plugin.report import pictures, previews
from sensorgate.stages.harmonize.model import HarmonizedFrame

from tests.plugin.report.sample import sample


def opened(data: bytes) -> Any:
    return np.asarray(Image.open(io.BytesIO(data)).convert("L"), float)


def target(width: int, height: int) -> "Image.Image":
    """A dark field with a bright disc in the middle, a tenth of the width wide."""
    y, x = np.mgrid[0:height, 0:width]
    inside = np.hypot(x - width / 2, y - height / 2) < width * 0.02
    return Image.fromarray(np.where(inside, 230, 40).astype(np.uint8)).convert("RGB")


def test_both_crops_show_the_same_ground(tmp_path: Path) -> None:
    before, after = tmp_path / "b.jpg", tmp_path / "a.jpg"
    target(2000, 1500).save(before, quality=95)
    target(3600, 2700).save(after, quality=95)
    pair = previews.crop_pair(before, after)
    assert pair is not None
    shares = [(opened(p) > 135).mean() for p in pair]
    assert shares[0] > 0.05 and shares[0] == pytest.approx(shares[1], rel=0.06)
    assert opened(pair[1]).shape == (previews.CROP_HEIGHT, previews.CROP_WIDTH)


def test_sixteen_bits_share_one_stretch(tmp_path: Path) -> None:
    rows = np.linspace(2000, 30000, 480)[:, None] * np.ones((1, 640))
    for name, values in (("b", rows), ("a", rows * 0.5)):
        Image.fromarray(values.astype(np.uint16)).save(tmp_path / f"{name}.tif")
    pair = previews.crop_pair(tmp_path / "b.tif", tmp_path / "a.tif")
    assert pair is not None
    assert opened(pair[0]).mean() > opened(pair[1]).mean() + 40


def test_noise_stays_within_the_bytes(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (1200, 1600, 3), np.uint8)
    Image.fromarray(noise).save(tmp_path / "n.png")
    pair = previews.crop_pair(tmp_path / "n.png", tmp_path / "n.png")
    assert pair is not None and max(map(len, pair)) <= pictures.MOST_BYTES
    small = previews.thumbnail(tmp_path / "n.png")
    assert small is not None and max(Image.open(io.BytesIO(small)).size) <= previews.CROP_WIDTH


@pytest.mark.filterwarnings("ignore:Corrupt EXIF")
@pytest.mark.parametrize("content", [b"", b"\xff\xd8\xff\xe0 not an image", b"II*\x00\x08\x00\x00\x00\xff\xff"])
def test_unreadable_gives_no_picture(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.jpg").write_bytes(content)
    assert previews.thumbnail(tmp_path / "x.jpg") is None
    assert previews.crop_pair(tmp_path / "x.jpg", tmp_path / "x.jpg") is None
    assert previews.thumbnail(tmp_path / "missing.jpg") is None


def test_a_truncated_frame_gives_no_picture(tmp_path: Path) -> None:
    target(800, 600).save(tmp_path / "t.jpg")
    whole = (tmp_path / "t.jpg").read_bytes()
    (tmp_path / "t.jpg").write_bytes(whole[: len(whole) // 2])
    assert previews.crop_pair(tmp_path / "t.jpg", tmp_path / "t.jpg") is None


def test_too_large_is_not_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target(800, 600).save(tmp_path / "t.jpg")
    monkeypatch.setattr(pictures, "MOST_DECODED_PIXELS", 1000)
    assert previews.thumbnail(tmp_path / "t.jpg") is None


def test_one_picture_per_changed_flight(tmp_path: Path) -> None:
    report = sample(10)
    chosen = previews.chosen(report)
    flights = [f["flight"] for f in report["frames"] if f["path"] in chosen]
    assert sorted(flights) == ["dji-fc6310-rgb-flight-1", "dji-fc6310-rgb-flight-2"]
    copies = {}
    for path in chosen:
        frame = next(f for f in report["frames"] if f["path"] == path)
        name = tmp_path / f"{frame['flight']}.jpg"
        target(900, 600).save(name)
        frame["path"] = str(name)
        copies[str(name)] = HarmonizedFrame(str(name), str(name), name.name, 900, 600, 1.5, "resampled")
    for flight in report["flights"]:
        flight["frames"] = []
    report["frames"] = [f for f in report["frames"] if f["path"] in copies]
    found = previews.previews_of(report, copies)
    assert len(found) == 4 and all(v[:2] == b"\xff\xd8" for v in found.values())
