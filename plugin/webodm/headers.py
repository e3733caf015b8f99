"""Header bytes that a browser sent, read into frames. Everything in them is untrusted."""

from __future__ import annotations

import base64
import binascii
import logging
import unicodedata
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union

from ...stages.errors import FrameError, UsageError
from ...stages.frame import BrokenFrame, Frame
from ...stages.headers.source import HeaderIncomplete
from ...stages.read import IMAGE_EXTENSIONS, frame_from_header
from ...stages.thresholds import DEFAULTS, Thresholds
from . import bounds

LOG = logging.getLogger("sensorgate.webodm")
_LARGEST = 1 << 44
_NEXT_BYTES = 4096
_MASK = "_mask"


@dataclass(frozen=True)
class Sent:
    """One file as the browser described it; ``path`` is cleaned."""

    id: int
    path: str
    size: int
    ranges: Mapping[int, bytes]


@dataclass(frozen=True)
class Need:
    """Bytes of file ``id`` without which it cannot be read."""

    id: int
    offset: int
    length: int


@dataclass(frozen=True)
class Read:
    """What became of a batch: by file id."""

    frames: Mapping[int, Union[Frame, BrokenFrame]]
    masks: Mapping[int, str]
    need: Tuple[Need, ...]
    ignored: int = 0


def clean_path(text: Any) -> str:
    """A path that stays below its folder and can be shown: no control characters, no ``..``, ``/`` between parts."""
    if not isinstance(text, str) or not text:
        raise UsageError("A file has no name.")
    if len(text) > bounds.PATH_CHARACTERS:
        raise UsageError("A file's path is too long.")
    plain = "".join("_" if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp") else c for c in text)
    parts = [p for p in plain.replace("\\", "/").split("/") if p not in ("", ".", "..")]
    if not parts:
        raise UsageError("A file has no name.")
    return "/".join(parts)


def sent_files(value: Any) -> Tuple[Sent, ...]:
    """The files of a batch. Raises ``UsageError`` where it is not what the API says."""
    if not isinstance(value, list) or not value:
        raise UsageError("files must be a list of files.")
    if len(value) > bounds.BATCH_FILES:
        raise UsageError(f"A batch holds at most {bounds.BATCH_FILES} files.")
    return tuple(_sent(item) for item in value)


def _sent(item: Any) -> Sent:
    if not isinstance(item, dict):
        raise UsageError("A file must be an object with id, path, size and ranges.")
    number, size, listed = item.get("id"), item.get("size"), item.get("ranges")
    if not _whole(number, bounds.SESSION_FILES * 50):
        raise UsageError("A file's id must be a whole number.")
    if not _whole(size, _LARGEST):
        raise UsageError("A file's size must be a whole number of bytes.")
    if not isinstance(listed, list) or len(listed) > bounds.MOST_RANGES:
        raise UsageError("A file's ranges must be a list of [offset, base64].")
    ranges: Dict[int, bytes] = {}
    total = 0
    for entry in listed:
        if not isinstance(entry, list) or len(entry) != 2 or not _whole(entry[0], _LARGEST):
            raise UsageError("A file's ranges must be a list of [offset, base64].")
        data = _bytes(entry[1])
        total += len(data)
        if total > bounds.FILE_BYTES:
            raise UsageError(f"More than {bounds.FILE_BYTES} header bytes of one file.")
        if len(data) > len(ranges.get(entry[0], b"")):
            ranges[entry[0]] = data
    return Sent(int(number), clean_path(item.get("path")), int(size), ranges)


def _whole(value: Any, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most


def _bytes(text: Any) -> bytes:
    if not isinstance(text, str):
        raise UsageError("Header bytes must be base64 text.")
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise UsageError("Header bytes must be base64 text.") from None


def is_mask(path: str) -> bool:
    """ODM takes every file whose name ends so for the mask of an image."""
    return PurePosixPath(path).stem.lower().endswith(_MASK)


def read_headers(files: Sequence[Sent], limits: Thresholds = DEFAULTS) -> Read:
    """Read each file's header; what is missing is named, what is no image is counted."""
    frames: Dict[int, Union[Frame, BrokenFrame]] = {}
    masks: Dict[int, str] = {}
    need: List[Need] = []
    ignored = 0
    for file in files:
        if is_mask(file.path):
            masks[file.id] = file.path
        elif PurePosixPath(file.path).suffix.lower() not in IMAGE_EXTENSIONS:
            ignored += 1
        else:
            try:
                frames[file.id] = _read(file, limits)
            except HeaderIncomplete as gap:
                sent = sum(map(len, file.ranges.values()))
                length = min(max(gap.length, _NEXT_BYTES), max(1, file.size - gap.offset))
                if sent + length > bounds.FILE_BYTES:
                    frames[file.id] = BrokenFrame(
                        file.path, file.size, "unreadable-file", "Its header is larger than can be sent."
                    )
                else:
                    need.append(Need(file.id, gap.offset, length))
    return Read(frames, masks, tuple(need), ignored)


def _read(file: Sent, limits: Thresholds) -> Union[Frame, BrokenFrame]:
    try:
        return frame_from_header(file.path, file.ranges, file.size, limits)
    except HeaderIncomplete:
        raise
    except FrameError as error:
        return BrokenFrame(file.path, file.size, error.code, error.message)
    except Exception as error:  # a fault of ours must not stop the other files
        LOG.exception("reading a header that was sent")
        return BrokenFrame(
            file.path,
            file.size,
            "unreadable-file",
            f"sensorgate failed on this header ({type(error).__name__}); report it.",
        )


def mask_of(paths: Sequence[str], masks: Sequence[str]) -> Dict[str, str]:
    """Image -> its mask, by folder and name, the first by name where there are several."""
    by_stem: Dict[Tuple[str, str], str] = {}
    for mask in sorted(masks, reverse=True):
        pure = PurePosixPath(mask)
        by_stem[str(pure.parent), pure.stem[: -len(_MASK)]] = mask
    found: Dict[str, str] = {}
    for path in paths:
        pure = PurePosixPath(path)
        mask: Optional[str] = by_stem.get((str(pure.parent), pure.stem))
        if mask is not None:
            found[path] = mask
    return found
