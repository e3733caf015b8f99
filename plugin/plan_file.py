"""Reads a ``plan.json``, which may come from anybody: bounded, and its shape checked before anything uses it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple, Union

from ..stages.errors import UsageError
from .plan import PLAN_VERSION
from .report.view import clean_text

# Ten times the plan of ten thousand frames.
MAX_PLAN_BYTES = 64 * 1024 * 1024


@dataclass(frozen=True)
class Plan:
    """A plan that was read and checked. ``sha256`` is of the file, ``folder`` where it lies."""

    record: Mapping[str, Any]
    sha256: str
    folder: Path


Shape = Union[type, Tuple[type, ...], List[Any], Dict[str, Any]]
_NONE = type(None)
_OUTPUTS: Shape = {"*": (str, _NONE)}
_FILE: Shape = {"name": str, "sha256": str}
_ACTION: Shape = {"profile": str, "flight": str, "frames": [str]}
_PROJECT: Shape = {
    **{"name": str, "spectrum": str, "route": str, "payloads": [str], "frames": [str], "held": [str]},
    "options": [{"name": str}],
    "files": _OUTPUTS,
}
_PLAN: Shape = {
    "schema_version": str,
    "versions": {"*": (str, _NONE)},
    "settings": {"options": dict, "files": {"*": _FILE}, "stored": (list, _NONE)},
    "thresholds": {"all": dict},
    "inputs": {"paths": int, "files": _OUTPUTS},
    "harmonize": {"actions": [_ACTION], "luts": [{"id": str}]},
    "subprojects": [_PROJECT],
    "excluded": {"*": (str, _NONE)},
}


def _misfit(value: Any, shape: Shape, where: str = "") -> Optional[str]:
    """Where ``value`` leaves ``shape``, or ``None``. ``*`` stands for any name; names beyond the shape are free."""
    if isinstance(shape, list):
        if not isinstance(value, list):
            return where
        return next((bad for i, v in enumerate(value) if (bad := _misfit(v, shape[0], f"{where}[{i}]"))), None)
    if isinstance(shape, dict):
        if not isinstance(value, dict):
            return where
        inner = dict.fromkeys(value, shape["*"]) if "*" in shape else shape
        found = (_misfit(value.get(k), s, f"{where}.{k}" if where else k) for k, s in inner.items())
        return next((bad for bad in found if bad), None)
    return None if isinstance(value, shape) and not (shape is int and isinstance(value, bool)) else where


def read_plan(path: str) -> Plan:
    """Read ``plan.json``. ``UsageError`` where it is no plan of this version's, or larger than a plan can be."""
    file = Path(path)
    try:
        if not file.is_file():
            raise UsageError(f"--plan: there is no file {path}.")
        with file.open("rb") as stream:
            data = stream.read(MAX_PLAN_BYTES + 1)
    except OSError as error:
        raise UsageError(f"--plan: {path} cannot be read ({error.strerror}).") from None
    if len(data) > MAX_PLAN_BYTES:
        raise UsageError(f"--plan: {path} is too large for a plan.")
    try:
        record = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError):
        raise UsageError(f"--plan: {path} is not valid JSON.") from None
    version = record.get("schema_version") if isinstance(record, dict) else None
    if not isinstance(version, str):
        raise UsageError(f"--plan: {path} is no plan.json of sensorgate.")
    if version != PLAN_VERSION:
        raise UsageError(
            f"--plan: {clean_text(path)} is of format {clean_text(version)[:20]}, this version reads {PLAN_VERSION}. "
            "Replay it with the version of sensorgate that wrote it."
        )
    bad = _misfit(record, _PLAN)
    if bad is not None:
        raise UsageError(f"--plan: {path} is damaged at {clean_text(bad)[:80]}. Copy it again from the first run.")
    return Plan(record, hashlib.sha256(data).hexdigest(), file.resolve().parent)
