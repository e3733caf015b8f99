"""A sub-project as it is sent: which files under which names, with which options."""

from __future__ import annotations

import hashlib
import json
import re
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.errors import UsageError
from ...stages.record import dumps
from ..odm.folder import EXTENSIONS, extension
from ..odm.layout import GCP_FILE, GEO_FILE
from ..odm.project import CALIBRATION, OURS
from ..odm.wire import CALIBRATION_INPUT

UNPROVEN = "unproven"
ROUTE_FILE = f"{OURS}/route.json"
# Every task's uuid comes from what is sent, so a submission whose ledger was lost is recognised on the node.
_NAMESPACE = uuid.UUID("5b0c0b0e-7a0e-5d8e-9c1b-2f1f4ad7c0de")
_HEAD = 65536
_MAX_JSON = 256 * 1024 * 1024
# Names by which a node does something else than to put the file among the images.
_SPECIAL = re.compile(r"^(body\.json|_body\.json|seed_*\.zip|zipurl\.zip|align\.(las|laz|tif)|.*\.zip)$", re.IGNORECASE)
_SAFE = re.compile(r"^[A-Za-z0-9_][A-Za-z0-9._-]*$")
_TEXTS = (GCP_FILE, GEO_FILE)


@dataclass(frozen=True)
class Item:
    """One file to be sent."""

    name: str
    path: str
    size: int

    @property
    def is_image(self) -> bool:
        """Whether the node counts it among the images: it moves every .txt away."""
        return not self.name.lower().endswith(".txt")


@dataclass(frozen=True)
class Parcel:
    """One sub-project ready to be sent.

    ``payloads`` and ``reasons`` are the report's; ``anchor_wanted`` says that
    it waits for the anchor's result to be laid on.
    """

    name: str
    folder: str
    items: Tuple[Item, ...]
    options: Tuple[Mapping[str, Any], ...]
    calibration: Optional[Mapping[str, Any]]
    route: str
    reasons: Tuple[str, ...]
    payloads: Tuple[str, ...]
    digest: str
    parent: str = ""

    @property
    def images(self) -> int:
        """How many of the files the node counts as images."""
        return sum(1 for i in self.items if i.is_image)

    @property
    def size(self) -> int:
        """Bytes."""
        return sum(i.size for i in self.items)

    def uuid(self, number: int) -> str:
        """The uuid of this parcel's ``number``-th task."""
        return str(uuid.uuid5(_NAMESPACE, f"{self.digest}:{number}"))


def read_json(path: Path, what: str) -> Any:
    """A JSON file of ours, bounded. Raises ``UsageError``."""
    try:
        if path.stat().st_size > _MAX_JSON:
            raise UsageError(f"{path} is too large for {what}.")
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"Cannot read {what} from {path}: {error.strerror}.") from error
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path} is no {what}: {error}.") from error


def subprojects(folder: Path) -> Tuple[Mapping[str, Any], ...]:
    """What the report of ``run`` says of its sub-projects; empty where there is no report."""
    report = folder / "report.json"
    if not report.is_file():
        return ()
    told = read_json(report, "report")
    listed = told.get("subprojects") if isinstance(told, dict) else None
    return tuple(s for s in listed if isinstance(s, dict) and isinstance(s.get("name"), str)) if listed else ()


def project_folders(folder: Path) -> Tuple[Path, ...]:
    """The project folders of an output of ``run``, or the folder itself where it is one project."""
    if (folder / "images").is_dir():
        return (folder,)
    root = folder / "projects"
    found = sorted(p for p in root.iterdir() if (p / "images").is_dir()) if root.is_dir() else []
    if not found:
        raise UsageError(f"There is no project in {folder}. Write some with: sensorgate run PATH --out {folder}")
    return tuple(found)


def read_parcels(folder: Path) -> Tuple[Parcel, ...]:
    """All sub-projects below ``folder``, by name. Raises ``UsageError`` where one could not arrive whole."""
    said = {str(s["name"]): s for s in subprojects(folder)}
    return tuple(read_parcel(p, said.get(p.name) or said_of(p)) for p in project_folders(folder))


def said_of(folder: Path) -> Mapping[str, Any]:
    """What stands in a project that came out of another one."""
    file = folder / ROUTE_FILE
    told = read_json(file, "route") if file.is_file() else {}
    return told if isinstance(told, dict) else {}


def read_parcel(folder: Path, said: Mapping[str, Any]) -> Parcel:
    """One project folder as it would be sent."""
    items: List[Item] = []
    for file in sorted((folder / "images").iterdir()):
        if file.name.startswith(".") or not file.is_file():
            continue
        if extension(file.name) not in EXTENSIONS and not file.name.lower().endswith("_mask.png"):
            continue
        items.append(Item(file.name, str(file), file.stat().st_size))
    for name in _TEXTS:
        if (folder / name).is_file():
            items.append(Item(name, str(folder / name), (folder / name).stat().st_size))
    _check_names(folder.name, items)
    options = _options(folder)
    file = folder / CALIBRATION
    calibration = read_json(file, "calibration") if file.is_file() else None
    if calibration is not None and not isinstance(calibration, dict):
        raise UsageError(f"{file} must hold a JSON object of cameras.")
    return Parcel(
        name=folder.name,
        folder=str(folder),
        items=tuple(items),
        options=options,
        calibration=calibration or None,
        route=str(said.get("route", "proceed")),
        reasons=tuple(str(r) for r in said.get("reasons", ())),
        payloads=tuple(str(p) for p in said.get("payloads", ())) or (folder.name,),
        digest=digest(folder.name, items, options, calibration),
        parent=str(said.get("parent", "")),
    )


def _options(folder: Path) -> Tuple[Mapping[str, Any], ...]:
    file = folder / OURS / "options.json"
    if not file.is_file():
        return ()
    told = read_json(file, "option list")
    if not isinstance(told, list) or not all(isinstance(o, dict) and "name" in o and "value" in o for o in told):
        raise UsageError(f'{file} must be a list of {{"name", "value"}}.')
    return tuple({"name": str(o["name"]), "value": o["value"]} for o in told)


def _check_names(project: str, items: Sequence[Item]) -> None:
    """Names that would clash, or that a node takes for something else, lose images without a word."""
    seen: Dict[str, str] = {}
    for item in items:
        key = item.name.lower()
        if key in seen:
            raise UsageError(
                f"{project}: {seen[key]} and {item.name} differ by case alone; a node may keep only one of them."
            )
        seen[key] = item.name
        if _SPECIAL.match(item.name) or item.name == CALIBRATION_INPUT or not _SAFE.match(item.name):
            raise UsageError(f"{project}: a node would not keep {item.name!r} among the images. Rename the file.")
        if item.size == 0:
            raise UsageError(f"{project}: {item.name} is empty.")


def digest(
    name: str, items: Sequence[Item], options: Sequence[Mapping[str, Any]], calibration: Optional[Mapping[str, Any]]
) -> str:
    """What tells two submissions apart: names, sizes, heads and tails of the files, options, calibration."""
    total = hashlib.sha256(f"{name}\n".encode())
    for item in sorted(items, key=lambda i: i.name):
        total.update(f"{item.name}\0{item.size}\0".encode())
        with Path(item.path).open("rb") as stream:
            total.update(stream.read(_HEAD))
            if item.size > 2 * _HEAD:
                stream.seek(-_HEAD, 2)
                total.update(stream.read(_HEAD))
    total.update(dumps([list(options), calibration]).encode("utf-8"))
    return total.hexdigest()
