from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Dict, List, Tuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from sensorgate.stages.frame import Frame
from sensorgate.stages.geo import metres_per_degree
from sensorgate.stages.harmonize import learn_luts, plan
from sensorgate.stages.harmonize.tables import match_table, mean_dn
from sensorgate.stages.harmonize.tones import read_tones
from sensorgate.stages.intrinsics import Intrinsics
from sensorgate.stages.profile import RGB, CameraProfile, Flight, SurveyFrame
from sensorgate.stages.thresholds import DEFAULTS

from .samples import texture

ORIGIN = (46.0, 7.0)
GROUND_CM = 10.0


class World:
    """Ground of 10 cm texels seen by flights: frames are cut from it, turned by their heading."""

    def __init__(self, folder: Path, seed: int = 5, size: int = 2000) -> None:
        self.folder = folder
        ground = texture(size, size, 3, seed).astype(np.float32)
        self.ground = 60.0 + ground * (130.0 / 255.0)
        self.frames: List[SurveyFrame] = []
        self.files: Dict[str, Frame] = {}
        self.sources: Dict[str, Path] = {}
        self.profiles: List[CameraProfile] = []
        self.flights: List[Flight] = []

    def fly(
        self,
        name: str,
        *,
        light: Any = lambda p, i: p,
        start: Tuple[float, float] = (40.0, 40.0),
        count: int = 5,
        rows: int = 3,
        step: float = 12.0,
        gsd: Any = 20.0,
        size: Tuple[int, int] = (240, 180),
        gps: bool = True,
        seed: int = 1,
        **header: Any,
    ) -> None:
        rng = np.random.default_rng(seed)
        north, east = metres_per_degree(ORIGIN[0])
        paths = []
        for index in range(count * rows):
            row, column = divmod(index, count)
            along = column if row % 2 == 0 else count - 1 - column
            x, y = start[0] + along * step + rng.normal(0, 1), start[1] + row * 1.5 * step + rng.normal(0, 1)
            pixels = np.clip(light(self._see(x, y, gsd or 20.0, size, 90.0 * (row % 4)), index), 0, 255)
            path = f"{name}/{index:03d}.jpg"
            file = self.folder / path
            file.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.rint(pixels).astype(np.uint8)).save(file, quality=92)
            place = {"latitude": ORIGIN[0] + y / north, "longitude": ORIGIN[1] + x / east} if gps else {}
            time = f"2024-05-01T10:{index // 20:02d}:{index % 20 * 3:02d}"
            self.files[path] = Frame(path, file.stat().st_size, "jpeg", *size, time=time, **place, **header)
            self.sources[path] = file
            self.frames.append(
                SurveyFrame(
                    path,
                    name,
                    f"{name}:1",
                    name,
                    path,
                    RGB,
                    "",
                    "",
                    "survey",
                    Intrinsics(0.7),
                    height_m=50.0,
                    gsd_cm=gsd,
                )
            )
            paths.append(path)
        self.profiles.append(
            CameraProfile(name, name, RGB, "", "A", "B", "", "", "", *size, tuple(paths), Intrinsics(0.7))
        )
        self.flights.append(Flight(f"{name}:1", name, tuple(paths), height_m=50.0, gsd_cm=gsd))

    def _see(self, x: float, y: float, gsd: float, size: Tuple[int, int], heading: float) -> np.ndarray:
        turn = math.radians(heading)
        v, u = np.mgrid[0 : size[1], 0 : size[0]]
        right, up = (u - (size[0] - 1) / 2) * gsd / 100, ((size[1] - 1) / 2 - v) * gsd / 100
        east = x + right * math.cos(turn) + up * math.sin(turn)
        north = y - right * math.sin(turn) + up * math.cos(turn)
        columns = np.clip((east * 100 / GROUND_CM).astype(int), 0, self.ground.shape[1] - 1)
        rows = np.clip((north * 100 / GROUND_CM).astype(int), 0, self.ground.shape[0] - 1)
        return self.ground[rows, columns]

    def learn(self, **options: Any):
        return learn_luts(self.frames, self.files, self.sources, self.profiles, self.flights, DEFAULTS, **options)


def gain(pixels: np.ndarray, _index: int) -> np.ndarray:
    return pixels * np.array([1.25, 1.1, 0.9]) + np.array([10.0, 15.0, -8.0])


def test_offset_over_common_ground_gets_a_table_that_takes_it_out(tmp_path):
    world = World(tmp_path)
    world.fly("a", count=6)
    world.fly("b", light=gain, seed=2)
    luts, findings = world.learn()
    assert [f.code for f in findings] == ["radiometry-offset"]
    (lut,) = luts
    assert lut.id == "b|b:1" and lut.reference == "a|a:1" and lut.frames_sampled >= 6
    truth = [float(np.mean(gain(world.ground, 0)[..., c] - world.ground[..., c])) for c in range(3)]
    assert lut.offset_dn == pytest.approx(truth, abs=4)
    seen = np.arange(70, 180, 5)
    for c, (factor, shift) in enumerate(((1.25, 10.0), (1.1, 15.0), (0.9, -8.0))):
        back = np.asarray(lut.tables[c])[np.rint(seen * factor + shift).astype(int)]
        assert np.median(np.abs(back - seen)) < 6
    result, _ = plan(world.frames, world.files, world.profiles, world.flights, DEFAULTS, luts=luts)
    assert {a.profile: a.write_lut for a in result.actions} == {"a": False, "b": True}


def test_equal_tones_and_small_offsets_are_left_alone(tmp_path):
    world = World(tmp_path)
    world.fly("a", count=6)
    world.fly("b", light=lambda p, _: p + 8, seed=2)
    assert world.learn() == ((), ())


def test_another_height_is_no_offset(tmp_path):
    world = World(tmp_path)
    world.fly("a", count=6)
    world.fly("b", gsd=30.0, seed=2)
    assert world.learn() == ((), ())


def test_other_ground_is_no_sensor_offset(tmp_path):
    """Flights side by side over dark and bright ground: nothing may be learned from that."""
    world = World(tmp_path)
    world.ground[:, 1000:] *= 0.4
    world.fly("a", count=4, start=(20.0, 40.0))
    world.fly("b", count=3, start=(130.0, 40.0), seed=2)
    luts, findings = world.learn()
    assert luts == () and [(f.code, f.severity) for f in findings] == [("radiometry-no-overlap", "info")]


@pytest.mark.parametrize("missing", [{"gps": False}, {"gsd": None}])
def test_without_positions_or_heights_nothing_is_learned(tmp_path, missing):
    world = World(tmp_path)
    world.fly("a", count=6, **missing)
    world.fly("b", light=gain, seed=2, **missing)
    luts, findings = world.learn()
    if "gsd" in missing or {f.code for f in findings}:
        assert {f.code for f in findings} == {"radiometry-no-overlap"}
    assert luts == ()


def test_light_that_changes_within_a_flight_is_told(tmp_path):
    drift, cloud, steady = World(tmp_path / "d"), World(tmp_path / "c"), World(tmp_path / "s")
    drift.fly("a", count=8, rows=4, step=9.0, light=lambda p, i: p + 30 - 2.0 * i)
    cloud.fly("a", count=8, rows=4, step=6.0, light=lambda p, i: p * (0.6 if i % 8 > 4 else 1.0))
    steady.fly("a", count=8, rows=4, step=6.0)
    for world, expected in ((drift, ["light-varies"]), (cloud, ["light-varies"]), (steady, [])):
        luts, findings = world.learn()
        assert luts == () and [f.code for f in findings] == expected


def test_unreadable_frames_are_passed_over(tmp_path):
    world = World(tmp_path)
    world.fly("a", count=6)
    world.fly("b", light=gain, seed=2)
    for path in sorted(world.sources)[::5]:
        world.sources[path].write_bytes(b"\xff\xd8\xff broken")
    luts, _ = world.learn()
    assert len(luts) == 1


def test_order_of_input_changes_nothing_and_progress_is_told(tmp_path):
    world = World(tmp_path)
    world.fly("a", count=6)
    world.fly("b", light=gain, seed=2)
    seen = []
    first = world.learn(progress=lambda *step: seen.append(step))
    world.frames.reverse()
    world.flights.reverse()
    world.profiles.reverse()
    assert world.learn() == first
    assert seen == [("tones", 1, 2), ("tones", 2, 2)]


def test_reduced_decoding_keeps_means(tmp_path):
    pixels = texture(1600, 1200)
    Image.fromarray(pixels).save(tmp_path / "a.jpg", quality=95)
    v, u = np.mgrid[0:1200, 0:1600]
    disc = (u - 799.5) ** 2 + (v - 599.5) ** 2 <= 300.0**2
    tones = read_tones(tmp_path / "a.jpg", 0.5, 200)
    assert [mean_dn(t) for t in tones] == pytest.approx(list(pixels[disc].mean(axis=0)), abs=1.0)


HISTOGRAMS = st.lists(st.integers(0, 1000), min_size=256, max_size=256).filter(lambda h: sum(h) > 0)
NARROW = st.tuples(st.integers(0, 255), st.integers(1, 60)).map(
    lambda t: [1000 if t[0] <= i < t[0] + t[1] else 0 for i in range(256)]
)


@given(st.one_of(HISTOGRAMS, NARROW), st.one_of(HISTOGRAMS, NARROW), st.floats(1.0, 8.0))
@settings(max_examples=150, deadline=None)
def test_tables_are_monotone_bounded_and_complete(source, reference, slope):
    table = match_table(np.asarray(source, float), np.asarray(reference, float), slope)
    steps = np.diff(table)
    assert len(table) == 256 and min(table) >= 0 and max(table) <= 255
    assert steps.min() >= 0 and steps.max() <= math.ceil(slope)


@given(st.one_of(HISTOGRAMS, NARROW))
@settings(max_examples=50, deadline=None)
def test_equal_histograms_leave_the_seen_tones(histogram):
    weights = np.asarray(histogram, float)
    table = np.asarray(match_table(weights, weights, 4.0))
    assert abs(float(np.dot(weights, table - np.arange(256)) / weights.sum())) <= 1.0


@given(st.floats(0.6, 1.6), st.floats(-40, 40))
@settings(max_examples=50, deadline=None)
def test_known_gain_and_offset_are_undone(factor, shift):
    rng = np.random.default_rng(1)
    truth = np.clip(rng.normal(120, 25, 40000), 40, 200)
    changed = np.clip(np.rint(truth * factor + shift), 0, 255).astype(int)
    table = match_table(
        np.bincount(changed, minlength=256).astype(float),
        np.bincount(np.rint(truth).astype(int), minlength=256).astype(float),
        4.0,
    )
    inside = (changed > 2) & (changed < 253)
    assert np.mean(np.abs(np.asarray(table)[changed] - truth)[inside]) < 3.0
