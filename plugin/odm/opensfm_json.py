"""JSON that ODM and OpenSfM left behind, with bounds: small files whole, ``reconstruction.json`` piece by piece."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

from ...stages.thresholds import Thresholds

_CHUNK = 1 << 20
_MAX_DEPTH = 4
SECTIONS = ("cameras", "shots", "points")


class Unreadable(Exception):
    """A file of the project cannot be read; the message says which and why."""


def read_json(path: Path, limits: Thresholds) -> Any:
    """Read a JSON file of at most ``outcome_json_bytes``. ``Unreadable``, or ``FileNotFoundError`` where absent."""
    try:
        with open(path, "rb") as stream:
            data = stream.read(limits.outcome_json_bytes + 1)
        if len(data) > limits.outcome_json_bytes:
            raise Unreadable(f"{path.name} is larger than {limits.outcome_json_bytes} bytes")
        return json.loads(data.decode("utf-8", "replace"))
    except FileNotFoundError:
        raise
    except (OSError, ValueError, RecursionError) as error:
        raise Unreadable(f"{path.name} cannot be read ({_short(error)})") from None


def read_object(path: Path, limits: Thresholds) -> Dict[str, Any]:
    """Read one JSON object as ``read_json`` does; ``Unreadable`` where it is something else."""
    value = read_json(path, limits)
    if not isinstance(value, dict):
        raise Unreadable(f"{path.name} holds no JSON object")
    return value


def _short(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error)[:120]}"


def read_reconstructions(path: Path, limits: Thresholds) -> Iterator[Tuple[int, str, str, Any]]:
    """Yield (reconstruction, section, key, value) of every camera, shot and point in ``reconstruction.json``.

    One entry is in memory at a time; other sections are passed over. Raises
    ``Unreadable`` where the file ends early or is no such list: what was
    yielded until then stands.
    """
    try:
        with open(path, encoding="utf-8", errors="replace") as stream:
            text = _Pieces(stream, path.name, limits.outcome_value_chars)
            for index in text.items():
                if index >= limits.outcome_max_models:
                    raise Unreadable(f"{path.name} holds more than {limits.outcome_max_models} reconstructions")
                for section in text.members():
                    if section in SECTIONS:
                        for key in text.members():
                            yield index, section, key, text.value()
                    else:
                        text.skip()
    except OSError as error:
        raise Unreadable(f"{path.name} cannot be read ({_short(error)})") from None


class _Pieces:
    """A JSON text read in pieces: enter lists and objects, decode what is small."""

    def __init__(self, stream: Any, name: str, most: int) -> None:
        self._stream = stream
        self._name = name
        self._most = most
        self._text = ""
        self._at = 0
        self._ended = False
        self._decode = json.JSONDecoder().raw_decode

    def _more(self) -> None:
        chunk = self._stream.read(_CHUNK)
        self._ended = not chunk
        self._text = self._text[self._at :] + chunk
        self._at = 0

    def _peek(self) -> str:
        while True:
            while self._at < len(self._text):
                char = self._text[self._at]
                if char not in " \t\r\n":
                    return char
                self._at += 1
            if self._ended:
                raise Unreadable(f"{self._name} ends early")
            self._more()

    def _take(self, expected: str) -> None:
        if self._peek() not in expected:
            raise Unreadable(f"{self._name} is damaged: {expected!r} expected")
        self._at += 1

    def value(self) -> Any:
        """Decode the value that starts here."""
        self._peek()
        while True:
            try:
                found, end = self._decode(self._text, self._at)
                # A number at the very end of what was read may go on.
                if end < len(self._text) or self._ended:
                    self._at = end
                    return found
            except RecursionError:
                raise Unreadable(f"{self._name} is nested too deeply") from None
            except ValueError:
                if self._ended:
                    raise Unreadable(f"{self._name} ends early or is damaged") from None
            if self._ended or len(self._text) - self._at > self._most:
                raise Unreadable(f"{self._name} holds a value longer than {self._most} characters, or is damaged")
            self._more()

    def items(self) -> Iterator[int]:
        """Enter a list; yield each index, the caller consumes the item."""
        self._take("[")
        if self._peek() == "]":
            self._at += 1
            return
        number = 0
        while True:
            yield number
            number += 1
            last = self._peek()
            self._take(",]")
            if last == "]":
                return

    def members(self) -> Iterator[str]:
        """Enter an object; yield each key, the caller consumes the value."""
        self._take("{")
        if self._peek() == "}":
            self._at += 1
            return
        while True:
            key = self.value()
            if not isinstance(key, str):
                raise Unreadable(f"{self._name} is damaged: a key is no text")
            self._take(":")
            yield key
            last = self._peek()
            self._take(",}")
            if last == "}":
                return

    def skip(self, depth: int = 0) -> None:
        """Pass over a value of any size."""
        first = self._peek()
        if depth >= _MAX_DEPTH or first not in "{[":
            self.value()
        elif first == "{":
            for _ in self.members():
                self.skip(depth + 1)
        else:
            for _ in self.items():
                self.skip(depth + 1)


def numbers(value: Any, count: int) -> List[float]:
    """Return ``value`` as ``count`` finite floats. Raises ``ValueError`` where it is anything else."""
    if not isinstance(value, list) or len(value) != count:
        raise ValueError(f"{count} numbers expected")
    found = [float(v) for v in value if isinstance(v, (int, float)) and not isinstance(v, bool)]
    if len(found) != count or not all(abs(v) < 1e15 for v in found):
        raise ValueError(f"{count} finite numbers expected")
    return found
