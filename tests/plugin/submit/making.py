"""Small projects to submit, in the shape that ``run`` writes."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence

from PIL import Image
from sensorgate.plugin.submit import Settings, submit
from sensorgate.stages.thresholds import DEFAULTS, Thresholds

from .node_double import NodeDouble
from .node_parts import Task

CAMERA = "dji fc6310 64 48 brown 0.6666"
CALIBRATION = {CAMERA: {"projection_type": "brown", "width": 64, "height": 48, "focal_x": 0.664, "focal_y": 0.664}}
LOCK = {"name": "use-fixed-camera-params", "value": True}


def quick(**changes: Any) -> Thresholds:
    """Limits that make waiting short."""
    values: Dict[str, Any] = {
        "submit_poll_s": 0.005,
        "submit_retry_s": 0.005,
        "submit_patience_s": 2.0,
        "submit_call_timeout_s": 10.0,
        "submit_upload_timeout_s": 10.0,
    }
    return DEFAULTS.replaced({**values, **changes})


def picture(number: int) -> bytes:
    """A real little JPEG, another one for each number."""
    made = io.BytesIO()
    Image.linear_gradient("L").resize((64, 48)).rotate(number * 7).save(made, "JPEG", quality=90)
    return made.getvalue() + bytes([number % 256]) * 3


def project(
    root: Path,
    name: str,
    frames: Sequence[str] = ("A.JPG", "B.JPG", "C.JPG"),
    *,
    options: Sequence[Mapping[str, Any]] = (),
    calibration: Optional[Mapping[str, Any]] = None,
    gcp: Optional[str] = None,
    geo: Optional[str] = None,
) -> Path:
    """One project folder below ``root``/projects."""
    folder = root / "projects" / name
    (folder / "images").mkdir(parents=True)
    (folder / "sensorgate").mkdir()
    for number, frame in enumerate(frames):
        (folder / "images" / frame).write_bytes(picture(number + sum(map(ord, name))))
    (folder / "sensorgate/options.json").write_text(json.dumps(list(options)))
    if calibration is not None:
        (folder / "sensorgate/calibration.json").write_text(json.dumps(calibration))
    for file, text in (("gcp_list.txt", gcp), ("geo.txt", geo)):
        if text is not None:
            (folder / file).write_text(text)
    return folder


def report(root: Path, subprojects: List[Dict[str, Any]]) -> None:
    """A report of ``run`` with what ``submit`` reads of it; ``payload_of`` maps frames to payloads."""
    frames = []
    for sub in subprojects:
        for frame, payload in sorted(sub.pop("payload_of", {}).items()):
            frames.append(
                {
                    "path": f"in/{frame}",
                    "subproject": sub["name"],
                    "output": f"projects/{sub['name']}/images/{frame}",
                    "payload": payload,
                    "odm_camera_id": f"v2 {CAMERA}",
                }
            )
    (root / "report.json").write_text(json.dumps({"frames": frames, "subprojects": subprojects}))


def files_of(folder: Path) -> Dict[str, bytes]:
    """Name -> bytes of a project's images."""
    return {p.name: p.read_bytes() for p in sorted((folder / "images").iterdir())}


def go(root: Path, node: NodeDouble, **settings):
    more = {k: settings.pop(k) for k in ("read_outcome", "cancel", "ask_cancel", "tell") if k in settings}
    limits = quick(**settings.pop("limits", {}))
    return submit(root, node.url, Settings(thresholds=limits, **settings), **more)


def only(node: NodeDouble) -> Task:
    (task,) = node.tasks.values()
    return task


def ends(**by_name):
    """How tasks end, by name; the others end well."""

    def end(task: Task):
        return by_name.get(task.name.replace("-", "_"), (40, "", ["fine"]))

    return end
