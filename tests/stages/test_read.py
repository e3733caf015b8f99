"""Folders to frames: what is found, in which order, once, and what is passed over."""

from __future__ import annotations

import os
import random
import shutil
from pathlib import Path

import pytest
from sensorgate.stages import record
from sensorgate.stages.errors import Cancelled, FrameError, UsageError
from sensorgate.stages.frame import Frame
from sensorgate.stages.read import frame_from_header, read_frame, scan
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.headers.build import REAL, exif_stream, jpeg_file, packet, tiff_file

GOOD = jpeg_file(exif_stream([(0x010F, 2, "Acme")]))


@pytest.fixture
def folder(tmp_path):
    def put(name, data=GOOD):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)

    for name in ("b/DJI_0001.JPG", "a/DJI_0001.jpeg", "a/x.JPE", "a/deep/er/y.jpg", "top.jpg"):
        put(name)
    put("a/m.TIF", tiff_file())
    put("empty.jpg", b"")
    put("cut.jpg", GOOD[:-400])
    put("notes.txt", b"text")
    put("a/film.MP4", b"film")
    put("a/raw.NEF", b"raw")
    put(".DS_Store", b"")
    put(".thumbs/z.jpg")
    put("a/._DJI_0001.jpeg")
    return tmp_path


def test_a_folder_is_read_to_its_leaves(folder):
    found = scan([str(folder)])
    names = [f.path[len(str(folder)) + 1 :] for f in found.frames]
    assert names == ["a/DJI_0001.jpeg", "a/deep/er/y.jpg", "a/m.TIF", "a/x.JPE", "b/DJI_0001.JPG", "top.jpg"]
    assert [(b.path[len(str(folder)) + 1 :], b.code) for b in found.broken] == [
        ("cut.jpg", "truncated-image"), ("empty.jpg", "empty-file"),
    ]  # fmt: skip
    assert found.ignored == {"hidden": 3, "not_images": 2, "raw": 1}


def test_paths_are_as_given_plus_the_relative_part(folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert [f.path for f in scan(["b", "top.jpg"]).frames] == ["b/DJI_0001.JPG", "top.jpg"]
    assert [f.path for f in scan(["./b/"]).frames] == ["./b/DJI_0001.JPG"]
    assert scan(["."]).frames[0].path == "./a/DJI_0001.jpeg"


def test_the_same_file_appears_once_and_the_order_of_arguments_changes_nothing(folder):
    arguments = [str(folder), str(folder / "b"), str(folder / "top.jpg"), str(folder), str(folder) + "/"]
    found = scan(arguments)
    assert len(found.frames) == 6
    for seed in range(5):
        random.Random(seed).shuffle(arguments)
        assert scan(arguments) == found


def test_byte_identical_copies_are_two_frames(folder):
    shutil.copy(folder / "top.jpg", folder / "copy.jpg")
    assert {"copy.jpg", "top.jpg"} <= {f.name for f in scan([str(folder)]).frames}


def test_links_are_followed_once_and_loops_end(folder):
    (folder / "b" / "up").symlink_to(folder, target_is_directory=True)
    (folder / "z_link.jpg").symlink_to(folder / "top.jpg")
    (folder / "dead.jpg").symlink_to(folder / "nowhere.jpg")
    found = scan([str(folder)])
    assert len(found.frames) == 6
    assert [b.code for b in found.broken if b.path.endswith("dead.jpg")] == ["unreadable-file"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes on this system")
def test_a_pipe_named_like_a_picture_does_not_hang(folder):
    os.mkfifo(folder / "pipe.jpg")
    assert [b.code for b in scan([str(folder)]).broken if b.path.endswith("pipe.jpg")] == ["unreadable-file"]


@pytest.mark.skipif(os.name != "posix", reason="names are bytes only there")
def test_a_name_that_is_no_text_is_told(tmp_path):
    try:
        Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe.jpg")).write_bytes(GOOD)
    except OSError:
        pytest.skip("this file system refuses such names")
    found = scan([str(tmp_path)])
    assert [b.code for b in found.broken] == ["unreadable-file"]
    record.dumps(found).encode("utf-8")


def test_a_path_that_does_not_exist_is_a_usage_error(tmp_path):
    with pytest.raises(UsageError, match="nowhere"):
        scan([str(tmp_path / "nowhere")])
    assert scan([str(tmp_path)]).frames == ()


def many(tmp_path, count):
    for index in range(count):
        xmp = packet(attributes=f'Camera:PerspectiveFocalLength="5.4" Camera:BandName="calibration,{index}"')
        (tmp_path / f"{index:04d}.jpg").write_bytes(b"" if index % 50 == 7 else jpeg_file(xmp=xmp, size=(16, 16)))


def test_two_processes_give_what_one_gives(tmp_path):
    many(tmp_path, 120)
    alone = scan([str(tmp_path)])
    told = []
    together = scan(
        [str(tmp_path)],
        limits=DEFAULTS.replaced({"parallel_read_files": 100}),
        progress=lambda what, done, total: told.append((what, done, total)),
    )
    assert together == alone
    assert len(alone.broken) == 3 and alone.frames[0].bands == ("calibration", "0")
    assert told[-1] == ("read", 120, 120) and told == sorted(told)


def test_a_worker_that_cannot_start_changes_nothing(tmp_path, monkeypatch):
    many(tmp_path, 20)
    alone = scan([str(tmp_path)])
    limits = DEFAULTS.replaced({"parallel_read_files": 10})
    for interpreter in ("/bin/false", "/no/such/python"):
        monkeypatch.setattr("sys.executable", interpreter)
        assert scan([str(tmp_path)], limits=limits) == alone


@pytest.mark.parametrize("limit", [10, 1000])
def test_cancelling_stops_the_reading(tmp_path, limit):
    many(tmp_path, 30)
    with pytest.raises(Cancelled):
        scan([str(tmp_path)], cancel=lambda: True, limits=DEFAULTS.replaced({"parallel_read_files": limit}))


def test_limits_reach_the_readers(tmp_path):
    file = tmp_path / "a.jpg"
    file.write_bytes(jpeg_file(xmp=packet(attributes='drone-dji:RtkFlag="50"')))
    assert read_frame(file).rtk_flag == 50
    small = read_frame(file, limits=DEFAULTS.replaced({"max_xmp_bytes": 100}))
    assert small.rtk_flag is None and small.problems[0].startswith("xmp-too-large:")


def test_errors_of_single_files(tmp_path):
    with pytest.raises(FrameError) as caught:
        read_frame(tmp_path / "no.jpg")
    assert caught.value.code == "unreadable-file"
    with pytest.raises(FrameError) as caught:
        read_frame(tmp_path)
    assert caught.value.code == "unreadable-file"
    with pytest.raises(FrameError) as caught:
        frame_from_header("a.jpg", {}, 0)
    assert caught.value.code == "empty-file"


@pytest.mark.skipif(not REAL.is_dir(), reason="the real frames are not beside this checkout")
def test_the_real_frames_are_all_read_and_survive_json():
    found = scan([str(REAL)])
    assert len(found.frames) == 48 and found.broken == ()
    for frame in found.frames:
        assert record.from_plain(Frame, record.to_plain(frame)) == frame
