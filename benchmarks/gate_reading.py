"""How fast frames' metadata is read: CPU per frame, and wall time of a folder with one process and with two.

    python benchmarks/gate_reading.py [FOLDER] [--files 2000]

Without FOLDER a folder of made-up frames of three kinds is written (DJI-like
JPEG with Exif and XMP, radiometric JPEG with raw data, 16-bit TIFF with its
directories at the end). With one, its images are taken. Either is repeated by
hard links up to ``--files``. Files are read once before, so that the page
cache holds them and the figures are the reader's own.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sensorgate.stages.read import read_frame, scan
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.headers.build import ASCII, RATIONAL, exif_stream, jpeg_file, packet, tiff_file

ROUNDS = 5


def made_up(folder: Path) -> None:
    exif = exif_stream(
        [(0x010F, ASCII, "DJI"), (0x0110, ASCII, "FC6310")],
        [(0x920A, RATIONAL, (88, 10)), (0x9003, ASCII, "2024:06:01 12:00:00"), (0xA431, ASCII, "0K8TE")],
        [(1, ASCII, "N"), (2, RATIONAL, [(46, 1), (30, 1), (0, 1)]), (3, ASCII, "E"),
         (4, RATIONAL, [(7, 1), (0, 1), (0, 1)])],
    )  # fmt: skip
    names = ("GimbalRollDegree", "GimbalYawDegree", "GimbalPitchDegree", "FlightRollDegree", "FlightYawDegree",
             "RelativeAltitude", "AbsoluteAltitude", "RtkFlag", "RtkStdLon", "RtkStdLat", "RtkStdHgt")  # fmt: skip
    xmp = packet(attributes=" ".join(f'drone-dji:{name}="+1.25"' for name in names)).ljust(8000)
    (folder / "color.jpg").write_bytes(jpeg_file(exif, xmp, size=(1200, 900)))
    raw = [(0xE3, b"\x11\x4b" * 32760)] * 10
    (folder / "thermal.jpg").write_bytes(jpeg_file(exif, xmp, size=(640, 512), segments=raw))
    (folder / "band.tif").write_bytes(tiff_file([(700, 1, list(xmp))], size=(1280, 960)))


def images(folder: Path) -> list:
    return [f.path for f in scan([str(folder)]).frames]


def best(work, clock) -> float:
    times = []
    for _ in range(ROUNDS):
        before = clock()
        work()
        times.append(clock() - before)
    return min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--files", type=int, default=2000)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        sources = Path(scratch) / "sources"
        sources.mkdir()
        if asked.folder is None:
            made_up(sources)
        files = images(asked.folder or sources)
        if not files:
            raise SystemExit("No image was found there.")

        def one_by_one() -> None:
            for file in files:
                read_frame(file)

        cpu = best(one_by_one, time.process_time) / len(files)
        print(f"read_frame, {len(files)} files: {1000 * cpu:.3f} ms CPU a frame")
        many = Path(scratch) / "many"
        many.mkdir()
        for index in range(asked.files):
            source = Path(files[index % len(files)])
            target = many / f"{index:06d}{source.suffix}"
            try:
                os.link(source, target)
            except OSError:
                target.symlink_to(source.resolve())
        for name, limit in (("one process", asked.files), ("two processes", 1)):
            limits = DEFAULTS.replaced({"parallel_read_files": limit})
            seconds = best(lambda limits=limits: scan([str(many)], limits=limits), time.perf_counter)
            print(f"scan, {asked.files} files, {name}: {seconds:.2f} s, {1000 * seconds / asked.files:.3f} ms a frame")


if __name__ == "__main__":
    main()
