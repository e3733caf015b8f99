"""The simulator's files say what they should, and its frames show what its truth says."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.simulator import Plan, Receiver, Survey, catalogue, fly, lies, render, stories
from tests.simulator.camera import Camera, distort, look, project, rays, undistort
from tests.simulator.dialects import WRITERS
from tests.simulator.geo import Origin, utm, utm_zone
from tests.simulator.materials import ID
from tests.simulator.run import render_shot, world_of
from tests.simulator.stories import GROUND, STORIES, build
from tests.simulator.survey import ControlPoint, Scene

cv2 = pytest.importorskip("cv2", reason="frames are rendered with OpenCV")


def survey_of(*payloads, plan=None, points=(), scene=GROUND, name="test"):
    plan = plan or Plan(height_m=40.0, strips=1, per_strip=2)
    shots = tuple(s for p in payloads for s in fly(p, plan, scene, 0))
    return Survey(name, (scene,), tuple(payloads), shots, tuple(points))


def digests(folder):
    files = sorted(p for p in Path(folder).rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return render("tiny", tmp_path_factory.mktemp("tiny"))


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
    survey = survey_of(*payloads)
    flown = tuple(s for p in payloads for s in fly(p, plan, GROUND, 0, receiver))
    folder = tmp_path_factory.mktemp("everything")
    return render(replace(survey, shots=flown), folder), flown


# --- coordinates and optics ------------------------------------------------------


def test_enu_goes_to_degrees_and_back():
    origin = Origin(-33.4, 151.2, 62.0)
    place = origin.to_geodetic(812.0, -455.0, 97.0)
    assert origin.to_enu(*place) == pytest.approx((812.0, -455.0, 97.0), abs=1e-4)
    north = origin.to_geodetic(0.0, 100.0, 0.0)
    assert (north[0] - origin.latitude) * 110.92e3 == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize("place", [(47.2184, 8.7315), (-33.4, 151.2), (64.1, -21.9), (0.2, -78.5)])
def test_utm_agrees_with_proj(place):
    pyproj = pytest.importorskip("pyproj", reason="the referee for UTM")
    zone = utm_zone(place[1])
    code = (32600 if place[0] >= 0 else 32700) + zone
    expected = pyproj.Transformer.from_crs(4326, code, always_xy=True).transform(place[1], place[0])
    assert utm(*place, zone) == pytest.approx(expected, abs=1e-3)


def test_projection_agrees_with_opencv():
    camera = Camera(1280, 960, 0.73, (5.5, -4.0), (-0.085, 0.061, 0.0006, -0.0004, -0.012))
    rotation, center = look(37.0, -78.0, 4.0), np.array([3.0, -8.0, 55.0])
    points = np.array([[3.0, -4.0, 1.0], [-12.0, 2.0, 0.0], [14.0, 9.0, 3.0]])
    cx, cy = camera.principal_px
    matrix = np.array([[camera.focal_px, 0, cx], [0, camera.focal_px, cy], [0, 0, 1]])
    turn = cv2.Rodrigues(rotation)[0]
    expected = cv2.projectPoints(points, turn, -rotation @ center, matrix, np.array(camera.distortion))[0][:, 0]
    assert project(points, camera, rotation, center) == pytest.approx(expected, abs=1e-6)


def test_undistort_inverts_distort_and_rays_use_it():
    camera = Camera(640, 480, 0.7, (2.0, 1.0), (-0.1, 0.13, 0.0005, -0.0003, 0.01))
    x, y = rays(camera, 1)
    back = distort(np.stack((x, y), axis=-1).astype(float), camera.distortion) * camera.focal_px
    rows, columns = np.mgrid[0:480, 0:640]
    assert np.abs(back[..., 0] + camera.principal_px[0] - columns).max() < 2e-3
    assert np.abs(back[..., 1] + camera.principal_px[1] - rows).max() < 2e-3
    spot = np.array([[0.4, -0.3]])
    assert distort(undistort(spot, camera.distortion), camera.distortion) == pytest.approx(spot, abs=1e-8)


def test_a_fisheye_is_pix4ds():
    camera = Camera(1280, 960, 0.83, (20.0, -9.0), fisheye=(0.0059, -0.137))
    ray = np.array([[0.6, -0.45]])
    share = np.arctan(0.75) * 2.0 / np.pi
    affine = camera.focal_px * np.pi / 2.0
    expected = affine * (share + 0.0059 * share**2 - 0.137 * share**3) * ray / 0.75
    assert camera.bend(ray) * camera.focal_px == pytest.approx(expected)
    assert camera.unbend(camera.bend(ray)) == pytest.approx(ray, abs=1e-7)


def test_a_gimbal_looks_where_it_says():
    nadir = look(0.0, -90.0, 0.0)
    assert nadir[0] == pytest.approx([1, 0, 0], abs=1e-12)  # right is east
    assert nadir[1] == pytest.approx([0, -1, 0], abs=1e-12)  # down in the frame is south
    assert look(90.0, 0.0, 0.0)[2] == pytest.approx([1, 0, 0], abs=1e-12)  # level, facing east


# --- files -----------------------------------------------------------------------


def test_same_seed_same_bytes(tmp_path):
    survey = survey_of(*(catalogue.with_band_size(p, 0.25) for p in (catalogue.phantom4pro(), catalogue.micasense())))
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        render(survey, tmp_path / name, seed)
    assert digests(tmp_path / "a") == digests(tmp_path / "b")
    first, other = digests(tmp_path / "a"), digests(tmp_path / "c")
    assert set(first) == set(other)
    assert all(first[k] != other[k] for k in first)


def test_truth_says_nothing_of_this_machine(tiny):
    text = (Path(tiny.folder) / "truth.json").read_text(encoding="utf-8")
    assert tiny.folder not in text
    assert json.loads(text)["frames"][0]["path"] == "p4p/DJI_0001.JPG"
    assert len(tiny.frames) == 8


def exif_of(path):
    from PIL import Image

    with Image.open(path) as image:
        exif = image.getexif()
        return image.size, exif, exif.get_ifd(0x8769), exif.get_ifd(0x8825), dict(image.info)


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
    survey = survey_of(*payloads, plan=Plan(height_m=40.0, strips=1, per_strip=1))
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


# --- what the frames show ----------------------------------------------------------


def mark_error(image, mark):
    """Distance (px) from a mark to the crossing that the frame shows there."""
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    gray = cv2.normalize(gray.astype(np.float32), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    start = np.array([[[mark.x_px, mark.y_px]]], np.float32)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 0.001)
    found = cv2.cornerSubPix(gray, start.copy(), (4, 4), (-1, -1), stop)
    return float(np.hypot(*(found - start).ravel()))


def test_targets_lie_where_the_truth_says(tmp_path):
    points = [ControlPoint(f"p{i}", GROUND.id, x, y) for i, (x, y) in enumerate([(0, 0), (-11, 6), (10, -7), (9, 8)])]
    cameras = (catalogue.phantom4pro(), catalogue.kestrel(), catalogue.micasense(folder="ms"))
    plan = Plan(height_m=42.0, strips=1, per_strip=2, forward=0.8)
    truth = render(survey_of(*cameras, plan=plan, points=points), tmp_path)
    errors = {}
    for point in truth.points:
        for mark in point.marks:
            image = cv2.imread(str(truth.image_dir / mark.path), cv2.IMREAD_UNCHANGED)
            errors.setdefault(truth.frame(mark.path).profile, []).append(mark_error(image, mark))
    assert len(errors) == 7
    for profile, found in errors.items():
        assert len(found) >= 4, profile
        assert np.median(found) < 0.15, profile
        assert max(found) < 0.3, profile


def test_rows_read_one_after_another_and_fisheyes_show_targets_where_the_truth_says(tmp_path):
    points = [ControlPoint(f"p{i}", GROUND.id, x, y) for i, (x, y) in enumerate([(0, 0), (-9, 5), (8, -6), (8, 6)])]
    slow = catalogue.with_band_size(catalogue.anafi(), 0.6)
    slow = replace(slow, bands=(replace(slow.bands[0], readout_s=0.4),))
    fish = catalogue.sequoia()
    fish = catalogue.with_band_size(replace(fish, bands=fish.bands[:1]), 0.6)
    plan = Plan(height_m=26.0, strips=1, per_strip=2, forward=0.8, speed_mps=10.0)
    survey = survey_of(slow, fish, plan=plan, points=points)
    truth = render(survey, tmp_path)
    still = replace(survey, shots=tuple(replace(s, velocity_mps=(0.0, 0.0)) for s in survey.shots))
    errors, moved = {}, []
    for point in truth.points:
        for mark in point.marks:
            image = cv2.imread(str(truth.image_dir / mark.path), cv2.IMREAD_UNCHANGED)
            errors.setdefault(truth.frame(mark.path).payload, []).append(mark_error(image, mark))
            shot = next(s for s in still.shots if s.path == mark.path)
            payload = survey.payload(shot.payload)
            xyz = np.array([[point.east_m, point.north_m, point.up_m]])
            there = project(xyz, shot.optics(payload), shot.rotation(payload), np.array(shot.position))[0]
            moved.append(float(np.hypot(*(there - (mark.x_px, mark.y_px)))))
    assert max(moved) > 10.0
    assert set(errors) == {"anafi", "sequoia"}
    for found in errors.values():
        assert len(found) >= 4
        assert np.median(found) < 0.15 and max(found) < 0.3


def test_gcp_file_is_odms(tiny):
    lines = (Path(tiny.folder) / "gcp_list.txt").read_text().splitlines()
    assert lines[0] == "WGS84 UTM 32N"
    marks = {(m.path.rsplit("/", 1)[-1], p.id): (p, m) for p in tiny.points for m in p.marks}
    assert len(lines) == 1 + len(marks)
    for line in lines[1:]:
        x, y, z, px, py, name, gcp = line.split()
        point, mark = marks[name, gcp]
        assert (float(x), float(y)) == pytest.approx(utm(point.latitude, point.longitude, 32), abs=1e-3)
        assert (float(z), float(px), float(py)) == pytest.approx((point.altitude_m, mark.x_px, mark.y_px), abs=1e-3)


def features(path):
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image.dtype != np.uint8:
        image = np.clip(image / np.percentile(image, 99.5) * 255, 0, 255).astype(np.uint8)
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    keys, words = cv2.SIFT_create(4000, contrastThreshold=0.02).detectAndCompute(image, None)
    words = np.sqrt(words / (words.sum(axis=1, keepdims=True) + 1e-9))
    return np.array([k.pt for k in keys]), words


def matched(a, b, ratio=0.8):
    """Mutual nearest neighbours under Lowe's ratio, as pixel pairs."""
    there = cv2.BFMatcher().knnMatch(a[1], b[1], 2)
    back = {m.queryIdx: m.trainIdx for m in cv2.BFMatcher().match(b[1], a[1])}
    good = [m for m, n in there if m.distance < ratio * n.distance and back[m.trainIdx] == m.queryIdx]
    return a[0][[m.queryIdx for m in good]], b[0][[m.trainIdx for m in good]]


def verified(first, second):
    if len(first) < 8:
        return 0
    mask = cv2.findFundamentalMat(first, second, cv2.USAC_MAGSAC, 2.0, 0.999, 5000)[1]
    return 0 if mask is None else int(mask.sum())


def epipolar_px(truth_a, truth_b, first, second):
    """Distance (px) of matches to the epipolar lines of the *true* geometry."""

    def bearing(frame, pixels):
        c = frame.camera
        camera = Camera(c.width, c.height, c.focal_ratio, c.center_px, c.distortion)
        xy = undistort((pixels - np.array(camera.principal_px)) / camera.focal_px, camera.distortion)
        return np.column_stack((xy, np.ones(len(xy)))), camera.focal_px

    rays_a, _ = bearing(truth_a, first)
    rays_b, focal = bearing(truth_b, second)
    ra, rb = np.array(truth_a.rotation), np.array(truth_b.rotation)
    t = rb @ (np.array(truth_a.center_m) - np.array(truth_b.center_m))
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    lines = rays_a @ (cross @ rb @ ra.T).T
    return np.abs((lines * rays_b).sum(axis=1)) / np.hypot(lines[:, 0], lines[:, 1]) * focal


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    """Neighbours at 75 % overlap of three spectra at survey size, and frames of another scene."""
    payloads = (catalogue.phantom4pro(), catalogue.kestrel(), catalogue.thermal())
    survey = survey_of(*payloads, plan=Plan(height_m=60.0, strips=1, per_strip=3))
    other = Scene("other", GROUND.origin, key="other")
    stranger = catalogue.compact()
    flown = fly(stranger, Plan(height_m=55.0, strips=1, per_strip=2), other, 0)
    survey = replace(survey, scenes=(GROUND, other), payloads=(*payloads, stranger), shots=survey.shots + flown)
    return render(survey, tmp_path_factory.mktemp("strip"))


@pytest.mark.parametrize(("payload", "least"), [("p4p", 200), ("kestrel", 200), ("thermal", 120)])
def test_neighbours_match_and_agree_with_the_true_geometry(strip, payload, least):
    frames = strip.of(payload)
    found = [features(strip.image_dir / f.path) for f in frames]
    for a, b, fa, fb in zip(frames, frames[1:], found, found[1:]):
        first, second = matched(fa, fb)
        right = epipolar_px(a, b, first, second) < 1.5
        assert right.sum() >= least
        assert right.mean() > 0.85
        assert np.median(epipolar_px(a, b, first, second)[right]) < 0.35


def test_other_ground_and_other_spectrum_do_not_match(strip):
    here = [features(strip.image_dir / f.path) for f in strip.of("p4p")]
    there = [features(strip.image_dir / f.path) for f in strip.of("compact")]
    heat = [features(strip.image_dir / f.path) for f in strip.of("thermal")]
    assert max(verified(*matched(a, b)) for a in here for b in there) < 15
    assert max(verified(*matched(a, b)) for a, b in zip(here, heat)) < 30


def test_ground_far_apart_in_one_scene_does_not_match(tmp_path):
    camera = catalogue.phantom4pro()
    survey = survey_of(camera, plan=Plan(height_m=60.0, strips=1, per_strip=2, forward=-0.3))
    truth = render(survey, tmp_path)
    a, b = (features(truth.image_dir / f.path) for f in truth.frames)
    assert verified(*matched(a, b)) < 15


def test_vegetation_is_dark_in_red_and_bright_in_infrared_and_cool():
    survey = survey_of(catalogue.with_band_size(catalogue.micasense(), 0.25))
    world = world_of(survey, GROUND, 0)
    green = (world.ground.material == 0) & (world.ground.grass > 0.8) & (world.ground.dry < 0.2)
    bare = (world.ground.material == 0) & (world.ground.grass < 0.15)
    red, nir = (world.layer((c,), 1e-6)[0].astype(float) for c in ("ms-red", "ms-nir"))
    heat = world.layer(("thermal",), 1e-6)[0].astype(float)
    index = (nir - red) / (nir + red)
    assert np.median(index[green]) > 0.6
    assert np.median(index[bare]) < 0.3
    assert np.median(heat[green]) < np.median(heat[bare])
    road = world.ground.material == ID["asphalt"]
    if road.any():
        assert np.median(heat[road]) > np.median(heat[green])


def test_true_height_is_above_the_ground_that_is_seen(tiny):
    for frame in tiny.frames:
        assert frame.mean_height_m == pytest.approx(45.0, abs=9.0)
        width = frame.camera.focal_ratio * frame.camera.width
        assert frame.gsd_cm == pytest.approx(100 * frame.mean_height_m / width)


# --- stories and lies ----------------------------------------------------------------


@pytest.mark.parametrize("name", list(STORIES))
def test_every_story_is_sound(name):
    survey = build(name, 0)
    paths = [s.path for s in survey.shots]
    assert len(set(paths)) == len(paths)
    assert len({p.rsplit("/", 1)[-1] for p in paths}) == len(paths)
    assert {s.payload for s in survey.shots} == {p.id for p in survey.payloads}
    assert all(p.dialect in WRITERS for p in survey.payloads)
    assert {lie.path for lie in survey.file_lies} <= set(paths)
    assert build(name, 0) == survey


def test_the_demo_is_the_mix_it_promises():
    survey = build("demo", 0)
    counts = {p.id: sum(s.payload == p.id for s in survey.shots) for p in survey.payloads}
    assert counts == {"p4p": 18, "p4": 12, "rededge": 50, "thermal": 14, "compact": 8}
    gsd = {}
    for shot in survey.shots:
        camera = shot.optics(survey.payload(shot.payload))
        gsd.setdefault(shot.payload, []).append(shot.position[2] / camera.focal_px)
    assert np.median(gsd["p4"]) / np.median(gsd["p4p"]) == pytest.approx(1.4, abs=0.06)
    projects = {p.id: p.project for p in survey.payloads}
    assert projects["p4p"] == projects["p4"]
    assert len(set(projects.values())) == 4
    assert survey.payload("compact").route == "isolate"
    assert all(s.reported.focal_mm is None for s in survey.shots if s.payload == "thermal")


def test_unknown_story_names_the_known():
    with pytest.raises(ValueError, match="demo"):
        build("no-such-story")


def test_scaled_frames_stay_true(tmp_path):
    camera = catalogue.compact()
    truth = render(survey_of(camera), tmp_path, frames_scale=0.3)
    frame = truth.frames[0]
    size, _, exif, _, _ = exif_of(truth.image_dir / frame.path)
    assert size == (frame.camera.width, frame.camera.height) == (400, 300)
    assert size[0] / float(exif[41486]) * 25.4 == pytest.approx(7.44, rel=1e-4)


def small(count=4):
    camera = catalogue.with_band_size(catalogue.phantom4pro(), 0.2)
    return survey_of(camera, plan=Plan(height_m=40.0, strips=1, per_strip=count))


def test_firmware_drift_changes_the_tag_not_the_lens(tmp_path):
    truth = render(lies.drift_focal(small(), "p4p", 0.05), tmp_path)
    said = [float(exif_of(truth.image_dir / f.path)[2][37386]) for f in truth.frames]
    assert said == pytest.approx([8.8, 8.8, 9.24, 9.24])
    assert len({f.camera.focal_ratio for f in truth.frames}) == 1
    assert [f.lies for f in truth.frames] == [(), (), ("drifted-focal",), ("drifted-focal",)]


def test_dropped_tags_are_gone(tmp_path):
    survey = lies.drop_tags(small(2), "p4p", ("gps", "focal"), only=lambda shot, index: index == 1)
    truth = render(survey, tmp_path)
    first, second = (exif_of(truth.image_dir / f.path) for f in truth.frames)
    assert 37386 in first[2] and first[3]
    assert 37386 not in second[2] and 41989 not in second[2] and not second[3]
    assert b"GpsLatitude" not in (truth.image_dir / truth.frames[1].path).read_bytes()


def test_a_shifted_gps_moves_only_what_is_said(tmp_path):
    before = small(2)
    after = lies.shift_gps(before, "p4p", 12.0, -7.0, 3.0)
    for a, b in zip(before.shots, after.shots):
        assert a.position == b.position
        origin = Origin(a.reported.latitude, a.reported.longitude, a.reported.altitude_m)
        moved = origin.to_enu(b.reported.latitude, b.reported.longitude, b.reported.altitude_m)
        assert moved == pytest.approx((12.0, -7.0, 3.0), abs=1e-3)


def test_rationals_can_be_undefined(tmp_path):
    camera = catalogue.with_band_size(catalogue.compact(), 0.2)
    plan = Plan(height_m=40.0, strips=1, per_strip=2)
    survey = lies.undefine(survey_of(camera, plan=plan), "compact", ("focal-plane", "zoom"), lambda s, i: i == 1)
    truth = render(survey, tmp_path)
    exif = [exif_of(truth.image_dir / f.path)[2] for f in truth.frames]
    for tag in (41486, 41487, 41988):
        assert float(exif[0][tag]) > 0.0
        assert (exif[1][tag].numerator, exif[1][tag].denominator) == (0, 0)


def test_digital_zoom_is_in_the_picture_and_in_the_tags(tmp_path):
    truth = render(lies.zoom(small(2), "p4p", 2.0, lambda shot, index: index == 1), tmp_path)
    plain, near = truth.frames
    assert near.camera.focal_ratio == 2.0 * plain.camera.focal_ratio
    exif = [exif_of(truth.image_dir / f.path)[2] for f in truth.frames]
    assert [(float(e[41988]), e[41989], float(e[37386])) for e in exif] == [(1.0, 24, 8.8), (2.0, 48, 8.8)]


def test_captures_can_be_swapped_and_a_second_camera_flies_beside():
    survey = build("swapped-captures")
    own = [s for s in survey.shots if s.band == 3]
    told = {s.capture: s.reported.capture_id for s in survey.shots if s.band == 0}
    wrong = [s.path for s in own if s.reported.capture_id != told[s.capture]]
    assert wrong == [own[2].path, own[5].path]
    rig = build("parrot-rig")
    green = [s for s in rig.shots if s.payload == "sequoia" and s.band == 0]
    colour = [s for s in rig.shots if s.payload == "sequoia-rgb"]
    assert len(green) == len(colour) == 8
    for a, b in zip(green, colour):
        assert a.reported.latitude == b.reported.latitude
        assert b.reported.time_s - a.reported.time_s == pytest.approx(0.058)
        assert 0.3 < np.linalg.norm(np.subtract(a.position, b.position)) < 0.8


def test_files_can_be_spoiled(tmp_path):
    survey = small(6)
    names = [s.path for s in survey.shots]
    for name, kind in zip(names, ("truncate", "empty", "text", "resize", "strip")):
        survey = lies.spoil(survey, name, kind)
    survey = lies.duplicate(survey, names[5], "p4p/COPY.JPG")
    truth = render(survey, tmp_path)
    data = [(truth.image_dir / n).read_bytes() for n in names]
    whole = len(data[5])
    assert 0 < len(data[0]) < 0.6 * whole and data[0][:2] == b"\xff\xd8"
    assert data[1] == b"" and data[2].startswith(b"<!DOCTYPE")
    size, _, exif, _, _ = exif_of(truth.image_dir / names[3])
    assert size == (137, 91) and exif[0xA002] == 274
    assert truth.frame(names[3]).camera.width == 137
    assert not exif_of(truth.image_dir / names[4])[2]
    assert (truth.image_dir / "p4p/COPY.JPG").read_bytes() == data[5]
    assert truth.frame("p4p/COPY.JPG").lies == ("copy",)


def test_bands_can_be_lost_and_misnumbered(tmp_path):
    rig = catalogue.with_band_size(catalogue.micasense(), 0.2)
    survey = lies.lose(survey_of(rig), "rededge/IMG_0001_3.tif")
    truth = render(lies.rename(survey, "rededge/IMG_0002_4.tif", "rededge/IMG_0022_4.tif"), tmp_path)
    names = sorted(p.name for p in (truth.image_dir / "rededge").iterdir())
    assert "IMG_0001_3.tif" not in names and "IMG_0002_4.tif" not in names
    moved = truth.frame("rededge/IMG_0022_4.tif")
    assert (moved.capture, moved.band, moved.lies) == ("rededge-0002", "NIR", ("rename",))
    assert len(truth.frames) == len(names) == 9


def test_panels_are_taken_by_hand_near_the_ground(tmp_path):
    rig = catalogue.with_band_size(catalogue.micasense(), 0.2)
    truth = render(lies.panels(survey_of(rig), "rededge", (0,)), tmp_path)
    roles = {f.capture: f.role for f in truth.frames}
    assert roles == {"rededge-0001": "panel", "rededge-0002": "survey"}
    for frame in truth.frames:
        height = frame.altitude_m - GROUND.origin.altitude_m
        assert (frame.height_m < 2.0) == (frame.role == "panel"), height


def test_transit_frames_climb_below_half_the_height(tmp_path):
    camera = catalogue.with_band_size(catalogue.phantom4pro(), 0.2)
    survey = survey_of(camera, plan=Plan(height_m=60.0, strips=1, per_strip=3, transit=3))
    heights = [s.reported.relative_altitude_m for s in survey.shots]
    assert [s.role for s in survey.shots] == ["transit"] * 3 + ["survey"] * 3
    assert heights[:3] == sorted(heights[:3]) and heights[2] < 30.0
    assert min(heights[3:]) > 58.0


def test_roofs_hide_what_lies_behind_them():
    survey = survey_of(catalogue.phantom4pro())
    world = world_of(survey, GROUND, 0)
    rows, columns = world.ground.height.shape
    # A block 12 m high across the ground, north of the camera's foot.
    world.ground.height[:] = 0.0
    row = rows // 2
    world.ground.height[row - 40 : row, :] = 12.0
    wall_north = world.north - row * world.cell_m
    east = world.west + columns / 2 * world.cell_m
    eye = np.array([east, wall_north - 6.0, 30.0])
    back = wall_north + 40 * world.cell_m
    assert not world.visible(np.array([east, back + 1.0, 0.0]), eye)
    assert world.visible(np.array([east, back + 40.0, 0.0]), eye)
    assert world.visible(np.array([east, wall_north - 1.0, 0.0]), eye)
    from tests.simulator.renderer import hit

    camera = Camera(600, 600, 0.6)
    z, _ = hit(world, camera, look(0.0, -90.0, 0.0), eye)
    assert z[300, 300] == pytest.approx(0.0, abs=0.01)
    top = project(np.array([[east, wall_north + 20 * world.cell_m, 12.0]]), camera, look(0.0, -90.0, 0.0), eye)[0]
    assert z[round(top[1]), round(top[0])] == pytest.approx(12.0, abs=0.01)


def test_one_frame_can_be_rendered_alone():
    survey = small(2)
    world = world_of(survey, GROUND, 0)
    data, frame = render_shot(world, survey.payloads[0], survey.shots[1], 0)
    again, _ = render_shot(world, survey.payloads[0], survey.shots[1], 0)
    assert data == again and data[:2] == b"\xff\xd8"
    assert frame.path == survey.shots[1].path


def test_stories_module_lists_what_the_command_offers(capsys):
    from tests.simulator.__main__ import main

    with pytest.raises(SystemExit):
        main(["--help"])
    shown = capsys.readouterr().out
    assert all(name in shown for name in stories.STORIES)
