from __future__ import annotations

import contextlib
import gzip
import json
import os
import pickle
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.plugin.odm.opensfm_cameras import camera_from_json, project, rotation_matrix
from sensorgate.plugin.odm.opensfm_errors import ErrorTable
from sensorgate.plugin.odm.opensfm_json import Unreadable, read_json, read_reconstructions
from sensorgate.plugin.odm.opensfm_matches import pair_counts, pairs_of, read_matches
from sensorgate.plugin.odm.opensfm_tracks import PointIds, read_tracks
from sensorgate.plugin.odm.outcome_console import FAILED, FINISHED, UNFINISHED, outcome_of_console
from sensorgate.stages.thresholds import DEFAULTS

SIZE = {"width": 4000, "height": 3000}
POINTS = np.array([[0.3, -0.4, 1.2], [-0.8, 0.5, 1.0]])
# What OpenSfM's own camera models give for these points.
MODELS = (
    (
        {"projection_type": "perspective", "focal": 0.8, "k1": -0.05, "k2": 0.01},
        [[0.198324171, -0.264432227], [-0.61658944, 0.3853684]],
    ),
    (
        {
            "projection_type": "brown",
            "focal_x": 0.7,
            "focal_y": 0.71,
            "c_x": 0.01,
            "c_y": -0.02,
            "k1": -0.05,
            "k2": 0.01,
            "k3": 0.003,
            "p1": 0.002,
            "p2": -0.001,
        },
        [[0.183094035, -0.2540069], [-0.533339108, 0.325307047]],
    ),
    (
        {"projection_type": "fisheye", "focal": 0.6, "k1": -0.03, "k2": 0.004},
        [[0.141474066, -0.188632088], [-0.378695986, 0.236684991]],
    ),
    (
        {
            "projection_type": "fisheye_opencv",
            "focal_x": 0.6,
            "focal_y": 0.61,
            "c_x": 0.01,
            "c_y": -0.02,
            "k1": -0.03,
            "k2": 0.004,
            "k3": 0.001,
            "k4": -0.0002,
        },
        [[0.151474587, -0.211776663], [-0.368759749, 0.220670257]],
    ),
)


@pytest.mark.parametrize("values, expected", MODELS, ids=[m[0]["projection_type"] for m in MODELS])
def test_cameras_project_as_opensfm_does(values: dict, expected: list) -> None:
    camera = camera_from_json("c", {**SIZE, **values})
    assert project(camera, POINTS) == pytest.approx(np.asarray(expected), abs=1e-8)


def test_a_camera_without_formula_is_refused_and_a_damaged_one_too() -> None:
    dome = camera_from_json("c", {**SIZE, "projection_type": "spherical"})
    assert not dome.known
    with pytest.raises(ValueError, match="spherical"):
        project(dome, POINTS)
    for bad in ({**SIZE, "focal": "x"}, {**SIZE, "focal": -1}, {"focal": 1.0}, [], {**SIZE, "focal": float("nan")}):
        with pytest.raises(ValueError):
            camera_from_json("c", bad)


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_rotation_matrices_are_rotations(vector: list) -> None:
    matrix = rotation_matrix(np.asarray(vector))
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)


# --- matches ---------------------------------------------------------------------


class Hostile:
    def __init__(self, mark: str) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple:
        return os.system, (f"touch {self.mark}",)


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_matches_of_every_protocol_are_counted(protocol: int) -> None:
    pairs = {
        "a.jpg": np.arange(98).reshape(49, 2),
        "tried.jpg": np.array([]),
        "b.jpg": np.zeros((3, 2), dtype=np.int32),
    }
    assert pair_counts(pickle.dumps(pairs, protocol), "x") == {"a.jpg": 49, "tried.jpg": 0, "b.jpg": 3}


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_a_hostile_pickle_is_refused_and_not_run(tmp_path: Path, protocol: int) -> None:
    mark = tmp_path / "executed"
    file = tmp_path / "a.jpg_matches.pkl.gz"
    file.write_bytes(gzip.compress(pickle.dumps({"b.jpg": Hostile(str(mark))}, protocol)))
    with pytest.raises(Unreadable, match="it was not run"):
        read_matches(file, DEFAULTS)
    assert not mark.exists()


def test_an_array_that_says_more_than_it_holds_is_refused() -> None:
    honest = pickle.dumps({"a": np.zeros((3, 2), dtype=np.int64)}, 4)
    lying = honest.replace(b"K\x03K\x02", b"K\xffK\x02")
    assert lying != honest
    with pytest.raises(Unreadable, match="not as large as it says"):
        pair_counts(lying, "x")
    with pytest.raises(Unreadable):
        pair_counts(pickle.dumps({"a": np.array([object()])}, 4), "x")


def test_a_gz_bomb_is_cut_off(tmp_path: Path) -> None:
    file = tmp_path / "a.jpg_matches.pkl.gz"
    file.write_bytes(gzip.compress(b"\0" * 50_000_000))
    with pytest.raises(Unreadable, match="unpacks to more than 1000000"):
        read_matches(file, replace(DEFAULTS, outcome_match_bytes=1_000_000))


@given(st.binary(max_size=200))
def test_bytes_that_are_no_pickle_are_unreadable_never_a_crash(data: bytes) -> None:
    with contextlib.suppress(Unreadable):
        pair_counts(data, "x")


@settings(max_examples=200)
@given(st.data())
def test_damaged_pickles_are_unreadable_never_a_crash(data: st.DataObject) -> None:
    good = bytearray(pickle.dumps({"a": np.zeros((3, 2)), "b": np.array([])}, 4))
    for _ in range(data.draw(st.integers(1, 4))):
        good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    try:
        found = pair_counts(bytes(good), "x")
    except Unreadable:
        return
    assert all(0 <= n <= 3 for n in found.values())


def test_a_pair_counts_once() -> None:
    assert pairs_of({"b": {"a": 5, "b": 9}, "a": {"b": 7, "c": 0}}) == {("a", "b"): 7, ("a", "c"): 0}


# --- tracks ----------------------------------------------------------------------


def binary(rows: list) -> bytes:
    data = b"OPENSFM_TRACKS_VERSION_v102\n"
    for image, track, x, y in rows:
        data += struct.pack("<HH", len(image), len(track)) + image.encode() + track.encode()
        data += struct.pack("<ifffBBBx", 1, x, y, 0.1, 1, 2, 3)
    return data


def read_all(path: Path, most: int = 100) -> list:
    ids = PointIds()
    found = []
    for batch in read_tracks(path, {"a.jpg": 0, "b.jpg": 1}, ids, most):
        found += zip(batch.frame.tolist(), batch.track.tolist(), batch.xy.tolist())
    return found


def test_tracks_of_all_versions_say_the_same(tmp_path: Path) -> None:
    rows = [("a.jpg", "7", 0.25, -0.5), ("c.jpg", "7", 0.5, 0.0), ("b.jpg", "x1", -0.125, 0.0)]
    expected = [(0, 7, [0.25, -0.5]), (-1, 7, [0.5, 0.0]), (1, -1, [-0.125, 0.0])]
    path = tmp_path / "tracks.csv"
    path.write_bytes(binary(rows))
    assert read_all(path) == expected
    tails = {
        "": "1\t2\t3",
        "OPENSFM_TRACKS_VERSION_v1\n": "0.1\t1\t2\t3",
        "OPENSFM_TRACKS_VERSION_v2\n": "0.1\t1\t2\t3\t-1\t-1",
    }
    for head, tail in tails.items():
        path.write_text(head + "".join(f"{i}\t{t}\t5\t{x}\t{y}\t{tail}\n" for i, t, x, y in rows))
        assert read_all(path) == expected


def test_tracks_that_end_early_or_never_are_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "tracks.csv"
    rows = [("a.jpg", str(i), 0.0, 0.0) for i in range(50)]
    path.write_bytes(binary(rows)[:-5])
    with pytest.raises(Unreadable, match="within a record"):
        read_all(path)
    path.write_bytes(binary(rows))
    with pytest.raises(Unreadable, match="more than 10 "):
        read_all(path, 10)
    path.write_bytes(b"OPENSFM_TRACKS_VERSION_v9\n")
    with pytest.raises(Unreadable, match="not known"):
        read_all(path)


# --- reconstruction.json -----------------------------------------------------------

value = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-9, 9) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)
model = st.fixed_dictionaries(
    {},
    optional={k: st.dictionaries(st.text(max_size=4), value, max_size=3) for k in ("cameras", "shots", "points")}
    | {"biases": value, "rig_instances": value},
)


@settings(deadline=None)
@given(st.lists(model, max_size=3), st.sampled_from([None, 4]))
def test_pieces_are_what_the_whole_file_says(
    tmp_path_factory: pytest.TempPathFactory, models: list, indent: int
) -> None:
    path = tmp_path_factory.mktemp("m") / "reconstruction.json"
    path.write_text(json.dumps(models, indent=indent))
    expected = [
        (i, section, key, v)
        for i, m in enumerate(models)
        for section, rows in m.items()
        if section in ("cameras", "shots", "points")
        for key, v in rows.items()
    ]
    assert list(read_reconstructions(path, DEFAULTS)) == expected


def test_a_model_larger_than_a_piece_is_read_whole(tmp_path: Path) -> None:
    points = {str(i): {"coordinates": [i + 0.5, 1.0, 2.0]} for i in range(60_000)}
    path = tmp_path / "reconstruction.json"
    path.write_text(json.dumps([{"points": points, "reference_lla": {"altitude": 1}}]))
    found = {k: v for _, _, k, v in read_reconstructions(path, DEFAULTS)}
    assert path.stat().st_size > 2 << 20 and found == points


@pytest.mark.parametrize(
    "text", ["", "[", "{}", "[1]", '[{"shots"', '[{"shots": {"a": 1}', '[{"shots": {"a": 1 2}}]', "[[" * 9]
)
def test_a_file_that_is_no_model_is_unreadable(tmp_path: Path, text: str) -> None:
    path = tmp_path / "reconstruction.json"
    path.write_text(text)
    with pytest.raises(Unreadable):
        list(read_reconstructions(path, DEFAULTS))


def test_json_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "log.json"
    path.write_text("[" + "1," * 1000 + "1]")
    with pytest.raises(Unreadable, match="larger than 100"):
        read_json(path, replace(DEFAULTS, outcome_json_bytes=100))
    path.write_text("[" * 100_000)
    with pytest.raises(Unreadable):
        read_json(path, DEFAULTS)
    path.write_text('[{"shots": {"a": "' + "x" * 3_000_000 + '"}}]')
    with pytest.raises(Unreadable, match="longer than 1000"):
        list(read_reconstructions(path, replace(DEFAULTS, outcome_value_chars=1000)))


# --- errors ----------------------------------------------------------------------


def test_errors_are_not_bounded_by_four_pixels_and_few_mismatches_are_left_out() -> None:
    gen = np.random.default_rng(1)
    error = gen.rayleigh(6.0, 5000)
    table = ErrorTable(1, 4.0)
    table.add(np.zeros(5000, dtype=np.int64), error)
    rows = np.array([0])
    figures = table.figures(rows, DEFAULTS)
    assert figures.mean_px == pytest.approx(error.mean(), rel=1e-3)
    assert figures.odm_px == pytest.approx(error[error <= 4].mean(), abs=1e-3)
    table.add(np.zeros(300, dtype=np.int64), np.full(300, 500.0))
    assert table.figures(rows, DEFAULTS).mean_px == pytest.approx(error.mean(), rel=1e-3)
    table.add(np.zeros(900, dtype=np.int64), np.full(900, np.inf))
    assert (table.figures(rows, DEFAULTS).mean_px or 0) > 1000


# --- console -----------------------------------------------------------------------

CASES = (
    (
        ["[INFO]    Running dataset stage", "[ERROR]   There are no images in /d! Make sure"],
        FAILED,
        "no-images",
        "dataset",
    ),
    (["Exception: Cannot match bands by filename on IMG_1.TIF, make sure"], FAILED, "bands-unmatched", ""),
    (
        ["\x1b[91m[ERROR]   The program could not process this dataset using the current settings."],
        FAILED,
        "no-reconstruction",
        "",
    ),
    (["run.py: error: unrecognized arguments: --force-gcp"], FAILED, "option-refused", ""),
    (["[ERROR]   Whoops! You ran out of memory! Add more RAM"], FAILED, "out-of-memory", ""),
    (["TypeError: '<=' not supported between instances of 'NoneType' and 'int'"], FAILED, "bad-metadata", ""),
    (["[ERROR]   A GCP file was provided, but no valid GCP entries could be used. Note"], FAILED, "gcp-unusable", ""),
)


@pytest.mark.parametrize("said, state, code, stage", CASES, ids=[c[2] for c in CASES])
def test_the_console_says_why_it_ended(said: list, state: str, code: str, stage: str) -> None:
    found = outcome_of_console(said)
    assert (found.state, found.stage) == (state, stage)
    assert found.cause is not None and found.cause.code == code and found.cause.remedy


def test_a_specific_cause_is_told_before_the_general_one() -> None:
    found = outcome_of_console(
        [
            "Cannot match bands by filename on x",
            "Uh oh! Processing stopped because of strange values in the reconstruction.",
        ]
    )
    assert found.cause is not None and found.cause.code == "bands-unmatched"


def test_the_console_counts_pieces_before_they_are_merged() -> None:
    found = outcome_of_console(
        [
            "[INFO]    Running opensfm stage",
            "2026-11-22 16:14:00,1 INFO: Reconstruction 0: 15 images, 984 points",
            "2026-11-22 16:14:00,1 INFO: Reconstruction 1: 6 images, 300 points",
            "2026-11-22 16:14:00,1 INFO: 2 partial reconstructions in total.",
            "[WARNING] Multiple reconstructions detected (2), this might be an indicator",
            "[INFO]    ODM app finished - Sun Nov 22",
        ]
    )
    assert (found.state, found.components, found.sizes) == (FINISHED, 2, (15, 6))
    assert [f.code for f in found.facts] == ["several-components"]


def test_a_console_that_just_stops_is_unfinished() -> None:
    assert outcome_of_console(["[INFO]    Running openmvs stage", "working"]).state == UNFINISHED
    assert outcome_of_console([]).state == UNFINISHED
