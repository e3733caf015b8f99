"""What the node double is made of: its uploads and tasks, how it is set up, and what may go wrong."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Optional, Tuple

POLICY = {
    "name": "mixed-sensor-policy",
    "type": "enum",
    "value": "auto",
    "domain": ["off", "report", "auto", "strict"],
    "help": "",
}


# What may go wrong with one request.
REFUSED = "refused"  # the connection is closed before anything was read


TORN = "torn"  # the connection breaks in the middle of the body; what came so far stays


MUTE = "mute"  # it is carried out, and the answer is lost


ERROR_BEFORE = "error-before"  # status 500, nothing was done (NodeODM --test_drop_uploads)


ERROR_AFTER = "error-after"  # status 502 of a proxy, although it was done


GARBAGE = "garbage"  # a web page instead of JSON, nothing was done


KILLED = "killed"  # the process dies: all tasks are forgotten, unfinished uploads stay on disk


FAULTS = (REFUSED, TORN, MUTE, ERROR_BEFORE, ERROR_AFTER, KILLED)


@dataclass
class Upload:
    body: Dict[str, Any]
    files: Dict[str, bytes] = field(default_factory=dict)


@dataclass
class Task:
    uuid: str
    name: str
    options: List[Dict[str, Any]]
    images: Dict[str, bytes]
    gcp: Dict[str, bytes]
    estimate: int
    others: Dict[str, bytes] = field(default_factory=dict)
    outputs: List[str] = field(default_factory=list)
    status: int = 20
    message: str = ""
    progress: float = 0.0
    processing_time: int = -1
    asked: int = 0
    console: List[str] = field(default_factory=list)
    initialized: bool = False


@dataclass
class Behaviour:
    """How this node is set up."""

    version: str = "2.2.4"
    token: str = ""
    max_images: Optional[int] = None
    slots: int = 4
    adapter: bool = False
    cluster: bool = False
    drops: Tuple[str, ...] = ()  # options that the node behind a cluster does not know
    adds: Tuple[Tuple[str, Any], ...] = ()
    bends: Dict[str, Any] = field(default_factory=dict)
    disk_bytes: Optional[int] = None
    splitmerge: bool = True
    polls: int = 1  # how often a task is asked after until it is done
    ends: Callable[[Task], Tuple[int, str, List[str]]] = lambda task: (40, "", ["done"])
    archive: Callable[[Task], bytes] = lambda task: products()
    unauthorized: int = 200  # ClusterODM answers 401
    crash_on_numbers: bool = False  # NodeODM issue 269


def products(**files: bytes) -> bytes:
    """An all.zip."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("odm_orthophoto/odm_orthophoto.tif", b"orthophoto")
        archive.writestr("odm_georeferencing/odm_georeferenced_model.laz", b"points")
        archive.writestr("odm_report/stats.json", "{}")
        for name, data in files.items():
            archive.writestr(name, data)
    return made.getvalue()
