from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from sensorgate.stages.align.images import read_grey, stretch_ranges, to_eight_bits, working_size
from sensorgate.stages.align.solution import JobFrame


def _ramp(width=400, height=300):
    return np.tile(np.linspace(10, 240, width), (height, 1))


def test_sizes_shrink_and_never_grow():
    assert working_size(4000, 3000, 1200) == (1200, 900)
    assert working_size(3000, 4000, 1200) == (900, 1200)
    assert working_size(640, 512, 1200) == (640, 512)


@pytest.mark.parametrize("size", [(400, 300), (200, 150), (93, 70)])
def test_a_jpeg_keeps_its_picture_when_decoded_small(tmp_path, size):
    path = tmp_path / "a.jpg"
    Image.fromarray(_ramp().astype(np.uint8)).convert("RGB").save(path, quality=95)
    grey = read_grey(str(path), size)
    assert grey.dtype == np.uint8 and grey.shape == (size[1], size[0])
    assert abs(grey.astype(float).mean() - 125) < 2
    assert grey[:, -1].mean() - grey[:, 0].mean() > 210


def test_sixteen_bits_are_stretched_per_flight_not_per_frame(tmp_path):
    """The dark frame stays darker than the bright one of its flight."""
    frames = []
    for name, gain in (("dark", 20.0), ("bright", 60.0)):
        path = tmp_path / f"{name}.tif"
        Image.fromarray((_ramp() * gain).astype(np.uint16)).save(path)
        frames.append(JobFrame(name, str(path), 0, "flight"))
    sizes = [(200, 150)] * 2
    spans = stretch_ranges(frames, sizes)
    dark, bright = (to_eight_bits(read_grey(f.file, s), spans["flight"]) for f, s in zip(frames, sizes))
    assert dark.dtype == np.uint8
    assert bright.mean() > dark.mean() + 40


def test_eight_bit_flights_are_not_stretched(tmp_path):
    Image.fromarray(_ramp().astype(np.uint8)).save(tmp_path / "a.png")
    frame = JobFrame("a", str(tmp_path / "a.png"), 0, "f")
    assert stretch_ranges([frame], [(100, 75)]) == {}


def test_tables_are_applied_per_channel(tmp_path):
    Image.fromarray(np.full((60, 80, 3), (10, 20, 30), dtype=np.uint8)).save(tmp_path / "a.png")
    invert = tuple(255 - v for v in range(256))
    same = tuple(range(256))
    plain = read_grey(str(tmp_path / "a.png"), (80, 60), (same, same, same))
    turned = read_grey(str(tmp_path / "a.png"), (80, 60), (invert, invert, invert))
    assert abs(int(plain[0, 0]) + int(turned[0, 0]) - 255) <= 1


def test_a_broken_file_raises(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8 no picture")
    with pytest.raises((OSError, ValueError)):
        read_grey(str(tmp_path / "a.jpg"), (10, 10))
