"""COLMAP's own program as the engine: the same job, the same solution, through its command line.

Runs inside the worker process only. Option names changed between 3.8 and 4.x;
the program's own help says which exist. The CPU is used throughout: Debian's
build aborts when asked for a GPU. It cannot hold one camera while another
moves, so where only some may move, all do, and the calibration stage puts the
trusted ones back.
"""

from __future__ import annotations

import math
import shutil
import sqlite3
import subprocess
from pathlib import Path
from typing import Callable, Dict, List, NamedTuple, Sequence, Set, Tuple

import numpy as np
import numpy.typing as npt

from ..errors import MissingDependency
from .images import read_grey, stretch_ranges, to_eight_bits
from .matching import alike_pairs, signatures
from .models import camera_model, read_model
from .solution import UNPLACED, AdjustJob, Array, CameraSetting, Job, Solution
from .textmodel import TextModel, read_model_text, write_cameras
from .worker import SolverFailed

Step = Callable[[str, int, int], None]
Pair = Tuple[int, int]

_TIMEOUT_S = 24 * 3600
_PAIR_BASE = 2147483647


class Flag(NamedTuple):
    """An option under its names, newest first, and its value."""

    names: Tuple[str, ...]
    value: str


def solve(job: Job, folder: Path, cache: Path, step: Step) -> Solution:
    """Extract, match, verify and map with the program; models are stored under ``folder``."""
    del cache
    program = _program()
    folder.mkdir(parents=True, exist_ok=True)
    database, images = folder / "database.db", folder / "images"
    if database.exists():
        database.unlink()
    notes = _write_images(job, images, step)
    _extract(program, job, database, images, folder, step)
    ids, features = _image_ids(database)
    pairs = sorted(set(job.pairs) | _retrieved(job, database, ids))
    _match(program, job, database, pairs, folder, step)
    inliers = _inliers(database, ids)
    step("mapping", 0, 1)
    found = _map(program, job, database, images, folder)
    step("mapping", 1, 1)
    shutil.rmtree(images, ignore_errors=True)
    solution = collect(job, job.cameras, _cameras_of(database, job, ids), found)
    rows = [(a, b, inliers.get((a, b), 0)) for a, b in pairs]
    return _replaced(
        solution,
        pairs=np.asarray(rows, dtype=np.int64).reshape(-1, 3),
        notes=notes,
        stored=str(folder / "models"),
        features=np.asarray([features.get(i, 0) for i in range(len(job.frames))], dtype=np.int64),
    )


def adjust(task: AdjustJob, step: Step) -> Tuple[Solution, ...]:
    """Adjust a copy of the stored models for each variant of the cameras, all from the same start."""
    program = _program()
    base = Path(task.models)
    results = []
    for number, cameras in enumerate(task.variants, start=1):
        folder = base.parent / f"{base.name}-v{number:02d}"
        adjusted: List[TextModel] = []
        for source in sorted(p for p in base.iterdir() if p.is_dir()):
            target = folder / source.name
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(source, target)
            model = read_model_text(target)
            camera_of = {c: int(name.split("-")[0]) for c, name in _camera_owner(model, task.job).items()}
            write_cameras(target, {c: cameras[i] for c, i in camera_of.items()})
            moving = [cameras[i] for i in set(camera_of.values()) if not cameras[i].held]
            _run(
                program,
                "bundle_adjuster",
                [
                    Flag(("input_path",), str(target)),
                    Flag(("output_path",), str(target)),
                    Flag(("BundleAdjustment.refine_focal_length",), _bit(any(c.solve_focal for c in moving))),
                    Flag(("BundleAdjustment.refine_extra_params",), _bit(any(c.solve_distortion for c in moving))),
                    Flag(("BundleAdjustment.refine_principal_point",), "0"),
                    Flag(("BundleAdjustmentCeres.max_num_iterations", "BundleAdjustment.max_num_iterations"), "60"),
                ],
                folder,
            )
            _to_text(program, target)
            adjusted.append(read_model_text(target))
        owners = [_camera_owner(m, task.job) for m in adjusted]
        merged = {c: int(name.split("-")[0]) for owner in owners for c, name in owner.items()}
        results.append(_replaced(collect(task.job, cameras, merged, adjusted), stored=str(folder)))
        step("calibration", number, len(task.variants))
    return tuple(results)


def _program() -> str:
    found = shutil.which("colmap")
    if found is None:
        raise MissingDependency("COLMAP", "the alignment with --engine colmap", "sudo apt install colmap")
    return found


def _replaced(solution: Solution, **changes: object) -> Solution:
    import dataclasses

    return dataclasses.replace(solution, **changes)  # type: ignore[arg-type]


def _bit(value: bool) -> str:
    return "1" if value else "0"


def _run(program: str, verb: str, flags: Sequence[Flag], folder: Path) -> None:
    """Run one verb with the options that this version knows; raises ``SolverFailed`` with its last words."""
    known = subprocess.run(
        [program, verb, "--help"], capture_output=True, text=True, errors="replace", timeout=60, check=False
    )
    words = known.stdout + known.stderr
    command = [program, verb]
    for flag in flags:
        name = next((n for n in flag.names if f"--{n} " in words or f"--{n}\n" in words), None)
        if name is not None:
            command += [f"--{name}", flag.value]
    done = subprocess.run(
        command, capture_output=True, text=True, errors="replace", timeout=_TIMEOUT_S, check=False, cwd=str(folder)
    )
    if done.returncode != 0:
        tail = " | ".join((done.stdout + done.stderr).strip().splitlines()[-3:])
        raise SolverFailed(f"colmap {verb} ended with code {done.returncode}: {tail[-500:]}")


def _write_images(job: Job, images: Path, step: Step) -> Tuple[str, ...]:
    from PIL import Image

    images.mkdir(parents=True, exist_ok=True)
    sizes = [(job.cameras[f.camera].width, job.cameras[f.camera].height) for f in job.frames]
    spans = stretch_ranges(job.frames, sizes)
    notes = []
    for index, frame in enumerate(job.frames):
        try:
            pixels = read_grey(frame.file, sizes[index], frame.luts)
            grey = to_eight_bits(pixels, spans.get(frame.tone, (0.0, 255.0)))
            Image.fromarray(grey).save(images / _name(job, index), compress_level=1)
        except Exception as error:
            notes.append(f"{frame.name}: pixels cannot be decoded ({type(error).__name__})")
        step("images", index + 1, len(job.frames))
    return tuple(notes)


def _name(job: Job, index: int) -> str:
    """File name that carries the camera and the frame's row."""
    return f"{job.frames[index].camera:03d}-{index:06d}.png"


def _row(name: str) -> int:
    return int(name.split("-")[1].split(".")[0])


def _extract(program: str, job: Job, database: Path, images: Path, folder: Path, step: Step) -> None:
    settings = job.settings
    for index, camera in enumerate(job.cameras):
        names = [_name(job, i) for i, f in enumerate(job.frames) if f.camera == index]
        names = [n for n in names if (images / n).exists()]
        if not names:
            continue
        listing = folder / f"images-{index:03d}.txt"
        listing.write_text("\n".join(names) + "\n", encoding="utf-8")
        model, params = camera_model(camera)
        small = max(camera.width, camera.height) < settings.upsample_below_px
        _run(
            program,
            "feature_extractor",
            [
                Flag(("database_path",), str(database)),
                Flag(("image_path",), str(images)),
                Flag(("image_list_path",), str(listing)),
                Flag(("default_random_seed", "random_seed"), str(settings.seed)),
                Flag(("ImageReader.single_camera",), "1"),
                Flag(("ImageReader.camera_model",), model),
                Flag(("ImageReader.camera_params",), ",".join(repr(v) for v in params)),
                Flag(("FeatureExtraction.use_gpu", "SiftExtraction.use_gpu"), "0"),
                Flag(("FeatureExtraction.num_threads", "SiftExtraction.num_threads"), str(settings.threads)),
                Flag(
                    ("FeatureExtraction.max_image_size", "SiftExtraction.max_image_size"),
                    str(max(camera.width, camera.height)),
                ),
                Flag(("SiftExtraction.max_num_features",), str(settings.max_features)),
                Flag(("SiftExtraction.peak_threshold",), repr(settings.peak_threshold)),
                Flag(("SiftExtraction.first_octave",), "-1" if small else "0"),
            ],
            folder,
        )
        step("features", index + 1, len(job.cameras))


def _image_ids(database: Path) -> Tuple[Dict[int, int], Dict[int, int]]:
    """Return row -> image id and row -> number of features."""
    if not database.exists():
        return {}, {}
    link = sqlite3.connect(str(database))
    try:
        ids = {_row(name): int(key) for key, name in link.execute("SELECT image_id, name FROM images")}
        counts = {int(key): int(rows) for key, rows in link.execute("SELECT image_id, rows FROM keypoints")}
    finally:
        link.close()
    return ids, {row: counts.get(key, 0) for row, key in ids.items()}


def _cameras_of(database: Path, job: Job, ids: Dict[int, int]) -> Dict[int, int]:
    """Return COLMAP's camera id -> our camera's index."""
    if not database.exists():
        return {}
    link = sqlite3.connect(str(database))
    try:
        rows = list(link.execute("SELECT name, camera_id FROM images"))
    finally:
        link.close()
    return {int(camera): job.frames[_row(name)].camera for name, camera in rows if _row(name) in ids}


def _camera_owner(model: TextModel, job: Job) -> Dict[int, str]:
    return {i.camera_id: f"{job.frames[_row(i.name)].camera}-" for i in model.images}


def _retrieved(job: Job, database: Path, ids: Dict[int, int]) -> Set[Pair]:
    if not job.retrieval:
        return set()
    empty: npt.NDArray[np.uint8] = np.zeros((0, 128), dtype=np.uint8)
    rows = {key: row for row, key in ids.items()}
    found = {}
    link = sqlite3.connect(str(database))
    try:
        for key, count, width, data in link.execute("SELECT image_id, rows, cols, data FROM descriptors"):
            if count and int(key) in rows:
                found[rows[int(key)]] = np.frombuffer(data, dtype=np.uint8).reshape(count, width)
    finally:
        link.close()
    vectors = signatures([found.get(i, empty) for i in range(len(job.frames))])
    barred = {frozenset((a, b)) for group in job.apart for a in group for b in group}
    known = set(job.pairs)
    wanted: Set[Pair] = set()
    for wish in job.retrieval:
        asked = wish.count + len(known) if wish.count else 0
        ranked = alike_pairs(vectors, wish.left, wish.right, asked, wish.per_frame)
        fresh = [p for p in ranked if p not in known and frozenset(p) not in barred]
        wanted |= set(fresh[: wish.count] if wish.count else fresh)
    return wanted


def _match(program: str, job: Job, database: Path, pairs: Sequence[Pair], folder: Path, step: Step) -> None:
    ids, _ = _image_ids(database)
    listing = folder / "pairs.txt"
    lines = [f"{_name(job, a)} {_name(job, b)}" for a, b in pairs if a in ids and b in ids]
    listing.write_text("\n".join(lines) + "\n", encoding="utf-8")
    step("pairs", 0, len(pairs))
    if lines:
        settings = job.settings
        _run(
            program,
            "matches_importer",
            [
                Flag(("database_path",), str(database)),
                Flag(("match_list_path",), str(listing)),
                Flag(("match_type",), "pairs"),
                Flag(("default_random_seed", "random_seed"), str(settings.seed)),
                Flag(("FeatureMatching.use_gpu", "SiftMatching.use_gpu"), "0"),
                Flag(("FeatureMatching.num_threads", "SiftMatching.num_threads"), str(settings.threads)),
                Flag(("SiftMatching.max_ratio",), repr(settings.max_ratio)),
                Flag(("TwoViewGeometry.max_error", "SiftMatching.max_error"), repr(settings.verify_error_px)),
                Flag(("TwoViewGeometry.min_num_inliers", "SiftMatching.min_num_inliers"), "15"),
            ],
            folder,
        )
    step("pairs", len(pairs), len(pairs))


def _inliers(database: Path, ids: Dict[int, int]) -> Dict[Pair, int]:
    rows = {key: row for row, key in ids.items()}
    link = sqlite3.connect(str(database))
    try:
        found = list(link.execute("SELECT pair_id, rows FROM two_view_geometries"))
    finally:
        link.close()
    result = {}
    for pair_id, count in found:
        second = pair_id % _PAIR_BASE
        a, b = rows.get((pair_id - second) // _PAIR_BASE), rows.get(second)
        if a is not None and b is not None and count:
            result[(min(a, b), max(a, b))] = int(count)
    return result


def _map(program: str, job: Job, database: Path, images: Path, folder: Path) -> List[TextModel]:
    raw, models = folder / "mapper", folder / "models"
    for place in (raw, models):
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
    free = any(not c.held for c in job.cameras)
    settings = job.settings
    try:
        _run(
            program,
            "mapper",
            [
                Flag(("database_path",), str(database)),
                Flag(("image_path",), str(images)),
                Flag(("output_path",), str(raw)),
                Flag(("Mapper.random_seed", "default_random_seed", "random_seed"), str(settings.seed)),
                Flag(("Mapper.num_threads",), "1"),
                Flag(("Mapper.min_model_size",), str(settings.min_model_frames)),
                Flag(("Mapper.filter_max_reproj_error",), repr(settings.filter_max_reproj_error_px)),
                Flag(("Mapper.ba_refine_focal_length",), _bit(free)),
                Flag(("Mapper.ba_refine_extra_params",), _bit(free)),
                Flag(("Mapper.ba_refine_principal_point",), "0"),
                Flag(("Mapper.extract_colors",), "0"),
            ],
            folder,
        )
    except SolverFailed:
        # The mapper ends with an error where no two frames can be joined: that is an answer, not a fault.
        if not any(p.is_dir() for p in raw.iterdir()) and _inliers(database, _image_ids(database)[0]):
            pass
        elif not any(p.is_dir() for p in raw.iterdir()):
            return []
        else:
            raise
    found = []
    for source in sorted(p for p in raw.iterdir() if p.is_dir()):
        _to_text(program, source)
        found.append((read_model_text(source), source))
    ranked = sorted(found, key=lambda f: (-len(f[0].images), -len(f[0].points), min(i.name for i in f[0].images)))
    for number, (_, source) in enumerate(ranked):
        shutil.move(str(source), str(models / f"{number:03d}"))
    return [model for model, _ in ranked]


def _to_text(program: str, place: Path) -> None:
    _run(
        program,
        "model_converter",
        [Flag(("input_path",), str(place)), Flag(("output_path",), str(place)), Flag(("output_type",), "TXT")],
        place,
    )
    for binary in place.glob("*.bin"):
        binary.unlink()


def collect(
    job: Job, cameras: Sequence[CameraSetting], camera_of: Dict[int, int], models: Sequence[TextModel]
) -> Solution:
    """Read text models into arrays; a frame in two models counts in the larger one."""
    count = len(job.frames)
    placed = np.full(count, UNPLACED, dtype=np.int64)
    center, rotation = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    error, seen = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
    solved = list(cameras)
    told: Set[int] = set()
    xyz: List[Array] = []
    owner: List[int] = []
    ids: List[int] = []
    kept = 0
    for model in models:
        fresh = [i for i in model.images if placed[_row(i.name)] == UNPLACED]
        if len(fresh) < job.settings.min_model_frames:
            continue
        for camera_id, (name, values) in sorted(model.cameras.items()):
            index = camera_of.get(camera_id)
            if index is not None and index not in told:
                solved[index] = read_model(cameras[index], name, values)
                told.add(index)
        for image in fresh:
            row = _row(image.name)
            placed[row] = kept
            rotation[row] = image.rotation
            center[row] = -image.rotation.T @ image.translation
            errors = model.errors(image)
            seen[row] = len(errors)
            error[row] = float(np.mean(errors)) if len(errors) else math.nan
        for point_id in sorted(model.points):
            xyz.append(model.points[point_id])
            owner.append(kept)
            ids.append(point_id)
        kept += 1
    return Solution(
        cameras=tuple(solved),
        model=placed,
        center=center,
        rotation=rotation,
        error_px=error,
        observations=seen,
        point_xyz=np.asarray(xyz, dtype=float).reshape(-1, 3),
        point_model=np.asarray(owner, dtype=np.int64),
        point_id=np.asarray(ids, dtype=np.int64),
        pairs=np.zeros((0, 3), dtype=np.int64),
        focal_sigma=np.full(len(cameras), np.nan),
    )
