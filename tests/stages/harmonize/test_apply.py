"""Harmonizing whole surveys: what is linked, copied, rewritten, and what is said."""

from __future__ import annotations

import errno

import numpy as np
import pytest
from PIL import Image
from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize import HarmonizePlan, Lut
from sensorgate.stages.harmonize import files as put

from .applying import PLUS_TEN, action, digests, run, shrunk, survey
from .samples import texture

pytest.importorskip("cv2")


def test_untouched_frames_are_the_same_file(tmp_path):
    frames = survey(tmp_path / "in")
    done, broken = run(HarmonizePlan((action(frames),)), frames, tmp_path / "in", tmp_path / "out")
    assert not broken and [d.how for d in done] == ["linked"] * 3
    for name in frames:
        assert (tmp_path / "in" / name).samefile(tmp_path / "out" / name)
    again, _ = run(HarmonizePlan((action(frames),)), frames, tmp_path / "in", tmp_path / "out")
    assert again == done


def test_copies_where_links_cannot_be(tmp_path, monkeypatch):
    frames = survey(tmp_path / "in")

    def refuse(*_args, **_options):
        raise OSError(errno.EXDEV, "cross-device")

    monkeypatch.setattr(put.os, "link", refuse)
    done, _ = run(HarmonizePlan((action(frames),)), frames, tmp_path / "in", tmp_path / "out")
    assert {d.how for d in done} == {"copied"}
    assert digests(tmp_path / "in") == digests(tmp_path / "out")


def test_one_pass_of_size_table_and_tag(tmp_path):
    frames = survey(tmp_path / "in")
    before = digests(tmp_path / "in")
    plan = shrunk(frames, focal_mm=8.801)
    done, broken = run(plan, frames, tmp_path / "in", tmp_path / "out")
    assert not broken and [(d.how, d.width, d.height, d.scale) for d in done] == [("resampled", 256, 192, 0.8)] * 3
    assert digests(tmp_path / "in") == before
    for name in frames:
        with Image.open(tmp_path / "out" / name) as image, Image.open(tmp_path / "in" / name) as source:
            assert image.size == (256, 192)
            assert float(image.getexif().get_ifd(0x8769)[0x920A]) == pytest.approx(8.801)
            want = np.asarray(source.resize((256, 192), Image.Resampling.BICUBIC)).astype(float).mean() + 10
            assert np.asarray(image).mean() == pytest.approx(want, abs=1.5)


def test_focal_tags_alone_need_no_opencv_and_leave_the_picture(tmp_path):
    frames = survey(tmp_path / "in")
    done, _ = run(HarmonizePlan((action(frames, focal_mm=8.801),)), frames, tmp_path / "in", tmp_path / "out")
    assert [d.how for d in done] == ["retagged", "linked", "retagged"]
    for name in frames:
        with Image.open(tmp_path / "out" / name) as image, Image.open(tmp_path / "in" / name) as source:
            assert float(image.getexif().get_ifd(0x8769)[0x920A]) == pytest.approx(8.801)
            assert np.array_equal(np.asarray(image), np.asarray(source))


def test_colours_alone_are_called_matched(tmp_path):
    frames = survey(tmp_path / "in", 1)
    lut = Lut("l", (PLUS_TEN,) * 3, (-10.0,) * 3, "r", 6)
    done, _ = run(
        HarmonizePlan((action(frames, lut="l", write_lut=True),), (lut,)), frames, tmp_path / "in", tmp_path / "out"
    )
    assert done[0].how == "matched"
    silent, _ = run(HarmonizePlan((action(frames, lut="l"),), (lut,)), frames, tmp_path / "in", tmp_path / "out2")
    assert silent[0].how == "linked"


def test_frames_without_an_action_are_linked(tmp_path):
    frames = survey(tmp_path / "in")
    done, _ = run(HarmonizePlan(()), frames, tmp_path / "in", tmp_path / "out")
    assert {d.how for d in done} == {"linked"}


def test_sixteen_bit_tiff_keeps_its_depth(tmp_path):
    (tmp_path / "in").mkdir()
    pixels = texture(120, 90, 1)[:, :, 0].astype(np.uint16) * 257
    Image.fromarray(pixels).save(tmp_path / "in" / "a.TIF")
    size = (tmp_path / "in" / "a.TIF").stat().st_size
    frames = {"a.TIF": Frame("a.TIF", size, "tiff", 120, 90, bits=16, channels=1)}
    plan = HarmonizePlan((action(frames, scale=1.5, out_width=180, out_height=135),))
    run(plan, frames, tmp_path / "in", tmp_path / "out")
    with Image.open(tmp_path / "out" / "a.TIF") as image:
        assert image.size == (180, 135) and np.asarray(image).dtype == np.uint16


def test_mask_follows_its_frame(tmp_path):
    frames = survey(tmp_path / "in", 1)
    name = next(iter(frames))
    mask = tmp_path / "in" / "IMG_000_mask.png"
    Image.fromarray(np.where(texture(320, 240, 1)[:, :, 0] > 128, 255, 0).astype(np.uint8)).save(mask)
    place = tmp_path / "out" / mask.name
    _, broken = run(shrunk(frames), frames, tmp_path / "in", tmp_path / "out", masks={name: (mask, place)})
    assert not broken
    with Image.open(place) as image:
        assert image.size == (256, 192) and set(np.unique(np.asarray(image))) == {0, 255}


def test_a_bad_frame_does_not_stop_the_others(tmp_path):
    frames = survey(tmp_path / "in", 5)
    names = list(frames)
    (tmp_path / "in" / names[0]).unlink()
    (tmp_path / "in" / names[1]).write_bytes(b"\xff\xd8\xff" + bytes(frames[names[1]].size_bytes - 3))
    data = (tmp_path / "in" / names[2]).read_bytes()
    cut = data[: len(data) * 2 // 3]
    (tmp_path / "in" / names[2]).write_bytes(cut + bytes(len(data) - len(cut)))
    (tmp_path / "in" / names[3]).write_bytes(data + b"more")
    done, broken = run(shrunk(frames), frames, tmp_path / "in", tmp_path / "out")
    assert [d.path for d in done] == names[4:]
    assert {b.path: b.code for b in broken} == {
        names[0]: "frame-vanished",
        names[1]: "tags-not-rewritable",
        names[2]: "truncated-image",
        names[3]: "frame-changed",
    }
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == names[4:]


def test_a_file_that_cannot_be_rewritten_goes_in_as_it_is(tmp_path):
    """BigTIFF: no reason to lose the frame, nor its mask; the others are resampled."""
    (tmp_path / "in").mkdir()
    pixels = texture(120, 90, 1)[:, :, 0]
    Image.fromarray(pixels).save(tmp_path / "in" / "a.TIF")
    Image.fromarray(pixels).save(tmp_path / "in" / "b.TIF", big_tiff=True)
    assert (tmp_path / "in" / "b.TIF").read_bytes()[2] == 43
    mask = tmp_path / "in" / "b_mask.png"
    Image.fromarray(pixels).save(mask)
    frames = {
        n: Frame(n, (tmp_path / "in" / n).stat().st_size, "tiff", 120, 90, channels=1, focal_mm=5.0)
        for n in ("a.TIF", "b.TIF")
    }
    masks = {"b.TIF": (mask, tmp_path / "out" / mask.name)}
    for plan, how in (
        (HarmonizePlan((action(frames, scale=1.5, out_width=180, out_height=135),)), "resampled"),
        (HarmonizePlan((action(frames, focal_mm=5.5),)), "retagged"),
    ):
        done, broken = run(plan, frames, tmp_path / "in", tmp_path / "out", masks=masks)
        assert not broken
        assert [(d.how, bool(d.kept)) for d in done] == [(how, False), ("linked", True)]
        assert (done[1].width, done[1].scale) == (120, 1.0)
        assert (tmp_path / "in" / "b.TIF").samefile(tmp_path / "out" / "b.TIF")
        with Image.open(tmp_path / "out" / mask.name) as image:
            assert image.size == (120, 90)


def test_a_link_whose_source_is_gone_is_told(tmp_path):
    frames = survey(tmp_path / "in", 2)
    (tmp_path / "in" / "IMG_000.JPG").unlink()
    done, broken = run(HarmonizePlan((action(frames),)), frames, tmp_path / "in", tmp_path / "out")
    assert [b.code for b in broken] == ["frame-vanished"] and len(done) == 1
