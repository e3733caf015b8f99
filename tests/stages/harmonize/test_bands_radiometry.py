"""Black level, vignette and row gradient: MicaSense's model on real tags, then neutral to the last byte."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize import tiff
from sensorgate.stages.harmonize.bands_radiometry import _without, can_be_applied, correction_of, neutralised
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


def test_a_maker_with_another_model_is_left_to_none() -> None:
    data = real(SEQUOIA).read_bytes()
    assert correction_of(data, DEFAULTS) is None
    assert not can_be_applied(data, DEFAULTS)


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
