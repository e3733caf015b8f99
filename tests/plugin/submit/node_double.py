"""A processing node that is no node: NodeODM's HTTP as it was seen to be, with faults on demand.

Each quirk says where it was seen: NodeODM 2.2.4 (8ad3e30), NodeODX 2.3.1 (e36d801), ClusterODM 1.5.8 (69181e2).
"""

from __future__ import annotations

import io
import json
import re
import socket
import threading
import zipfile
from collections import Counter
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Callable, Dict, List, Optional, Tuple
from urllib.parse import parse_qs, urlsplit

from sensorgate.plugin.odm.options import odm_3_6_options

UUID = re.compile(r"^[0-9a-f]{8}-[0-9a-f]{4}-[1-7][0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}$", re.IGNORECASE)
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

        class Handler(_Handler):
            node = double

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
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


class _Handler(BaseHTTPRequestHandler):
    node: NodeDouble
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: Any) -> None:
        pass

    def do_GET(self) -> None:
        self._handle("GET")

    def do_POST(self) -> None:
        self._handle("POST")

    def _hang_up(self) -> None:
        self.close_connection = True
        self.connection.shutdown(socket.SHUT_RDWR)

    def _answer(self, value: Any, status: int = 200, kind: str = "application/json; charset=utf-8") -> None:
        data = value if isinstance(value, bytes) else json.dumps(value).encode()
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(data)

    def _handle(self, method: str) -> None:
        node = self.node
        parts = urlsplit(self.path)
        with node.lock:
            number = len(node.requests)
            node.requests.append((method, parts.path))
            node.queries.append(parts.query)
        fault = node.fault(number, method, parts.path) if node.fault is not None else None
        if fault == REFUSED:
            self._hang_up()
            return
        length = int(self.headers.get("Content-Length") or 0)
        body = self.rfile.read(length // 2 if fault == TORN else length)
        if fault == TORN:
            upload = re.match(r"^/task/new/upload/(.+)$", parts.path)
            if upload:
                name, data = _torn_file(body)
                if name:
                    node.store(upload.group(1), name, data, whole=False)
            self._hang_up()
            return
        if fault == KILLED:
            node.kill()
            self._hang_up()
            return
        if fault == ERROR_BEFORE:
            self._answer(b"Internal Server Error", 500, "text/plain")
            return
        if fault == GARBAGE:
            self._answer(b"<html>login</html>", 200, "text/html")
            return
        status, value, kind = self._carry_out(method, parts.path, parse_qs(parts.query), body)
        if fault == MUTE:
            self._hang_up()
        elif fault == ERROR_AFTER:
            self._answer(b"Bad Gateway", 502, "text/plain")
        else:
            self._answer(value, status, kind)

    def _carry_out(self, method: str, path: str, query: Dict[str, List[str]], body: bytes) -> Tuple[int, Any, str]:
        node, way = self.node, self.node.behaviour
        if way.token and query.get("token", [""])[0] != way.token:
            if way.unauthorized == 401:
                return 401, b"", "text/plain"
            return 200, {"error": "Invalid authentication token: token does not match."}, "application/json"
        with node.lock:
            value = self._route(method, path, query, body)
        if isinstance(value, bytes):
            return 200, value, "application/zip"
        return 200, value, "application/json; charset=utf-8"

    def _route(self, method: str, path: str, query: Dict[str, List[str]], body: bytes) -> Any:
        node, way = self.node, self.node.behaviour
        if path == "/info":
            big = 99999999999
            return {
                "version": "1.5.3" if way.cluster else way.version,
                "taskQueueCount": 0 if way.cluster else len(node.tasks),
                "totalMemory": big if way.cluster else 8 << 30,
                "availableMemory": big if way.cluster else 4 << 30,
                "cpuCores": big if way.cluster else 2,
                "maxImages": way.max_images,
                "maxParallelTasks": big if way.cluster else way.slots,
                "engineVersion": "3.6.0",
                "engine": "odm",
            }
        if path == "/options":
            return node.option_list()
        if path == "/task/list":
            return [{"uuid": u} for u in node.tasks]
        fields, files = _multipart(body, self.headers.get("Content-Type", ""))
        if path == "/task/new/init":
            return node.init(self.headers.get("set-uuid", ""), fields)
        found = re.match(r"^/task/new/(upload|commit)/([^/]+)$", path)
        if found and found.group(1) == "upload":
            if not files:
                return {"error": "Need at least 1 file.", "noRetry": True}
            return [node.store(found.group(2), n, d) for n, d in files][-1]
        if found:
            return node.commit(found.group(2))
        if path in ("/task/cancel", "/task/remove"):
            form = parse_qs(body.decode()) if not fields else {k: [str(v)] for k, v in fields.items()}
            return self._end(path, form.get("uuid", [""])[0])
        found = re.match(r"^/task/([^/]+)/(info|output|download/(.+))$", path)
        if not found:
            return {"error": f"Cannot handle {path}"}
        task = node.tasks.get(found.group(1))
        if task is None:
            if way.cluster:
                return {"error": f"Invalid route for taskId {found.group(1)}:info, no task table entry."}
            return {"error": f"{found.group(1)} not found"}
        if found.group(2) == "info":
            node.advance(task)
            return node.info(task)
        if found.group(2) == "output":
            return task.console[int(query.get("line", ["0"])[0]) :]
        if found.group(3) != "all.zip":
            return {"error": "Invalid asset"}
        return way.archive(task) if task.status == 40 else {"error": "Asset not ready"}

    def _end(self, path: str, uuid: str) -> Any:
        task = self.node.tasks.get(uuid)
        if task is None:
            return {"success": False, "error": f"{uuid} not found"}
        if path == "/task/remove":
            del self.node.tasks[uuid]
        elif task.status != 50:
            task.status = 50
        return {"success": True}


def _multipart(body: bytes, kind: str) -> Tuple[Dict[str, Any], List[Tuple[str, bytes]]]:
    found = re.search(r"boundary=([^;]+)", kind)
    fields: Dict[str, Any] = {}
    files: List[Tuple[str, bytes]] = []
    if not found:
        return fields, files
    for piece in body.split(b"--" + found.group(1).strip('"').encode())[1:-1]:
        head, _, data = piece.partition(b"\r\n\r\n")
        data = data[:-2]
        name = re.search(rb'name="([^"]*)"', head)
        file = re.search(rb'filename="([^"]*)"', head)
        if file:
            files.append((file.group(1).decode(), data))
        elif name:
            fields[name.group(1).decode()] = data.decode()
    return fields, files


def _torn_file(body: bytes) -> Tuple[str, bytes]:
    file = re.search(rb'filename="([^"]*)"', body)
    return (file.group(1).decode(), body.partition(b"\r\n\r\n")[2]) if file else ("", b"")
