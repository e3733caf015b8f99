"""The one module that knows pyodm, or pyodx where only that is installed.

pyodm's own calls are wrapped where they were seen to go wrong: a token that
wanders to other nodes through a shared default, ``https`` on any port but 443
turned into ``http``, a path in the address dropped, errors that come as HTTP
200, tokens in error texts, and answers of any size. Every call here makes one
request, answers or raises, and never tries again by itself: whether a request
may be repeated is for the caller to know.
"""

from __future__ import annotations

import functools
import importlib
import json
import re
from pathlib import Path
from typing import Any, Callable, List, Mapping, Optional, Sequence, Tuple, Type
from urllib.parse import quote, urlencode, urlsplit, urlunsplit

from ...stages.errors import MissingDependency
from ...stages.thresholds import DEFAULTS, Thresholds
from .address import TOKEN_VARIABLE, bare, split_address
from .errors import NodeFull, NodeUnusable, NotSent, Refused, Unsure
from .views import NodeView, TaskView, count, task_view

# ClusterODM answers /info with this instead of figures.
_NO_FIGURE = 99999999999
_BAD_TOKEN = re.compile(r"invalid authentication|unauthorized|authentication token", re.IGNORECASE)
_UNKNOWN_TASK = re.compile(r"not found|no task table entry|invalid route", re.IGNORECASE)
_FULL = re.compile(r"ENOSPC|EDQUOT|no space left|disk quota", re.IGNORECASE)


@functools.lru_cache(maxsize=1)
def _library() -> Any:
    """The package that is installed: pyodm, else pyodx."""
    for name in ("pyodm", "pyodx"):
        try:
            package = importlib.import_module(f"{name}.api")
            importlib.import_module(f"{name}.utils")
        except ImportError:
            continue
        return package
    raise MissingDependency("pyodm", "submitting to a node", "pip install 'sensorgate[submit]'")


def binding_name() -> str:
    """``pyodm`` or ``pyodx``."""
    return str(_library().__name__).partition(".")[0]


@functools.lru_cache(maxsize=1)
def _node_class() -> Type[Any]:
    """pyodm's ``Node`` with the address and the requests made safe."""
    base: Type[Any] = _library().Node

    class _Node(base):  # type: ignore[misc]
        def __init__(self, client: NodeClient) -> None:
            parts = urlsplit(client.address)
            super().__init__(parts.hostname, parts.port or 80, client.token, client.limits.submit_call_timeout_s)
            self._client = client

        def url(self, url: str, query: Optional[Mapping[str, Any]] = None) -> str:
            return self._client.link(url, query)

        def get(self, url: str, query: Optional[Mapping[str, Any]] = None, **_: Any) -> Any:
            return self._client.ask("GET", url, query=query)

        def post(self, url: str, data: Any = None, headers: Optional[Mapping[str, str]] = None) -> Any:
            return self._client.ask("POST", url, data=data, headers=headers)

    return _Node


class NodeClient:
    """One node, one token. Safe to use from several threads."""

    def __init__(self, url: str, *, token: Optional[str] = None, limits: Thresholds = DEFAULTS) -> None:
        self.address, self.token = split_address(url, token)
        self.limits = limits
        self._node = _node_class()(self)

    @property
    def shown(self) -> str:
        """The address as it may be shown: no token, no password."""
        parts = urlsplit(self.address)
        host = parts.hostname or ""
        host = f"[{host}]" if ":" in host else host
        return urlunsplit((parts.scheme, f"{host}:{parts.port}" if parts.port else host, parts.path, "", ""))

    def link(self, path: str, query: Optional[Mapping[str, Any]] = None) -> str:
        """The address of a call; the token is added to a dictionary of its own."""
        full = dict(query or {})
        if self.token:
            full["token"] = self.token
        parts = urlsplit(self.address)
        return urlunsplit((parts.scheme, parts.netloc, parts.path + path, urlencode(full), ""))

    def hide(self, text: Any) -> str:
        """``text`` without the token and without the address it was put into, short enough for a line."""
        said = str(text)
        for secret in (self.token, quote(self.token), quote(self.token, safe=""), urlsplit(self.address).password):
            if secret:
                said = said.replace(secret, "***")
        said = "".join(c if c.isprintable() else " " for c in said)
        return " ".join(said.split())[:400]

    def ask(
        self,
        method: str,
        path: str,
        *,
        query: Optional[Mapping[str, Any]] = None,
        data: Any = None,
        headers: Optional[Mapping[str, str]] = None,
        timeout_s: Optional[float] = None,
    ) -> Any:
        """One request and its JSON answer; all errors are those of ``errors.py``."""
        import requests

        limit = (self.limits.submit_connect_timeout_s, timeout_s or self.limits.submit_call_timeout_s)
        try:
            with requests.request(
                method,
                self.link(path, query),
                data=data,
                headers=dict(headers or {}),
                timeout=limit,
                stream=True,
                allow_redirects=False,
            ) as response:
                body = self._body(response)
        except requests.RequestException as error:
            raise self._no_answer(error, path) from None
        return self._value(response.status_code, response.headers.get("Location", ""), body, path)

    def _body(self, response: Any) -> bytes:
        parts: List[bytes] = []
        size = 0
        for part in response.iter_content(65536):
            size += len(part)
            if size > self.limits.submit_answer_bytes:
                raise NodeUnusable(f"{self.shown} answers with more than {self.limits.submit_answer_bytes} bytes.")
            parts.append(part)
        return b"".join(parts)

    def _no_answer(self, error: Exception, path: str) -> Exception:
        """Whether the request can have arrived is what decides if it may be repeated."""
        import requests

        reason = getattr(error.args[0] if error.args else None, "reason", None)
        never = isinstance(error, (requests.exceptions.ConnectTimeout, requests.exceptions.InvalidURL)) or (
            type(reason).__name__ in ("NewConnectionError", "NameResolutionError", "ConnectTimeoutError")
        )
        if isinstance(error, requests.exceptions.SSLError):
            return NodeUnusable(f"{self.shown} has no valid certificate: {self.hide(error)}")
        if never:
            return NotSent(f"{self.shown} cannot be reached. Is the node running, and the address right?")
        return Unsure(f"{self.shown} broke the connection at {path.split('?')[0]}: {type(error).__name__}.")

    def _value(self, status: int, location: str, body: bytes, path: str) -> Any:
        if status in (401, 403):
            raise NodeUnusable(self._token_text())
        if 300 <= status < 400:
            raise NodeUnusable(f"{self.shown} sends us on to {self.hide(bare(location))}. Give that address instead.")
        if status == 413:
            raise Refused(f"A proxy before {self.shown} refuses files of this size (413).", "413")
        if status == 404:
            raise NodeUnusable(
                f"{self.shown} knows no {path}: it is no NodeODM, or another path belongs to its address."
            )
        if status != 200:
            raise Unsure(f"{self.shown} answers with status {status} at {path}.")
        try:
            value = json.loads(body.decode("utf-8"))
        except (ValueError, RecursionError):
            if path.startswith("/task/") and not body:
                raise Unsure(f"{self.shown} answers with nothing at {path}.") from None
            raise NodeUnusable(f"{self.shown} does not answer in JSON at {path}. Is it a NodeODM?") from None
        if isinstance(value, dict) and value.get("error"):
            self._refusal(str(value["error"]))
        return value

    def _refusal(self, text: str) -> None:
        """Errors come with HTTP 200: sort them by their text."""
        if _BAD_TOKEN.search(text):
            raise NodeUnusable(self._token_text())
        if _FULL.search(text):
            raise NodeFull(
                f"The disk of {self.shown} is full ({self.hide(text)}). Free some space there and try again."
            )
        raise Refused(f"{self.shown} refuses: {self.hide(text)}", text[:2000])

    def _token_text(self) -> str:
        given = "refuses the token" if self.token else "wants a token"
        return f"{self.shown} {given}. Give it with --node URL?token=... or in {TOKEN_VARIABLE}."

    def info(self) -> NodeView:
        """What the node is."""
        told = self._node.get("/info")
        if not isinstance(told, dict) or "version" not in told:
            raise NodeUnusable(f"{self.shown} answers, but is no NodeODM.")
        return NodeView(
            version=str(told.get("version", "")),
            engine=str(told.get("engine", "odm")),
            engine_version=str(told.get("engineVersion", "?")),
            max_images=count(told.get("maxImages")) or None,
            slots=count(told.get("maxParallelTasks")),
            queued=count(told.get("taskQueueCount")),
            available_memory_bytes=count(told.get("availableMemory")),
            cluster=told.get("cpuCores") == _NO_FIGURE or told.get("totalMemory") == _NO_FIGURE,
        )

    def options(self) -> Tuple[Mapping[str, Any], ...]:
        """The node's own option list."""
        told = self._node.get("/options")
        found = tuple(o for o in told if isinstance(o, dict) and "name" in o) if isinstance(told, list) else ()
        if not found:
            raise NodeUnusable(f"{self.shown} has no option list, so it could not take any option. Restart the node.")
        return found

    def tasks(self) -> Tuple[str, ...]:
        """The uuids of the tasks that the node knows."""
        told = self._node.get("/task/list")
        return tuple(str(t["uuid"]) for t in told if isinstance(t, dict) and "uuid" in t)

    def init(self, uuid: str, name: str, options: Sequence[Mapping[str, Any]], outputs: Sequence[str] = ()) -> None:
        """Begin an upload under our own uuid."""
        fields = {"name": name, "options": json.dumps(list(options))}
        if outputs:
            fields["outputs"] = json.dumps(list(outputs))
        encoder = importlib.import_module(f"{binding_name()}.utils").MultipartEncoder(fields=fields)
        told = self._node.post(
            "/task/new/init", data=encoder, headers={"Content-Type": encoder.content_type, "set-uuid": uuid}
        )
        if not isinstance(told, dict) or told.get("uuid") != uuid:
            raise NodeUnusable(
                f"{self.shown} gave the task another uuid than was asked for. NodeODM 2.2 or later is needed."
            )

    def upload(self, uuid: str, name: str, file: Path) -> None:
        """Send one file. After ``Unsure`` and ``Refused`` a part of it may lie on the node under this name."""
        from requests_toolbelt.multipart.encoder import MultipartEncoder

        with file.open("rb") as stream:
            encoder = MultipartEncoder(fields={"images": (name, stream, "application/octet-stream")})
            told = self.ask(
                "POST",
                f"/task/new/upload/{uuid}",
                data=encoder,
                headers={"Content-Type": encoder.content_type},
                timeout_s=self.limits.submit_upload_timeout_s,
            )
        if not isinstance(told, dict) or told.get("success") is not True:
            raise Unsure(f"{self.shown} does not say that it has {name}.")

    def commit(self, uuid: str) -> None:
        """End the upload: the node makes a task of it."""
        told = self._node.post(f"/task/new/commit/{uuid}")
        if not isinstance(told, dict) or told.get("uuid") != uuid:
            raise Unsure(f"{self.shown} does not say that it took the task {uuid}.")

    def task(self, uuid: str) -> Optional[TaskView]:
        """The task, or ``None`` when the node says that it does not know it."""
        try:
            told = self._node.get(f"/task/{uuid}/info")
        except Refused as error:
            if _UNKNOWN_TASK.search(error.text):
                return None
            raise
        if not isinstance(told, dict):
            raise Unsure(f"{self.shown} says nothing of the task {uuid}.")
        return task_view(uuid, told, self.hide)

    def console(self, uuid: str, last: int = 400) -> Tuple[str, ...]:
        """The last pieces of a task's console output; a piece is what came through the pipe, not always a line."""
        told = self._node.get(f"/task/{uuid}/output", {"line": -last})
        pieces = told if isinstance(told, list) else [told]
        return tuple(line for piece in pieces if isinstance(piece, str) for line in piece.splitlines())

    def cancel(self, uuid: str) -> None:
        """Stop a task; it stays known to the node."""
        self._library_task(uuid).cancel()

    def remove(self, uuid: str) -> None:
        """Stop a task and delete its files."""
        self._library_task(uuid).remove()

    def _library_task(self, uuid: str) -> Any:
        return self._node.get_task(uuid)

    def download(
        self, uuid: str, target: Path, *, max_bytes: int, progress: Optional[Callable[[int, int], None]] = None
    ) -> None:
        """Fetch ``all.zip`` into ``target``; one cut short raises ``Unsure``, for nodes cannot go on in the middle."""
        import requests

        path = f"/task/{uuid}/download/all.zip"
        limit = (self.limits.submit_connect_timeout_s, self.limits.submit_upload_timeout_s)
        try:
            # A cluster may hand its products out from a store elsewhere; the token goes to the node's address alone.
            with requests.get(self.link(path), timeout=limit, stream=True) as response:
                if response.status_code != 200 or "json" in response.headers.get("Content-Type", ""):
                    self._value(response.status_code, response.headers.get("Location", ""), self._body(response), path)
                    raise Refused(f"{self.shown} has no all.zip for {uuid}.", "no all.zip")
                total = count(response.headers.get("Content-Length")) or 0
                if total > max_bytes:
                    raise Refused(
                        f"all.zip of {uuid} has {total} bytes, and only {max_bytes} may be taken here. "
                        "Free some disk, or ask for less with --assets.",
                        "too large",
                    )
                self._save(response, target, max_bytes, total, progress)
        except requests.RequestException as error:
            raise self._no_answer(error, path) from None

    def _save(
        self,
        response: Any,
        target: Path,
        max_bytes: int,
        total: int,
        progress: Optional[Callable[[int, int], None]],
    ) -> None:
        done = 0
        with target.open("wb") as stream:
            for part in response.iter_content(1 << 20):
                done += len(part)
                if done > max_bytes:
                    raise Refused(f"all.zip grew beyond {max_bytes} bytes.", "too large")
                stream.write(part)
                if progress is not None:
                    progress(done, total)
        if total and done != total:
            raise Unsure(f"{self.shown} sent {done} of {total} bytes of all.zip.")
