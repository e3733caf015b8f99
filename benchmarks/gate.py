"""The gate's speed and size beside other readers: CPU per frame, and time and memory at 100,000 frames.

    python benchmarks/gate.py [FOLDER] [--files 1000] [--synthetic 100000]

The headers of FOLDER's images (default: three made-up kinds like those of real
cameras) are copied up to ``--files`` times and read once before, so that the
page cache holds them. All rows of the first table are measured in one
run on the same files; the floor is opening each file and reading 64 KB. The
second table takes frames without files through grouping, flights, rules and
harmonizing plan, at a tenth of the number and at the number: equal times per
frame show that the cost is linear.
"""

from __future__ import annotations

import argparse
import datetime
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import List, Optional, Tuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sensorgate.plugin.pipeline import gate
from sensorgate.stages.gate import assess
from sensorgate.stages.read import header_ranges, read_frame, scan
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import build
from sensorgate.stages.thresholds import DEFAULTS

from benchmarks.gate_reading import made_up
from tests.frames import strip, survey_of

HEAD_BYTES = 65536
VERDICT = "sensorgate: to the verdict"
TIME = re.compile(rb"[12]\d{3}:\d\d:\d\d \d\d:\d\d:\d\d")


def cpu_seconds() -> float:
    """CPU time of this process and of the children that ended."""
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def measured(work, rounds=3):
    """The least CPU and wall seconds of some rounds."""
    times = []
    for _ in range(rounds):
        cpu, wall = cpu_seconds(), time.perf_counter()
        work()
        times.append((cpu_seconds() - cpu, time.perf_counter() - wall))
    return min(t[0] for t in times), min(t[1] for t in times)


def floor(files):
    for file in files:
        with open(file, "rb") as stream:
            stream.read(HEAD_BYTES)


def with_exifread(files):
    import exifread

    for file in files:
        with open(file, "rb") as stream:
            exifread.process_file(stream, details=True)


def with_exiftool(folder):
    command = ["exiftool", "-fast", "-q", "-j", str(folder)]
    subprocess.run(command, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def repeated(source: Path, target: Path, count: int):
    """Fill ``target`` with the images of ``source`` in turn: their headers at their places, holes for the pictures.

    Each copy has a time of its own, two seconds after the one before, as frames
    of a flight have.
    """
    images = [(Path(f.path), header_ranges(f.path), f.size_bytes) for f in scan([str(source)]).frames]
    if not images:
        raise SystemExit("No image was found there.")
    begin = datetime.datetime(2024, 5, 1, 8)
    for index in range(count):
        image, ranges, size = images[index % len(images)]
        stamp = (begin + datetime.timedelta(seconds=2 * index)).strftime("%Y:%m:%d %H:%M:%S").encode("ascii")
        with open(image, "rb") as original, open(target / f"{index:06d}{image.suffix}", "wb") as copy:
            # A file without a time gets a length of its own instead.
            copy.truncate(size)
            dated = False
            for offset, length in ranges:
                original.seek(offset)
                header, changed = TIME.subn(stamp, original.read(length))
                dated = dated or changed > 0
                copy.seek(offset)
                copy.write(header)
            if not dated:
                copy.truncate(size + 1 + index)
    return sorted(target.iterdir())


def reading(source: Optional[Path], scratch: Path, count: int) -> List[Tuple[str, float, float]]:
    """Reader, CPU and wall seconds for ``count`` files; ours to the verdict is named ``VERDICT``."""
    if source is None:
        source = scratch / "source"
        source.mkdir()
        made_up(source)
    folder = scratch / "many"
    folder.mkdir()
    files = repeated(source, folder, count)
    sheet = load_sheet()

    def sensorgate() -> None:
        assess(build(scan([str(folder)]), sheet, DEFAULTS), DEFAULTS)

    rows = [
        ("open and read 64 KB", lambda: floor(files), 3),
        ("sensorgate: read only", lambda: [read_frame(f) for f in files], 3),
        (VERDICT, sensorgate, 3),
        ("sensorgate: gate, whole report", lambda: gate([str(folder)]), 1),
    ]
    try:
        import exifread  # noqa: F401

        rows.append(("exifread, details", lambda: with_exifread(files), 1))
    except ImportError:
        print("exifread is not installed: left out")
    if shutil.which("exiftool"):
        rows.append(("exiftool, one batch", lambda: with_exiftool(folder), 1))
    floor(files)
    return [(name, *measured(work, rounds)) for name, work, rounds in rows]


def read_table(source: Optional[Path], scratch: Path, count: int) -> None:
    results = reading(source, scratch, count)
    ours = next(cpu for name, cpu, _ in results if name == VERDICT)
    print(f"{count} files\n{'':34}{'CPU ms/frame':>14}{'wall ms/frame':>15}{'x sensorgate':>14}")
    for name, cpu, wall in results:
        print(f"{name:34}{1000 * cpu / count:14.3f}{1000 * wall / count:15.3f}{cpu / ours:14.2f}")


def synthetic(count: int) -> None:
    """One row of the second table; a process of its own, so that the peak is its own."""
    frames = []
    flights = max(1, count // 500)
    for number in range(flights):
        start = f"2024-05-{1 + number // 20 % 28:02d}T{number % 20:02d}:00:00"
        place = -91.99 + 0.001 * (number % 40)
        frames += strip(count=count // flights, prefix=f"F{number:04d}_", start=start, longitude=place)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    cpu = time.process_time()
    assess(survey_of(frames), DEFAULTS)
    cpu = time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    unit = 1024 * 1024 if sys.platform == "darwin" else 1024
    print(f"{len(frames):10d}{1000 * cpu / len(frames):14.3f}{cpu:12.1f}{before / unit:14.0f}{peak / unit:12.0f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--synthetic", type=int, default=100_000)
    parser.add_argument("--row", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.row:
        synthetic(asked.row)
        return
    with tempfile.TemporaryDirectory() as place:
        read_table(asked.folder, Path(place), asked.files)
    print(f"\n{'frames':>10}{'CPU ms/frame':>14}{'CPU s':>12}{'frames in MB':>14}{'peak MB':>12}")
    for count in (asked.synthetic // 10, asked.synthetic):
        sys.stdout.flush()
        subprocess.run([sys.executable, __file__, "--row", str(count)], check=True)


if __name__ == "__main__":
    main()
