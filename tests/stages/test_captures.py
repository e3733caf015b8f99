"""Captures: by id, by DJI's number, by time, by name; never a frame twice in one."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.captures import find_bodies, group_captures, seconds
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


# --- ids that cannot be true


def by_capture(frames):
    grouped = group_captures(frames, bands_of(frames), DEFAULTS)
    groups = {}
    for path, capture in grouped.items():
        groups.setdefault(capture, set()).add(path)
    return {frozenset(g) for g in groups.values()}


def names(capture, bands=range(1, 6)):
    return frozenset(f"in/IMG_{capture:04d}_{b}.tif" for b in bands)


@pytest.mark.parametrize("other", [3, 7])
def test_two_ids_exchanged_in_one_band_are_put_right_by_their_times(other):
    frames = rig(12)
    swapped = {"in/IMG_0002_5.tif": f"id{other}", f"in/IMG_{other:04d}_5.tif": "id2"}
    wrong = [replace(f, capture_id=swapped.get(f.path, f.capture_id)) for f in frames]
    assert by_capture(wrong) == {names(c) for c in range(12)}


def test_an_id_used_again_by_a_later_flight_is_two_captures():
    morning, noon = rig(3), [replace(f, path="b/" + f.path, time="2024-05-01T12" + f.time[13:]) for f in rig(3)]
    assert sizes([*morning, *noon]) == [5] * 6


def test_ids_hold_where_the_bands_clocks_disagree_throughout():
    frames = [replace(f, time="2024-05-01T11" + f.time[13:]) if f.bands == ("nir",) else f for f in rig(8)]
    assert by_capture(frames) == {names(c) for c in range(8)}


def test_ids_of_single_files_group_nothing_so_time_does():
    frames = [replace(f, capture_id=f"{i}-unique") for i, f in enumerate(rig())]
    assert sizes(frames) == [5, 5, 5, 5]


def test_a_band_copied_twice_under_one_id_stays_in_its_capture():
    frames = rig()
    again = replace(frames[2], path="in/IMG_0000_3 (1).tif", size_bytes=7)
    assert sizes([*frames, again]) == [5, 5, 5, 6]


# --- how the makers number


def band_frame(name, band, second, **changes):
    return Frame(
        path=f"in/{name}", size_bytes=1, format="tiff", width=1600, height=1300, make="DJI", model="FC6360",
        bands=(band,), time=f"2024-05-01T10:00:{second:02d}", latitude=46.0 + 1e-5 * second, longitude=8.0, **changes,
    )  # fmt: skip


P4M = ("rgb", "blue", "green", "red", "rededge", "nir")


def p4m(captures, spread=0):
    """P4 Multispectral: ..0.JPG is the colour frame, ..1 to ..5.TIF the bands; the second may turn between them."""
    return [
        band_frame(
            f"DJI_{c:03d}{b}.{'TIF' if b else 'JPG'}", band, 2 * c + (1 if b > 3 and c in (2, 3) else 0) * spread
        )
        for c in range(1, captures + 1)
        for b, band in enumerate(P4M)
    ]


@pytest.mark.parametrize("spread", [0, 1])
def test_p4_multispectral_numbers_by_tens(spread):
    frames = p4m(9, spread)
    expected = {frozenset(f.path for f in frames[6 * c : 6 * c + 6]) for c in range(9)}
    assert by_capture(frames) == expected


def test_p4_multispectral_with_one_band_lost():
    frames = [f for f in p4m(9) if f.name != "DJI_0043.TIF"]
    assert sizes(frames) == [5] + [6] * 8


M3M = (
    ("D.JPG", "rgb"), ("MS_G.TIF", "green"), ("MS_R.TIF", "red"), ("MS_RE.TIF", "rededge"), ("MS_NIR.TIF", "nir"),
)  # fmt: skip


def m3m(captures, gap=1):
    """Mavic 3 Multispectral: one number for all, the stamp may turn a second over; a capture a second."""
    return [
        band_frame(f"DJI_202405011000{gap * c:02d}_{c:04d}_{suffix}", band, gap * c)
        for c in range(1, captures + 1)
        for suffix, band in M3M
    ]


def test_mavic_3_multispectral_shares_one_number():
    frames = m3m(11)
    assert by_capture(frames) == {frozenset(f.path for f in frames[5 * c : 5 * c + 5]) for c in range(11)}
    assert sizes(m3m(1)) == [5]


def test_numbers_that_start_again_are_kept_apart_by_time():
    later = [
        replace(f, path=f.path.replace("DJI_20240501", "DJI_20240502"), time="2024-05-02" + f.time[10:]) for f in m3m(4)
    ]
    assert sizes(m3m(4) + later) == [5] * 8


def test_sequoia_by_name_where_ids_and_times_are_gone():
    bands = ("RGB.JPG", "GRE.TIF", "RED.TIF", "REG.TIF", "NIR.TIF")
    frames = [
        replace(band_frame(f"IMG_161122_1632{c}_{c:04d}_{b}", b, 0), time=None, latitude=None)
        for c in range(34, 40)
        for b in bands
    ]
    assert sizes(frames) == [5] * 6


def test_running_numbers_of_a_plain_camera_are_no_band_suffix():
    frames = [replace(band_frame(f"IMG_{n}.JPG", b, 0), time=None) for n, b in (("0001", "rgb"), ("0002", "nir"))]
    assert sizes(frames) == [1, 1]


def test_bodies_by_serial_and_by_the_captures_they_share():
    colour = band_frame("a.JPG", "rgb", 1, capture_id="x")
    bands = [replace(band_frame(f"{b}.TIF", b, 1, capture_id="x"), model="FC6360-MS", serial="7") for b in P4M[1:]]
    other = replace(band_frame("other.JPG", "rgb", 1), serial="8")
    frames = [colour, *bands, other]
    assert [len(b) for b in find_bodies(frames, {f.path: f.serial for f in frames})] == [6, 1]
    unshared = [replace(colour, capture_id=""), *bands, other]
    assert len(find_bodies(unshared, {f.path: f.serial for f in unshared})) == 3


# --- the laws

FRAMES = st.builds(
    Frame,
    path=st.builds(
        "{}/{}{}_{}.tif".format,
        st.sampled_from("ab"),
        st.sampled_from(("IMG_", "DJI_", "DJI_20240501100001_")),
        st.integers(0, 12).map("{:04d}".format),
        st.sampled_from(("1", "2", "MS_G", "x")),
    ),
    size_bytes=st.just(1),
    format=st.just("tiff"),
    width=st.just(10),
    height=st.just(10),
    bands=st.sampled_from((("red",), ("green",), ("nir",))),
    capture_id=st.sampled_from(("", "", "a", "b", "c")),
    sequence=st.sampled_from((None, 0, 1)),
    time=st.one_of(st.none(), st.integers(0, 9).map("2024-05-01T10:00:0{}".format)),
    latitude=st.sampled_from((None, 46.0, 46.00001, 46.1)),
    longitude=st.just(8.0),
)


@given(st.lists(FRAMES, unique_by=lambda f: f.path, max_size=30), st.randoms(use_true_random=False))
@settings(max_examples=150, deadline=None)
def test_every_frame_has_one_capture_whatever_the_order(frames, rng: random.Random):
    bands = bands_of(frames)
    grouped = group_captures(frames, bands, DEFAULTS)
    assert set(grouped) == {f.path for f in frames}
    shuffled = list(frames)
    rng.shuffle(shuffled)
    assert group_captures(shuffled, bands, DEFAULTS) == grouped
    by_name = {f.path: f for f in frames}
    groups = {}
    for path, capture in grouped.items():
        groups.setdefault(capture, []).append(by_name[path])
    for capture, members in groups.items():
        for band in {f.bands for f in members}:
            same = [f for f in members if f.bands == band]
            # Only the camera's own id may put one band into a capture twice.
            assert len(same) == 1 or {f.capture_id for f in same} == {capture}
