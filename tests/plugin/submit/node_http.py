"""The HTTP side of the node double: requests, faults on the way, and the routes of NodeODM."""

from __future__ import annotations

import json
import re
import socket
from http.server import BaseHTTPRequestHandler
from typing import Any, Dict, List, Tuple
from urllib.parse import parse_qs, urlsplit

from .node_parts import ERROR_AFTER, ERROR_BEFORE, GARBAGE, KILLED, MUTE, REFUSED, TORN


class Handler(BaseHTTPRequestHandler):
    node: Any  # a NodeDouble
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
