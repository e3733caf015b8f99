"""Black level, vignette and row gradient: MicaSense's model on real tags, then neutral to the last byte."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, TiffImagePlugin
from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize import tiff
from sensorgate.stages.harmonize.bands_radiometry import Correction, _without, correction_of, neutralised, treatment
from sensorgate.stages.harmonize.exif import TiffBlock
from sensorgate.stages.read import read_frame
from sensorgate.stages.thresholds import DEFAULTS

from .samples import exiftool, real

RED = "micasense_rededge_capture/IMG_0001_3.tif"
SEQUOIA = "garfield_sequoia_rgb_ms/IMG_161122_163234_0000_GRE.TIF"


def micasense_model(pixels: np.ndarray) -> np.ndarray:
    """The published formulas with the numbers that this file's tags hold, written out once more."""
    y, x = np.mgrid[0 : pixels.shape[0], 0 : pixels.shape[1]].astype(np.float64)
    r = np.hypot(x - 628.95289831697539, y - 480.16144463974564)
    k = (-0.00022360689745034781, 2.2756632515387831e-06, -1.4298858977590891e-08, 3.6725996024189289e-11,
         -4.3939063980634656e-14, 1.943339637034977e-17)  # fmt: skip
    vignette = 1.0 / np.polyval([*reversed(k), 1.0], r)
    a2, a3, exposure = 8.3674834746646526e-08, -1.0749358739540847e-05, 1.0 / 871
    row = 1.0 / (1.0 + a2 * y / exposure - a3 * y)
    return vignette * row * (pixels - 4800.0)


def test_real_frame_is_levelled_as_its_maker_says() -> None:
    data = real(RED).read_bytes()
    pixels = tiff.decode(data, DEFAULTS)
    correction = correction_of(data, DEFAULTS)
    assert correction is not None and correction.black == 4800.0
    # The exposure is a rational of its own in the file, 1/871 is how it prints: a relative 1e-3 of a small term.
    wanted = micasense_model(pixels[:, :, 0].astype(np.float64))
    assert np.abs(correction.applied(pixels)[:, :, 0] / wanted - 1.0)[np.abs(wanted) > 500].max() < 2e-4


def test_neutral_tags_change_numbers_only(tmp_path) -> None:  # type: ignore[no-untyped-def]
    source = real(RED)
    data = source.read_bytes()
    result = neutralised(data, DEFAULTS)
    assert len(result) == len(data)
    changed = [i for i in range(len(data)) if data[i] != result[i]]
    block = TiffBlock(bytearray(data))
    packet, black = block.find(block.first, 700), block.find(block.first, 0xC61A)
    assert packet is not None and black is not None
    inside = [(e.value_at, e.value_at + e.length) for e in (packet, black)]
    assert changed and all(any(low <= i < high for low, high in inside) for i in changed)
    path = tmp_path / source.name
    path.write_bytes(result)
    before = exiftool(source, "-a", "-G1", "-s", "-XMP:all").splitlines()
    after = exiftool(path, "-a", "-G1", "-s", "-XMP:all").splitlines()
    differing = {line.split("]")[1].split(":")[0].strip() for line in set(before) ^ set(after)}
    assert differing == {"VignettingPolynomial", "RadiometricCalibration"}
    told = exiftool(path, "-XMP-MicaSense:RadiometricCalibration", "-s3").split(",")
    assert [float(v) for v in told] == [0.00026046664063603917, 0.0, 0.0]
    assert exiftool(path, "-BlackLevel", "-s3").split() == ["0", "0", "0", "0"]


def test_neutral_is_identity_and_stays(tmp_path) -> None:  # type: ignore[no-untyped-def]
    result = neutralised(real(RED).read_bytes(), DEFAULTS)
    correction = correction_of(result, DEFAULTS)
    assert correction is not None
    pixels = tiff.decode(result, DEFAULTS)
    assert np.array_equal(correction.applied(pixels), pixels.astype(np.float32))
    assert neutralised(result, DEFAULTS) == result
    path = tmp_path / "a.tif"
    path.write_bytes(result)
    frame: Frame = read_frame(path)
    assert frame.capture_id and frame.bands == ("Red",) and frame.calibration is not None


def test_parrots_model_over_both_axes_is_read_and_stays_in_the_tags() -> None:
    """SEQ-AN-02: light is divided by a polynomial in x / width and y / height."""
    data = real(SEQUOIA).read_bytes()
    correction = correction_of(data, DEFAULTS)
    assert correction is not None and correction.form == "plane" and correction.kept
    assert treatment(data, DEFAULTS) == "kept"
    terms = [float(v) for v in exiftool(real(SEQUOIA), "-VignettingPolynomial2D", "-s3").split(",")]
    powers = [int(v) for v in exiftool(real(SEQUOIA), "-VignettingPolynomial2DName", "-s3").split(",")]
    told = exiftool(real(SEQUOIA), "-BlackLevel", "-s3").split()
    assert correction.black == pytest.approx(np.mean([float(v) for v in told]))
    level = correction.level((1280, 960))
    for x, y in ((0, 0), (640, 480), (1279, 17), (300, 959)):
        fall = sum(c * (x / 1280) ** i * (y / 960) ** j for c, i, j in zip(terms, powers[::2], powers[1::2]))
        assert level[y, x] == pytest.approx(1.0 / fall, rel=1e-5)


DJI_XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" xmlns:Camera="http://pix4d.com/camera/1.0/" '
    "{}/></rdf:RDF></x:xmpmeta>"
)
P4M = (
    'drone-dji:CalibratedOpticalCenterX="800.0" drone-dji:CalibratedOpticalCenterY="650.0" '
    'drone-dji:VignettingData="0.000218235, 1.20722E-06, -2.8676E-09, 5.1742E-12, -4.16853E-15, 1.36962E-18"'
)


def dji_file(folder: Path, attributes: str, *, black: bool = True) -> bytes:
    path = folder / "dji.tif"
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[271] = "DJI"
    if black:
        tags.tagtype[0xC61A] = 3
        tags[0xC61A] = 4096
    tags.tagtype[700] = 1
    tags[700] = DJI_XMP.format(attributes).encode()
    pixels = np.full((1300, 1600), 9000, np.uint16)
    Image.fromarray(pixels).save(path, tiffinfo=tags)
    return path.read_bytes()


def test_djis_model_multiplies_about_the_optical_center(tmp_path: Path) -> None:
    """The coefficients that DJI's P4 Multispectral image processing guide shows."""
    data = dji_file(tmp_path, P4M)
    correction = correction_of(data, DEFAULTS)
    assert correction is not None and correction.form == "gain" and correction.black == 4096.0
    assert treatment(data, DEFAULTS) == "kept"
    level = correction.level((1600, 1300))
    assert level[650, 800] == pytest.approx(1.0)
    r = np.hypot(800.0, 650.0)
    k = (0.000218235, 1.20722e-06, -2.8676e-09, 5.1742e-12, -4.16853e-15, 1.36962e-18)
    assert level[0, 0] == pytest.approx(1.0 + sum(v * r ** (i + 1) for i, v in enumerate(k)), rel=1e-4)
    assert level[0, 0] > 1.2


def test_a_mavics_own_center_goes_before_the_design(tmp_path: Path) -> None:
    own = 'Camera:VignettingCenter="700.5,600.25" Camera:VignettingPolynomial="1e-4,1e-7" Camera:BlackCurrent="3200" '
    correction = correction_of(dji_file(tmp_path, own + P4M, black=False), DEFAULTS)
    assert correction is not None and correction.form == "gain" and correction.kept
    assert (correction.center, correction.polynomial, correction.black) == ((700.5, 600.25), (1e-4, 1e-7), 3200.0)


@pytest.mark.parametrize(
    "attributes",
    [
        P4M.replace("drone-dji:CalibratedOpticalCenterX", "drone-dji:Other"),
        P4M.replace("0.000218235", "0.9"),
        P4M.replace("0.000218235", "nonsense"),
        'Camera:VignettingPolynomial2D="1,0.1" Camera:VignettingPolynomial2DName="0,0,1"',
        'Camera:VignettingPolynomial2D="1,0.1" Camera:VignettingPolynomial2DName="0,0,1,-1"',
        'Camera:VignettingPolynomial2D="1,-2" Camera:VignettingPolynomial2DName="0,0,1,0"',
        'Camera:RowGradient="0.1"',
    ],
)
def test_tags_in_no_published_form_void_reflectance(tmp_path: Path, attributes: str) -> None:
    data = dji_file(tmp_path, attributes)
    assert correction_of(data, DEFAULTS) is None
    assert treatment(data, DEFAULTS) == "none"


FORMS = {
    "loss": ((628.9, 480.1), (-2.2e-4, 2.2e-6, -1.4e-8, 3.6e-11, -4.4e-14, 1.9e-17), ()),
    "gain": ((640.0, 480.0), (2.0e-4, 1.2e-6, -2.8e-9, 5.1e-12, -4.1e-15, 1.3e-18), ()),
    "plane": ((0.0, 0.0), (0.7, 1.2, -1.2, 0.4, -0.4), ((0, 0), (1, 0), (2, 0), (0, 1), (0, 2))),
}


@given(
    form=st.sampled_from(sorted(FORMS)), black=st.floats(0, 6000), row=st.floats(-1e-4, 1e-4), grow=st.integers(1, 2)
)
@settings(max_examples=40, deadline=None)
def test_what_was_taken_off_and_put_back_is_what_it_was(form: str, black: float, row: float, grow: int) -> None:
    center, polynomial, powers = FORMS[form]
    correction = Correction(black, center, polynomial, row, form, powers, True)
    pixels = np.random.default_rng(3).uniform(500, 60000, (96, 128, 1)).astype(np.float32)
    there = correction.put_back(correction.applied(pixels), (128, 96))
    assert np.abs(there - pixels).max() < 0.05
    again = correction.level((128, 96), (128 * grow, 96 * grow))
    small = again.reshape(96, grow, 128, grow).mean(axis=(1, 3))
    assert np.abs(small / correction.level((128, 96)) - 1.0).max() < 1e-3


def test_warped_light_reads_as_its_tags_say_on_the_new_grid() -> None:
    """Even light over a vignetted band, moved by 40 pixels: levelled by the same tags it is even again."""
    from sensorgate.stages.harmonize.bands_lens import Lens
    from sensorgate.stages.harmonize.bands_work import warp_pixels

    data = real(SEQUOIA).read_bytes()
    correction = correction_of(data, DEFAULTS)
    assert correction is not None
    even = np.full((960, 1280, 1), 20000.0, np.float32)
    frame = np.rint(correction.put_back(even, (1280, 960))).astype(np.uint16)
    here = Lens(1280, 960, 1000.0, (639.5, 479.5))
    there = replace(here, center_px=(679.5, 464.5))
    moved = warp_pixels(correction.applied(frame), here, there, np.eye(3), np.nan)
    written = correction.put_back(moved, (1280, 960))
    seen = np.isfinite(written)
    assert 0.9 < seen.mean() < 0.99
    assert np.abs(correction.applied(np.nan_to_num(written))[seen] - 20000.0).max() < 3.0
    plain = warp_pixels(frame, here, there, np.eye(3))
    assert np.abs(correction.applied(plain)[seen] / 20000.0 - 1.0).max() > 0.01


def test_incomplete_tags_are_not_half_applied() -> None:
    data = bytearray(real(RED).read_bytes())
    block = TiffBlock(data)
    entry = block.find(block.first, 0xC61A)
    assert entry is not None
    struct.pack_into(block.order + "H", data, entry.at, 0xFFF0)
    assert correction_of(bytes(data), DEFAULTS) is None


@pytest.mark.parametrize(
    ("packet", "wanted"),
    [
        (
            b'<rdf:Description Camera:VignettingPolynomial="-1.5e-05,2.0,3" Camera:VignettingPolynomial2D="1,2"/>',
            b'<rdf:Description Camera:VignettingPolynomial="0.000000,0.0,0" Camera:VignettingPolynomial2D="1,2"/>',
        ),
        (
            b"<Camera:VignettingPolynomial>\n <rdf:Seq>\n <rdf:li>-1.25</rdf:li><rdf:li>7</rdf:li></rdf:Seq>"
            b"</Camera:VignettingPolynomial><Camera:Yaw>12</Camera:Yaw>",
            b"<Camera:VignettingPolynomial>\n <rdf:Seq>\n <rdf:li>0.000</rdf:li><rdf:li>0</rdf:li></rdf:Seq>"
            b"</Camera:VignettingPolynomial><Camera:Yaw>12</Camera:Yaw>",
        ),
    ],
)
def test_either_form_is_kept(packet: bytes, wanted: bytes) -> None:
    assert _without(packet, b"VignettingPolynomial", 0) == wanted


def test_first_coefficient_of_the_gradient_tag_is_kept() -> None:
    packet = b'<x MicaSense:RadiometricCalibration="2.6e-4, 8.3e-08, -1.0e-05" a:b="1"/>'
    assert _without(packet, b"RadiometricCalibration", 1) == (
        b'<x MicaSense:RadiometricCalibration="2.6e-4, 0.00000, 0.000000" a:b="1"/>'
    )
