"""Temperature or picture: what ODM 3.6 does with each thermal camera."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.plugin.odm.thermal import known_as_thermal, thermal_reading
from sensorgate.stages.frame import Frame
from sensorgate.stages.read import scan

from tests.frames import REAL

RJPEG = Frame(
    path="a.JPG", size_bytes=1, format="jpeg", width=640, height=512, make="DJI", model="MAVIC2-ENTERPRISE-ADVANCED",
    thermal_payload="DJI raw in APP3",
)  # fmt: skip
ALTUM = Frame(
    path="a.tif", size_bytes=1, format="tiff", width=160, height=120, bits=16, channels=1, make="MicaSense",
    model="Altum", bands=("LWIR",),
)  # fmt: skip


@pytest.mark.parametrize(
    ("frame", "band", "temperature"),
    [
        (RJPEG, "RGB", True),
        (replace(RJPEG, thermal_payload=""), "RGB", False),
        (replace(RJPEG, width=1280, height=1024), "RGB", False),
        (replace(RJPEG, model="ZH20T"), "RGB", False),
        (replace(RJPEG, model="ZH20T", format="tiff", bits=16, channels=1, thermal_payload=""), "RGB", True),
        (replace(RJPEG, model="M3T"), "RGB", False),
        (replace(RJPEG, model="FLIR", thermal_payload="FLIR FFF in APP1"), "LWIR", False),
        (ALTUM, "LWIR", True),
        (replace(ALTUM, model="Altum-PT"), "LWIR", True),
        (replace(ALTUM, make="Sentera", model="6X"), "LWIR", False),
        (replace(ALTUM, model="Any", bits=32, sample_format="float"), "RGB", True),
    ],
)
def test_temperature_or_not(frame, band, temperature):
    text = thermal_reading(frame, band)
    said = "as temperature in degrees" in text or "as they are: temperature" in text
    assert said == temperature, text
    assert "ODM 3.6" in text
    assert temperature or any(word in text for word in ("convert", "scale", "as the camera wrote", "no raw temp")), text


def test_flir_payloads_are_sent_to_flirs_tools_and_djis_to_djis():
    assert "FLIR's tools" in thermal_reading(replace(RJPEG, model="XT2", thermal_payload="FLIR FFF in APP1"), "LWIR")
    assert "DJI's Thermal SDK" in thermal_reading(replace(RJPEG, model="M30T"), "RGB")


def test_known_as_thermal_needs_the_native_size_or_the_band():
    assert known_as_thermal(RJPEG, "RGB")
    assert not known_as_thermal(replace(RJPEG, width=1280, height=1024), "RGB")
    assert known_as_thermal(replace(RJPEG, model="Else", width=1, height=1), "lwir")


@pytest.mark.skipif(not REAL.exists(), reason="the real frames are not here")
def test_real_thermal_frames():
    frames = {f.path.split("/")[-2]: f for f in scan([str(REAL / "thermal_samples")]).frames}
    read = {k: thermal_reading(f, f.bands[0] if f.bands else "RGB") for k, f in frames.items()}
    assert "as temperature in degrees" in read["dji-m2ea-thermal"]
    assert "does not know these frames as thermal" in read["dji-m30t-thermal"]
    assert "does not read its raw data" in read["dji-zh20t-thermal"]
    assert "FLIR's tools" in read["dji-zenmuse-xt2"]
