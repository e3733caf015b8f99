"""What the panel talks to: its own API with the real gate behind it, and WebODM's task API on a folder."""

from __future__ import annotations

import json
import re
import threading
import uuid
from email.parser import BytesParser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Tuple

from sensorgate.plugin.inspection import Settings
from sensorgate.plugin.webodm import bounds, gathering, headers, sessions
from sensorgate.plugin.webodm.proposal import Choices, propose
from sensorgate.plugin.webodm.verdict import words_for
from sensorgate.stages.errors import UsageError
from sensorgate.stages.frame import Frame
from sensorgate.stages.grouping import camera_name

NAME = "sensorgate-1"
USER = 1
PROJECT = 7
TOKEN = "t0k3n"
PUBLIC = Path(headers.__file__).with_name("public")
PAGE = Path(__file__).with_name("panel_page.html")
_TYPES = {".js": "text/javascript", ".css": "text/css"}

Answer = Tuple[int, Any]


class Refused(Exception):
    """An answer other than success."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status


class Dashboard:
    """A WebODM with one project and one user, on a free port. ``disturb`` may raise ``Refused`` for any request."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.hold = "off"
        self.tasks: Dict[str, Dict[str, Any]] = {}
        self.states: Dict[str, List[Dict[str, Any]]] = {}
        self.waiting: List[List[Dict[str, Any]]] = []  # what waits in the project, for each time that it is asked
        self.claim_message = ""
        self.requests: List[Tuple[str, str, int]] = []
        self.bodies: List[Tuple[str, Any]] = []
        self.verdicts: List[Any] = []
        self.disturb: Callable[[str, str], None] = lambda method, path: None
        self.lock = threading.Lock()
        (folder / "sessions").mkdir(parents=True)
        dashboard = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *_: object) -> None:
                pass

            def do_GET(self) -> None:
                dashboard.serve(self, "GET", b"")

            def do_POST(self) -> None:
                dashboard.serve(self, "POST", self.rfile.read(int(self.headers.get("Content-Length", 0))))

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        # A browser that breaks a request off is no error.
        self._server.handle_error = lambda *_: None  # type: ignore[method-assign]
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()

    def sent_bytes(self, part: str) -> int:
        """Bytes of the bodies sent to paths that hold ``part``."""
        return sum(size for _, path, size in self.requests if part in path)

    def serve(self, handler: BaseHTTPRequestHandler, method: str, body: bytes) -> None:
        """Answer one request."""
        path = handler.path.split("?")[0]
        with self.lock:
            self.requests.append((method, path, len(body)))
        kind, data, status = "application/json", b"", 200
        try:
            self.disturb(method, path)
            if method == "GET" and path == "/":
                kind, data = "text/html; charset=utf-8", PAGE.read_bytes().replace(b"PLUGIN", NAME.encode())
            elif method == "GET" and path.startswith(f"/plugins/{NAME}/"):
                file = PUBLIC / Path(path).name
                if not file.is_file():
                    raise Refused(404, "Not found.")
                kind, data = _TYPES[file.suffix] + "; charset=utf-8", file.read_bytes()
            else:
                if method == "POST" and handler.headers.get("X-CSRFToken") != TOKEN:
                    raise Refused(403, "CSRF Failed")
                status, value = self.answer(method, path, handler.headers.get("Content-Type", ""), body)
                data = json.dumps(value).encode()
        except Refused as refused:
            status, data = refused.status, json.dumps({"detail": str(refused)}).encode()
        except UsageError as error:
            status, data = 400, json.dumps({"detail": str(error)}).encode()
        except Exception as error:  # seen in the page, and so in the test that fails
            status, data = 400, json.dumps({"detail": f"{type(error).__name__}: {error}"}).encode()
        handler.send_response(status)
        handler.send_header("Content-Type", kind)
        handler.send_header("Content-Length", str(len(data)))
        if path == "/":
            handler.send_header("Set-Cookie", f"csrftoken={TOKEN}; Path=/")
        handler.end_headers()
        handler.wfile.write(data)

    def answer(self, method: str, path: str, kind: str, body: bytes) -> Answer:
        """The JSON answer of an API."""
        own = f"/api/plugins/{NAME}/"
        if path.startswith(own):
            value = json.loads(body) if body else {}
            with self.lock:
                self.bodies.append((path[len(own) :], value))
            return self._own(method, path[len(own) :], value)
        match = re.match(rf"^/api/projects/{PROJECT}/tasks/(?:([0-9a-f-]+)/(\w+)/)?$", path)
        if not match:
            raise Refused(404, "Not found.")
        if match.group(1) is None:
            return self._create(json.loads(body))
        task = self.tasks.get(match.group(1))
        if task is None:
            raise Refused(404, "Not found.")
        if match.group(2) == "upload":
            return self._upload(task, kind, body)
        if match.group(2) == "commit":
            task["partial"] = False
            return 200, {"id": task["id"]}
        task["removed"] = True
        return 200, {"success": True}

    def _own(self, method: str, path: str, value: Any) -> Answer:
        if path == "sessions":
            made = sessions.create(self.folder / "sessions", USER, value["project"])
            return 201, {"session": made.id, "limits": bounds.shown(), "hold": self.hold, "may_override": False}
        state = re.match(rf"^projects/{PROJECT}/tasks/([^/]+)/(\w+)$", path)
        if state:
            return self._state(method, state.group(1), state.group(2))
        if path == "waiting":
            now = self.waiting.pop(0) if len(self.waiting) > 1 else (self.waiting or [[]])[0]
            return 200, {"projects": {str(PROJECT): now} if now else {}}
        _, name, what = path.split("/")
        session = sessions.find(self.folder / "sessions", name, USER)
        if session is None:
            raise Refused(404, "Not found.")
        if what == "headers":
            read = headers.read_headers(headers.sent_files(value["files"]))
            held = session.add(read)
            return 200, {
                "read": len(read.frames), "files": held, "need": [vars(n) for n in read.need], "ignored": read.ignored,
                "broken": [
                    {"id": i, "path": f.path, "message": f.message}
                    for i, f in read.frames.items() if not isinstance(f, Frame)
                ],
                "cameras": _cameras([f for f in read.frames.values() if isinstance(f, Frame)]),
            }  # fmt: skip
        if what == "control":
            session.keep_control(value["kind"], value["text"])
            return 200, {"ok": True}
        if what == "claim":
            return 200, {"ok": True, "honoured": not self.claim_message, "message": self.claim_message}
        return 200, self._verdict(session, value)

    def _verdict(self, session: sessions.Session, value: Any) -> Any:
        gathered = session.gather()
        if not gathered.scan.frames:
            raise Refused(409, "None of these files can be read as an image.")
        choices = Choices(frozenset(value.get("off", ())), value.get("moves", {}))
        inspection = gathering.of_session(gathered, Settings(), session.control("gcp"), session.control("geo"))
        words = words_for(inspection, propose(inspection, choices), choices, gathered.ids, "/report")
        with self.lock:
            self.verdicts.append(words)
        return words

    def _create(self, value: Any) -> Answer:
        for option in value["options"]:
            if not option["value"]:
                raise Refused(400, "Invalid options")
        task = {**value, "id": str(uuid.uuid4()), "files": {}, "uploads": 0, "chunks": {}}
        self.tasks[task["id"]] = task
        return 201, {"id": task["id"]}

    def _upload(self, task: Dict[str, Any], kind: str, body: bytes) -> Answer:
        fields, name, data = _form(kind, body)
        uploaded = {}
        with self.lock:
            task["uploads"] += 1
            if "dzuuid" in fields:
                held = task["chunks"].setdefault(fields["dzuuid"], bytearray())
                assert len(held) == int(fields["dzchunkbyteoffset"])
                held.extend(data)
                if int(fields["dzchunkindex"]) + 1 < int(fields["dztotalchunkcount"]):
                    return 200, {"success": True, "uploaded": {}}
                data = bytes(task["chunks"].pop(fields["dzuuid"]))
            task["files"][name] = data
            uploaded[name] = len(data)
        return 200, {"success": True, "uploaded": uploaded}

    def _state(self, method: str, task: str, action: str) -> Answer:
        states = self.states.get(task)
        if not states:
            raise Refused(404, "Not found.")
        # A post moves on to the next state, and so does each look while work is under way.
        if len(states) > 1 and (method == "POST" or states[0]["state"] in ("checking", "working")):
            states.pop(0)
        return 200, states[0]


def _cameras(frames: List[Frame]) -> List[Dict[str, Any]]:
    found: Dict[Tuple[str, int, int], int] = {}
    for frame in frames:
        key = (camera_name(frame.make, frame.model), frame.width, frame.height)
        found[key] = found.get(key, 0) + 1
    return [
        {"name": n, "width": w, "height": h, "new": True, "frames": many} for (n, w, h), many in sorted(found.items())
    ]


def _form(kind: str, body: bytes) -> Tuple[Dict[str, str], str, bytes]:
    """Fields, and name and content of the one file, of a multipart body."""
    fields: Dict[str, str] = {}
    name: Optional[str] = None
    data = b""
    boundary = b"--" + kind.split("boundary=")[1].encode()
    for part in body.split(boundary)[1:-1]:
        head, content = part[2:-2].split(b"\r\n\r\n", 1)
        told = BytesParser().parsebytes(head + b"\r\n\r\n")
        label = told.get_param("name", header="content-disposition")
        file = told.get_param("filename", header="content-disposition")
        if file is not None:
            assert label == "images"
            name, data = str(file), content
        else:
            fields[str(label)] = content.decode()
    assert name is not None
    return fields, name, data
