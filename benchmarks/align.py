"""The proof of a block beside COLMAP's default run, all pairs matched: verdict, CPU, memory.

    python benchmarks/align.py [FOLDER] [--sizes 20,60] [--width 5472] [--reference pycolmap] [--reference-px 3200]

The frames are one flight over rendered ground, brought to ``--width`` as the
camera would write them; with FOLDER they are the first frames of that folder,
as many as the size says. Ours is what ``sensorgate run`` does to prove a block:
headers, decoding, features, pairs, mapping, calibration. The other is COLMAP
with the options it comes with (CPU only): features at up to 3200 px, every pair,
mapping; its model is judged by our own measures and limits. The program of the
same name stands in with ``--reference colmap``, none with ``--reference none``.
``--reference-px`` shrinks what COLMAP extracts from, where time is short: the
table then says so. Each runs in a process of its own; CPU seconds are of that
process and all below it, memory is the largest single one's.

Exit code 1 where the verdicts differ, the CPU per frame is over 2.0 s, memory is
over 2 GB, or the default run was the cheaper one. 180 frames are 16,110 pairs
for COLMAP: hours.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sensorgate.stages.align.collected import Part, Pose, assembled
from sensorgate.stages.align.colmap_program import Flag, program, run
from sensorgate.stages.align.judge import judge, overall
from sensorgate.stages.align.measure import measure
from sensorgate.stages.align.model import AlignRequest, GpsFit
from sensorgate.stages.align.pairs import plan_pairs
from sensorgate.stages.align.prepare import build_job, sorted_request
from sensorgate.stages.align.pycolmap_model import errors_of, quiet
from sensorgate.stages.align.solution import UNPLACED, Solution
from sensorgate.stages.align.world import ground_of
from sensorgate.stages.document import requests_for
from sensorgate.stages.harmonize import jpeg
from sensorgate.stages.harmonize.exif import TagEdit
from sensorgate.stages.harmonize.resample import decode_jpeg, encode_jpeg, resize
from sensorgate.stages.read import scan
from sensorgate.stages.route import prove
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import build
from sensorgate.stages.thresholds import DEFAULTS

from tests import simulator
from tests.simulator import catalogue
from tests.simulator.flight import Plan, fly
from tests.simulator.stories import GROUND
from tests.simulator.survey import Survey

MOST_CPU_S, MOST_MEMORY_MB = 2.0, 2048.0
# The renderer's own width of this camera; twice that is as fine as its ground is.
RENDERED_AT = 2.0
BASE_SEED = 0


@dataclass(frozen=True)
class Row:
    """What one contender made of a block and what it took."""

    frames: int
    registered: int
    components: int
    horizontal_m: Optional[float]
    vertical_m: Optional[float]
    reproj_px: Optional[float]
    verdict: str
    cpu_s: float
    wall_s: float
    memory_mb: float


def render(folder: Path, count: int, width: int) -> None:
    """Render a lawn-mower block of ``count`` frames to ``folder / images`` and bring them to ``width``."""
    strips = max(2, round((count / 1.6) ** 0.5))
    camera = catalogue.phantom4pro()
    shots = fly(camera, Plan(height_m=60.0, strips=strips, per_strip=-(-count // strips)), GROUND, BASE_SEED)[:count]
    survey = Survey("block", (GROUND,), (camera,), shots)
    simulator.render(survey, folder, seed=BASE_SEED, frames_scale=RENDERED_AT)
    for path in sorted((folder / "images").rglob("*.JPG")):
        data = path.read_bytes()
        pixels = decode_jpeg(data, grey=False)
        was = (pixels.shape[1], pixels.shape[0])
        now = (width, round(was[1] * width / was[0]))
        if now != was:
            larger = encode_jpeg(resize(pixels, now), (2, 1), DEFAULTS)
            path.write_bytes(jpeg.with_header_of(data, larger, TagEdit((*was, *now))))


def part_of(source: Path, folder: Path, count: int) -> Path:
    """Links to the first ``count`` pictures of a folder."""
    folder.mkdir(parents=True)
    files = [p for p in sorted(source.iterdir()) if p.suffix.lower() in (".jpg", ".jpeg", ".tif", ".tiff")]
    for path in files[:count]:
        (folder / path.name).symlink_to(path.resolve())
    return folder


def request_of(images: Path) -> AlignRequest:
    """The folder's largest group of frames that may share a project."""
    requests = requests_for(build(scan([str(images)]), load_sheet(), DEFAULTS))
    if not requests:
        sys.exit(f"{images}: nothing that could be aligned")
    return sorted_request(max(requests, key=lambda r: len(r.frames)))


def ours(images: Path, work: Path) -> Dict[str, Any]:
    """Prove the block as the main job does."""
    request = request_of(images)
    proof = prove(request, work)
    report = max((g.alignment for g in proof.groups if g.alignment), key=lambda r: r.registered)
    figures = told(len(request.frames), report.registered, report.components, report.gps, report.mean_reproj_error_px)
    return {**figures, "verdict": report.verdict}


def theirs(images: Path, work: Path, tool: str, side: int) -> Dict[str, Any]:
    """COLMAP's default run, judged by our measures."""
    import pycolmap

    quiet(pycolmap)
    request = request_of(images)
    inputs, models, database = work / "images", work / "models", work / "database.db"
    inputs.mkdir(parents=True)
    models.mkdir()
    for index, frame in enumerate(request.frames):
        (inputs / f"{index:06d}{Path(frame.file).suffix.lower()}").symlink_to(Path(frame.file).resolve())
    if tool == "colmap":
        found = with_program(pycolmap, inputs, models, database, side)
    else:
        found = with_pycolmap(pycolmap, inputs, models, database, side)
    solution = solution_of(pycolmap, request, found, database, side)
    ground = ground_of(request.frames, request.cameras, side, DEFAULTS, request.gcps)
    areas = plan_pairs(request.frames, request.cameras, DEFAULTS).areas
    measured = measure(request.frames, solution, ground, areas, DEFAULTS)
    payloads = judge(measured, DEFAULTS)
    placed = solution.model != UNPLACED
    error = None
    if placed.any():
        error = float(np.average(solution.error_px[placed], weights=solution.observations[placed]))
    fit = next((p.together for p in payloads if p.payload == measured.anchor), GpsFit(0))
    figures = told(len(request.frames), int(placed.sum()), measured.components, fit, error)
    return {**figures, "verdict": overall(payloads)}


def told(frames: int, registered: int, components: int, gps: GpsFit, reproj: Optional[float]) -> Dict[str, Any]:
    return {
        "frames": frames,
        "registered": registered,
        "components": components,
        "horizontal_m": gps.horizontal_m,
        "vertical_m": gps.vertical_m,
        "reproj_px": reproj,
    }


def with_pycolmap(pycolmap: Any, inputs: Path, models: Path, database: Path, side: int) -> List[Any]:
    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    extraction.use_gpu = matching.use_gpu = False
    extraction.max_image_size = side
    pycolmap.set_random_seed(0)
    pycolmap.extract_features(str(database), str(inputs), extraction_options=extraction, device=pycolmap.Device.cpu)
    pycolmap.match_exhaustive(str(database), matching_options=matching, device=pycolmap.Device.cpu)
    found = pycolmap.incremental_mapping(str(database), str(inputs), str(models))
    return [found[key] for key in sorted(found)]


def with_program(pycolmap: Any, inputs: Path, models: Path, database: Path, side: int) -> List[Any]:
    tool, at = program(), Flag(("database_path",), str(database))
    pictures = Flag(("image_path",), str(inputs))
    no_gpu = Flag(("FeatureExtraction.use_gpu", "SiftExtraction.use_gpu"), "0")
    size = Flag(("FeatureExtraction.max_image_size", "SiftExtraction.max_image_size"), str(side))
    run(tool, "feature_extractor", [at, pictures, no_gpu, size], inputs.parent)
    no_gpu = Flag(("FeatureMatching.use_gpu", "SiftMatching.use_gpu"), "0")
    run(tool, "exhaustive_matcher", [at, no_gpu], inputs.parent)
    run(tool, "mapper", [at, pictures, Flag(("output_path",), str(models))], inputs.parent)
    return [pycolmap.Reconstruction(str(p)) for p in sorted(models.iterdir()) if p.is_dir()]


def solution_of(pycolmap: Any, request: AlignRequest, found: Sequence[Any], database: Path, side: int) -> Solution:
    """COLMAP's models in the terms of our measures; a frame in two models counts in the larger one."""
    parts = []
    for each in sorted(found, key=lambda m: (-m.num_reg_images(), -m.num_points3D())):
        poses = {}
        for image_id in each.reg_image_ids():
            image = each.images[image_id]
            pose = image.cam_from_world()
            rotation = pose.rotation.matrix()
            centre = -rotation.T @ np.asarray(pose.translation)
            poses[int(image.name.split(".")[0])] = Pose(rotation, centre, errors_of(each, image))
        parts.append(Part(poses, {}, {int(i): np.asarray(p.xyz) for i, p in each.points3D.items()}))
    opened = pycolmap.Database.open(str(database))
    names = {image.image_id: int(image.name.split(".")[0]) for image in opened.read_all_images()}
    keys, inliers = opened.read_two_view_geometry_num_inliers()
    opened.close()
    pairs = []
    for key, number in zip(keys, inliers):
        second = key % 2147483647
        a, b = sorted((names[(key - second) // 2147483647], names[second]))
        pairs.append((a, b, int(number)))
    job = build_job(request, plan_pairs(request.frames, request.cameras, DEFAULTS), "quick", side, 1, DEFAULTS)
    solution, _ = assembled(job, job.cameras, parts)
    return replace(solution, pairs=np.asarray(sorted(pairs), dtype=np.int64).reshape(-1, 3))


def contend(name: str, images: Path, work: Path, side: int) -> Row:
    """Run one contender in a process of its own."""
    began = time.perf_counter()
    command = [sys.executable, __file__, "--one", name, str(images), str(work), str(side)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{name} ended with code {done.returncode}: {done.stderr[-2000:]}")
    figures = json.loads(done.stdout.splitlines()[-1])
    return Row(wall_s=time.perf_counter() - began, **figures)


def one(name: str, images: Path, work: Path, side: int) -> None:
    figures = ours(images, work) if name == "sensorgate" else theirs(images, work, name, side)
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    figures["cpu_s"] = sum(u.ru_utime + u.ru_stime for u in used)
    figures["memory_mb"] = max(u.ru_maxrss for u in used) / 1024
    print(json.dumps(figures))


def show(name: str, row: Row) -> None:
    def number(value: Optional[float]) -> str:
        return "-" if value is None else f"{value:.2f}"

    print(
        f"{name:26}{f'{row.registered}/{row.frames}':>10}{row.components:>7}{number(row.horizontal_m):>8}"
        f"{number(row.vertical_m):>8}{number(row.reproj_px):>7}{row.verdict:>10}{row.cpu_s:>9.1f}"
        f"{row.cpu_s / row.frames:>9.2f}{row.wall_s:>9.1f}{row.memory_mb:>7.0f}"
    )


def compare(size: int, arguments: argparse.Namespace, folder: Path) -> List[Tuple[str, bool]]:
    """Both contenders on one block; returns what had to hold."""
    here = folder / str(size)
    if arguments.folder:
        images = part_of(arguments.folder, here / "images", size)
    else:
        # In a process of its own: Linux counts a parent's peak memory in the processes that it starts.
        subprocess.run([sys.executable, __file__, "--render", str(here), str(size), str(arguments.width)], check=True)
        images = here / "images"
    mine = contend("sensorgate", images, here / "ours", 0)
    print(
        f"\n{mine.frames} frames\n{'':26}{'placed':>10}{'parts':>7}{'GPS h m':>8}{'v m':>8}{'px':>7}{'verdict':>10}"
        f"{'CPU s':>9}{'/ frame':>9}{'wall s':>9}{'MB':>7}"
    )
    show("sensorgate", mine)
    checks = [
        (f"{size}: {mine.cpu_s / mine.frames:.2f} s CPU per frame (at most {MOST_CPU_S})",
         mine.cpu_s <= MOST_CPU_S * mine.frames),
        (f"{size}: {mine.memory_mb:.0f} MB (at most {MOST_MEMORY_MB:.0f})", mine.memory_mb <= MOST_MEMORY_MB),
    ]  # fmt: skip
    sys.stdout.flush()
    if arguments.reference == "none":
        return checks
    other = contend(arguments.reference, images, here / "theirs", arguments.reference_px)
    show(f"{arguments.reference} at {arguments.reference_px} px, all pairs", other)
    ratio = other.cpu_s / mine.cpu_s
    same = (mine.verdict, mine.components) == (other.verdict, other.components) and mine.registered >= other.registered
    sys.stdout.flush()
    return [
        *checks,
        (f"{size}: same verdict and parts, no fewer frames placed", same),
        (f"{size}: {ratio:.1f} times cheaper in CPU, {other.wall_s / mine.wall_s:.1f} times by wall", ratio > 1.0),
    ]


def main() -> int:
    if sys.argv[1:2] == ["--one"]:
        one(sys.argv[2], Path(sys.argv[3]), Path(sys.argv[4]), int(sys.argv[5]))
        return 0
    if sys.argv[1:2] == ["--render"]:
        render(Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--sizes", default="20,60", help="frames per block, with commas; 180 takes COLMAP hours")
    parser.add_argument("--width", type=int, default=5472, help="of the rendered frames")
    parser.add_argument("--reference", choices=("pycolmap", "colmap", "none"), default="pycolmap")
    parser.add_argument("--reference-px", type=int, default=3200, help="COLMAP's own limit is 3200")
    parser.add_argument("--work", type=Path, help="folder for what is rendered and solved, kept; else a temporary one")
    arguments = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    folder = arguments.work or Path(tempfile.mkdtemp(prefix="sensorgate-align-"))
    checks: List[Tuple[str, bool]] = []
    try:
        for size in (int(s) for s in arguments.sizes.split(",")):
            checks += compare(size, arguments, folder)
    finally:
        if arguments.work is None:
            shutil.rmtree(folder, ignore_errors=True)
    print()
    for text, held in checks:
        print(f"{'ok    ' if held else 'MISSED'} {text}")
    return 0 if all(held for _, held in checks) else 1


if __name__ == "__main__":
    sys.exit(main())
