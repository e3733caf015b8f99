"""``tracks.csv`` of OpenSfM, streamed: which feature of which frame belongs to which point.

ODM's fork writes it in binary (version 102), upstream as tab-separated text
(versions 0 to 2).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Dict, Iterator, List, Mapping, Tuple

import numpy as np
import numpy.typing as npt

from .opensfm_json import Unreadable

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

_HEADER = b"OPENSFM_TRACKS_VERSION_v"
_BINARY = 102
_LENGTHS = struct.Struct("<HH")
_RECORD = struct.Struct("<iff8x")  # feature, x, y; scale and colour are not needed
_X_COLUMN = 3
_CHUNK = 1 << 20
_BATCH = 200_000
_LONGEST_LINE = 1 << 16


class PointIds:
    """Track names as numbers: decimal names are their own, others are counted down from -1."""

    def __init__(self) -> None:
        self._others: Dict[str, int] = {}

    def number(self, name: str) -> int:
        """The number of a track."""
        if len(name) < 16 and name.isascii() and name.isdigit():
            return int(name)
        return self._others.setdefault(name, -1 - len(self._others))


@dataclass(frozen=True)
class Observations:
    """A batch: frame row (-1 for a frame that was not asked for), track number, x and y in image coordinates."""

    frame: Ints
    track: Ints
    xy: Array


def read_tracks(path: Path, rows: Mapping[str, int], ids: PointIds, most: int) -> Iterator[Observations]:
    """Yield the observations in batches; ``rows`` is frame name -> row, ``most`` the number read at all.

    Raises ``Unreadable`` where the file is none of OpenSfM's, ends within a
    record or is longer than ``most``: batches until then stand.
    """
    try:
        with open(path, "rb") as stream:
            first = stream.readline(_LONGEST_LINE)
            version = 0
            if first.startswith(_HEADER):
                text = first[len(_HEADER) :].strip()
                version = int(text) if text.isdigit() else -1
            else:
                stream.seek(0)
            if version == _BINARY:
                records = _binary(stream, path.name)
            elif version in (0, 1, 2):
                records = _lines(stream, path.name)
            else:
                raise Unreadable(f"{path.name} has a version that is not known")
            yield from _batches(records, rows, ids, most, path.name)
    except OSError as error:
        raise Unreadable(f"{path.name} cannot be read ({error.strerror})") from None


_Record = Tuple[bytes, bytes, float, float]


def _batches(
    records: Iterator[_Record], rows: Mapping[str, int], ids: PointIds, most: int, name: str
) -> Iterator[Observations]:
    frame: List[int] = []
    track: List[int] = []
    xy: List[Tuple[float, float]] = []
    seen: Dict[bytes, int] = {}
    total = 0
    failed = None
    try:
        for image, point, x, y in records:
            row = seen.get(image)
            if row is None:
                row = seen[image] = rows.get(image.decode("utf-8", "replace"), -1)
            frame.append(row)
            track.append(ids.number(point.decode("utf-8", "replace")))
            xy.append((x, y))
            total += 1
            if total > most:
                raise Unreadable(f"{name} holds more than {most} observations")
            if len(frame) >= _BATCH:
                yield _batch(frame, track, xy)
                frame, track, xy = [], [], []
    except Unreadable as error:
        failed = error
    if frame:
        yield _batch(frame, track, xy)
    if failed:
        raise failed


def _batch(frame: List[int], track: List[int], xy: List[Tuple[float, float]]) -> Observations:
    return Observations(
        np.asarray(frame, dtype=np.int64), np.asarray(track, dtype=np.int64), np.asarray(xy, dtype=np.float64)
    )


def _binary(stream: BinaryIO, name: str) -> Iterator[_Record]:
    left = b""
    while True:
        chunk = stream.read(_CHUNK)
        data = left + chunk
        at, end = 0, len(data)
        while at + _LENGTHS.size <= end:
            image, track = _LENGTHS.unpack_from(data, at)
            start = at + _LENGTHS.size
            record = start + image + track
            if record + _RECORD.size > end:
                break
            _, x, y = _RECORD.unpack_from(data, record)
            yield data[start : start + image], data[start + image : record], x, y
            at = record + _RECORD.size
        left = data[at:]
        if not chunk:
            if left:
                raise Unreadable(f"{name} ends within a record")
            return


def _lines(stream: BinaryIO, name: str) -> Iterator[_Record]:
    while True:
        line = stream.readline(_LONGEST_LINE)
        if not line:
            return
        parts = line.rstrip(b"\r\n").split(b"\t")
        try:
            yield parts[0], parts[1], float(parts[_X_COLUMN]), float(parts[_X_COLUMN + 1])
        except (IndexError, ValueError):
            raise Unreadable(f"{name} holds a line that is no observation") from None
