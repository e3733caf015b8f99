"""``matches/<frame>_matches.pkl.gz`` of OpenSfM: verified matches per pair, read without running any of it.

A pickle is a program. This reads the few operations that a dictionary of
numpy arrays needs and builds nothing: of every array only its number of rows
is taken, and that only where its bytes are really there.
"""

from __future__ import annotations

import gzip
import pickletools
import zlib
from pathlib import Path
from typing import Any, Dict, List, Mapping, Tuple

from ...stages.thresholds import Thresholds
from .opensfm_json import Unreadable

SUFFIX = "_matches.pkl.gz"

_VALUES = frozenset(
    (
        *("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
        *("BININT", "BININT1", "BININT2", "LONG1"),
        *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
    )
)
_SMALL = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_PUTS = frozenset(["BINPUT", "LONG_BINPUT", "PUT"])
_GETS = frozenset(["BINGET", "LONG_BINGET", "GET"])
_RECONSTRUCT = ("numpy.core.multiarray _reconstruct", "numpy._core.multiarray _reconstruct")
_FROM_BUFFER = ("numpy.core.numeric _frombuffer", "numpy._core.numeric _frombuffer")
_NDARRAY, _DTYPE, _ENCODE = "numpy ndarray", "numpy dtype", "_codecs encode"
_BYTES = ("__builtin__ bytes", "builtins bytes")  # how an old protocol spells no bytes at all
_ALLOWED = frozenset((*_RECONSTRUCT, *_FROM_BUFFER, *_BYTES, _NDARRAY, _DTYPE, _ENCODE))
_MARK = object()


class _Name(str):
    """A name that the pickle asks for; never looked up."""


class _Dtype(str):
    """A numpy type by its code, such as ``i4``."""


class _Rows:
    """An array of which only the shape is kept."""

    def __init__(self) -> None:
        self.count = 0


def read_matches(path: Path, limits: Thresholds) -> Dict[str, int]:
    """Return other frame -> verified matches of one file (0 where matching was tried and failed).

    Raises ``Unreadable`` where the file is damaged, larger than
    ``outcome_match_bytes`` once unpacked, or asks for anything but arrays.
    """
    try:
        with gzip.open(path, "rb") as stream:
            data = stream.read(limits.outcome_match_bytes + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise Unreadable(f"{path.name} cannot be unpacked ({type(error).__name__})") from None
    if len(data) > limits.outcome_match_bytes:
        raise Unreadable(f"{path.name} unpacks to more than {limits.outcome_match_bytes} bytes")
    return pair_counts(data, path.name)


def pair_counts(data: bytes, name: str) -> Dict[str, int]:
    """Read the pickle's bytes; errors as ``read_matches``."""
    try:
        result = _run(data)
    except Unreadable as error:
        raise Unreadable(f"{name}: {error}") from None
    except (ValueError, IndexError, KeyError, TypeError, UnicodeError, OverflowError) as error:
        raise Unreadable(f"{name} is no list of matches ({type(error).__name__})") from None
    if not isinstance(result, dict):
        raise Unreadable(f"{name} is no list of matches")
    return {k: v.count for k, v in result.items() if isinstance(k, str) and isinstance(v, _Rows)}


def _run(data: bytes) -> Any:
    stack: List[Any] = []
    memo: Dict[int, Any] = {}
    for operation, argument, _ in pickletools.genops(data):
        code = operation.name
        if code in ("PROTO", "FRAME"):
            continue
        if code == "STOP":
            return stack.pop()
        if code in _VALUES:
            stack.append(argument)
        elif code in _SMALL:
            stack.append(_SMALL[code])
        elif code == "EMPTY_DICT":
            stack.append({})
        elif code == "MARK":
            stack.append(_MARK)
        elif code in _TUPLES:
            count = _TUPLES[code]
            stack[-count:] = [tuple(stack[-count:])]
        elif code == "TUPLE":
            stack.append(tuple(_since_mark(stack)))
        elif code == "MEMOIZE":
            memo[len(memo)] = stack[-1]
        elif code in _PUTS:
            memo[_index(argument)] = stack[-1]
        elif code in _GETS:
            stack.append(memo[_index(argument)])
        elif code == "GLOBAL":
            stack.append(_name(str(argument)))
        elif code == "STACK_GLOBAL":
            member, module = stack.pop(), stack.pop()
            stack.append(_name(f"{module} {member}"))
        elif code == "REDUCE":
            arguments, function = stack.pop(), stack.pop()
            stack.append(_call(function, arguments))
        elif code == "BUILD":
            state = stack.pop()
            _build(stack[-1], state)
        elif code == "SETITEM":
            value, key = stack.pop(), stack.pop()
            _put(stack[-1], [key, value])
        elif code == "SETITEMS":
            pairs = _since_mark(stack)
            _put(stack[-1], pairs)
        else:
            raise Unreadable(f"the operation {code} has no place in a list of matches")
    raise Unreadable("it ends early")


def _index(argument: Any) -> int:
    return int(argument)


def _since_mark(stack: List[Any]) -> List[Any]:
    at = len(stack) - 1
    while stack[at] is not _MARK:
        at -= 1
        if at < 0:
            raise Unreadable("it is damaged")
    found = stack[at + 1 :]
    del stack[at:]
    return found


def _name(text: str) -> _Name:
    if text not in _ALLOWED:
        raise Unreadable(f"it asks for {text[:80]!r}, which a list of matches does not need; it was not run")
    return _Name(text)


def _put(target: Any, pairs: List[Any]) -> None:
    if not isinstance(target, dict):
        raise Unreadable("it is damaged")
    for key, value in zip(pairs[::2], pairs[1::2]):
        target[key] = value


def _call(function: Any, arguments: Any) -> Any:
    if not isinstance(function, _Name) or not isinstance(arguments, tuple):
        raise Unreadable("it is damaged")
    if function in _RECONSTRUCT:
        return _Rows()
    if function == _DTYPE:
        return _Dtype(arguments[0])
    if function == _ENCODE:  # bytes in a pickle that an old protocol wrote
        return str(arguments[0]).encode("latin-1")
    if function in _FROM_BUFFER:
        rows = _Rows()
        rows.count = _counted(arguments[2], arguments[1], arguments[0])
        return rows
    if function in _BYTES and not arguments:
        return b""
    raise Unreadable(f"it calls {function}")


def _build(target: Any, state: Any) -> None:
    if isinstance(target, _Dtype):
        return
    if not isinstance(target, _Rows):
        raise Unreadable("it is damaged")
    _, shape, dtype, _, data = state
    target.count = _counted(shape, dtype, data)


def _counted(shape: Any, dtype: Any, data: Any) -> int:
    """Rows of an array whose bytes are all there."""
    if not isinstance(shape, tuple) or not isinstance(dtype, _Dtype) or not isinstance(data, (bytes, bytearray)):
        raise Unreadable("an array in it is damaged")
    size = int(dtype[1:])
    for extent in shape:
        size *= int(extent)
    if not shape or size != len(data) or min(shape) < 0:
        raise Unreadable("an array in it is not as large as it says")
    return int(shape[0])


def pairs_of(counts: Mapping[str, Mapping[str, int]]) -> Dict[Tuple[str, str], int]:
    """Return (frame, frame) in order -> matches; of a pair that two files hold, the larger count."""
    found: Dict[Tuple[str, str], int] = {}
    for first in sorted(counts):
        for second, inliers in sorted(counts[first].items()):
            pair = (first, second) if first < second else (second, first)
            if first != second:
                found[pair] = max(found.get(pair, 0), inliers)
    return found
