"""Rules about cameras: each fires on the smallest survey that breaks it, and not beside it."""

from __future__ import annotations

from dataclasses import replace

from sensorgate.stages.gate import assess
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import P4P, strip, survey_of


def found(frames, code):
    return [f for f in assess(survey_of(frames), DEFAULTS).findings if f.code == code]


def test_digital_zoom_in_some_frames_is_a_warning_in_all_a_note():
    frames = strip(count=12)
    mixed = [replace(f, digital_zoom=2.0 if i < 4 else 1.0) for i, f in enumerate(frames)]
    (finding,) = found(mixed, "digital-zoom")
    assert finding.severity == "warning" and "2x" in finding.message
    (finding,) = found([replace(f, digital_zoom=2.0) for f in frames], "digital-zoom")
    assert finding.severity == "info"
    assert not found([replace(f, digital_zoom=1.0) for f in frames], "digital-zoom")


def test_raw_beside_jpeg():
    raw = [replace(f, path=f.path.replace(".JPG", ".DNG"), format="dng", size_bytes=9) for f in strip(count=8)]
    (finding,) = found(strip(count=8) + raw, "mixed-modes")
    assert "raw" in finding.message
    assert not found(strip(count=8), "mixed-modes")


def test_fisheye_beside_perspective():
    fisheye = strip(P4P, 8, prefix="F_", make="Parrot", model="Bebop 2", projection="fisheye", focal_mm=1.8,
                    focal_35mm=None, width=4096, height=3072)  # fmt: skip
    assert found(strip(count=8) + fisheye, "projections-mixed")
    assert not found(fisheye, "projections-mixed")


def test_missing_focal_plane_tags_are_noted_only_where_no_sheet_helps():
    unknown = strip(count=8, make="Maker", model="Never Heard")
    (finding,) = found(unknown, "focal-plane-missing")
    assert finding.severity == "info"
    assert not found(strip(count=8), "focal-plane-missing")


def test_two_sizes_name_them_in_pixels():
    frames = strip(count=8)
    (finding,) = found([replace(frames[0], width=4000, height=3000), *frames[1:]], "mixed-resolutions")
    assert "4000x3000" in finding.message and "px" in finding.message
