"""The files of an ODM project, read with bounds: model, matches, console, ODM's own figures."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, Tuple

import numpy as np

from ...stages.thresholds import Thresholds
from .opensfm_cameras import OpenSfmCamera, camera_from_json, rotation_matrix
from .opensfm_json import Unreadable, numbers, read_json, read_object
from .opensfm_matches import SUFFIX, pairs_of, read_matches
from .opensfm_model import OdmModel, build_model
from .opensfm_pieces import Pairs
from .opensfm_raw import grown_components
from .outcome_console import FAILED, FINISHED, ConsoleOutcome, outcome_of_console
from .outcome_frames import opensfm_folder
from .outcome_judge import PlacedFrames, placed_of

CONSOLES = ("task_output.txt", "console.txt", "sensorgate/console.txt")
_SIDE = re.compile(r"^feature_process_size:\s*(\d{2,6})\s*$", re.MULTILINE)
_MAX_CONFIG_BYTES = 1 << 20
_LAST_OUTPUT = 50


@dataclass(frozen=True)
class GcpFigures:
    """Ground control as ODM's report has it: residuals after the adjustment, in metres. No proof."""

    points: Optional[int]
    mean_m: Optional[float]
    ce90_m: Optional[float]
    le90_m: Optional[float]
    worst: str = ""
    worst_m: Optional[float] = None


@dataclass(frozen=True)
class OdmFigures:
    """What ODM's own report says, for comparison: components after the merge, errors cut at 4 px."""

    components: Optional[int] = None
    registered: Optional[int] = None
    frames: Optional[int] = None
    mean_reproj_error_px: Optional[float] = None
    gps_error_m: Optional[float] = None
    gcp: Optional[GcpFigures] = None


@dataclass(frozen=True)
class RunLog:
    """How the run ended. ``error`` is ODM's last word, ``held`` whether it kept the cameras as given."""

    state: str
    version: str
    error: str
    held: bool
    console: ConsoleOutcome


def read_placed(
    folder: Path, figures: OdmFigures, limits: Thresholds, count_shared: bool, notes: List[str]
) -> Tuple[Optional[PlacedFrames], Optional[OdmModel]]:
    """Where frames were placed: OpenSfM's model, else the shots of ODM's report."""
    opensfm = opensfm_folder(folder)
    for name in ("reconstruction.topocentric.json", "reconstruction.json"):
        if (opensfm / name).is_file():
            model = build_model(opensfm, opensfm / name, limits, count_shared)
            if model is not None:
                return placed_of(model, limits), model
            if not _empty(opensfm / name):
                notes.append(f"{name} holds no placed frame that can be read")
    try:
        shots = read_object(folder / "odm_report" / "shots.geojson", limits)
    except FileNotFoundError:
        return None, None
    except Unreadable as error:
        notes.append(str(error))
        return None, None
    return _placed_by_report(shots, opensfm, figures, limits), None


def _empty(path: Path) -> bool:
    """Whether a list holds nothing: ODM writes one where it placed no frame."""
    try:
        with open(path, "rb") as stream:
            return b"".join(stream.read(64).split()) == b"[]"
    except OSError:
        return False


def _placed_by_report(
    shots: Mapping[str, Any], opensfm: Path, figures: OdmFigures, limits: Thresholds
) -> Optional[PlacedFrames]:
    """The shots of ``odm_report/shots.geojson``: centres in metres on ODM's map grid, no points, no matches."""
    found: Dict[str, Tuple[str, List[float], List[float]]] = {}
    cameras: Dict[str, OpenSfmCamera] = {}
    rows = shots.get("features")
    for row in rows[: limits.outcome_max_frames] if isinstance(rows, list) else []:
        told = _object(row, "properties") if isinstance(row, dict) else {}
        try:
            name, camera = str(told["filename"]), str(told["camera"])
            place, turn = numbers(told["translation"], 3), numbers(told["rotation"], 3)
            if camera not in cameras:
                cameras[camera] = camera_from_json(camera, {**told, "projection_type": "perspective"})
        except (KeyError, TypeError, ValueError, OverflowError):
            continue
        found.setdefault(name, (camera, place, turn))
    names = tuple(sorted(found))
    if not names:
        return None
    grown = grown_components(opensfm / "reports" / "reconstruction.json", limits) or {}
    piece = np.asarray([grown.get(n, 0) for n in names], dtype=np.int64)
    order = np.argsort(-np.bincount(piece), kind="stable")
    rank = np.argsort(order, kind="stable")
    error = figures.mean_reproj_error_px
    return PlacedFrames(
        names=names,
        camera_of=tuple(found[n][0] for n in names),
        cameras=cameras,
        model=rank[piece].astype(np.int64),
        center=np.asarray([found[n][1] for n in names]),
        rotation=np.stack([rotation_matrix(np.asarray(found[n][2])) for n in names]),
        error_px=np.full(len(names), np.nan if error is None else error),
        observations=np.ones(len(names), dtype=np.int64),
        point_xyz=np.zeros((0, 3)),
        point_model=np.zeros(0, dtype=np.int64),
        whole_errors=False,
    )


def read_pairs(opensfm: Path, limits: Thresholds, notes: List[str]) -> Tuple[Optional[Pairs], str]:
    """Verified matches per pair of file names and what they come from; ``None`` where nothing tells.

    The matches themselves, else the tracks that pairs have in common by
    OpenSfM's own report.
    """
    counts: Dict[str, Mapping[str, int]] = {}
    refused: List[str] = []
    try:
        files = sorted((opensfm / "matches").glob(f"*{SUFFIX}"))[: limits.outcome_max_frames]
    except OSError:
        files = []
    for file in files:
        try:
            counts[file.name[: -len(SUFFIX)]] = read_matches(file, limits)
        except Unreadable as error:
            refused.append(str(error))
    if refused:
        notes.append(f"{len(refused)} files of matches were left out: {refused[0]}")
    if counts:
        return pairs_of(counts), "matches"
    try:
        graph = read_object(opensfm / "reports" / "tracks.json", limits).get("view_graph")
    except FileNotFoundError:
        return None, ""
    except Unreadable as error:
        notes.append(str(error))
        return None, ""
    shared: Dict[str, Dict[str, int]] = {}
    for row in graph if isinstance(graph, list) else []:
        if isinstance(row, list) and len(row) == 3 and isinstance(row[2], int):
            shared.setdefault(str(row[0]), {})[str(row[1])] = row[2]
    return (pairs_of(shared), "common tracks") if shared else (None, "")


def start_cameras(opensfm: Path, limits: Thresholds, notes: List[str]) -> Dict[str, OpenSfmCamera]:
    """The cameras that ODM started from: its own from the tags, replaced by those that it was given."""
    found: Dict[str, OpenSfmCamera] = {}
    for name in ("camera_models.json", "camera_models_overrides.json"):
        try:
            rows = read_object(opensfm / name, limits)
        except FileNotFoundError:
            continue
        except Unreadable as error:
            notes.append(str(error))
            continue
        for identity, value in rows.items():
            try:
                found[identity] = camera_from_json(identity, value)
            except (ValueError, TypeError, OverflowError):
                notes.append(f"{name}: the camera {identity[:80]!r} is damaged")
    return found


def feature_side(opensfm: Path, limits: Thresholds) -> int:
    """Longer side in pixels that features were extracted at."""
    try:
        with open(opensfm / "config.yaml", "rb") as stream:
            told = _SIDE.search(stream.read(_MAX_CONFIG_BYTES).decode("utf-8", "replace"))
    except OSError:
        told = None
    return int(told.group(1)) if told else limits.align_max_dim_px


def read_figures(folder: Path, limits: Thresholds, notes: List[str]) -> OdmFigures:
    """ODM's own statistics, empty where it made none."""
    opensfm = opensfm_folder(folder)
    for path in (opensfm / "stats" / "stats.json", folder / "odm_report" / "stats.json"):
        try:
            stats = read_object(path, limits)
        except FileNotFoundError:
            continue
        except Unreadable as error:
            notes.append(str(error))
            continue
        built = _object(stats, "reconstruction_statistics")
        mean = _number(built.get("reprojection_error_pixels"))
        return OdmFigures(
            components=_whole(built.get("components")),
            registered=_whole(built.get("reconstructed_shots_count")),
            frames=_whole(built.get("initial_shots_count")),
            mean_reproj_error_px=mean if mean is not None and mean >= 0 else None,
            gps_error_m=_number(_object(stats, "gps_errors").get("average_error")),
            gcp=_gcp(_object(stats, "gcp_errors"), opensfm, limits),
        )
    return OdmFigures()


def _gcp(errors: Mapping[str, Any], opensfm: Path, limits: Thresholds) -> Optional[GcpFigures]:
    """Residuals of the ground control that ODM used, ``None`` without any."""
    if _number(errors.get("average_error")) is None:
        return None
    found: List[Tuple[float, str]] = []
    try:
        rows = read_json(opensfm / "stats" / "ground_control_points.json", limits)
    except (FileNotFoundError, Unreadable):
        rows = None
    for row in rows if isinstance(rows, list) else []:
        miss = row.get("error") if isinstance(row, dict) else None
        try:
            found.append((float(np.linalg.norm(numbers(miss, 3))), str(row.get("id", ""))))
        except (ValueError, TypeError):
            continue
    worst = max(found) if found else None
    return GcpFigures(
        points=len(rows) if isinstance(rows, list) else None,
        mean_m=_number(errors.get("average_error")),
        ce90_m=_number(errors.get("ce90")),
        le90_m=_number(errors.get("le90")),
        worst=worst[1] if worst else "",
        worst_m=round(worst[0], 4) if worst else None,
    )


def _object(value: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = value.get(name)
    return found if isinstance(found, dict) else {}


def _number(value: Any) -> Optional[float]:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e12:
        return None
    return round(float(value), 6)


def _whole(value: Any) -> Optional[int]:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else None


def read_log(folder: Path, limits: Thresholds, notes: List[str]) -> RunLog:
    """How the run ended, by ``log.json``, else by the console that a node kept."""
    log: Mapping[str, Any] = {}
    try:
        log = read_object(folder / "log.json", limits)
    except FileNotFoundError:
        pass
    except Unreadable as error:
        notes.append(str(error))
    lines = list(_log_lines(log)) if log else []
    for name in CONSOLES:
        if (folder / name).is_file():
            lines.extend(_console_lines(folder / name, limits, notes))
            break
    console = outcome_of_console(lines)
    told = log.get("error")
    words = str(told.get("message", ""))[:500] if isinstance(told, dict) else ""
    state = FINISHED if log.get("success") is True else FAILED if isinstance(told, dict) else console.state
    options = _object(log, "options")
    return RunLog(
        state=state,
        version=str(log.get("odmVersion", ""))[:40],
        error=words,
        held=options.get("use_fixed_camera_params") is True,
        console=console,
    )


def _log_lines(log: Mapping[str, Any]) -> Iterator[str]:
    """The messages of ``log.json`` as a console would show them, the last words of a failed process among them."""
    stages = log.get("stages")
    for stage in stages if isinstance(stages, list) else []:
        rows = stage.get("messages") if isinstance(stage, dict) else None
        for row in rows if isinstance(rows, list) else []:
            if isinstance(row, dict) and isinstance(row.get("message"), str):
                yield f"[{str(row.get('type', 'info')).upper()[:20]}] {row['message']}"
    processes = log.get("processes")
    for process in processes if isinstance(processes, list) else []:
        if isinstance(process, dict) and process.get("exitCode") not in (0, None):
            output = process.get("output")
            yield from (str(line) for line in (output if isinstance(output, list) else [])[-_LAST_OUTPUT:])
    told = log.get("error")
    if isinstance(told, dict):
        yield f"[ERROR] {told.get('message', '')}"
        trace = log.get("stackTrace")
        yield from (str(line) for line in (trace if isinstance(trace, list) else [])[-_LAST_OUTPUT:])


def _console_lines(path: Path, limits: Thresholds, notes: List[str]) -> Iterator[str]:
    try:
        with open(path, encoding="utf-8", errors="replace") as stream:
            for _ in range(limits.outcome_console_lines):
                line = stream.readline(1 << 16)
                if not line:
                    return
                yield line
            notes.append(f"{path.name} is longer than {limits.outcome_console_lines} lines; the rest was not read")
    except OSError as error:
        notes.append(f"{path.name} cannot be read ({error.strerror})")
