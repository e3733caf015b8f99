"""Harmonizing killed at random moments and resumed: the same bytes as undisturbed, originals untouched.

    python benchmarks/kill_resume.py [--kills 50] [--frames 10] [--seed 7] [--folder DIR]

Frames are JPEGs (resampled, colours matched), 16-bit TIFFs (resampled), JPEGs
of which the focal tag alone changes, and frames that are linked, some with
masks. A run is started, killed with SIGKILL after a random time, and started
again until it comes to its end undisturbed; then all is taken away and it
begins anew, until the kills are used up. Every second kill takes the parent
alone: its workers are left behind and have to end by themselves. Exit code 1
where a byte differs or something is left over. POSIX only.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Dict

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize import FlightAction, HarmonizePlan, Lut, apply
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.harmonize.samples import exif_block, jpeg_bytes, texture

WIDTH, HEIGHT = 800, 600
RESAMPLED, DEEP, RETAGGED, LINKED = "resampled", "deep", "retagged", "linked"
BRIGHTER = tuple(min(255, i + 12) for i in range(256))


def make(folder: Path, count: int) -> None:
    """Write ``count`` frames of each kind."""
    folder.mkdir(parents=True)
    picture = jpeg_bytes(WIDTH, HEIGHT, exif=exif_block(WIDTH, HEIGHT))
    deep = texture(WIDTH, HEIGHT, 1)[:, :, 0].astype(np.uint16) * 200
    mask = np.where(texture(WIDTH, HEIGHT, 1)[:, :, 0] > 100, 255, 0).astype(np.uint8)
    for index in range(count):
        for kind in (RESAMPLED, RETAGGED, LINKED):
            # Bytes behind the end tell the frames apart and cost no time to make.
            (folder / f"{kind}_{index:03d}.JPG").write_bytes(picture + index.to_bytes(2, "big"))
        Image.fromarray(deep + np.uint16(index)).save(folder / f"{DEEP}_{index:03d}.TIF")
        if index % 4 == 0:
            Image.fromarray(mask).save(folder / f"{RESAMPLED}_{index:03d}_mask.png")


def harmonize(folder: Path, out: Path) -> None:
    """Put all frames of ``folder`` into ``out / images``, as the pipeline does it."""
    files = sorted(p for p in folder.iterdir() if p.suffix in (".JPG", ".TIF"))
    frames: Dict[str, Frame] = {}
    for file in files:
        deep = file.suffix == ".TIF"
        frames[file.name] = Frame(
            file.name, file.stat().st_size, "tiff" if deep else "jpeg", WIDTH, HEIGHT,
            bits=16 if deep else 8, channels=1 if deep else 3, focal_mm=None if deep else 8.8,
        )  # fmt: skip
    lut = Lut("l", (BRIGHTER,) * 3, (-12.0,) * 3, "r", 6)
    actions = []
    for kind in (DEEP, LINKED, RESAMPLED, RETAGGED):
        scale = 0.8 if kind in (RESAMPLED, DEEP) else 1.0
        size = (WIDTH, HEIGHT, round(WIDTH * scale), round(HEIGHT * scale))
        names = tuple(n for n in frames if n.startswith(kind))
        action = FlightAction(kind, kind, names, 2.0, 2.0 / scale, scale, *size)
        if kind == RESAMPLED:
            action = replace(action, lut=lut.id, write_lut=True)
        if kind == RETAGGED:
            action = replace(action, focal_mm=8.9)
        actions.append(action)
    masks = {
        name: (mask, out / "images" / mask.name)
        for name in frames
        for mask in [folder / f"{Path(name).stem}_mask.png"]
        if mask.exists()
    }
    done, broken = apply(
        HarmonizePlan(tuple(actions), (lut,)),
        frames,
        {n: folder / n for n in frames},
        {n: out / "images" / n for n in frames},
        thresholds=DEFAULTS,
        journal=out / "journal",
        masks=masks,
    )
    if broken or len(done) != len(frames):
        raise SystemExit(f"{len(done)} of {len(frames)} frames done, broken: {broken}")


def digests(folder: Path) -> Dict[str, str]:
    """Name -> digest of every file, unfinished ones too."""
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}


def start(folder: Path, out: Path) -> "subprocess.Popen[bytes]":
    command = [sys.executable, __file__, "--run", str(folder), str(out)]
    return subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE)


def finish(process: "subprocess.Popen[bytes]") -> None:
    _, errors = process.communicate()
    if process.returncode:
        raise SystemExit(f"a resumed run failed:\n{errors.decode(errors='replace')}")


def trial(folder: Path, frames: int, kills: int, seed: int) -> Dict[str, int]:
    """Kill and resume ``kills`` times below ``folder``; returns what was counted, raises ``SystemExit``."""
    source, whole, out = folder / "in", folder / "whole", folder / "out"
    make(source, frames)
    before = digests(source)
    began = time.monotonic()
    finish(start(source, whole))
    length = time.monotonic() - began
    wanted = digests(whole / "images")
    rng = random.Random(seed)
    counted = {"kills": 0, "of them inside the work": 0, "runs to the end": 0, "frames": len(before)}
    while counted["kills"] < kills:
        shutil.rmtree(out, ignore_errors=True)
        for _ in range(min(rng.randint(2, 6), kills - counted["kills"])):
            process = start(source, out)
            time.sleep(rng.uniform(0.0, length))
            alone = counted["kills"] % 2 == 0
            counted["kills"] += 1
            counted["of them inside the work"] += process.poll() is None and (out / "images").exists()
            with contextlib.suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL) if alone else os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
        finish(start(source, out))
        counted["runs to the end"] += 1
        if digests(out / "images") != wanted:
            left, right = digests(out / "images"), wanted
            odd = sorted(n for n in {*left, *right} if left.get(n) != right.get(n))
            raise SystemExit(f"after {counted}: these differ from an undisturbed run: {odd}")
        if digests(source) != before:
            raise SystemExit(f"after {counted}: an original was changed")
    return counted


def main() -> None:
    if sys.argv[1:2] == ["--run"]:
        harmonize(Path(sys.argv[2]), Path(sys.argv[3]))
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--frames", type=int, default=10, help="of each of the four kinds")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--folder", type=Path, help="where to work: a disk to try (default: a temporary folder)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        print(json.dumps(trial(Path(folder), arguments.frames, arguments.kills, arguments.seed)))
    print("same bytes as undisturbed, originals untouched, nothing left over")


if __name__ == "__main__":
    main()
