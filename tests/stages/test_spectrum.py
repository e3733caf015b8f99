"""Spectrum and band: truth of the real frames, and every kind of evidence alone."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any, Optional, Tuple

import pytest
from sensorgate.stages.frame import Frame
from sensorgate.stages.read import read_frame
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.spectrum import classify, normalise_band

SHEET = load_sheet()
REAL = Path(__file__).resolve().parents[2].parent / "shared/data/real_frames"


def frame(name: str = "IMG_0001.JPG", width: int = 4000, height: int = 3000, **facts: Any) -> Frame:
    tiff = name.lower().endswith((".tif", ".tiff"))
    return replace(
        Frame(path=f"in/{name}", size_bytes=1, format="tiff" if tiff else "jpeg", width=width, height=height), **facts
    )


def mono(name: str = "IMG_0001.tif", width: int = 1280, height: int = 960, **facts: Any) -> Frame:
    return frame(name, width, height, **{"bits": 16, "channels": 1, **facts})


def test_every_real_frame() -> None:
    manifest = REAL / "MANIFEST.csv"
    if not manifest.exists():
        pytest.skip("the real frames are not here")
    with manifest.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 48
    for row in rows:
        truth = row["spectrum_truth"]
        found = classify(read_frame(REAL / row["file"], row["file"]), SHEET)
        expected = (
            (truth, {"rgb": "rgb", "thermal": "lwir"}[truth])
            if truth in ("rgb", "thermal")
            else ("multispectral", truth)
        )
        assert (found.spectrum, found.band) == expected, (row["file"], found)


@pytest.mark.parametrize(
    "name, wavelength, band",
    [
        ("Blue", None, "blue"),
        ("Red edge", 717.0, "rededge"),
        ("RedEdge", None, "rededge"),
        ("red_edge", None, "rededge"),
        ("NIR", 840.0, "nir"),
        ("Near IR", None, "nir"),
        ("Panchro", 634.5, "pan"),
        ("LWIR", 11000.0, "lwir"),
        ("Blue-444", 444.0, "blue-444"),
        ("Green-531", None, "green-531"),
        ("Red-650", None, "red-650"),
        ("Red edge-705", None, "rededge-705"),
        ("Red edge-740", None, "rededge-740"),
        ("Green-560", None, "green"),
        ("Red-668", None, "red"),
        ("NIR-842", None, "nir"),
        ("RGB", None, "rgb"),
        ("", 650.0, "red"),
        ("", 10000.0, "lwir"),
        ("", None, ""),
        ("Swir-1550", None, "swir-1550"),
    ],
)
def test_band_names(name: str, wavelength: Optional[float], band: str) -> None:
    assert normalise_band(name, wavelength) == band


CASES = [
    ("band list of a colour camera", frame(bands=("Red", "Green", "Blue")), ("rgb", "rgb")),
    ("band list as one text", frame(bands=("Red, Green, Blue",)), ("rgb", "rgb")),
    ("rgb stored as tiff", frame("scan.tif", bits=8, channels=3), ("rgb", "rgb")),
    ("16-bit rgb tiff", frame("scan.tif", bits=16, channels=3), ("rgb", "rgb")),
    ("named band", mono(bands=("NIR",), wavelength_nm=840.0), ("multispectral", "nir")),
    ("wavelength alone", mono(wavelength_nm=560.0), ("multispectral", "green")),
    ("three filter bands in one picture", frame(bands=("Red", "Green", "NIR")), ("multispectral", "red+green+nir")),
    ("thermal source", frame(width=640, height=512, image_source="InfraredCamera"), ("thermal", "lwir")),
    ("wide source", frame(make="DJI", model="M3T", image_source="WideCamera"), ("rgb", "rgb")),
    ("payload", frame(width=640, height=512, thermal_payload="DJI raw in APP3"), ("thermal", "lwir")),
    ("payload beats nothing in a large picture", frame(thermal_payload="?"), ("rgb", "rgb")),
    (
        "payload in a frame whose camera says that it is wide",
        frame(width=1280, height=960, thermal_payload="x", image_source="WideCamera"),
        ("rgb", "rgb"),
    ),
    (
        "M2EA thermal, everything stripped",
        frame(width=640, height=512, make="DJI", model="MAVIC2-ENTERPRISE-ADVANCED"),
        ("thermal", "lwir"),
    ),
    (
        "M2EA visible",
        frame(width=8000, height=6000, make="DJI", model="MAVIC2-ENTERPRISE-ADVANCED"),
        ("rgb", "rgb"),
    ),
    ("M2E Dual thermal", frame(width=640, height=480, make="DJI", model="FC2403"), ("thermal", "lwir")),
    ("M2E Dual visible", frame(width=4056, height=3040, make="DJI", model="FC2403"), ("rgb", "rgb")),
    ("M30T super resolution", frame(width=1280, height=1024, make="DJI", model="M30T"), ("thermal", "lwir")),
    ("P4M colour", frame(width=1600, height=1300, make="DJI", model="FC6360"), ("rgb", "rgb")),
    (
        "P4M band",
        mono("DJI_0011.TIF", 1600, 1300, make="DJI", model="FC6360", bands=("Blue",)),
        ("multispectral", "blue"),
    ),
    (
        "M3M band by its name alone",
        mono("DJI_20230101_0001_MS_RE.TIF", 2592, 1944, make="DJI", model="M3M"),
        ("multispectral", "rededge"),
    ),
    (
        "M3M band by the name of its camera",
        mono("x.tif", 2592, 1944, make="DJI", model="M3M", image_source="MSRECamera"),
        ("multispectral", "rededge"),
    ),
    ("M3M colour", frame(width=5280, height=3956, make="DJI", model="M3M", image_source="RGBCamera"), ("rgb", "rgb")),
    (
        "RedEdge band by its place in the rig",
        mono("IMG_0042_4.tif", make="MicaSense", model="RedEdge"),
        ("multispectral", "nir"),
    ),
    (
        "Altum thermal by its size",
        mono("IMG_0042_6.tif", 160, 120, make="MicaSense", model="Altum"),
        ("thermal", "lwir"),
    ),
    (
        "second red edge by its wavelength",
        mono(make="MicaSense", model="RedEdge-M", bands=("Red Edge",), wavelength_nm=705.0),
        ("multispectral", "rededge-705"),
    ),
    ("temperatures", mono("t.tif", 640, 512, bits=32, sample_format="float"), ("thermal", "lwir")),
    (
        "reflectance with a band",
        mono("r.tif", bits=32, sample_format="float", bands=("Green",)),
        ("multispectral", "green"),
    ),
    ("unknown single channel", mono(), ("multispectral", "mono")),
    ("unknown single channel of thermal size", mono("a.tif", 640, 512), ("thermal", "lwir")),
    ("file name is the last hint", frame("DJI_0001_T.JPG", 640, 512), ("thermal", "lwir")),
    ("a name alone makes no thermal frame", frame("DJI_0001_T.JPG", 4000, 3000), ("rgb", "rgb")),
    ("small colour picture", frame("photo.jpg", 640, 480), ("rgb", "rgb")),
    ("near infrared converted", frame(make="Canon", model="Canon PowerShot S110"), ("rgb", "rgb")),
    ("unknown model of a maker", frame(width=640, height=512, make="DJI", model="M99T"), ("thermal", "lwir")),
    ("unknown handheld", frame(width=320, height=240, make="FLIR", model="FLIR E8"), ("thermal", "lwir")),
    ("unknown model in another size", frame(make="DJI", model="M99T"), ("rgb", "rgb")),
    ("size alone", frame(width=640, height=512, make="Nobody", model="X"), ("rgb", "rgb")),
    ("a stack of bands in one file", frame("s.tif", bits=16, channels=5), ("multispectral", "stack")),
    ("colour with transparency", frame("s.png", channels=4), ("rgb", "rgb")),
    ("grey with transparency", mono("g.tif", channels=2), ("multispectral", "mono")),
    ("nothing known", frame(), ("rgb", "rgb")),
]


@pytest.mark.parametrize("case, shown, truth", CASES, ids=[c[0] for c in CASES])
def test_each_kind_of_evidence(case: str, shown: Frame, truth: Tuple[str, str]) -> None:
    found = classify(shown, SHEET)
    assert (found.spectrum, found.band) == truth, found.evidence
    assert found.evidence


def test_file_name_hints_are_said() -> None:
    hinted = classify(frame("DJI_0001_T.JPG", 640, 512), SHEET)
    assert "file name" in hinted.evidence
    assert "file name" in classify(mono("IMG_0042_4.tif", make="MicaSense", model="RedEdge"), SHEET).evidence


def test_explicit_band_beats_the_file_name() -> None:
    shown = mono("IMG_0001_NIR.tif", bands=("Red",), wavelength_nm=660.0)
    assert classify(shown, SHEET).band == "red"
