from __future__ import annotations

import io
import struct
import zlib

import exifread
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from sensorgate.stages.errors import FrameError
from sensorgate.stages.harmonize import tiff
from sensorgate.stages.harmonize.exif import TagEdit, TiffBlock
from sensorgate.stages.harmonize.metadata import retag
from sensorgate.stages.harmonize.resample import resize
from sensorgate.stages.harmonize.targets import rewritable
from sensorgate.stages.harmonize.work import REWRITE, FrameJob, rewrite
from sensorgate.stages.profile import THERMAL
from sensorgate.stages.read import read_frame
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.spectrum import classify
from sensorgate.stages.thresholds import DEFAULTS

from .samples import MAKER_NOTE, exiftool, real, texture


def by_pillow(pixels: np.ndarray, **options) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "TIFF", **options)
    return out.getvalue()


def by_hand(
    pixels: np.ndarray, *, order: str = "<", compression: int = 1, planar: int = 1, tile: int = 0, rows: int = 0
) -> bytes:
    """A TIFF that Pillow cannot write: any channel count, byte order, planes, tiles."""
    height, width, channels = pixels.shape
    typed = pixels.astype(pixels.dtype.newbyteorder(order))
    planes = [typed] if planar == 1 else [typed[:, :, c : c + 1] for c in range(channels)]
    parts = []
    for plane in planes:
        if tile:
            for top in range(0, height, tile):
                for left in range(0, width, tile):
                    full = np.zeros((tile, tile, plane.shape[2]), plane.dtype)
                    cut = plane[top : top + tile, left : left + tile]
                    full[: cut.shape[0], : cut.shape[1]] = cut
                    parts.append(full.tobytes())
        else:
            step = rows or height
            parts += [plane[top : top + step].tobytes() for top in range(0, height, step)]
    if compression == 8:
        parts = [zlib.compress(p) for p in parts]
    kind = {"u": 1, "i": 2, "f": 3}[pixels.dtype.kind]
    tags = {256: (4, [width]), 257: (4, [height]), 258: (3, [8 * pixels.itemsize] * channels), 259: (3, [compression])}
    tags.update({262: (3, [1]), 277: (3, [channels]), 284: (3, [planar]), 339: (3, [kind] * channels)})
    tags[0xC61A] = (4, [4800])
    tags[271] = (2, list(b"ACME\x00"))
    offsets, lengths = (324, 325) if tile else (273, 279)
    tags.update({322: (4, [tile]), 323: (4, [tile])} if tile else {278: (4, [rows or height])})
    tags.update({offsets: (4, [0] * len(parts)), lengths: (4, [len(p) for p in parts])})
    code = {2: "B", 3: "H", 4: "I"}
    base = 8 + 2 + 12 * len(tags) + 4
    blobs = {t: struct.pack(f"{order}{len(v)}{code[k]}", *v) for t, (k, v) in tags.items()}
    data_at = base + sum(len(b) for b in blobs.values() if len(b) > 4)
    starts, at = [], data_at
    for part in parts:
        starts.append(at)
        at += len(part)
    blobs[offsets] = struct.pack(f"{order}{len(starts)}I", *starts)
    head = (b"II*\x00" if order == "<" else b"MM\x00*") + struct.pack(order + "IH", 8, len(tags))
    extra = b""
    for tag in sorted(tags):
        kind_, values = tags[tag]
        blob = blobs[tag]
        head += struct.pack(order + "HHI", tag, kind_, len(values))
        if len(blob) <= 4:
            head += blob.ljust(4, b"\x00")
        else:
            head += struct.pack(order + "I", base + len(extra))
            extra += blob
    return head + b"\x00" * 4 + extra + b"".join(parts)


@pytest.mark.parametrize("compression", ["raw", "tiff_lzw", "packbits", "tiff_adobe_deflate"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_reads_what_pillow_writes(compression, dtype):
    pixels = texture(97, 61, 1)[:, :, 0].astype(dtype)
    data = by_pillow(pixels, compression=compression)
    assert np.array_equal(tiff.decode(data, DEFAULTS)[:, :, 0], pixels)


@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_adobe_deflate"])
@pytest.mark.parametrize("dtype, predictor", [(np.uint8, 2), (np.uint16, 2), (np.float32, 3)])
def test_undoes_predictors(compression, dtype, predictor):
    pixels = (texture(97, 61, 1)[:, :, 0].astype(dtype) * 3).astype(dtype)
    data = by_pillow(pixels, compression=compression, tiffinfo={317: predictor})
    assert TiffBlock(bytearray(data)).find(TiffBlock(bytearray(data)).first, 317) is not None
    assert np.array_equal(tiff.decode(data, DEFAULTS)[:, :, 0], pixels)


@given(
    channels=st.integers(1, 10),
    dtype=st.sampled_from(["u1", "u2", "i2", "f4"]),
    order=st.sampled_from("<>"),
    compression=st.sampled_from([1, 8]),
    planar=st.sampled_from([1, 2]),
    tile=st.sampled_from([0, 16, 32]),
    rows=st.sampled_from([0, 7]),
)
@settings(max_examples=80, deadline=None)
def test_round_trip_of_any_layout(channels, dtype, order, compression, planar, tile, rows):
    pixels = np.random.default_rng(channels).integers(0, 200, (37, 53, channels)).astype(dtype)
    data = by_hand(pixels, order=order, compression=compression, planar=planar, tile=tile, rows=rows)
    assert np.array_equal(tiff.decode(data, DEFAULTS), pixels)
    other = np.ascontiguousarray(pixels[:20, :30])
    result = tiff.encode(data, other, TagEdit((53, 37, 30, 20)))
    assert np.array_equal(tiff.decode(result, DEFAULTS), other)
    block = TiffBlock(bytearray(result))
    black, make = block.find(block.first, 0xC61A), block.find(block.first, 271)
    assert black is not None and block.number(black) == 4800
    assert make is not None and result[make.value_at : make.value_at + 5] == b"ACME\x00"
    assert result[:2] == data[:2]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("compression", ["raw", "tiff_lzw"])
def test_resampled_tiff_opens_with_its_new_size(dtype, compression):
    pixels = texture(100, 80, 1)[:, :, 0].astype(dtype)
    data = by_pillow(pixels, compression=compression)
    other = resize(pixels, (150, 120))
    result = tiff.encode(data, other[:, :, None], TagEdit((100, 80, 150, 120)))
    with Image.open(io.BytesIO(result)) as image:
        assert image.size == (150, 120)
        assert np.array_equal(np.asarray(image), other)


def test_exif_gps_and_maker_note_survive_in_a_tiff():
    block = TiffBlock(bytearray(retag(by_pillow(texture(64, 48)), TagEdit(focal_mm=5.0))))
    date = b"2024:05:01 10:00:00\x00"
    block.grow(block.find(block.first, 0x8769).value_at, {0x927C: (7, MAKER_NOTE), 0x9003: (2, date)})
    block.grow(4, {0x8825: (4, b"\x00" * 4)})
    place = struct.pack("<6I", 46, 1, 30, 1, 15, 10)
    block.grow(block.find(block.first, 0x8825).value_at, {1: (2, b"S\x00"), 2: (5, place)})
    data = bytes(block.data)
    edit = TagEdit((64, 48, 32, 24), focal_mm=5.5)
    result = tiff.encode(data, np.ascontiguousarray(texture(64, 48)[::2, ::2]), edit)
    assert data.find(MAKER_NOTE) == result.find(MAKER_NOTE) > 0
    tags = exifread.process_file(io.BytesIO(result))
    assert str(tags["GPS GPSLatitudeRef"]) == "S"
    assert float(tags["EXIF FocalLength"].values[0]) == 5.5
    assert str(tags["EXIF DateTimeOriginal"]) == "2024:05:01 10:00:00"
    with Image.open(io.BytesIO(result)) as image:
        assert image.size == (32, 24)


def test_a_directory_that_names_itself_ends():
    data = bytearray(by_pillow(texture(64, 48)))
    block = TiffBlock(data)
    block.grow(4, {0x8769: (4, struct.pack("<I", 0))})
    entry = block.find(block.first, 0x8769)
    block.put("I", entry.value_at, block.first)
    tiff.encode(bytes(block.data), np.zeros((24, 32, 3), np.uint8), TagEdit((64, 48, 32, 24)))
    retag(bytes(block.data), TagEdit(focal_mm=5.0))


@pytest.mark.parametrize("cut", [0.3, 0.9])
def test_a_cut_file_is_told(cut):
    data = by_hand(texture(64, 48), rows=5)
    with pytest.raises(FrameError):
        tiff.decode(data[: int(len(data) * cut)], DEFAULTS)


def test_a_size_that_lies_takes_no_memory():
    data = bytearray(by_hand(texture(64, 48)))
    block = TiffBlock(data)
    for tag in (256, 257):
        block.set_number(block.find(block.first, tag), 60000)
    with pytest.raises(FrameError) as caught:
        tiff.decode(bytes(data), DEFAULTS)
    assert caught.value.code in ("frame-too-large", "pixels-not-supported")


def test_temperatures_made_from_a_radiometric_jpeg_are_thermal_and_resampled(tmp_path):
    """A float TIFF with the tags of a real R-JPEG, as converters write it: accepted, scaled, still degrees."""
    source = real("thermal_samples/dji-zh20t-thermal/DJI_H20T.jpg")
    y, x = np.mgrid[0:512, 0:640]
    degrees = (21.0 + 9.0 * np.sin(x / 40.0) * np.cos(y / 30.0)).astype(np.float32)
    file = tmp_path / "DJI_H20T.tif"
    Image.fromarray(degrees).save(file)
    exiftool(file, "-q", "-overwrite_original", "-tagsfromfile", str(source), "-all:all", "-unsafe")
    frame = read_frame(file)
    assert (frame.bits, frame.sample_format, frame.model, frame.thermal_payload) == (32, "float", "ZH20T", "")
    assert classify(frame, load_sheet()).spectrum == THERMAL and not rewritable(frame)
    job = FrameJob("a", "", "", REWRITE, frame.size_bytes, 640, 512, 960, 768)
    copy = tmp_path / "copy.tif"
    copy.write_bytes(rewrite(file.read_bytes(), job, DEFAULTS))
    again = read_frame(copy)
    assert (again.bits, again.sample_format, again.width, again.height) == (32, "float", 960, 768)
    assert (again.time, again.latitude, again.focal_mm) == (frame.time, frame.latitude, frame.focal_mm)
    with Image.open(copy) as image:
        found = np.asarray(image)
    want = 21.0 + 9.0 * np.sin(((np.arange(960) + 0.5) / 1.5 - 0.5) / 40.0) * np.cos(
        ((np.arange(768)[:, None] + 0.5) / 1.5 - 0.5) / 30.0
    )
    assert np.abs(found - want)[8:-8, 8:-8].max() < 0.02
