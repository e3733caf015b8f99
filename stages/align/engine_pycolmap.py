"""The pycolmap engine: features, matches, verified pairs, incremental models, bundle adjustments.

Runs inside the worker process only. Works with pycolmap 3.13 to 4.2; where
their names differ, the one that exists is used. Every random part gets the
job's seed and a fixed order.
"""

from __future__ import annotations

import hashlib
import io
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Callable, Dict, List, Sequence, Tuple

import numpy as np

from ..record import write_bytes
from .features import Features, all_descriptors, feature_keys, load_or_extract
from .matching import Descriptors, Matches, match, unit
from .pycolmap_adjust import adjust
from .pycolmap_model import camera_of, collect, quiet, stored_models, with_changes
from .retrieval import retrieved
from .solution import Job, Solution

Step = Callable[[str, int, int], None]
Pair = Tuple[int, int]

__all__ = ["adjust", "solve"]

# Fewer matches than this say nothing of two views' geometry (COLMAP's own limit).
VERIFIED = 15


def solve(job: Job, folder: Path, cache: Path, step: Step) -> Solution:
    """Extract, match, verify and map; models are stored under ``folder``."""
    import pycolmap

    quiet(pycolmap)
    pycolmap.set_random_seed(job.settings.seed)
    features, notes = load_or_extract(job, cache / "features", step)
    pairs = sorted(set(job.pairs) | set(retrieved(job, all_descriptors(features))))
    verified = _verify_all(pycolmap, job, features, pairs, cache / "matches", step)
    step("mapping", 0, 1)
    models = [] if job.only_pairs else _map(pycolmap, job, features, verified, folder)
    step("mapping", 1, 1)
    inliers = {pair: len(geometry.inlier_matches) for pair, geometry in verified.items()}
    solution = _read_back(job, models, folder, inliers, pairs, notes)
    return with_changes(solution, features=np.asarray([len(f.points) for f in features], dtype=np.int64))


def _verify_all(
    pycolmap: Any, job: Job, features: Sequence[Features], pairs: Sequence[Pair], cache: Path, step: Step
) -> Dict[Pair, Any]:
    """Match and verify every pair; raw matches are kept on disk, so that a subset of the frames costs nothing."""
    cache.mkdir(parents=True, exist_ok=True)
    keys = feature_keys(job)
    units: Dict[int, Descriptors] = {}
    cameras = [camera_of(pycolmap, index + 1, c) for index, c in enumerate(job.cameras)]
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = job.settings.seed
    options.ransac.max_error = job.settings.verify_error_px
    options.min_num_inliers = VERIFIED
    options.compute_relative_pose = False

    def raw(pair: Pair) -> Matches:
        said = f"{keys[pair[0]]} {keys[pair[1]]} {job.settings.max_ratio!r}"
        path = cache / f"{hashlib.sha256(said.encode('ascii')).hexdigest()[:32]}.npy"
        try:
            kept: Matches = np.load(path, allow_pickle=False)
            return kept
        except (OSError, ValueError):
            pass
        for index in pair:
            if index not in units:
                units[index] = unit(features[index].descriptors)
        found = match(units[pair[0]], units[pair[1]], job.settings.max_ratio)
        stream = io.BytesIO()
        np.save(stream, found)
        write_bytes(path, stream.getvalue())
        return found

    def work(pair: Pair) -> Any:
        a, b = pair
        matches = raw(pair)
        if len(matches) < VERIFIED:
            return None
        return pycolmap.estimate_two_view_geometry(
            cameras[job.frames[a].camera],
            features[a].points,
            cameras[job.frames[b].camera],
            features[b].points,
            matches,
            options,
        )

    verified: Dict[Pair, Any] = {}
    last = {index: place for place, pair in enumerate(pairs, start=1) for index in pair}
    with ThreadPoolExecutor(max_workers=max(1, job.settings.threads)) as pool:
        for done, (pair, geometry) in enumerate(zip(pairs, pool.map(work, pairs)), start=1):
            if geometry is not None and len(geometry.inlier_matches) >= VERIFIED:
                verified[pair] = geometry
            for index in pair:
                # As floats, the descriptors of hundreds of frames would not fit beside each other.
                if last[index] == done:
                    units.pop(index, None)
            step("pairs", done, len(pairs))
    return verified


def _map(pycolmap: Any, job: Job, features: Sequence[Features], verified: Dict[Pair, Any], folder: Path) -> List[Any]:
    folder.mkdir(parents=True, exist_ok=True)
    database = folder / "database.db"
    if database.exists():
        database.unlink()
    _fill(pycolmap, database, job, features, verified)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = job.settings.seed
    options.mapper.random_seed = job.settings.seed
    options.mapper.num_threads = 1
    options.triangulation.random_seed = job.settings.seed
    options.min_model_size = job.settings.min_model_frames
    options.extract_colors = False
    options.mapper.filter_max_reproj_error = job.settings.filter_max_reproj_error_px
    options.ba_refine_principal_point = False
    # The verdict needs no polished model on the way; the calibration adjusts it to the end.
    options.ba_global_frames_ratio = options.ba_global_points_ratio = 1.3
    options.ba_global_max_num_iterations, options.ba_global_max_refinements = 25, 2
    options.ba_local_max_num_iterations, options.ba_local_max_refinements = 15, 1
    options.constant_cameras = {i + 1 for i, c in enumerate(job.cameras) if c.held}
    for name in ("structure_less_registration_fallback",):
        if hasattr(options, name):
            # It places frames without a triangulated point: such a pose proves nothing.
            setattr(options, name, False)
    arguments: Dict[str, Any] = {}
    if job.start is not None:
        options.fix_existing_frames = True
        arguments["input_path"] = str(_start(pycolmap, job, folder / "start"))
    output = folder / "mapper"
    output.mkdir(exist_ok=True)
    found = pycolmap.incremental_mapping(str(database), str(folder), str(output), options=options, **arguments)
    models = [found[key] for key in sorted(found)]
    database.unlink()
    return models


def _start(pycolmap: Any, job: Job, folder: Path) -> Path:
    """The model to extend under the job's cameras: solved before, they are held now, and COLMAP compares their kind."""
    model = pycolmap.Reconstruction(str(stored_models(Path(job.start or ""))[0]))
    for camera_id in sorted(model.cameras):
        fresh = camera_of(pycolmap, camera_id, job.cameras[camera_id - 1])
        camera = model.cameras[camera_id]
        camera.model = fresh.model
        camera.params = fresh.params
    folder.mkdir(parents=True, exist_ok=True)
    model.write(str(folder))
    return folder


def _fill(pycolmap: Any, path: Path, job: Job, features: Sequence[Features], verified: Dict[Pair, Any]) -> None:
    opened = pycolmap.Database.open(str(path))
    try:
        for index, setting in enumerate(job.cameras):
            camera = camera_of(pycolmap, index + 1, setting)
            opened.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=index + 1)
            rig.add_ref_sensor(camera.sensor_id)
            opened.write_rig(rig, use_rig_id=True)
        for index, frame in enumerate(job.frames):
            image = pycolmap.Image(name=f"{index:06d}", camera_id=frame.camera + 1, image_id=index + 1)
            image.frame_id = index + 1
            shot = pycolmap.Frame()
            shot.frame_id = index + 1
            shot.rig_id = frame.camera + 1
            shot.add_data_id(image.data_id)
            opened.write_frame(shot, use_frame_id=True)
            opened.write_image(image, use_image_id=True)
            opened.write_keypoints(index + 1, features[index].points.astype(np.float32))
        for (a, b), geometry in sorted(verified.items()):
            opened.write_matches(a + 1, b + 1, np.asarray(geometry.inlier_matches, dtype=np.uint32))
            opened.write_two_view_geometry(a + 1, b + 1, geometry)
    finally:
        opened.close()


def _read_back(
    job: Job,
    models: Sequence[Any],
    folder: Path,
    inliers: Dict[Pair, int],
    pairs: Sequence[Pair],
    notes: Tuple[str, ...],
) -> Solution:
    ranked = sorted(models, key=lambda m: (-m.num_reg_images(), -m.num_points3D(), min(m.reg_image_ids(), default=0)))
    solution = collect(job, job.cameras, ranked, folder / "models")
    rows = [(a, b, inliers.get((a, b), 0)) for a, b in pairs]
    return with_changes(
        solution, pairs=np.asarray(rows, dtype=np.int64).reshape(-1, 3), notes=notes, stored=str(folder / "models")
    )
