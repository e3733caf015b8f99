"""Each lie changes what it says, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulator import Plan, catalogue, lies, render
from tests.simulator.checks import exif_of, flown_by, strip_of
from tests.simulator.geo import Origin
from tests.simulator.places import GROUND
from tests.simulator.stories import build

pytest.importorskip("cv2", reason="frames are rendered with OpenCV")


def test_firmware_drift_changes_the_tag_not_the_lens(tmp_path):
    truth = render(lies.drift_focal(strip_of(), "p4p", 0.05), tmp_path)
    said = [float(exif_of(truth.image_dir / f.path)[2][37386]) for f in truth.frames]
    assert said == pytest.approx([8.8, 8.8, 9.24, 9.24])
    assert len({f.camera.focal_ratio for f in truth.frames}) == 1
    assert [f.lies for f in truth.frames] == [(), (), ("drifted-focal",), ("drifted-focal",)]


def test_dropped_tags_are_gone(tmp_path):
    survey = lies.drop_tags(strip_of(2), "p4p", ("gps", "focal"), only=lambda shot, index: index == 1)
    truth = render(survey, tmp_path)
    first, second = (exif_of(truth.image_dir / f.path) for f in truth.frames)
    assert 37386 in first[2] and first[3]
    assert 37386 not in second[2] and 41989 not in second[2] and not second[3]
    assert b"GpsLatitude" not in (truth.image_dir / truth.frames[1].path).read_bytes()


def test_a_shifted_gps_moves_only_what_is_said(tmp_path):
    before = strip_of(2)
    after = lies.shift_gps(before, "p4p", 12.0, -7.0, 3.0)
    for a, b in zip(before.shots, after.shots):
        assert a.position == b.position
        origin = Origin(a.reported.latitude, a.reported.longitude, a.reported.altitude_m)
        moved = origin.to_enu(b.reported.latitude, b.reported.longitude, b.reported.altitude_m)
        assert moved == pytest.approx((12.0, -7.0, 3.0), abs=1e-3)


def test_rationals_can_be_undefined(tmp_path):
    camera = catalogue.with_band_size(catalogue.compact(), 0.2)
    plan = Plan(height_m=40.0, strips=1, per_strip=2)
    survey = lies.undefine(flown_by(camera, plan=plan), "compact", ("focal-plane", "zoom"), lambda s, i: i == 1)
    truth = render(survey, tmp_path)
    exif = [exif_of(truth.image_dir / f.path)[2] for f in truth.frames]
    for tag in (41486, 41487, 41988):
        assert float(exif[0][tag]) > 0.0
        assert (exif[1][tag].numerator, exif[1][tag].denominator) == (0, 0)


def test_digital_zoom_is_in_the_picture_and_in_the_tags(tmp_path):
    truth = render(lies.zoom(strip_of(2), "p4p", 2.0, lambda shot, index: index == 1), tmp_path)
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
    survey = strip_of(6)
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
    survey = lies.lose(flown_by(rig), "rededge/IMG_0001_3.tif")
    truth = render(lies.rename(survey, "rededge/IMG_0002_4.tif", "rededge/IMG_0022_4.tif"), tmp_path)
    names = sorted(p.name for p in (truth.image_dir / "rededge").iterdir())
    assert "IMG_0001_3.tif" not in names and "IMG_0002_4.tif" not in names
    moved = truth.frame("rededge/IMG_0022_4.tif")
    assert (moved.capture, moved.band, moved.lies) == ("rededge-0002", "NIR", ("rename",))
    assert len(truth.frames) == len(names) == 9


def test_panels_are_taken_by_hand_near_the_ground(tmp_path):
    rig = catalogue.with_band_size(catalogue.micasense(), 0.2)
    truth = render(lies.panels(flown_by(rig), "rededge", (0,)), tmp_path)
    roles = {f.capture: f.role for f in truth.frames}
    assert roles == {"rededge-0001": "panel", "rededge-0002": "survey"}
    for frame in truth.frames:
        height = frame.altitude_m - GROUND.origin.altitude_m
        assert (frame.height_m < 2.0) == (frame.role == "panel"), height


def test_transit_frames_climb_below_half_the_height(tmp_path):
    camera = catalogue.with_band_size(catalogue.phantom4pro(), 0.2)
    survey = flown_by(camera, plan=Plan(height_m=60.0, strips=1, per_strip=3, transit=3))
    heights = [s.reported.relative_altitude_m for s in survey.shots]
    assert [s.role for s in survey.shots] == ["transit"] * 3 + ["survey"] * 3
    assert heights[:3] == sorted(heights[:3]) and heights[2] < 30.0
    assert min(heights[3:]) > 58.0
