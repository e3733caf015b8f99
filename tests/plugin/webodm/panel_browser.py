"""A headless Chromium, driven over its DevTools protocol through a pair of pipes."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
_CONTRAST = Path(__file__).with_name("panel_contrast.js").read_text(encoding="utf-8")
# Chromium reads its orders from descriptor 3 and answers on 4.
_START = (
    "import os, sys\n"
    "read, write = int(sys.argv[1]), int(sys.argv[2])\n"
    "read, write = os.dup(read), os.dup(write)\n"
    "os.dup2(read, 3); os.dup2(write, 4)\n"
    "os.set_inheritable(3, True); os.set_inheritable(4, True)\n"
    "os.execv(sys.argv[3], sys.argv[3:])\n"
)


class Browser:
    """One browser with one page; ``errors`` collects what its console and scripts complained of."""

    def __init__(self, profile: Path, width: int = 1280, height: int = 1000) -> None:
        assert CHROMIUM is not None
        orders, self._orders = os.pipe()
        self._answers, answers = os.pipe()
        # Descriptors 3 and 4 are the browser's: ours must be others.
        moved = [os.dup(fd) for fd in (orders, answers)]
        arguments = [
            CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run",
            "--disable-dev-shm-usage", "--remote-debugging-pipe", f"--user-data-dir={profile}",
            f"--window-size={width},{height}", "about:blank",
        ]  # fmt: skip
        self._process = subprocess.Popen(
            [sys.executable, "-c", _START, *map(str, moved), *arguments],
            pass_fds=moved, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        for fd in (orders, answers, *moved):
            os.close(fd)
        self.errors: List[str] = []
        self._buffer = b""
        self._count = 0
        self._dialogs: List[bool] = []
        target = next(t for t in self._send("Target.getTargets")["targetInfos"] if t["type"] == "page")
        attached = self._send("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._page: Optional[str] = attached["sessionId"]
        for domain in ("Page", "Runtime", "DOM", "Log"):
            self.call(f"{domain}.enable")
        self.resize(width, height)

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._orders)
        os.close(self._answers)

    def call(self, method: str, **parameters: Any) -> Dict[str, Any]:
        """Call a method of the page's protocol."""
        return self._send(method, self._page, **parameters)

    def open(self, url: str) -> None:
        """Go to a page and wait until it is loaded."""
        self.call("Page.navigate", url=url)
        self.wait("document.readyState === 'complete' && location.href !== 'about:blank'")

    def run(self, script: str) -> Any:
        """The value of an expression; a promise is awaited."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise AssertionError(answer["exceptionDetails"].get("exception", {}).get("description", script))
        return answer["result"].get("value")

    def wait(self, condition: str, seconds: float = 20.0) -> None:
        """Wait until an expression is true."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            if self.run(f"Boolean({condition})"):
                return
            time.sleep(0.05)
        raise AssertionError(f"still not true after {seconds} s: {condition}\n{self.errors}\n{self.text()[-3000:]}")

    def busiest(self, condition: str, seconds: float) -> float:
        """Wait until an expression is true; the most seconds of computing that the page did between two looks at it.

        Of the processor's time, not of the clock's: other work on the machine does not count.
        """
        self.call("Performance.enable", timeDomain="threadTicks")
        until, most, before = time.monotonic() + seconds, 0.0, self._computed()
        while not self.run(f"Boolean({condition})"):
            if time.monotonic() > until:
                raise AssertionError(f"still not true after {seconds} s: {condition}\n{self.errors}")
            time.sleep(0.02)
            now = self._computed()
            most, before = max(most, now - before), now
        self.call("Performance.disable")
        return most

    def _computed(self) -> float:
        metrics = self.call("Performance.getMetrics")["metrics"]
        return float(next(m["value"] for m in metrics if m["name"] == "TaskDuration"))

    def text(self) -> str:
        """What a reader of the page sees."""
        return str(self.run("document.body ? document.body.innerText : ''"))

    def choose(self, selector: str, files: Sequence[Path]) -> None:
        """Choose files in a file field."""
        root = self.call("DOM.getDocument")["root"]["nodeId"]
        node = self.call("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self.call("DOM.setFileInputFiles", nodeId=node, files=[str(f) for f in files])

    def click(self, key: str) -> None:
        """Click what carries this ``data-key`` as soon as it can be clicked."""
        where = f"document.querySelector({json.dumps(f'[data-key={json.dumps(key)}]:not([disabled])')})"
        self.wait(where)
        self.run(f"{where}.click()")

    def unreadable(self, selector: str) -> List[Any]:
        """[text, contrast] of every text below that has less contrast than WCAG 2.1 AA asks for."""
        return list(self.run(f"{_CONTRAST}({json.dumps(selector)}, 4.5)"))

    def press(self, key: str) -> None:
        """Press and release a key."""
        codes = {"Tab": 9, "Enter": 13, " ": 32}
        text = {"Enter": "\r", " ": " "}.get(key)
        down: Dict[str, Any] = {"type": "keyDown", "key": key, "windowsVirtualKeyCode": codes[key]}
        self.call("Input.dispatchKeyEvent", **({**down, "text": text} if text else down))
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, windowsVirtualKeyCode=codes[key])

    def answer_dialogs(self, *answers: bool) -> None:
        """Answer the next confirmations so."""
        self._dialogs.extend(answers)

    def resize(self, width: int, height: int) -> None:
        """Give the page this size."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def screenshot(self, file: Path) -> None:
        """Keep a picture of the whole page."""
        file.parent.mkdir(parents=True, exist_ok=True)
        made = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        file.write_bytes(base64.b64decode(made["data"]))

    def _send(self, method: str, session: Optional[str] = None, **parameters: Any) -> Dict[str, Any]:
        number = self._post(method, session, parameters)
        until = time.monotonic() + 60
        while True:
            message = self._receive(until)
            if message.get("id") == number:
                if "error" in message:
                    raise AssertionError(f"{method}: {message['error']}")
                return dict(message["result"])
            self._event(message)

    def _post(self, method: str, session: Optional[str], parameters: Dict[str, Any]) -> int:
        self._count += 1
        order: Dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if session:
            order["sessionId"] = session
        data = json.dumps(order).encode("utf-8") + b"\0"
        while data:
            data = data[os.write(self._orders, data) :]
        return self._count

    def _receive(self, until: float) -> Dict[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._answers], [], [], max(0.0, until - time.monotonic()))
            data = os.read(self._answers, 1 << 20) if ready else b""
            if not data:
                raise AssertionError("the browser does not answer")
            self._buffer += data
        line, self._buffer = self._buffer.split(b"\0", 1)
        return dict(json.loads(line))

    def _event(self, message: Dict[str, Any]) -> None:
        method, told = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.errors.append(f"{told['entry']['text']} {told['entry'].get('url', '')}")
        elif method == "Page.javascriptDialogOpening":
            accept = self._dialogs.pop(0) if self._dialogs else told["type"] == "beforeunload"
            self._post("Page.handleJavaScriptDialog", self._page, {"accept": accept})
