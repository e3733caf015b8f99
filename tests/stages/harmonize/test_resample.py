from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from sensorgate.stages.errors import FrameError
from sensorgate.stages.harmonize.resample import decode_jpeg, encode_jpeg, recolour, resize, resize_mask, transform
from sensorgate.stages.thresholds import DEFAULTS

from .samples import psnr, real, texture

cv2 = pytest.importorskip("cv2")


def reference(pixels: np.ndarray, size: tuple) -> np.ndarray:
    """Windowed-sinc resize in floating point, without rounding between the passes."""
    planes = [
        np.asarray(Image.fromarray(pixels[:, :, c].astype(np.float32)).resize(size, Image.Resampling.LANCZOS))
        for c in range(pixels.shape[2])
    ]
    return np.stack(planes, axis=-1)


def crop(name: str) -> np.ndarray:
    return decode_jpeg(real(name).read_bytes(), grey=False)[400:1400, 600:1800]


BARS = [(0.9, 48.0), (0.8, 45.5), (0.7, 42.5), (0.6, 41.0), (0.5, 41.0), (0.3, 39.0), (1.5, 50.0), (3.0, 50.0)]


@pytest.mark.parametrize("scale, least", BARS)
def test_fidelity_on_real_frames(scale, least):
    """PSNR to the float reference, never below the area mean when shrinking; deep pixels above cubic when enlarging."""
    for name in ("brighton_p3_rgb/DJI_0030.JPG", "caliterra_canon_rgb/IMG_9375.jpg"):
        pixels = crop(name)
        size = (round(pixels.shape[1] * scale), round(pixels.shape[0] * scale))
        wanted = reference(pixels, size)
        got = psnr(resize(pixels, size), wanted)
        assert got >= least
        if scale < 1:
            assert got >= psnr(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), wanted) - 0.3
        else:
            assert got > psnr(cv2.resize(pixels, size, interpolation=cv2.INTER_LINEAR), wanted) + 5
            deep = (pixels.astype(np.uint16) * 200).astype(np.uint16)
            found, plain = (
                psnr(other / 200.0, wanted)
                for other in (resize(deep, size), cv2.resize(deep, size, interpolation=cv2.INTER_CUBIC))
            )
            assert found > plain + 1


@pytest.mark.parametrize("scale", [0.9, 0.8, 0.7, 0.6, 0.5])
def test_noise_of_a_sensor_comes_as_near_to_the_reference_as_with_any_plain_filter(scale):
    pixels = cv2.GaussianBlur(np.random.default_rng(3).integers(0, 256, (300, 400, 3)).astype(np.uint8), (0, 0), 0.5)
    size = (round(400 * scale), round(300 * scale))
    wanted = reference(pixels, size)
    others = (cv2.INTER_AREA, cv2.INTER_CUBIC, cv2.INTER_LINEAR)
    best = max(psnr(cv2.resize(pixels, size, interpolation=kind), wanted) for kind in others)
    assert psnr(resize(pixels, size), wanted) >= best - 0.5


@pytest.mark.parametrize("scale, share", [(0.8, 0.92), (0.6, 0.55), (0.5, 0.4), (0.3, 0.25)])
def test_shrinking_does_not_alias(scale, share):
    """Stripes near the finest that a frame holds fade towards their mean; alone, the cubic kernel keeps them."""
    wave = 127.5 + 120 * np.cos(2 * np.pi * 0.49 * np.arange(1200))
    pixels = np.repeat(wave[None, :], 600, axis=0).astype(np.float32)
    size = (round(1200 * scale), round(600 * scale))
    alone = cv2.resize(pixels, size, interpolation=cv2.INTER_CUBIC)
    assert np.std(resize(pixels, size)) < share * np.std(alone)


@pytest.mark.parametrize("dtype, top", [(np.uint8, 255), (np.uint16, 65535), (np.float32, 1.0)])
@pytest.mark.parametrize("scale", [0.37, 0.8, 1.7])
def test_depths_agree(dtype, top, scale):
    """16 bit and float see the same filter, 8 bit too when shrinking (else nearly); 16 bits keep their depth."""
    ground = texture(300, 200, 1)[:, :, 0].astype(np.float64) / 255
    pixels = (ground * top).astype(dtype)
    size = (round(300 * scale), round(200 * scale))
    got = resize(pixels, size)
    assert got.dtype == dtype and got.shape == (size[1], size[0])
    exact = resize(ground.astype(np.float64), size)
    apart = np.abs(got.astype(np.float64) / top - np.clip(exact, 0, 1))
    if dtype == np.uint8 and scale > 1:
        assert apart.mean() < 3.0 / 255
    elif dtype != np.float32:
        assert apart.max() < (2.5 / 255 if dtype == np.uint8 else 1e-4)
    if dtype == np.uint16:
        assert len(np.unique(got)) > 256


@given(
    width=st.integers(20, 120),
    height=st.integers(20, 120),
    channels=st.integers(1, 10),
    scale=st.floats(0.2, 4.0),
    value=st.integers(0, 65535),
)
@settings(max_examples=60, deadline=None)
def test_flat_stays_flat_and_sizes_are_exact(width, height, channels, scale, value):
    pixels = np.full((height, width, channels), value, np.uint16)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    got = resize(pixels, size).reshape(size[1], size[0], -1)
    assert got.shape == (size[1], size[0], channels)
    assert np.all(np.abs(got.astype(int) - value) <= 1)


@pytest.mark.parametrize("scale", [0.4, 0.8, 2.0])
def test_no_shift_and_no_crop(scale):
    """The centre of a blob lies at the scaled place, half-pixel convention: any shift would move every camera."""
    y, x = np.mgrid[0:200, 0:300]
    blob = np.exp(-((x - 201.0) ** 2 + (y - 61.0) ** 2) / 200.0).astype(np.float32)
    size = (round(300 * scale), round(200 * scale))
    got = resize(blob, size).astype(np.float64)
    gy, gx = np.mgrid[0 : size[1], 0 : size[0]]
    assert (got * gx).sum() / got.sum() == pytest.approx((201.5 * size[0] / 300) - 0.5, abs=0.02)
    assert (got * gy).sum() / got.sum() == pytest.approx((61.5 * size[1] / 200) - 0.5, abs=0.02)


def test_channels_do_not_mix():
    pixels = texture(120, 90, 7).astype(np.uint16) * 200
    whole = resize(pixels, (96, 72))
    for c in range(7):
        alone = resize(np.ascontiguousarray(pixels[:, :, c]), (96, 72))
        assert np.max(np.abs(whole[:, :, c].astype(int) - alone)) <= 1


@pytest.mark.parametrize("scale", [0.4, 0.8, 1.6])
def test_no_data_neither_spreads_nor_vanishes(scale):
    pixels = np.full((100, 150), 21.5, np.float32)
    pixels[20:40, 30:60] = np.nan
    size = (round(150 * scale), round(100 * scale))
    got = resize(pixels, size)
    share = np.isnan(got).mean()
    assert share == pytest.approx(20 * 30 / (100 * 150), rel=0.15)
    assert np.nanmax(np.abs(got - 21.5)) < 1e-3


def test_masks_keep_their_values():
    mask = np.where(texture(100, 80, 1)[:, :, 0] > 128, 255, 0).astype(np.uint8)
    assert set(np.unique(resize_mask(mask, (77, 61)))) <= {0, 255}


def test_tables_reach_their_own_channel():
    pixels = np.zeros((4, 5, 3), np.uint8)
    tables = tuple(tuple(np.clip(np.arange(256) + shift, 0, 255).tolist()) for shift in (10, 20, 30))
    assert np.array_equal(recolour(pixels, tables, reverse=False)[0, 0], (10, 20, 30))
    assert np.array_equal(recolour(pixels, tables, reverse=True)[0, 0], (30, 20, 10))
    with pytest.raises(FrameError):
        recolour(pixels, tables[:1], reverse=False)


@pytest.mark.parametrize("size", [(80, 60), (160, 120)])
def test_table_and_size_in_one_pass(size):
    pixels = texture(120, 90)
    table = tuple(min(255, v + 20) for v in range(256))
    together = transform(pixels, size, (table,) * 3, reverse=True)
    apart = recolour(resize(pixels, size), (table,) * 3, reverse=True)
    assert psnr(together, apart) > 45


def test_quality_can_be_set():
    pixels = texture(320, 240)
    coarse, fine = (encode_jpeg(pixels, (1, 1), DEFAULTS.replaced({"jpeg_quality": q})) for q in (50, 95))
    assert len(coarse) < len(fine)
    assert psnr(decode_jpeg(fine, grey=False), pixels) > 35


def test_a_broken_picture_is_told():
    with pytest.raises(FrameError):
        decode_jpeg(b"\xff\xd8\xff\xe0nothing", grey=False)
