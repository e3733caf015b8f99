"""A processing node that is no node: NodeODM's HTTP as it was seen to be, with faults on demand.

Each quirk says where it was seen: NodeODM 2.2.4 (8ad3e30), NodeODX 2.3.1 (e36d801), ClusterODM 1.5.8 (69181e2).
"""

from __future__ import annotations

import io
import json
import re
import threading
import zipfile
from collections import Counter
from http.server import ThreadingHTTPServer
from typing import Any, Callable, Dict, List, Optional, Tuple
from uuid import uuid4

from sensorgate.plugin.odm.options import odm_3_6_options

from .node_http import Handler
from .node_parts import POLICY, Behaviour, Task, Upload

UUID = re.compile(r"^[0-9a-f]{8}-[0-9a-f]{4}-[1-7][0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}$", re.IGNORECASE)


class NodeDouble:
    """The server; ``fault(number, method, path)`` names what goes wrong with a request."""

    def __init__(
        self, behaviour: Optional[Behaviour] = None, fault: Optional[Callable[[int, str, str], Optional[str]]] = None
    ) -> None:
        self.behaviour = behaviour or Behaviour()
        self.fault = fault
        self.uploads: Dict[str, Upload] = {}
        self.tasks: Dict[str, Task] = {}
        self.requests: List[Tuple[str, str]] = []
        self.queries: List[str] = []
        self.received: Counter[str] = Counter()
        self.deaths = 0
        self.forgotten: Dict[str, Task] = {}
        self.lock = threading.RLock()
        double = self

        class Bound(Handler):
            node = double

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Bound)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    def __enter__(self) -> NodeDouble:
        self._thread.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    # --- what the node does ----------------------------------------------------

    def kill(self) -> None:
        """SIGKILL and restart: tasks since the last hourly dump and their files are gone, tmp/ stays (NodeODM)."""
        with self.lock:
            self.forgotten.update(self.tasks)
            self.tasks.clear()
            self.deaths += 1

    def option_list(self) -> List[Dict[str, Any]]:
        listed = [
            {"name": o["name"], "type": o["type"], "value": str(o["default"]), "domain": o["domain"] or "", "help": ""}
            for o in odm_3_6_options()
            if o["nodeodm_shows"]
        ]
        return [*listed, POLICY] if self.behaviour.adapter else listed

    def filter_options(self, given: Any) -> List[Dict[str, Any]]:
        """NodeODM's filterOptions: unknown names vanish without a word, 80zz is 80, 8000.7 is 8000."""
        options = json.loads(given) if isinstance(given, str) else given or []
        wanted = {o["name"]: o["value"] for o in options}
        result, errors = [], []
        for known in self.option_list():
            name = known["name"]
            if name not in wanted or name in self.behaviour.drops:
                continue
            value = wanted[name]
            if known["type"] == "bool":
                if value in (True, "true", "1"):
                    value = True
                elif value in (False, "false", "0"):
                    value = False
                else:
                    errors.append({"name": name, "error": f"Cannot convert {value} to boolean"})
            elif known["type"] in ("int", "float"):
                found = re.match(r"^\s*-?\d+(\.\d+)?(e[-+]?\d+)?", str(value))
                if not found:
                    errors.append({"name": name, "error": "Invalid value NaN (out of range)"})
                    continue
                value = int(float(found.group(0))) if known["type"] == "int" else float(found.group(0))
            elif isinstance(known["domain"], list) and value not in known["domain"]:
                errors.append({"name": name, "error": f"Invalid value {value} (not in enum)"})
            elif known["domain"] == "json" and not _is_json(value):
                errors.append({"name": name, "error": f"Invalid value {value} (out of range)"})
            result.append({"name": name, "value": self.behaviour.bends.get(name, value)})
        if errors:
            raise ValueError(json.dumps(errors))
        result += [{"name": n, "value": v} for n, v in self.behaviour.adds]
        return result

    def init(self, uuid: str, fields: Dict[str, Any]) -> Dict[str, Any]:
        with self.lock:
            uuid = uuid or str(uuid4())
            if not UUID.match(uuid) or uuid in self.tasks:
                return {"error": f"Invalid set-uuid: {uuid}"}
            try:
                self.filter_options(fields.get("options"))
            except ValueError as error:
                self.uploads.pop(uuid, None)
                return {"error": str(error)}
            # A second init over an upload writes its note anew and leaves the files (NodeODM handleInit).
            files = self.uploads[uuid].files if uuid in self.uploads else {}
            self.uploads[uuid] = Upload(dict(fields), files)
            return {"uuid": uuid}

    def store(self, uuid: str, name: str, data: bytes, whole: bool = True) -> Dict[str, Any]:
        """A name that is there already gets ``_`` (assureUniqueFilename); a torn body leaves what came (multer 1.4)."""
        with self.lock:
            upload = self.uploads.get(uuid)
            if upload is None:
                return {"error": "Invalid uuid (not found)"}
            used = sum(len(d) for u in self.uploads.values() for d in u.files.values())
            limit = self.behaviour.disk_bytes
            if limit is not None and used + len(data) > limit:
                whole, data = False, data[: max(0, limit - used)]
            while name in upload.files:
                stem, dot, extension = name.rpartition(".")
                name = f"{stem}_.{extension}" if dot else f"{name}_"
            upload.files[name] = data
            if whole:
                self.received[name] += 1
            elif limit is not None:
                return {"error": "ENOSPC: no space left on device, write"}
            return {"success": True}

    def commit(self, uuid: str) -> Dict[str, Any]:
        with self.lock:
            upload = self.uploads.pop(uuid, None)
            if upload is None:
                return {"error": "Invalid uuid (not found)"}
            if not upload.files:
                return {"error": "Need at least 1 file."}
            if "seed.zip" in upload.files and not self.behaviour.splitmerge:
                return {"error": "Cannot use this node as a split-merge cluster."}
            options = self.filter_options(upload.body.get("options"))
            options += [
                {"name": n, "value": True}
                for n in ("pc-ept", "cog", "gltf")
                if not any(o["name"] == n for o in options)
            ]
            task = Task(
                uuid,
                str(upload.body.get("name")),
                options,
                dict(upload.files),
                {},
                estimate=len(upload.files),
                outputs=json.loads(upload.body.get("outputs") or "[]"),
            )
            self.tasks[uuid] = task
            if self.behaviour.crash_on_numbers and any(
                isinstance(o["value"], (int, float)) and not isinstance(o["value"], bool) for o in options
            ):
                self.kill()
            return {"uuid": uuid}

    def sort(self, task: Task) -> None:
        """What NodeODM does after it answered the commit: unpack the seed, count, move text files away."""
        if task.initialized:
            return
        task.initialized = True
        seed = task.images.pop("seed.zip", None)
        try:
            if seed is not None:
                with zipfile.ZipFile(io.BytesIO(seed)) as archive:
                    for name in archive.namelist():
                        home, _, rest = name.partition("/")
                        (task.images if home == "images" else task.others).update(
                            {rest if home == "images" else name: archive.read(name)}
                        )
        except zipfile.BadZipFile:
            task.status, task.message = 30, "Could not extract .zip file, unzip exited with code 9"
            return
        most = self.behaviour.max_images
        if most is not None and len(task.images) > most:
            task.status = 30
            task.message = f"{len(task.images)} images uploaded, but this node can only process up to {most}."
            return
        for name in list(task.images):
            if name.lower().endswith(".txt") or re.match(r"^align\.(las|laz|tif)$", name, re.IGNORECASE):
                task.gcp[name] = task.images.pop(name)
            elif name.lower().endswith(".zip"):
                del task.images[name]
        task.status = 10

    def advance(self, task: Task) -> None:
        """Each question brings a task a step on: forwarding or sorting, queued, running, ended."""
        if task.status in (30, 40, 50):
            return
        task.asked += 1
        if not task.initialized:
            if task.asked > 1:
                self.sort(task)
        elif task.asked > 2 + self.behaviour.polls:
            task.status, task.message, console = self.behaviour.ends(task)
            # The console is a list of pieces as they came through the pipe (chunks, not lines).
            task.console += ["\n".join(console)]
            task.progress = 100.0
        elif task.asked > 2:
            task.status, task.processing_time = 20, 1000
            task.progress = min(90.0, task.progress + 30.0)

    def info(self, task: Task) -> Dict[str, Any]:
        told: Dict[str, Any] = {
            "uuid": task.uuid,
            "name": task.name,
            "dateCreated": 1,
            "processingTime": task.processing_time,
            "status": {"code": task.status, **({"errorMessage": task.message} if task.message else {})},
            "options": task.options,
            "imagesCount": len(task.images) if task.initialized and task.status != 30 else task.estimate,
            "progress": task.progress,
        }
        if self.behaviour.cluster and not task.initialized:
            # While ClusterODM forwards the files it counts all of them and reports no progress.
            del told["progress"]
            told["processingTime"] = 5000
        return told


def _is_json(value: Any) -> bool:
    try:
        json.loads(value)
    except (TypeError, ValueError):
        return False
    return True
