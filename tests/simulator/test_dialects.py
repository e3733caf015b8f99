"""The simulator's files read back, by several readers, as what was meant."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.simulator import Plan, Receiver, catalogue, fly, render
from tests.simulator.checks import exif_of, flown_by
from tests.simulator.places import GROUND

cv2 = pytest.importorskip("cv2", reason="frames are rendered with OpenCV")


@pytest.fixture(scope="module")
def everything(tmp_path_factory):
    """Two frames or captures of every payload class, small."""
    payloads = (
        catalogue.phantom4pro(serial="0K9CE5R0A50012"),
        catalogue.kestrel(calibration="dewarp", lens="K 6.4 mm"),
        catalogue.compact(),
        catalogue.micasense(),
        catalogue.thermal(),
    )
    payloads = tuple(catalogue.with_band_size(p, 0.25) for p in payloads[:-1]) + payloads[-1:]
    receiver = Receiver(0.02, 0.03, rtk_flag=50, rtk_std_m=(0.012, 0.011, 0.024))
    plan = Plan(height_m=40.0, strips=1, per_strip=2)
    survey = flown_by(*payloads)
    shots = tuple(s for p in payloads for s in fly(p, plan, GROUND, 0, receiver))
    folder = tmp_path_factory.mktemp("everything")
    return render(replace(survey, shots=shots), folder), shots


def test_exif_reads_back_with_pillow(everything):
    truth, shots = everything
    for shot in shots:
        frame = truth.frame(shot.path)
        size, image, exif, gps, _ = exif_of(truth.image_dir / shot.path)
        said = shot.reported
        assert size == (frame.camera.width, frame.camera.height)
        assert (image[0x010F], image[0x0110]) == (said.make, said.model)
        if said.focal_mm is None:
            assert 37386 not in exif and 41989 not in exif and 41486 not in exif
        else:
            assert float(exif[37386]) == pytest.approx(said.focal_mm, abs=1e-3)
        if said.focal_plane_per_mm is not None:
            mm = {2: 25.4, 4: 1.0}[exif[41488]]
            width = size[0] / float(exif[41486]) * mm
            assert width == pytest.approx(frame.camera.sensor_width_mm, rel=1e-4)
            assert float(exif[37386]) / width == pytest.approx(frame.camera.focal_ratio, rel=0.02)
        if said.focal_35mm is not None:
            assert exif[41989] / 36.0 == pytest.approx(frame.camera.focal_ratio, rel=0.05)
        latitude = sum(float(v) / 60**i for i, v in enumerate(gps[2]))
        longitude = sum(float(v) / 60**i for i, v in enumerate(gps[4]))
        assert (latitude, longitude) == pytest.approx((said.latitude, said.longitude), abs=1e-8)
        assert float(gps[6]) == pytest.approx(said.altitude_m, abs=1e-3)
        # RTK positions are those of the body; the lens hangs at most a hand's breadth beside.
        assert said.altitude_m == pytest.approx(frame.altitude_m, abs=0.3)


def test_exifread_reads_the_same_focals(everything):
    exifread = pytest.importorskip("exifread", reason="the second referee for EXIF")
    truth, shots = everything
    for shot in shots:
        with open(truth.image_dir / shot.path, "rb") as stream:
            tags = exifread.process_file(stream, details=False)
        said = shot.reported
        if said.focal_mm is None:
            assert "EXIF FocalLength" not in tags
        else:
            assert float(tags["EXIF FocalLength"].values[0]) == pytest.approx(said.focal_mm, abs=1e-3)


@pytest.mark.skipif(shutil.which("exiftool") is None, reason="exiftool is not installed")
def test_exiftool_reads_every_dialect(everything):
    truth, shots = everything
    names = [str(truth.image_dir / s.path) for s in shots]
    done = subprocess.run(["exiftool", "-json", "-n", "-G0", *names], capture_output=True, check=True)
    for shot, tags in zip(shots, json.loads(done.stdout)):
        frame, said = truth.frame(shot.path), shot.reported
        assert "ExifTool:Error" not in tags
        if frame.payload in ("p4p", "kestrel", "thermal"):
            assert float(tags["XMP:RelativeAltitude"]) == pytest.approx(said.relative_altitude_m, abs=1e-3)
            assert float(tags["XMP:GimbalPitchDegree"]) == pytest.approx(shot.pitch_deg, abs=0.01)
            assert int(tags["XMP:RtkFlag"]) == 50
        if frame.payload == "kestrel":
            numbers = [float(v) for v in tags["XMP:DewarpData"].split(";")[1].split(",")]
            assert numbers[0] == pytest.approx(frame.camera.focal_ratio * frame.camera.width, abs=1e-6)
            assert numbers[4:] == pytest.approx(frame.camera.distortion, abs=1e-8)
        if frame.payload == "thermal":
            assert "APP3:ThermalData" in tags or "APP:ThermalData" in tags or any("ThermalData" in k for k in tags)
        if frame.payload == "rededge":
            assert tags["XMP:BandName"] == frame.band
            assert tags["XMP:CaptureId"] == said.capture_id
            pixel = frame.camera.sensor_width_mm / frame.camera.width
            focal = frame.camera.focal_ratio * frame.camera.width * pixel
            assert float(tags["XMP:PerspectiveFocalLength"]) == pytest.approx(focal, abs=1e-5)
            k1, k2, p1, p2, k3 = frame.camera.distortion
            assert [float(v) for v in tags["XMP:PerspectiveDistortion"]] == pytest.approx([k1, k2, k3, p1, p2])


def test_a_rig_writes_five_mono_files_with_the_packet_at_the_end(everything):
    truth, _ = everything
    frames = [f for f in truth.of("rededge") if f.capture.endswith("0001")]
    assert [Path(f.path).name for f in frames] == [f"IMG_0001_{i}.tif" for i in range(1, 6)]
    assert len({f.profile for f in frames}) == 5
    for frame in frames:
        data = (truth.image_dir / frame.path).read_bytes()
        pixels = frame.camera.width * frame.camera.height * 2
        assert data.index(b"<x:xmpmeta") > pixels
        _, image, _, _, _ = exif_of(truth.image_dir / frame.path)
        assert float(image[0xC61A][0]) == 4800.0
        counts = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert counts.dtype == np.uint16 and counts.ndim == 2
        assert 4800 < counts.mean() < 60000 and counts.std() > 300


def test_thermal_keeps_its_raw_counts_beside_the_picture(everything):
    truth, _ = everything
    frame = truth.of("thermal")[0]
    data = (truth.image_dir / frame.path).read_bytes()
    raw, at = b"", 2
    while data[at + 1] != 0xDA:
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        if data[at + 1] == 0xE3:
            raw += data[at + 4 : at + 2 + length]
        at += 2 + length
    counts = np.frombuffer(raw, "<u2").reshape(512, 640).astype(float)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE).astype(float)
    inside = (picture > 5) & (picture < 250)
    assert np.corrcoef(counts[inside], picture[inside])[0, 1] > 0.98


@pytest.fixture(scope="module")
def makers(tmp_path_factory):
    """One frame or capture of Parrot's and FLIR's cameras."""
    duo = replace(catalogue.vue_pro("duo"), dialect="flir-jpeg", model="Duo Pro R", name_pattern="R{number:04d}.JPG")
    payloads = [catalogue.with_band_size(p, 0.25) for p in (catalogue.anafi(), catalogue.sequoia())]
    payloads += [catalogue.with_band_size(catalogue.sequoia_rgb(), 0.25), catalogue.vue_pro(), duo]
    survey = flown_by(*payloads, plan=Plan(height_m=40.0, strips=1, per_strip=1))
    return render(survey, tmp_path_factory.mktemp("makers"))


@pytest.mark.skipif(shutil.which("exiftool") is None, reason="exiftool is not installed")
def test_exiftool_reads_parrot_and_flir(makers):
    names = [str(makers.image_dir / f.path) for f in makers.frames]
    done = subprocess.run(["exiftool", "-json", "-n", "-G1", *names], capture_output=True, check=True)
    for frame, tags in zip(makers.frames, json.loads(done.stdout)):
        assert "ExifTool:Error" not in tags
        assert tags["IFD0:Make"] == ("Parrot" if frame.payload in ("anafi", "sequoia", "sequoia-rgb") else "FLIR")
        camera = frame.camera
        if frame.payload == "sequoia":
            affine = [float(v) for v in tags["XMP-Camera:FisheyeAffineMatrix"].split(",")]
            assert affine[0] == affine[3] == pytest.approx(camera.focal_ratio * camera.width * np.pi / 2.0)
            assert [float(v) for v in tags["XMP-Camera:FisheyePolynomial"].split(",")[2:]] == list(camera.fisheye)
            assert tags["XMP-Camera:BandName"] == frame.band
            assert abs(float(tags["XMP-Camera:Pitch"])) < 5.0
            assert tags["IFD0:StripOffsets"] < 10_000
        if frame.payload == "sequoia-rgb":
            k1, k2, p1, p2, k3 = camera.distortion
            told = [float(v) for v in tags["XMP-Camera:PerspectiveDistortion"].split(",")]
            assert told == pytest.approx([k1, k2, k3, p1, p2])
            assert "XMP-Camera:CaptureUUID" not in tags
        if frame.payload == "anafi":
            assert float(tags["XMP-drone-parrot:CameraPitchDegree"]) == pytest.approx(-90.0, abs=5.0)
        if frame.payload == "duo":
            assert (tags["FLIR:RawThermalImageWidth"], tags["FLIR:RawThermalImageHeight"]) == (640, 512)


def test_a_vue_pro_writes_kelvin(makers):
    (frame,) = makers.of("vue")
    counts = cv2.imread(str(makers.image_dir / frame.path), cv2.IMREAD_UNCHANGED)
    assert counts.dtype == np.uint16 and counts.shape == (512, 640)
    assert 10.0 < float(np.median(counts)) * 0.04 - 273.15 < 60.0
