"""Bytes of one image file, read by range: from disk, or from header bytes alone.

The readers ask for small ranges only. A file answers from its first 64 KB where
it can and seeks for the rest; header bytes sent ahead of a file answer from
what was sent. Nothing is ever read beyond the file's own size.
"""

from __future__ import annotations

import bisect
import os
import stat
from pathlib import Path
from typing import BinaryIO, List, Mapping, Optional, Tuple, TypeVar, Union

from ..errors import FrameError

HEAD_BYTES = 64 * 1024
_BLOCK_BYTES = 4096
_KEPT_BLOCKS = 64


Self = TypeVar("Self", bound="FileSource")


class BeyondEnd(Exception):
    """The range reaches past the end of the file."""

    def __init__(self, offset: int, length: int, size: int) -> None:
        super().__init__(f"bytes {offset}-{offset + length} asked of a file of {size}")


class HeaderIncomplete(FrameError):
    """The header bytes that were sent lack the range ``offset``, ``length``."""

    def __init__(self, offset: int, length: int) -> None:
        super().__init__(
            "header-incomplete",
            f"The header bytes sent do not hold the {length} bytes from {offset}; send them as well.",
        )
        self.offset = offset
        self.length = length


class ByteSource:
    """Random access to ``size`` bytes; ``complete`` when every one of them can be had."""

    size: int
    complete = True

    def read(self, offset: int, length: int) -> bytes:
        """Return ``length`` bytes from ``offset``; ``BeyondEnd`` or ``HeaderIncomplete`` where they are not."""
        raise NotImplementedError

    def peek(self, offset: int, length: int) -> bytes:
        """Like ``read`` for a few bytes among many that nobody needs."""
        return self.read(offset, length)

    def scan(self, offset: int, length: int) -> bytes:
        """Like ``peek`` for bytes that are searched only where a file is suspect: they are no part of its header."""
        return self.read(offset, length)

    def holds(self, offset: int, length: int) -> bool:
        """Whether ``read`` of this range would succeed."""
        return offset >= 0 and offset + length <= self.size


class FileSource(ByteSource):
    """A file on disk, opened once; use as a context manager.

    ``FrameError`` ``unreadable-file`` when it cannot be opened, ``empty-file``
    when it has no bytes. Only ordinary files are opened: a pipe would block.
    """

    def __init__(self, file: Union[str, Path]) -> None:
        try:
            if not stat.S_ISREG(os.stat(file).st_mode):
                raise FrameError("unreadable-file", "This is not an ordinary file.")
            self._file: BinaryIO = open(file, "rb", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise FrameError("unreadable-file", f"The file cannot be opened: {error.strerror or error}.") from None
        try:
            self.size = os.fstat(self._file.fileno()).st_size
            if self.size == 0:
                raise FrameError("empty-file", "The file has no bytes: the copy from the card failed.")
            self._blocks: List[Tuple[int, bytes]] = []
            self._head = b""
            self._head = self._pull(0, min(HEAD_BYTES, self.size))
        except BaseException:
            self._file.close()
            raise

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes; small ranges outside of the head are read in blocks of 4 KB and kept."""
        end = offset + length
        if offset >= 0 and end <= len(self._head):
            return self._head[offset:end]
        if offset < 0 or length < 0 or end > self.size:
            raise BeyondEnd(offset, length, self.size)
        for start, block in self._blocks:
            if start <= offset and end <= start + len(block):
                return block[offset - start : end - start]
        if length >= _BLOCK_BYTES:
            return self._pull(offset, length)
        block = self._pull(offset, min(_BLOCK_BYTES, self.size - offset))
        if len(self._blocks) < _KEPT_BLOCKS:
            self._blocks.append((offset, block))
        return block[:length]

    def peek(self, offset: int, length: int) -> bytes:
        """Like ``read``, without reading a block around the range."""
        if offset + length <= len(self._head):
            return self._head[offset : offset + length]
        if offset < 0 or offset + length > self.size:
            raise BeyondEnd(offset, length, self.size)
        return self._pull(offset, length)

    def scan(self, offset: int, length: int) -> bytes:
        """Like ``peek``."""
        return FileSource.peek(self, offset, length)

    def _pull(self, offset: int, length: int) -> bytes:
        try:
            self._file.seek(offset)
            data = self._file.read(length)
            while len(data) < length:
                more = self._file.read(length - len(data))
                if not more:
                    raise FrameError("unreadable-file", "The file ended while it was being read.")
                data += more
        except OSError as error:
            raise FrameError("unreadable-file", f"The file cannot be read: {error.strerror or error}.") from None
        return data


class RecordingSource(FileSource):
    """A file that notes which ranges were asked for: what a sender must send."""

    def __init__(self, file: Union[str, Path]) -> None:
        super().__init__(file)
        self.asked: List[Tuple[int, int]] = []

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes and note the range."""
        data = super().read(offset, length)
        self.asked.append((offset, length))
        return data

    def peek(self, offset: int, length: int) -> bytes:
        """Return the bytes and note the range."""
        data = super().peek(offset, length)
        self.asked.append((offset, length))
        return data

    def merged(self, gap: int) -> List[Tuple[int, int]]:
        """Return the noted ranges in order, joined where at most ``gap`` bytes lie between them."""
        result: List[Tuple[int, int]] = []
        for offset, length in sorted(self.asked):
            if result and offset <= result[-1][0] + result[-1][1] + gap:
                start, have = result[-1]
                result[-1] = (start, max(have, offset + length - start))
            else:
                result.append((offset, length))
        return result


class HeaderSource(ByteSource):
    """Header bytes as ``offset -> bytes`` of a file of ``size`` bytes that is elsewhere.

    Ranges that touch or overlap are joined. ``FrameError`` ``empty-file`` when
    the file has no bytes.
    """

    def __init__(self, ranges: Mapping[int, bytes], size: int) -> None:
        self.size = size
        if size <= 0:
            raise FrameError("empty-file", "The file has no bytes: the copy from the card failed.")
        self._starts: List[int] = []
        self._parts: List[bytes] = []
        for start in sorted(ranges):
            data = bytes(ranges[start])[: max(0, size - start)]
            if start < 0 or not data:
                continue
            end = self._starts[-1] + len(self._parts[-1]) if self._starts else -1
            if start <= end:
                self._parts[-1] += data[end - start :]
            else:
                self._starts.append(start)
                self._parts.append(data)
        self.complete = self._starts[:1] == [0] and len(self._parts[0]) == size

    def _part(self, offset: int, length: int) -> Optional[Tuple[int, bytes]]:
        index = bisect.bisect_right(self._starts, offset) - 1
        if index < 0:
            return None
        start, data = self._starts[index], self._parts[index]
        return (start, data) if offset + length <= start + len(data) else None

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes; ``HeaderIncomplete`` where the file has them and they were not sent."""
        if offset < 0 or length < 0 or offset + length > self.size:
            raise BeyondEnd(offset, length, self.size)
        part = self._part(offset, length)
        if part is None:
            raise HeaderIncomplete(offset, length)
        return part[1][offset - part[0] : offset - part[0] + length]

    def holds(self, offset: int, length: int) -> bool:
        """Whether these bytes were sent."""
        return offset >= 0 and offset + length <= self.size and self._part(offset, length) is not None
