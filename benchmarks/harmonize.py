"""What harmonizing one 20 MP JPEG costs: 0.8 times the size, one colour table per channel, tags kept, quality 95.

    python benchmarks/harmonize.py [FRAME.JPG] [--rounds 5] [--scale 0.8]

The frame is a mosaic of FRAME (header kept), or of noise that looks like ground
where none is given. CPU seconds, best of the rounds, beside: decoding and
encoding alone (the same libjpeg-turbo), Pillow with its Lanczos filter, table
and tags, and gdal_translate where it is installed (size only). Fidelity is PSNR
to a Lanczos resize in floating point, before encoding.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Callable, Tuple

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sensorgate.stages.harmonize import jpeg
from sensorgate.stages.harmonize.exif import TagEdit
from sensorgate.stages.harmonize.resample import decode_jpeg, encode_jpeg, opencv, resize
from sensorgate.stages.harmonize.work import REWRITE, FrameJob, rewrite
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.harmonize.samples import jpeg_bytes, psnr

WIDTH, HEIGHT = 5472, 3648
TABLES = tuple(
    tuple(min(255, max(0, round(i * slope + shift))) for i in range(256))
    for slope, shift in ((1.1, -5), (1.0, 9), (0.9, 4))
)


def mosaic(frame: bytes) -> bytes:
    """A 20 MP JPEG that repeats the picture of ``frame`` under its header, tags told the new size."""
    tile = decode_jpeg(frame, grey=False)
    across, down = -(-WIDTH // tile.shape[1]), -(-HEIGHT // tile.shape[0])
    pixels = np.ascontiguousarray(np.tile(tile, (down, across, 1))[:HEIGHT, :WIDTH])
    edit = TagEdit((tile.shape[1], tile.shape[0], WIDTH, HEIGHT))
    return jpeg.with_header_of(frame, encode_jpeg(pixels, (2, 1), DEFAULTS), edit)


def best(work: Callable[[], object], rounds: int, who: int = resource.RUSAGE_SELF) -> Tuple[float, float]:
    """Least CPU and least wall seconds of the rounds."""
    cpu, wall = [], []
    for _ in range(rounds):
        before, began = resource.getrusage(who), time.perf_counter()
        work()
        after = resource.getrusage(who)
        cpu.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        wall.append(time.perf_counter() - began)
    return min(cpu), min(wall)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frame", nargs="?", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scale", type=float, default=0.8)
    arguments = parser.parse_args()
    cv2 = opencv()
    data = mosaic(arguments.frame.read_bytes() if arguments.frame else jpeg_bytes(1368, 912))
    size = (round(WIDTH * arguments.scale), round(HEIGHT * arguments.scale))
    job = FrameJob("a", "a", "a", REWRITE, len(data), WIDTH, HEIGHT, *size, tables=TABLES, focal_mm=8.8)
    pixels = decode_jpeg(data, grey=False)
    small = resize(pixels, size)

    def bare() -> None:
        decode_jpeg(data, grey=False)
        encode_jpeg(small, (2, 1), DEFAULTS)

    def pillow() -> bytes:
        with Image.open(io.BytesIO(data)) as image:
            other = image.resize(size, Image.Resampling.LANCZOS).point([v for table in TABLES for v in table])
            out = io.BytesIO()
            other.save(
                out, "JPEG", quality=95, subsampling="4:2:2", exif=image.info["exif"], xmp=image.info.get("xmp", b"")
            )
        return out.getvalue()

    def area() -> bytes:
        """OpenCV's area filter in place of ours, everything else equal."""
        other = cv2.resize(decode_jpeg(data, grey=False), size, interpolation=cv2.INTER_AREA)
        return encode_jpeg(
            cv2.LUT(other, np.ascontiguousarray(np.asarray(TABLES[::-1], np.uint8).T[:, None])), (2, 1), DEFAULTS
        )

    print(f"{WIDTH}x{HEIGHT}, {len(data) / 1e6:.1f} MB -> {size[0]}x{size[1]}")
    assert (
        hashlib.sha256(rewrite(data, job, DEFAULTS)).digest() == hashlib.sha256(rewrite(data, job, DEFAULTS)).digest()
    )
    figures = {
        "decode + encode alone": best(bare, arguments.rounds),
        "sensorgate": best(lambda: rewrite(data, job, DEFAULTS), arguments.rounds),
        "OpenCV area, no tags": best(area, arguments.rounds),
        "Pillow Lanczos": best(pillow, arguments.rounds),
    }
    if shutil.which("gdal_translate"):
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "in.jpg"
            source.write_bytes(data)
            for kind in ("average", "cubic", "lanczos"):
                command = ["gdal_translate", "-q", "-of", "JPEG", "-co", "QUALITY=95", "-r", kind, "-outsize"]
                command += [str(size[0]), str(size[1]), str(source), str(Path(folder) / "out.jpg")]
                work = partial(subprocess.run, command, check=True, capture_output=True)
                figures[f"gdal_translate {kind}"] = best(work, 2, resource.RUSAGE_CHILDREN)
    base, ours = figures["decode + encode alone"][0], figures["sensorgate"][0]
    print(f"{'':26}{'CPU s':>8}{'wall s':>8}{'/ bare':>8}{'/ ours':>8}")
    for name, (cpu, wall) in figures.items():
        print(f"{name:26}{cpu:8.3f}{wall:8.3f}{cpu / base:8.2f}{cpu / ours:8.2f}")
    crop = np.ascontiguousarray(pixels[:1500, :2000])
    to = (round(2000 * arguments.scale), round(1500 * arguments.scale))
    planes = [Image.fromarray(crop[:, :, c].astype(np.float32)).resize(to, Image.Resampling.LANCZOS) for c in range(3)]
    wanted = np.stack([np.asarray(p) for p in planes], axis=-1)
    print("PSNR to float Lanczos:", end="")
    for name, result in (
        ("sensorgate", resize(crop, to)),
        ("area", cv2.resize(crop, to, interpolation=cv2.INTER_AREA)),
        ("linear", cv2.resize(crop, to, interpolation=cv2.INTER_LINEAR)),
        ("Pillow bicubic", np.asarray(Image.fromarray(crop).resize(to, Image.Resampling.BICUBIC))),
    ):
        print(f"  {name} {psnr(result, wanted):.1f} dB", end="")
    print()


if __name__ == "__main__":
    main()
