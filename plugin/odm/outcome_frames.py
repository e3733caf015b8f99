"""The frames of an ODM project as the alignment knows frames: who made them, where, and how well that is known.

Our own reading of ``images/`` comes first, with the payloads of the run that
wrote the project; without pixels that run's report, then ODM's own metadata,
where a camera of ODM's is the payload.
"""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from ...stages.align.model import AlignCamera, AlignFrame, AlignRequest
from ...stages.align.prepare import sorted_request
from ...stages.assemble import Group, request_of
from ...stages.harmonize.model import untouched
from ...stages.intrinsics import Intrinsics
from ...stages.read import IMAGE_EXTENSIONS, scan
from ...stages.sensors import load_sheet
from ...stages.survey import build
from ...stages.thresholds import Thresholds
from .camera_id import file_key
from .masks import split_masks
from .opensfm_cameras import OpenSfmCamera
from .opensfm_json import Unreadable, read_json, read_object
from .project import OURS

Row = Mapping[str, Any]

_MAX_LIST_BYTES = 64 * 1024 * 1024
# Where no file says how large a frame is; only the allowance for the network's own spread hangs on it.
_USUAL_SIZE = (4000, 3000)


@dataclass(frozen=True)
class ProjectFrames:
    """The frames that ODM was to place, as a request of the alignment.

    ``name_of`` is frame path -> file name in the project; ``dropped`` are
    images of the project that ODM never took into its list. ``grouped_by``
    says where the payloads come from. ``planned`` is the route that the run
    which wrote the project gave it, ``""`` where no such run is known.
    ``spectra`` is payload -> spectrum, where that is known.
    """

    request: AlignRequest
    name_of: Mapping[str, str]
    dropped: Tuple[str, ...]
    grouped_by: str
    planned: str
    notes: Tuple[str, ...]
    spectra: Mapping[str, str] = field(default_factory=dict)


def opensfm_folder(folder: Path) -> Path:
    """Where the OpenSfM files of a project are: ``opensfm/``, or the folder itself for a bare OpenSfM data set."""
    inner = folder / "opensfm"
    return folder if not inner.is_dir() and (folder / "reconstruction.json").is_file() else inner


def project_frames(
    folder: Path,
    placed: Mapping[str, str],
    cameras: Mapping[str, OpenSfmCamera],
    limits: Thresholds,
    home: Optional[Path] = None,
) -> ProjectFrames:
    """Gather the frames of a project; ``placed`` is placed frame -> ODM camera, ``cameras`` ODM's start values.

    ``home`` is the project that a run of ours wrote, where ``folder`` is a part of it.

    Nothing here raises for a missing or damaged file: what it would have said
    is left open and noted.
    """
    notes: List[str] = []
    metadata = _metadata(folder, limits, notes)
    names = _listed(opensfm_folder(folder), limits, notes) or _primary(metadata, placed)
    present = _images(folder)
    names = sorted(set(names or present) | set(placed))[: limits.outcome_max_frames]
    ours, planned = _our_rows(home or folder, limits, notes)
    dropped: Set[str] = (present - set(metadata)) if metadata else (present - set(names) if names else set())
    read, seen = _from_images(folder, [n for n in names if n in present], limits) if present else ({}, {})
    spectra: Dict[str, str] = {}
    frames: List[AlignFrame] = []
    intrinsics: Dict[Tuple[str, int, int], AlignCamera] = {}
    used = set()
    for name in names:
        known = read.get(name)
        row = ours.get(name)
        if known is not None:
            frame, camera = known
            source = "the images"
        elif row is not None:
            frame, camera = _from_report(name, row), None
            source = "the report of the run that wrote it"
        else:
            frame, camera = _from_metadata(name, metadata.get(name, {}), placed.get(name, "")), None
            source = "ODM's camera names"
        used.add(source)
        spectrum = seen.get(frame.payload) or str(row.get("spectrum") or "" if row is not None else "")
        if row is not None:
            frame = _as_planned(frame, row)
        if spectrum:
            spectra.setdefault(frame.payload, spectrum)
        if camera is None:
            start = cameras.get(placed.get(name) or str(metadata.get(name, {}).get("camera", "")))
            frame = _sized(frame, start)
            camera = _camera(frame, start)
        camera = replace(camera, profile=frame.profile)
        intrinsics.setdefault((frame.profile, frame.width, frame.height), camera)
        frames.append(frame)
    request = sorted_request(AlignRequest(folder.name or "project", tuple(frames), tuple(intrinsics.values())))
    return ProjectFrames(
        request=request,
        name_of={f.path: f.file for f in request.frames},
        dropped=tuple(sorted(_path(n, ours.get(n)) for n in dropped)),
        grouped_by=", ".join(sorted(used)),
        planned=planned,
        notes=tuple(notes),
        spectra=spectra,
    )


def _path(name: str, row: Optional[Row]) -> str:
    return str(row["path"]) if row is not None and isinstance(row.get("path"), str) else name


def _images(folder: Path) -> Set[str]:
    """Names of the image files in ``images/``, masks left out."""
    try:
        found = {p.name for p in (folder / "images").iterdir() if p.suffix.lower() in IMAGE_EXTENSIONS}
    except OSError:
        return set()
    stems = {PurePosixPath(n).stem for n in found}
    return {n for n in found if not _is_mask(PurePosixPath(n).stem, stems)}


def _is_mask(stem: str, stems: Set[str]) -> bool:
    return stem.lower().endswith("_mask") and stem[: -len("_mask")] in stems


def _listed(opensfm: Path, limits: Thresholds, notes: List[str]) -> List[str]:
    """The frames that ODM handed to OpenSfM."""
    try:
        with open(opensfm / "image_list.txt", "rb") as stream:
            text = stream.read(_MAX_LIST_BYTES).decode("utf-8", "replace")
    except OSError:
        return []
    return [_base(line.strip()) for line in text.splitlines() if line.strip()]


def _base(path: str) -> str:
    return path.replace("\\", "/").rsplit("/", 1)[-1]


def _primary(metadata: Mapping[str, Row], placed: Mapping[str, str]) -> List[str]:
    """All frames that ODM read, of several bands only those with a placed frame: the others never enter the model."""
    band = {n: str(r.get("band", "")) for n, r in metadata.items()}
    solved = {band[n] for n in placed if n in band}
    if len(set(band.values())) > 1 and solved:
        return [n for n in metadata if band[n] in solved]
    return list(metadata)


def _metadata(folder: Path, limits: Thresholds, notes: List[str]) -> Dict[str, Row]:
    """What ODM read of each frame: ``images.json``, else OpenSfM's ``exif/`` files."""
    try:
        rows = read_json(folder / "images.json", limits)
        if isinstance(rows, list):
            return {_base(str(r["filename"])): _photo(r) for r in rows if isinstance(r, dict) and "filename" in r}
        notes.append("images.json holds no list of frames")
    except FileNotFoundError:
        pass
    except Unreadable as error:
        notes.append(str(error))
    found: Dict[str, Row] = {}
    try:
        files = sorted((opensfm_folder(folder) / "exif").glob("*.exif"))[: limits.outcome_max_frames]
    except OSError:
        files = []
    for file in files:
        try:
            found[file.name[: -len(".exif")]] = _exif(read_object(file, limits))
        except (FileNotFoundError, Unreadable) as error:
            notes.append(str(error))
    return found


def _number(value: Any) -> Optional[float]:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)


def _whole(value: Any) -> int:
    number = _number(value)
    return int(number) if number is not None and 0 < number < 1 << 20 else 0


def _photo(row: Row) -> Row:
    """A photo of ``images.json`` in the terms used here."""
    ratio = _number(row.get("focal_ratio"))
    parts = [row.get("camera_make", ""), row.get("camera_model", ""), row.get("width", ""), row.get("height", "")]
    identity = " ".join(["v2", *map(str, parts), str(row.get("camera_projection", "")), str(ratio)[:6]]).lower()
    moment = _number(row.get("utc_time"))
    return {
        "camera": identity,
        "width": _whole(row.get("width")),
        "height": _whole(row.get("height")),
        "latitude": _number(row.get("latitude")),
        "longitude": _number(row.get("longitude")),
        "altitude": _number(row.get("altitude")),
        "time": None if moment is None else moment / 1000.0,
        "band": str(row.get("band_name") or ""),
        "capture": str(row.get("capture_uuid") or ""),
        "focal_ratio": ratio,
    }


def _exif(row: Row) -> Row:
    """An OpenSfM ``.exif`` file in the same terms."""
    gps = row.get("gps")
    gps = gps if isinstance(gps, dict) else {}
    return {
        "camera": str(row.get("camera", "")),
        "width": _whole(row.get("width")),
        "height": _whole(row.get("height")),
        "latitude": _number(gps.get("latitude")),
        "longitude": _number(gps.get("longitude")),
        "altitude": _number(gps.get("altitude")),
        "time": _number(row.get("capture_time")) or None,
        "band": str(row.get("band_name") or ""),
        "capture": "",
        "focal_ratio": _number(row.get("focal_ratio")),
    }


def _place(row: Row) -> Optional[Tuple[float, float, float]]:
    latitude, longitude = _number(row.get("latitude")), _number(row.get("longitude"))
    if latitude is None or longitude is None or (latitude == 0.0 and longitude == 0.0):
        return None
    if abs(latitude) > 90.0 or abs(longitude) > 180.0:
        return None
    return latitude, longitude, _number(row.get("altitude", row.get("altitude_m"))) or 0.0


def _from_metadata(name: str, row: Row, camera: str) -> AlignFrame:
    """A frame of which only ODM's reading is known: its camera is its payload."""
    payload = file_key(camera or str(row.get("camera", ""))) or "unknown camera"
    return AlignFrame(
        path=name,
        file=name,
        width=int(row.get("width") or 0),
        height=int(row.get("height") or 0),
        profile=payload,
        flight=payload,
        payload=payload,
        capture=str(row.get("capture", "")),
        time_s=row.get("time"),
        position=_place(row),
    )


def _our_rows(folder: Path, limits: Thresholds, notes: List[str]) -> Tuple[Dict[str, Row], str]:
    """File name -> row of the report of the run that wrote this project, and the route it gave it."""
    root = folder.absolute()
    if root.parent.name != "projects" or not (root / OURS).is_dir():
        return {}, ""
    try:
        report = read_object(root.parent.parent / "report.json", limits)
    except FileNotFoundError:
        return {}, ""
    except Unreadable as error:
        notes.append(str(error))
        return {}, ""
    start = f"projects/{root.name}/images/"
    found: Dict[str, Row] = {}
    for row in _rows(report.get("frames")):
        output = row.get("output")
        if isinstance(output, str) and output.startswith(start):
            found[output[len(start) :]] = row
    routes = [str(s.get("route", "")) for s in _rows(report.get("subprojects")) if s.get("name") == root.name]
    return found, routes[0] if routes else ""


def _rows(value: Any) -> List[Dict[str, Any]]:
    return [r for r in value if isinstance(r, dict)] if isinstance(value, list) else []


def _as_planned(frame: AlignFrame, row: Row) -> AlignFrame:
    """The frame under the names that the run gave it; its height above ground came with that run's ground."""
    height = _number(row.get("height_m"))
    return replace(
        frame,
        path=_path(frame.file, row),
        profile=str(row.get("profile") or frame.profile),
        flight=str(row.get("flight") or frame.flight),
        payload=str(row.get("payload") or frame.payload),
        capture=str(row.get("capture") or frame.capture),
        height_m=height if height is not None else frame.height_m,
    )


def _from_report(name: str, row: Row) -> AlignFrame:
    """A frame without pixels, by the report alone."""
    gps = row.get("gps")
    gps = gps if isinstance(gps, dict) else {}
    change = row.get("change")
    change = change if isinstance(change, dict) else {}
    flat, up = _number(gps.get("sigma_horizontal_m")), _number(gps.get("sigma_vertical_m"))
    return AlignFrame(
        path=_path(name, row),
        file=name,
        width=_whole(change.get("width")) or _whole(row.get("width")),
        height=_whole(change.get("height")) or _whole(row.get("height")),
        profile="",
        flight="",
        payload="",
        capture="",
        time_s=_seconds(gps.get("time")),
        position=_place(row),
        sigma_m=(flat, up) if flat is not None and up is not None else None,
        yaw_deg=_number(gps.get("yaw_deg")),
        pitch_deg=_number(gps.get("pitch_deg")),
        rtk=gps.get("rtk_fixed") is True,
    )


def _seconds(text: Any) -> Optional[float]:
    try:
        moment = datetime.datetime.fromisoformat(str(text))
    except ValueError:
        return None
    return moment.replace(tzinfo=datetime.timezone.utc).timestamp()


def _sized(frame: AlignFrame, start: Optional[OpenSfmCamera]) -> AlignFrame:
    """The frame with its camera's size where its own is not known."""
    if frame.width > 0 and frame.height > 0:
        return frame
    width, height = (start.width, start.height) if start is not None else _USUAL_SIZE
    return replace(frame, width=width, height=height)


def _camera(frame: AlignFrame, start: Optional[OpenSfmCamera]) -> AlignCamera:
    """The camera that ODM started from, as the profile's."""
    ratio = None
    if start is not None and start.known:
        ratio = start.focal_ratio * max(frame.width, frame.height) / frame.width
    return AlignCamera(frame.profile, frame.width, frame.height, Intrinsics(focal_ratio=ratio))


def _from_images(
    folder: Path, names: Sequence[str], limits: Thresholds
) -> Tuple[Dict[str, Tuple[AlignFrame, AlignCamera]], Dict[str, str]]:
    """File name -> frame and camera, payload -> spectrum, by our own reading of ``images/``."""
    images, _ = split_masks(scan([str(folder / "images")], limits=limits))
    survey = build(images, load_sheet(None, limits), limits)
    wanted = set(names)
    paths = tuple(sorted(f.path for f in survey.frames if Path(f.path).name in wanted))
    if not paths:
        return {}, {}
    payloads = tuple(sorted({f.payload for f in survey.frames if f.path in set(paths)}))
    group = Group("project", "", 0, payloads, paths, paths)
    request = request_of(group, survey, untouched(survey.files), limits)
    shapes = {(c.profile, c.width, c.height): c for c in request.cameras}
    found: Dict[str, Tuple[AlignFrame, AlignCamera]] = {}
    for frame in request.frames:
        name = Path(frame.path).name
        found[name] = (replace(frame, path=name, file=name), shapes[(frame.profile, frame.width, frame.height)])
    return found, {p.id: p.spectrum for p in survey.payloads}
