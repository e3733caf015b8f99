"""What harmonizing a 20 MP JPEG costs: size, one colour table per channel, tags kept, quality 95.

    python benchmarks/harmonize.py [FRAME.JPG] [--rounds 5] [--frames 6]

The frame is a mosaic of FRAME (header kept), or of noise that looks like ground
where none is given. First at 0.8 times the size, which is what the limits are
set for, then at 1.5 times: CPU seconds of one core, best of the rounds, beside
decoding and encoding alone (the same libjpeg-turbo, the same frame), other
filters of OpenCV, Pillow with its Lanczos filter, table and tags,
gdal_translate where it is installed (size only), and simplejpeg where it is
installed (its codec around our pixels). Then the real thing, files and tags and
journal, in one and in two worker processes, with the memory of the largest.
Wall time says little on a machine that others use; "by CPU" is what two
processes would reach on two free cores. PSNR is that to a Lanczos resize in
floating point, before encoding. Exit code 1 where a limit is missed.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, List, Tuple

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize import FlightAction, HarmonizePlan, Lut, apply, jpeg
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
MOST_OVER_BARE, LEAST_OVER_PILLOW, MOST_MEMORY_MB, LEAST_SPEEDUP = 2.5, 1.4, 250.0, 1.8
Figures = Dict[str, float]


def mosaic(frame: bytes) -> bytes:
    """A 20 MP JPEG that repeats the picture of ``frame`` under its header, tags told the new size."""
    tile = decode_jpeg(frame, grey=False)
    across, down = -(-WIDTH // tile.shape[1]), -(-HEIGHT // tile.shape[0])
    pixels = np.ascontiguousarray(np.tile(tile, (down, across, 1))[:HEIGHT, :WIDTH])
    edit = TagEdit((tile.shape[1], tile.shape[0], WIDTH, HEIGHT))
    return jpeg.with_header_of(frame, encode_jpeg(pixels, (2, 1), DEFAULTS), edit)


def cpu_s(work: Callable[[], object], who: int) -> float:
    before = resource.getrusage(who)
    work()
    after = resource.getrusage(who)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def best(works: Dict[str, Tuple[Callable[[], object], int]], rounds: int) -> Figures:
    """Least CPU seconds of each; the rounds go through all of them in turn, so that a busy spell hits all alike."""
    taken: Dict[str, List[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, (work, who) in works.items():
            taken[name].append(cpu_s(work, who))
    return {name: min(values) for name, values in taken.items()}


def contenders(data: bytes, scale: float, folder: Path) -> Dict[str, Tuple[Callable[[], object], int]]:
    """Name -> (work, whose CPU) of everything that is compared at one scale."""
    cv2 = opencv()
    size = (round(WIDTH * scale), round(HEIGHT * scale))
    job = FrameJob("a", "a", "a", REWRITE, len(data), WIDTH, HEIGHT, *size, tables=TABLES, focal_mm=8.8)
    small = resize(decode_jpeg(data, grey=False), size)
    lookup = np.ascontiguousarray(np.asarray(TABLES[::-1], np.uint8).T[:, None])

    def bare() -> None:
        decode_jpeg(data, grey=False)
        encode_jpeg(small, (2, 1), DEFAULTS)

    def ours() -> bytes:
        return rewrite(data, job, DEFAULTS)

    def plain(kind: int) -> bytes:
        other = cv2.resize(decode_jpeg(data, grey=False), size, interpolation=kind)
        return encode_jpeg(cv2.LUT(other, lookup), (2, 1), DEFAULTS)

    def pillow() -> bytes:
        with Image.open(io.BytesIO(data)) as image:
            other = image.resize(size, Image.Resampling.LANCZOS).point([v for table in TABLES for v in table])
            out = io.BytesIO()
            more = {"exif": image.info.get("exif", b""), "xmp": image.info.get("xmp", b"")}
            other.save(out, "JPEG", quality=95, subsampling="4:2:2", **more)
        return out.getvalue()

    assert hashlib.sha256(ours()).digest() == hashlib.sha256(ours()).digest()
    mine = resource.RUSAGE_SELF
    works: Dict[str, Tuple[Callable[[], object], int]] = {"decode + encode alone": (bare, mine)}
    works["sensorgate"] = (ours, mine)
    works["OpenCV area, no tags"] = (partial(plain, cv2.INTER_AREA), mine)
    works["OpenCV Lanczos, no tags"] = (partial(plain, cv2.INTER_LANCZOS4), mine)
    works["Pillow Lanczos"] = (pillow, mine)
    works.update({name: (work, mine) for name, work in with_simplejpeg(data, size, lookup).items()})
    if shutil.which("gdal_translate"):
        source = folder / "gdal.jpg"
        source.write_bytes(data)
        for kind in ("average", "cubic", "lanczos"):
            command = ["gdal_translate", "-q", "-of", "JPEG", "-co", "QUALITY=95", "-r", kind, "-outsize"]
            command += [str(size[0]), str(size[1]), str(source), str(folder / "gdal_out.jpg")]
            work = partial(subprocess.run, command, check=True, capture_output=True)
            works[f"gdal_translate {kind}"] = (work, resource.RUSAGE_CHILDREN)
    return works


def with_simplejpeg(data: bytes, size: Tuple[int, int], lookup: np.ndarray) -> Dict[str, Callable[[], object]]:
    try:
        import simplejpeg
    except ImportError:
        return {}

    def work() -> Any:
        pixels = resize(simplejpeg.decode_jpeg(data, colorspace="BGR"), size)
        pixels = opencv().LUT(pixels, lookup)
        return simplejpeg.encode_jpeg(pixels, quality=95, colorspace="BGR", colorsubsampling="422")

    return {"simplejpeg, no tags": work}


def compare(data: bytes, scale: float, rounds: int, folder: Path) -> Tuple[float, float]:
    """Print the table of one scale; returns ours over the bare codec, and Pillow over ours."""
    works = contenders(data, scale, folder)
    figures = best(works, rounds)
    base, ours = figures["decode + encode alone"], figures["sensorgate"]
    print(f"\n{scale:g} x, to {round(WIDTH * scale)}x{round(HEIGHT * scale)}")
    print(f"{'':26}{'CPU s':>8}{'/ bare':>8}{'/ ours':>8}")
    for name, cpu in figures.items():
        print(f"{name:26}{cpu:8.3f}{cpu / base:8.2f}{cpu / ours:8.2f}")
    return ours / base, figures["Pillow Lanczos"] / ours


def fidelity(data: bytes, scale: float) -> str:
    cv2 = opencv()
    crop = np.ascontiguousarray(decode_jpeg(data, grey=False)[:1500, :2000])
    to = (round(2000 * scale), round(1500 * scale))
    planes = [Image.fromarray(crop[:, :, c].astype(np.float32)).resize(to, Image.Resampling.LANCZOS) for c in range(3)]
    wanted = np.stack([np.asarray(p) for p in planes], axis=-1)
    shown = [
        f"{name} {psnr(result, wanted):.1f}"
        for name, result in (
            ("sensorgate", resize(crop, to)),
            ("area", cv2.resize(crop, to, interpolation=cv2.INTER_AREA)),
            ("linear", cv2.resize(crop, to, interpolation=cv2.INTER_LINEAR)),
            ("cubic", cv2.resize(crop, to, interpolation=cv2.INTER_CUBIC)),
            ("Pillow bicubic", np.asarray(Image.fromarray(crop).resize(to, Image.Resampling.BICUBIC))),
        )
    ]
    return "PSNR in dB: " + ", ".join(shown)


def run_files(folder: Path, count: int, workers: int, scale: float) -> None:
    """Harmonize ``count`` files of ``folder`` and print what it took, as JSON: for a process of its own."""
    files = {f"{i}.jpg": folder / f"{i}.jpg" for i in range(count)}
    frames = {n: Frame(n, f.stat().st_size, "jpeg", WIDTH, HEIGHT, focal_mm=8.7) for n, f in files.items()}
    size = (round(WIDTH * scale), round(HEIGHT * scale))
    action = FlightAction(
        "p", "f", tuple(files), 2.0, 2.0 / scale, scale, WIDTH, HEIGHT, *size, lut="l", write_lut=True, focal_mm=8.8
    )
    plan = HarmonizePlan((action,), (Lut("l", TABLES, (0.0,) * 3, "r", 1),))
    out = folder / f"out{workers}"
    targets = {n: out / n for n in files}
    began = time.perf_counter()
    done, broken = apply(plan, frames, files, targets, thresholds=DEFAULTS, workers=workers, journal=out / "journal")
    assert len(done) == count and not broken
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    figures = {"wall": time.perf_counter() - began, "cpu": used.ru_utime + used.ru_stime, "kb": used.ru_maxrss}
    print(json.dumps(figures))


def processes(data: bytes, count: int, folder: Path, scale: float, rounds: int) -> Tuple[float, float, float]:
    """Print one and two processes; returns the speed-up by wall and by CPU, and the peak memory in MB."""
    for index in range(count):
        (folder / f"{index}.jpg").write_bytes(data)
    found: Dict[int, Figures] = {}
    for workers in (1, 2):
        tries = []
        for _ in range(rounds):
            shutil.rmtree(folder / f"out{workers}", ignore_errors=True)
            command = [sys.executable, __file__, "--files", str(folder), str(count), str(workers), str(scale)]
            tries.append(json.loads(subprocess.run(command, check=True, capture_output=True).stdout))
        found[workers] = {name: min(t[name] for t in tries) for name in ("wall", "cpu")}
        found[workers]["mb"] = max(t["kb"] for t in tries) / 1024
        print(
            f"{scale:g} x, {count} files, {workers} worker{'s'[: workers - 1]}: wall {found[workers]['wall']:.2f} s, "
            f"CPU {found[workers]['cpu']:.2f} s, largest {found[workers]['mb']:.0f} MB"
        )
    by_wall = found[1]["wall"] / found[2]["wall"]
    by_cpu = 2.0 * found[1]["cpu"] / found[2]["cpu"]
    return by_wall, by_cpu, max(f["mb"] for f in found.values())


def main() -> int:
    if sys.argv[1:2] == ["--files"]:
        run_files(Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), float(sys.argv[5]))
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frame", nargs="?", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=6, help="files of the trial with worker processes")
    arguments = parser.parse_args()
    opencv()
    data = mosaic(arguments.frame.read_bytes() if arguments.frame else jpeg_bytes(1368, 912))
    print(f"{WIDTH}x{HEIGHT}, {len(data) / 1e6:.1f} MB")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        over_bare, over_pillow = compare(data, 0.8, arguments.rounds, folder)
        print(fidelity(data, 0.8))
        compare(data, 1.5, arguments.rounds, folder)
        print(fidelity(data, 1.5) + "\n")
        by_wall, by_cpu, memory = processes(data, arguments.frames, folder, 0.8, 2)
    checks = (
        (f"ours over the bare codec {over_bare:.2f} (at most {MOST_OVER_BARE})", over_bare <= MOST_OVER_BARE),
        (f"Pillow over ours {over_pillow:.2f} (at least {LEAST_OVER_PILLOW})", over_pillow >= LEAST_OVER_PILLOW),
        (f"peak memory {memory:.0f} MB (at most {MOST_MEMORY_MB:.0f})", memory <= MOST_MEMORY_MB),
        (
            f"two processes {by_wall:.2f} times one by wall, {by_cpu:.2f} by CPU (at least {LEAST_SPEEDUP})",
            max(by_wall, by_cpu) >= LEAST_SPEEDUP,
        ),
    )
    print()
    for text, held in checks:
        print(f"{'ok    ' if held else 'MISSED'} {text}")
    return 0 if all(held for _, held in checks) else 1


if __name__ == "__main__":
    sys.exit(main())
