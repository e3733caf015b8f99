"""What was finished, by content: one line per frame with the digests of its inputs and of its output."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Dict, Optional, TextIO, Tuple, Type, Union

from .files import output_error


class Journal:
    """A file that lets a later run keep what this one finished; without a file it remembers nothing.

    Use as a context manager where lines are noted. Raises ``OutputError``
    where it cannot be written.
    """

    def __init__(self, file: Union[str, Path, None]) -> None:
        self._file = None if file is None else Path(file)
        self._log: Optional[TextIO] = None
        self._known = self._read()

    def _read(self) -> Dict[str, Tuple[str, str]]:
        """Path -> (key, output digest) of earlier runs; a line that was cut by a kill is passed over."""
        found: Dict[str, Tuple[str, str]] = {}
        if self._file is None:
            return found
        try:
            text = self._file.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return found
        for line in text.splitlines():
            try:
                path, key, digest = json.loads(line)
            except (ValueError, TypeError):
                continue
            if all(isinstance(v, str) for v in (path, key, digest)):
                found[path] = (key, digest)
        return found

    def known(self, path: str) -> Tuple[str, ...]:
        """Key and output digest of a frame that an earlier run finished, empty for none."""
        return self._known.get(path, ())

    def __enter__(self) -> "Journal":
        if self._file is not None:
            try:
                self._file.parent.mkdir(parents=True, exist_ok=True)
                self._log = open(self._file, "a", encoding="utf-8", buffering=1)
            except OSError as error:
                raise output_error(self._file, error) from None
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        if self._log is not None:
            self._log.close()

    def note(self, path: str, key: str, digest: str) -> None:
        """Append one line; the newline in front ends a line that a kill has cut."""
        if self._log is None or self._known.get(path) == (key, digest):
            return
        try:
            self._log.write("\n" + json.dumps((path, key, digest)))
            self._log.flush()
        except OSError as error:
            raise output_error(Path(self._log.name), error) from None
