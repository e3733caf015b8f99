"""Frozen dataclasses to plain JSON values and back, unchanged.

Every noun of the job is a frozen dataclass; stages hand each other files. This
module is the one place that turns the one into the other. Field types must be
spelled with ``typing`` (``Optional``, ``Tuple``), so that Python 3.9 resolves
them.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import os
import tempfile
import typing
from pathlib import Path
from typing import Any, Dict, Type, TypeVar, Union

T = TypeVar("T")


def to_plain(value: Any) -> Any:
    """Turn dataclasses, tuples, sets and mappings into JSON values.

    Floats that JSON cannot say (NaN, infinities) become ``None``; sets are
    sorted so that the bytes do not depend on hashing.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(k): to_plain(v) for k, v in value.items()}
    if isinstance(value, (set, frozenset)):
        return [to_plain(v) for v in sorted(value)]
    if isinstance(value, (list, tuple)):
        return [to_plain(v) for v in value]
    if hasattr(value, "item") and callable(value.item) and getattr(value, "shape", None) == ():
        return to_plain(value.item())
    return value


def slotted(cls: Type[T]) -> Type[T]:
    """Give a frozen dataclass slots: a survey holds a hundred thousand frames, and Python 3.9 has no ``slots=True``."""
    names = tuple(f.name for f in dataclasses.fields(cls))  # type: ignore[arg-type]
    body = {k: v for k, v in cls.__dict__.items() if k not in (*names, "__dict__", "__weakref__")}
    body["__slots__"] = names

    def get_state(self: Any) -> Any:
        return tuple(getattr(self, n) for n in names)

    def set_state(self: Any, state: Any) -> None:
        for name, value in zip(names, state):
            object.__setattr__(self, name, value)

    body["__getstate__"], body["__setstate__"] = get_state, set_state
    made: Type[T] = type(cls.__name__, cls.__bases__, body)
    made.__qualname__ = cls.__qualname__
    return made


@functools.lru_cache(maxsize=None)
def _hints(cls: type) -> Dict[str, Any]:
    return typing.get_type_hints(cls)


def from_plain(cls: Type[T], value: Any) -> T:
    """Build ``cls`` from what ``to_plain`` gave; unknown keys are ignored.

    Raises ``ValueError`` or ``TypeError`` where the value does not fit.
    """
    result: T = _build(cls, value)
    return result


def _build(hint: Any, value: Any) -> Any:
    origin = typing.get_origin(hint)
    args = typing.get_args(hint)
    if origin is Union:
        if value is None:
            return None
        return _build(next(a for a in args if a is not type(None)), value)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        if not isinstance(value, dict):
            raise TypeError(f"{hint.__name__} needs an object, not {type(value).__name__}")
        hints = _hints(hint)
        known = {f.name for f in dataclasses.fields(hint) if f.init}
        return hint(**{k: _build(hints[k], v) for k, v in value.items() if k in known})
    if origin is tuple:
        if len(args) == 2 and args[1] is Ellipsis:
            return tuple(_build(args[0], v) for v in value)
        return tuple(_build(a, v) for a, v in zip(args, value))
    if origin in (dict, typing.Dict):
        return {k: _build(args[1], v) for k, v in value.items()}
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value


def dumps(value: Any) -> str:
    """The one JSON spelling used for every file: sorted nowhere, indented, ending in a newline."""
    return json.dumps(to_plain(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_text(path: Union[str, Path], text: str) -> None:
    """Write beside and rename, so that a reader never sees half a file."""
    # A file name that is no UTF-8 holds lone surrogates; as JSON escapes they come back unchanged.
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_bytes(path: Union[str, Path], data: bytes) -> None:
    """Write beside and rename, so that a reader never sees half a file."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, beside = tempfile.mkstemp(prefix=".part-", dir=str(target.parent))
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
        os.chmod(beside, 0o644)
        os.replace(beside, target)
    except BaseException:
        if os.path.exists(beside):
            os.unlink(beside)
        raise
