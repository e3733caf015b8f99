"""Captures: by id, by DJI's number, by time, by name; never a frame twice in one."""

from __future__ import annotations

from dataclasses import replace

from sensorgate.stages.captures import group_captures, seconds
from sensorgate.stages.frame import Frame
from sensorgate.stages.thresholds import DEFAULTS

BANDS = ("blue", "green", "red", "rededge", "nir")


def rig(captures=4, **changes):
    frames = []
    for c in range(captures):
        for b, band in enumerate(BANDS, start=1):
            frames.append(
                Frame(
                    path=f"in/IMG_{c:04d}_{b}.tif",
                    size_bytes=1,
                    format="tiff",
                    width=1280,
                    height=960,
                    make="MicaSense",
                    model="RedEdge",
                    bands=(band,),
                    capture_id=f"id{c}",
                    time=f"2024-05-01T10:00:{2 * c:02d}",
                    latitude=46.0 + c * 1e-4,
                    longitude=8.0,
                )
            )
    return [replace(f, **changes) for f in frames]


def bands_of(frames):
    return {f.path: f.bands[0] for f in frames}


def sizes(frames):
    grouped = group_captures(frames, bands_of(frames), DEFAULTS)
    assert set(grouped) == {f.path for f in frames}
    count = {}
    for capture in grouped.values():
        count[capture] = count.get(capture, 0) + 1
    return sorted(count.values())


def test_by_id():
    assert sizes(rig()) == [5, 5, 5, 5]


def test_by_time_when_ids_were_stripped():
    assert sizes(rig(capture_id="")) == [5, 5, 5, 5]


def test_by_name_when_ids_and_times_were_stripped():
    assert sizes(rig(capture_id="", time=None)) == [5, 5, 5, 5]


def test_a_shared_time_that_is_not_unique_within_a_band_does_not_group():
    same_second = [replace(f, time="2024-05-01T10:00:00", path=f"x/{i}.tif") for i, f in enumerate(rig(capture_id=""))]
    assert sizes(same_second) == [1] * 20


def test_dji_numbers_group_only_near_in_time():
    names = ("DJI_0001_MS_G.TIF", "DJI_0001_MS_R.TIF")
    base = rig(1, capture_id="")[:2]
    near = [replace(f, path=f"in/{n}") for f, n in zip(base, names)]
    assert sizes(near) == [2]
    late = [near[0], replace(near[1], time="2024-05-01T10:05:00", path="in/DJI_0001_R.TIF")]
    assert sizes([replace(late[0], path="in/DJI_0001_D.JPG"), late[1]]) in ([1, 1], [2])


def test_a_rigs_colour_frame_without_id_joins_its_capture():
    frames = rig()
    colour = Frame(
        path="in/IMG_0001_RGB.JPG", size_bytes=1, format="jpeg", width=4608, height=3456, make="MicaSense",
        model="RedEdge", time="2024-05-01T10:00:02", latitude=46.0001, longitude=8.0,
    )  # fmt: skip
    bands = {**bands_of(frames), colour.path: "rgb"}
    grouped = group_captures([*frames, colour], bands, DEFAULTS)
    assert grouped[colour.path] == "id1"


def test_an_orphan_band_stays_alone_in_its_capture():
    frames = rig()
    orphan = replace(frames[0], path="in/IMG_0009_1.tif", capture_id="id9")
    assert sizes([*frames, orphan]) == [1, 5, 5, 5, 5]


def test_times_before_the_clock_was_set_do_not_count():
    assert seconds(replace(rig()[0], time="1970-01-01T00:00:10")) is None
    assert seconds(replace(rig()[0], time="nonsense")) is None
