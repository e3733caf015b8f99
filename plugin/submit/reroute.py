"""A project that failed or came out poor, taken apart or tried again: new project folders beside the old one.

The frames are linked, not copied; ground control, positions and calibration
are cut to them. A frame of the old project is in exactly one of the new ones.
"""

from __future__ import annotations

import importlib.util
import logging
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from ...stages.errors import SensorgateError
from ...stages.grouping import slug
from ...stages.record import dumps, write_text
from ...stages.route import ISOLATE, PAIRWISE
from ...stages.thresholds import DEFAULTS, Thresholds
from ..odm.camera_id import file_key
from ..odm.gcp import read_gcp
from ..odm.layout import GCP_FILE, GEO_FILE
from ..odm.options import Option
from ..odm.project import write_project
from .negotiate import LOCK
from .parcel import ROUTE_FILE, Parcel

LOG = logging.getLogger("sensorgate.submit")

FEATURES = "min-num-features"

# Frames of a project -> names of those that do not stand with the rest when aligned pairwise, with the reason.
AlignPairwise = Callable[[Sequence[Path]], Mapping[str, str]]


@dataclass(frozen=True)
class Part:
    """One new project: its frames by name, and why it is."""

    name: str
    frames: Tuple[str, ...]
    payloads: Tuple[str, ...]
    route: str
    reasons: Tuple[str, ...]
    options: Tuple[Tuple[str, Any, str], ...] = ()


def frames_of(report: Mapping[str, Any]) -> Dict[str, Tuple[str, str]]:
    """Output name of a frame -> its payload and its camera id in ODM, out of the report of ``run``."""
    found: Dict[str, Tuple[str, str]] = {}
    for frame in report.get("frames", []):
        output = frame.get("output")
        if isinstance(output, str):
            identity = str(frame.get("odm_camera_id") or "")
            found[output.rsplit("/", 1)[-1]] = (str(frame.get("payload") or ""), file_key(identity))
    return found


def plan(
    parcel: Parcel,
    route: str,
    reasons: Sequence[str],
    known: Mapping[str, Tuple[str, str]],
    apart: Optional[Mapping[str, str]] = None,
    limits: Thresholds = DEFAULTS,
) -> Tuple[Part, ...]:
    """Which projects come out of this one. Pure; empty where there is nothing left to try.

    ``apart`` maps frames that a pairwise alignment refused to its reason;
    ``None`` where none was run.
    """
    names = [i.name for i in parcel.items if i.is_image and not _is_mask(i.name)]
    payload = {n: known.get(n, ("", ""))[0] or parcel.payloads[0] for n in names}
    payloads = sorted(set(payload.values()))
    why = tuple(reasons)
    if route == PAIRWISE:
        refused = sorted({payload[n] for n in (apart or {}) if n in payload})
        kept = [p for p in payloads if p not in refused]
        if not refused or not kept:
            if refused or any(o["name"] == FEATURES for o in parcel.options):
                route = ISOLATE
            else:
                more = (FEATURES, limits.submit_retry_features, "the block did not hold with ODM's own number")
                return (Part(f"{parcel.name}-again", tuple(names), tuple(payloads), PAIRWISE, why, (more,)),)
        else:
            parts = [Part(f"{parcel.name}-rest", _with(names, payload, kept), tuple(kept), PAIRWISE, why)]
            for one in refused:
                said = next(apart[n] for n in sorted(apart or {}) if payload.get(n) == one) if apart else ""
                parts.append(_alone(parcel, names, payload, one, (*why, said) if said else why))
            return _unique(parts)
    if route == ISOLATE and len(payloads) > 1:
        return _unique([_alone(parcel, names, payload, one, why) for one in payloads])
    return ()


def _alone(parcel: Parcel, names: Sequence[str], payload: Mapping[str, str], one: str, why: Tuple[str, ...]) -> Part:
    name = f"{parcel.name}-{slug(one.replace('/', '-'))}"[:80].rstrip("-.")
    return Part(name, _with(names, payload, [one]), (one,), ISOLATE, why)


def _with(names: Sequence[str], payload: Mapping[str, str], wanted: Sequence[str]) -> Tuple[str, ...]:
    return tuple(n for n in names if payload[n] in wanted)


def _unique(parts: Sequence[Part]) -> Tuple[Part, ...]:
    taken: Set[str] = set()
    result: List[Part] = []
    for part in parts:
        name, number = part.name, 2
        while name in taken:
            name, number = f"{part.name}-{number}", number + 1
        taken.add(name)
        result.append(Part(name, part.frames, part.payloads, part.route, part.reasons, part.options))
    return tuple(result)


def _is_mask(name: str) -> bool:
    return name.rpartition(".")[0].endswith("_mask")


def build(parcel: Parcel, part: Part, known: Mapping[str, Tuple[str, str]], limits: Thresholds = DEFAULTS) -> Path:
    """Write the folder of one new project beside the old one; an existing whole one is left as it is."""
    old = Path(parcel.folder)
    target = old.parent / part.name
    if (target / ROUTE_FILE).is_file():
        return target
    beside = old.parent / f".part-{part.name}"
    shutil.rmtree(beside, ignore_errors=True)
    (beside / "images").mkdir(parents=True)
    stems = {n.rpartition(".")[0] for n in part.frames}
    for item in parcel.items:
        mask_of = item.name.rpartition(".")[0][: -len("_mask")] if _is_mask(item.name) else None
        if item.name in part.frames or (mask_of is not None and mask_of in stems):
            _link(Path(item.path), beside / "images" / item.name)
    calibration = _calibration(parcel, part, known)
    write_project(
        beside,
        options=_options(parcel, part, bool(calibration)),
        gcp_text=_gcp(old, part, limits),
        geo_text=_geo(old, part),
        calibration=calibration,
        notes=(f"route: {part.route}", f"from: {parcel.name}"),
    )
    said = {
        "route": part.route,
        "reasons": list(part.reasons),
        "payloads": list(part.payloads),
        "parent": parcel.name,
    }
    write_text(beside / ROUTE_FILE, dumps(said))
    if target.exists():
        shutil.rmtree(target)
    os.replace(beside, target)
    return target


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _calibration(parcel: Parcel, part: Part, known: Mapping[str, Tuple[str, str]]) -> Optional[Dict[str, Any]]:
    """The cameras of the part's frames; the whole sheet where the ids are not known (a key too many does no harm)."""
    if not parcel.calibration:
        return None
    ids = {known.get(n, ("", ""))[1] for n in part.frames}
    cut = {k: v for k, v in parcel.calibration.items() if file_key(k) in ids}
    return cut or (dict(parcel.calibration) if "" in ids else None)


def _options(parcel: Parcel, part: Part, calibrated: bool) -> Tuple[Option, ...]:
    added = {name for name, _, _ in part.options}
    kept = [
        Option(str(o["name"]), o["value"], "as in the project it came from")
        for o in parcel.options
        if o["name"] not in added and (calibrated or o["name"] != LOCK)
    ]
    return tuple(sorted([*kept, *(Option(n, v, w) for n, v, w in part.options)], key=lambda o: o.name))


def _gcp(old: Path, part: Part, limits: Thresholds) -> Optional[str]:
    """Ground control cut to the frames, or none where too little is left to replace the GPS that ODM then ignores."""
    text = _cut(old / GCP_FILE, part.frames, 5)
    if text is None:
        return None
    seen: Dict[Tuple[float, float, float], Set[str]] = {}
    for line in read_gcp(text).lines:
        seen.setdefault(line.point, set()).add(line.image)
    solid = [p for p, images in seen.items() if len(images) >= limits.gcp_min_images]
    return text if len(solid) >= limits.gcp_min_points else None


def _geo(old: Path, part: Part) -> Optional[str]:
    return _cut(old / GEO_FILE, part.frames, 0)


def _cut(file: Path, frames: Sequence[str], column: int) -> Optional[str]:
    """The header and the lines whose ``column`` names one of the frames."""
    if not file.is_file():
        return None
    lines = [line for line in file.read_text(encoding="utf-8").splitlines() if line.strip()]
    wanted = set(frames)
    kept = [line for line in lines[1:] if len(line.split()) > column and line.split()[column] in wanted]
    return "\n".join([lines[0], *kept]) + "\n" if kept else None


def default_aligner(workspace: Path, limits: Thresholds = DEFAULTS) -> Optional[AlignPairwise]:
    """The router's own pairwise alignment, where its solver is installed."""
    if importlib.util.find_spec("pycolmap") is None or importlib.util.find_spec("cv2") is None:
        return None

    def align(frames: Sequence[Path]) -> Mapping[str, str]:
        from ...stages.document import requests_for
        from ...stages.read import scan
        from ...stages.route import FALLBACK_STRATEGY, PipelineRouter
        from ...stages.sensors import load_sheet
        from ...stages.survey import build as survey_of

        requests = requests_for(survey_of(scan([str(f) for f in frames]), load_sheet(), limits))
        if not requests:
            return {}
        request = max(requests, key=lambda r: (len(r.frames), r.name))
        router = PipelineRouter(limits.min_inliers, limits.max_reproj_error_px, limits)
        try:
            report = router.execute_fallback(FALLBACK_STRATEGY, request, workspace=workspace)
        except SensorgateError as error:
            LOG.info("pairwise alignment says nothing: %s", error)
            return {}
        refused = {p.payload: "; ".join(p.reasons[:2]) for p in report.payloads if p.verdict == "fail"}
        return {Path(f.path).name: refused[f.payload] for f in request.frames if f.payload in refused}

    return align
