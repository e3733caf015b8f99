"""COLMAP's own program as the engine: the same job, the same solution, through its command line.

Runs inside the worker process only. Option names changed between 3.8 and 4.x;
the program's own help says which exist. The CPU is used throughout: Debian's
build aborts when asked for a GPU. It cannot hold one camera while another
moves, so where only some may move, all do, and the calibration stage puts the
trusted ones back.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Callable, Dict, List, Sequence, Tuple

import numpy as np

from .collected import Part, Pose, assembled
from .colmap_database import descriptors_of, image_ids, inliers_of, name_of, row_of
from .colmap_program import Flag, ProgramFailed, program, run
from .images import read_grey, stretch_ranges, to_eight_bits, undecoded_note
from .models import camera_model, read_model
from .retrieval import retrieved
from .solution import AdjustJob, CameraSetting, Job, Solution
from .textmodel import TextModel, read_model_text, write_cameras

Step = Callable[[str, int, int], None]
Pair = Tuple[int, int]


def solve(job: Job, folder: Path, cache: Path, step: Step) -> Solution:
    """Extract, match, verify and map with the program; models are stored under ``folder``."""
    del cache
    tool = program()
    folder.mkdir(parents=True, exist_ok=True)
    database, images = folder / "database.db", folder / "images"
    if database.exists():
        database.unlink()
    notes = _write_images(job, images, step)
    _extract(tool, job, database, images, folder, step)
    ids, features = image_ids(database)
    descriptors = descriptors_of(database, ids, len(job.frames)) if job.retrieval else []
    pairs = sorted(set(job.pairs) | set(retrieved(job, descriptors)))
    _match(tool, job, database, pairs, folder, step)
    inliers = inliers_of(database, ids)
    step("mapping", 0, 1)
    found = [] if job.only_pairs else _map(tool, job, database, images, folder)
    step("mapping", 1, 1)
    shutil.rmtree(images, ignore_errors=True)
    solution, _ = assembled(job, job.cameras, [_part(job, job.cameras, model) for model in found])
    rows = [(a, b, inliers.get((a, b), 0)) for a, b in pairs]
    return replace(
        solution,
        pairs=np.asarray(rows, dtype=np.int64).reshape(-1, 3),
        notes=notes,
        stored=str(folder / "models"),
        features=np.asarray([features.get(i, 0) for i in range(len(job.frames))], dtype=np.int64),
    )


def adjust(task: AdjustJob, step: Step) -> Tuple[Solution, ...]:
    """Adjust a copy of the stored models for each variant of the cameras, all from the same start."""
    tool = program()
    base = Path(task.models)
    results = []
    for number, cameras in enumerate(task.variants, start=task.first):
        folder = base.parent / f"{base.name}-v{number:02d}"
        adjusted: List[TextModel] = []
        for source in sorted(p for p in base.iterdir() if p.is_dir()):
            target = folder / source.name
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(source, target)
            model = read_model_text(target)
            camera_of = _camera_owner(model, task.job)
            write_cameras(target, {c: cameras[i] for c, i in camera_of.items()})
            moving = [cameras[i] for i in set(camera_of.values()) if not cameras[i].held]
            run(
                tool,
                "bundle_adjuster",
                [
                    Flag(("input_path",), str(target)),
                    Flag(("output_path",), str(target)),
                    Flag(("BundleAdjustment.refine_focal_length",), _bit(any(c.solve_focal for c in moving))),
                    Flag(("BundleAdjustment.refine_extra_params",), _bit(any(c.solve_distortion for c in moving))),
                    Flag(
                        ("BundleAdjustment.refine_principal_point",),
                        _bit(bool(moving) and all(c.solve_center for c in moving)),
                    ),
                    Flag(("BundleAdjustmentCeres.max_num_iterations", "BundleAdjustment.max_num_iterations"), "60"),
                ],
                folder,
            )
            _to_text(tool, target)
            adjusted.append(read_model_text(target))
        solution, _ = assembled(task.job, cameras, [_part(task.job, cameras, m) for m in adjusted])
        results.append(replace(solution, stored=str(folder)))
        step("calibration", number - task.first + 1, len(task.variants))
    return tuple(results)


def _bit(value: bool) -> str:
    return "1" if value else "0"


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
            Image.fromarray(grey).save(images / name_of(job, index), compress_level=1)
        except Exception as error:
            notes.append(undecoded_note(frame.name, error))
        step("images", index + 1, len(job.frames))
    return tuple(notes)


def _extract(tool: str, job: Job, database: Path, images: Path, folder: Path, step: Step) -> None:
    settings = job.settings
    for index, camera in enumerate(job.cameras):
        names = [name_of(job, i) for i, f in enumerate(job.frames) if f.camera == index]
        names = [n for n in names if (images / n).exists()]
        if not names:
            continue
        listing = folder / f"images-{index:03d}.txt"
        listing.write_text("\n".join(names) + "\n", encoding="utf-8")
        model, params = camera_model(camera)
        small = max(camera.width, camera.height) < settings.upsample_below_px
        run(
            tool,
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


def _camera_owner(model: TextModel, job: Job) -> Dict[int, int]:
    """COLMAP's camera id -> our camera's index."""
    return {i.camera_id: job.frames[row_of(i.name)].camera for i in model.images}


def _match(tool: str, job: Job, database: Path, pairs: Sequence[Pair], folder: Path, step: Step) -> None:
    ids, _ = image_ids(database)
    listing = folder / "pairs.txt"
    lines = [f"{name_of(job, a)} {name_of(job, b)}" for a, b in pairs if a in ids and b in ids]
    listing.write_text("\n".join(lines) + "\n", encoding="utf-8")
    step("pairs", 0, len(pairs))
    if lines:
        settings = job.settings
        run(
            tool,
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


def _map(tool: str, job: Job, database: Path, images: Path, folder: Path) -> List[TextModel]:
    raw, models = folder / "mapper", folder / "models"
    for place in (raw, models):
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
    free = any(not c.held for c in job.cameras)
    settings = job.settings
    try:
        run(
            tool,
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
    except ProgramFailed as error:
        # The mapper ends with an error where no two frames can be joined: that is an answer; a crash is not.
        if error.crashed or any(p.is_dir() for p in raw.iterdir()):
            raise
    found = []
    for source in sorted(p for p in raw.iterdir() if p.is_dir()):
        _to_text(tool, source)
        found.append((read_model_text(source), source))
    ranked = sorted(found, key=lambda f: (-len(f[0].images), -len(f[0].points), min(i.name for i in f[0].images)))
    for number, (_, source) in enumerate(ranked):
        shutil.move(str(source), str(models / f"{number:03d}"))
    return [model for model, _ in ranked]


def _to_text(tool: str, place: Path) -> None:
    run(
        tool,
        "model_converter",
        [Flag(("input_path",), str(place)), Flag(("output_path",), str(place)), Flag(("output_type",), "TXT")],
        place,
    )
    for binary in place.glob("*.bin"):
        binary.unlink()


def _part(job: Job, cameras: Sequence[CameraSetting], model: TextModel) -> Part:
    owner = _camera_owner(model, job)
    return Part(
        {row_of(i.name): Pose(i.rotation, -i.rotation.T @ i.translation, model.errors(i)) for i in model.images},
        {owner[c]: read_model(cameras[owner[c]], *model.cameras[c]) for c in sorted(owner)},
        model.points,
    )
