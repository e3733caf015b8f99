"""Files put into a project: whole or not at all, never through a link into an original."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Iterable, Iterator, Set, Union

from ..errors import FrameError, UsageError

_FULL = (errno.ENOSPC, errno.EDQUOT)
_NO_LINK = frozenset(
    getattr(errno, name)
    for name in ("EXDEV", "EPERM", "EACCES", "EMLINK", "ENOSYS", "ENOTSUP", "EOPNOTSUPP", "EINVAL")
    if hasattr(errno, name)
)
_BLOCK_BYTES = 1 << 20
PathLike = Union[str, Path]


class OutputError(UsageError):
    """The output folder cannot take a file: full, read-only or gone. Finished frames stay whole."""


def output_error(target: Path, error: OSError) -> OutputError:
    """Say what is wrong with the folder of ``target`` and what to do."""
    if error.errno in _FULL:
        return OutputError(
            f"The disk of {target.parent} is full: {target.name} does not fit. Free some space or choose another "
            "--out, then run the same command with --resume: finished frames are kept."
        )
    return OutputError(
        f"{target} cannot be written ({error.strerror or error}). Choose another --out or make the folder writable."
    )


def check_targets(originals: Iterable[PathLike], targets: Iterable[Path]) -> None:
    """Raise ``UsageError`` where a target is one of the originals or is named twice."""
    kept = {os.path.realpath(o) for o in originals}
    seen: Set[str] = set()
    for target in targets:
        # The last name is not followed: a link that stands there is replaced, not written through.
        place = os.path.join(os.path.realpath(target.parent), target.name)
        if place in kept:
            raise UsageError(f"{target} is one of the originals, which are never written. Choose another --out.")
        if os.path.normcase(place) in seen:
            raise UsageError(f"Two frames would become {target}.")
        seen.add(os.path.normcase(place))


def remove_stale(target: Path) -> None:
    """Take away what an earlier run put for a frame that cannot be used now. Raises ``OutputError``."""
    try:
        _clear(target)
    except OSError as error:
        raise output_error(target, error) from None


def _beside(target: Path) -> Path:
    """Return the unfinished name of ``target``; always the same, so that a later run clears what a killed one left."""
    return target.with_name(f".{target.name}.part")


def _clear(path: Path) -> None:
    try:
        path.unlink()
    except FileNotFoundError:
        return


def put_bytes(target: Path, data: bytes) -> None:
    """Write ``data`` beside ``target`` and rename. Raises ``OutputError``.

    What stands at the unfinished name may be a hard link to an original: it is
    removed, never opened.
    """
    part = _beside(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _clear(part)
        try:
            with open(part, "xb") as stream:
                stream.write(data)
            part.replace(target)
        except BaseException:
            _clear(part)
            raise
    except OSError as error:
        raise output_error(target, error) from None


def put_link(source: PathLike, target: Path, *, link: bool = True) -> str:
    """Hard-link ``source`` as ``target``, or copy where that cannot be; returns ``linked`` or ``copied``.

    A target that already is that file, or has its content, is left as it is.
    Raises ``FileNotFoundError`` when the source is gone, ``FrameError``
    ``unreadable-file`` when it cannot be read, ``OutputError`` when the target
    cannot be written.
    """
    origin = os.path.realpath(source)
    if not os.path.isfile(origin):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(source))
    part = _beside(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if os.path.lexists(target) and not target.is_symlink():
            if target.samefile(origin) and link:
                return "linked"
            if not target.samefile(origin) and _equal(origin, target):
                return "copied"
        _clear(part)
        try:
            how = _link_or_copy(origin, part, link)
            part.replace(target)
        except BaseException:
            _clear(part)
            raise
        return how
    except OSError as error:
        if not os.path.isfile(origin):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(source)) from None
        raise output_error(target, error) from None


def _link_or_copy(origin: str, part: Path, link: bool) -> str:
    if link:
        try:
            os.link(origin, part)
            return "linked"
        except OSError as error:
            if error.errno not in _NO_LINK:
                raise
    with open(part, "xb") as stream:
        for block in _blocks(origin):
            stream.write(block)
    return "copied"


def _blocks(origin: str) -> Iterator[bytes]:
    """The source in pieces. What goes wrong on its side is its own fault, not that of the output."""
    try:
        with open(origin, "rb") as source:
            while True:
                block = source.read(_BLOCK_BYTES)
                if not block:
                    return
                yield block
    except FileNotFoundError:
        raise
    except OSError as error:
        raise FrameError("unreadable-file", f"The file cannot be read: {error.strerror or error}.") from None


def _equal(origin: str, target: Path) -> bool:
    if os.path.getsize(origin) != target.stat().st_size:
        return False
    with open(target, "rb") as other:
        return all(block == other.read(_BLOCK_BYTES) for block in _blocks(origin))
