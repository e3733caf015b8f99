"""One table: gate, harmonize, align and submit beside what one would use instead, in Markdown.

    python benchmarks/run_all.py [--full] [--only gate,submit] [--write]

CPU seconds of this machine, and each over ours. Without --full sizes are chosen for a few minutes in all; the table
says which. --write puts it into docs/benchmarks.md. Programs that are not installed are left out.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sensorgate.plugin.version import VERSION

from benchmarks import align, gate, harmonize, submit

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"
BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"


@dataclass(frozen=True)
class Size:
    """How much of each job is measured."""

    gate_files: int
    rounds: int
    frames: Sequence[int]
    width: int
    reference_px: int
    sent: int
    megabytes: float


QUICK = Size(gate_files=300, rounds=2, frames=(20,), width=2736, reference_px=1600, sent=30, megabytes=2.0)
FULL = Size(gate_files=1000, rounds=5, frames=(20, 60), width=5472, reference_px=3200, sent=100, megabytes=8.0)


@dataclass(frozen=True)
class Line:
    """One contender: CPU in ``unit`` s, and whether it is ours."""

    job: str
    contender: str
    cpu: float
    unit: str
    ours: bool
    note: str = ""


def gate_lines(size: Size) -> List[Line]:
    job = f"gate, {size.gate_files} files of three kinds"
    with tempfile.TemporaryDirectory() as place:
        rows = gate.reading(None, Path(place), size.gate_files)
    return [Line(job, n, 1000 * cpu / size.gate_files, "ms/frame", n == gate.VERDICT) for n, cpu, _ in rows]


def harmonize_lines(size: Size) -> List[Line]:
    lines = []
    data = harmonize.mosaic(harmonize.jpeg_bytes(1368, 912))
    for scale in (0.8, 1.5):
        job = f"harmonize, a 20-megapixel JPEG to {scale:g} x"
        with tempfile.TemporaryDirectory() as place:
            figures = harmonize.best(harmonize.contenders(data, scale, Path(place)), size.rounds)
        lines += [Line(job, name, cpu, "s/frame", name == "sensorgate") for name, cpu in figures.items()]
    return lines


def align_lines(size: Size) -> List[Line]:
    lines = []
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for count in size.frames:
        job = f"align, a block of {count} frames, {size.width} px wide"
        with tempfile.TemporaryDirectory() as place:
            here = Path(place)
            command = [sys.executable, align.__file__, "--render", str(here), str(count), str(size.width)]
            subprocess.run(command, check=True)
            for name, label in (
                ("sensorgate", "sensorgate"),
                ("pycolmap", f"COLMAP's default run, all pairs, at {size.reference_px} px"),
            ):
                row = align.contend(name, here / "images", here / name, size.reference_px)
                note = f"{row.registered}/{row.frames} placed, {row.verdict}"
                lines.append(Line(job, label, row.cpu_s / row.frames, "s/frame", name == "sensorgate", note))
    return lines


def submit_lines(size: Size) -> List[Line]:
    job = f"submit, {size.sent} frames of {size.megabytes:g} MB to a loopback node"
    rows = submit.sending(size.sent, size.megabytes)
    return [Line(job, name, 1000 * cpu / size.sent, "ms/frame", name == submit.OURS) for name, cpu, _ in rows]


JOBS: Dict[str, Callable[[Size], List[Line]]] = {
    "gate": gate_lines,
    "harmonize": harmonize_lines,
    "align": align_lines,
    "submit": submit_lines,
}


def table(lines: Sequence[Line]) -> str:
    """The lines as Markdown, each job's contenders over ours."""
    said = ["| job | contender | CPU | over ours | |", "| --- | --- | ---: | ---: | --- |"]
    before = ""
    for line in lines:
        ours = next(x.cpu for x in lines if x.job == line.job and x.ours)
        name = f"**{line.contender}**" if line.ours else line.contender
        job = line.job if line.job != before else ""
        said.append(f"| {job} | {name} | {line.cpu:.3g} {line.unit} | {line.cpu / ours:.2f} | {line.note} |")
        before = line.job
    return "\n".join(said)


def machine() -> str:
    """Processor, cores and the versions of all that was measured."""
    told = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.*)", told.read_text()) if told.is_file() else None
    model = found.group(1) if found else platform.processor() or platform.machine()
    versions = [f"sensorgate {VERSION}", f"Python {platform.python_version()}"]
    for name in ("numpy", "Pillow", "opencv-python-headless", "pycolmap", "pyodm", "exifread"):
        try:
            versions.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            continue
    for command in (["exiftool", "-ver"], ["gdal-config", "--version"]):
        if shutil.which(command[0]):
            said = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
            versions.append(f"{command[0].replace('gdal-config', 'GDAL')} {said}")
    return f"{model}, {os.cpu_count()} cores, {platform.system()}. {', '.join(versions)}."


def written(page: str, text: str) -> str:
    """The page with ``text`` between its marks."""
    head, _, rest = page.partition(BEGIN)
    _, mark, tail = rest.partition(END)
    if not mark:
        raise SystemExit(f"{PAGE} has no place for the figures.")
    return f"{head}{BEGIN}\n{text}\n{END}{tail}"


def main(argv: Optional[Sequence[str]] = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="all sizes; COLMAP's part takes an hour")
    parser.add_argument("--only", metavar="LIST", help=f"of {', '.join(JOBS)}")
    parser.add_argument("--write", action="store_true", help="put the table into docs/benchmarks.md")
    asked = parser.parse_args(argv)
    names = asked.only.split(",") if asked.only else list(JOBS)
    unknown = sorted(set(names) - set(JOBS))
    if unknown:
        parser.error(f"no such job: {', '.join(unknown)}")
    size = FULL if asked.full else QUICK
    lines: List[Line] = []
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        lines += JOBS[name](size)
    text = f"{table(lines)}\n\n{machine()}"
    print(text)
    if asked.write:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), text), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
