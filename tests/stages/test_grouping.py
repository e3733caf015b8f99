"""Profiles: one true camera each, whatever order the files came in."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.grouping import bin_zoom, camera_name, clean_serial, cluster_focals, slug
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import P4P, strip, survey_of


def partition(survey):
    return {frozenset(p.frames) for p in survey.profiles}


def test_autofocus_jitter_is_one_camera():
    frames = strip(count=8)
    jittered = [replace(f, focal_mm=8.8 * (1 + 0.001 * (i % 4))) for i, f in enumerate(frames)]
    survey = survey_of(jittered)
    assert len(survey.profiles) == 1
    assert 0 < survey.profiles[0].focal_variance < DEFAULTS.focal_variance


def test_firmware_drift_of_four_percent_is_one_camera_above_the_lock_rule():
    frames = [replace(f, focal_mm=8.8 if i < 6 else 9.16) for i, f in enumerate(strip(count=12))]
    survey = survey_of(frames)
    assert len(survey.profiles) == 1
    assert survey.profiles[0].focal_variance == pytest.approx(0.04, abs=0.001)


def test_two_lenses_under_one_name_are_two_cameras():
    frames = [replace(f, focal_mm=8.8 if i % 2 else 12.3, focal_35mm=None) for i, f in enumerate(strip(count=12))]
    assert len(survey_of(frames).profiles) == 2


def test_a_frame_that_lost_its_focal_joins_its_camera():
    frames = strip(count=8)
    frames[3] = replace(frames[3], focal_mm=None, focal_35mm=None)
    assert len(survey_of(frames).profiles) == 1


def test_serials_make_bodies_and_a_stripped_serial_joins_the_only_body():
    one = strip(count=6, serial="A1")
    other = strip(count=6, serial="B2", prefix="X_")
    assert len(survey_of(one + other).profiles) == 2
    one[2] = replace(one[2], serial="")
    assert len(survey_of(one).profiles) == 1


def test_digital_zoom_is_a_camera_of_its_own():
    frames = [replace(f, digital_zoom=2.0 if i > 7 else 1.0) for i, f in enumerate(strip(count=12))]
    assert len(survey_of(frames).profiles) == 2


def test_sizes_are_cameras_of_their_own():
    frames = strip(count=8)
    frames[0] = replace(frames[0], width=4000, height=3000)
    assert sorted(len(p.frames) for p in survey_of(frames).profiles) == [1, 7]


@given(st.randoms(use_true_random=False))
@settings(max_examples=20, deadline=None)
def test_order_of_files_changes_nothing(rng: random.Random):
    frames = strip(count=6, serial="A") + strip(count=5, serial="B", prefix="X_", focal_mm=8.9)
    frames += strip(P4P, count=5, model="FC7303", prefix="M_", width=4000, height=2250, focal_mm=4.49)
    shuffled = list(frames)
    rng.shuffle(shuffled)
    assert survey_of(shuffled) == survey_of(frames)


@given(st.dictionaries(st.floats(1.0, 500.0), st.integers(1, 50), min_size=1, max_size=12))
def test_clusters_partition_the_values_in_order(values):
    clusters = cluster_focals(values, DEFAULTS)
    flat = [v for c in clusters for v in c]
    assert flat == sorted(values)


def test_zoom_bins_are_two_percent_wide():
    assert bin_zoom([24.0, 24.3, 24.6, 70.0], DEFAULTS) == [[24.0, 24.3], [24.6], [70.0]]


def test_names():
    assert camera_name("Canon", "Canon PowerShot SX260 HS") == "Canon PowerShot SX260 HS"
    assert camera_name("DJI", "FC6310") == "DJI FC6310"
    assert slug("DJI FC6310") == "dji-fc6310"
    assert slug("../..\\x:") == "x"
    assert clean_serial("0000") == "" and clean_serial("00A1") == "00A1"
