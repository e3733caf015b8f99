"""Frames from files: one header, or everything below some folders."""

from __future__ import annotations

import dataclasses
import json
import logging
import os
import queue
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Set, Tuple, Union

from .errors import FrameError, UsageError
from .frame import BrokenFrame, FileCalibration, Frame
from .headers.assemble import frame_from
from .headers.source import FileSource, HeaderSource, RecordingSource
from .progress import Cancel, Progress, check
from .thresholds import DEFAULTS, Thresholds

IMAGE_EXTENSIONS = frozenset((".jpg", ".jpeg", ".jpe", ".tif", ".tiff", ".dng"))
RAW_EXTENSIONS = frozenset((".arw", ".cr2", ".cr3", ".nef", ".orf", ".pef", ".raf", ".raw", ".rw2", ".srw"))
HIDDEN, NOT_IMAGES, RAW, UNREADABLE = "hidden", "not_images", "raw", "unreadable_folders"

_JOIN_GAP_BYTES = 256
_STEP = 64
_WORKERS = 2

# The package is loaded by its folder, under a name of its own: installed, it has several.
_WORKER = (
    "import importlib, sys, types\n"
    "package = types.ModuleType('frame_reader'); package.__path__ = [sys.argv[1]]\n"
    "sys.modules['frame_reader'] = package\n"
    "importlib.import_module('frame_reader.read').serve(sys.stdin, sys.stdout)\n"
)

LOG = logging.getLogger(__name__)

Result = Union[Frame, BrokenFrame]
# Called with each file as soon as it is read, before the last one is.
Found = Callable[[Result], None]


@dataclass(frozen=True)
class Scan:
    """Every image file that was found: readable ones, broken ones, and counts of what was passed over.

    Both lists are sorted by path. ``ignored`` counts hidden files and folders,
    files that are no images, raw files that have no reader here, and folders
    below that cannot be opened.
    """

    frames: Tuple[Frame, ...]
    broken: Tuple[BrokenFrame, ...] = ()
    ignored: Dict[str, int] = field(default_factory=dict)


def read_frame(file: Union[str, Path], path: Optional[str] = None, limits: Thresholds = DEFAULTS) -> Frame:
    """Read one image's metadata without decoding a pixel.

    ``path`` is what the report calls it (default: ``file``). ``FrameError``
    with ``empty-file``, ``unreadable-file``, ``not-an-image``,
    ``damaged-header`` or ``truncated-image``.
    """
    with FileSource(file) as source:
        return frame_from(source, _slashes(str(file)) if path is None else path, limits)


def frame_from_header(path: str, ranges: Mapping[int, bytes], size_bytes: int, limits: Thresholds = DEFAULTS) -> Frame:
    """Read the metadata from header bytes alone.

    ``ranges`` maps file offsets to bytes, ``size_bytes`` is the whole file's
    size. Errors as ``read_frame``, and ``HeaderIncomplete`` (a ``FrameError``
    with ``offset`` and ``length``) where bytes are needed that were not sent.
    """
    return frame_from(HeaderSource(ranges, size_bytes), path, limits)


def header_ranges(file: Union[str, Path]) -> List[Tuple[int, int]]:
    """(offset, length) of the bytes that ``frame_from_header`` needs: no thumbnail, no picture, no raw thermal data."""
    with RecordingSource(file) as source:
        frame_from(source, str(file))
        return source.merged(_JOIN_GAP_BYTES)


def scan(
    paths: Sequence[str],
    *,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    limits: Thresholds = DEFAULTS,
    found: Optional[Found] = None,
) -> Scan:
    """Read every image below ``paths`` (files and folders); ``found`` hears of each as it is read.

    Symbolic links are followed, each real file is read once, under the first
    of its paths in order. The result does not depend on the order of
    ``paths`` or of a folder's listing. ``UsageError`` for a path that does not
    exist, ``Cancelled`` when ``cancel`` says so.
    """
    ignored = {HIDDEN: 0, NOT_IMAGES: 0}
    files: List[Tuple[str, str]] = []
    seen: Set[str] = set()
    for argument in sorted({str(p) for p in paths}):
        if not os.path.exists(argument):
            raise UsageError(
                f"There is no file or folder {argument!r}. Check the spelling, and that the card is mounted."
            )
        for file, shown, real in _below(argument, ignored):
            check(cancel)
            if real not in seen:
                seen.add(real)
                files.append((file, shown))
    files.sort(key=lambda f: f[1])
    results = _read_all(files, progress, cancel, limits, found)
    frames = [r for r in results if isinstance(r, Frame)]
    broken = [r for r in results if isinstance(r, BrokenFrame)]
    return Scan(tuple(frames), tuple(broken), ignored)


def _slashes(path: str) -> str:
    return path.replace(os.sep, "/") if os.sep != "/" else path


def _below(argument: str, ignored: Dict[str, int]) -> Iterator[Tuple[str, str, str]]:
    """(file, path to show, real path) of every image at or below ``argument``; counts the rest."""
    if not os.path.isdir(argument):
        if _is_image(os.path.basename(argument), ignored):
            yield argument, _slashes(argument), os.path.realpath(argument)
        return
    base = _slashes(argument)
    base = base if base.endswith("/") else base + "/"
    waiting = [(argument, base, os.path.realpath(argument))]
    visited = {waiting[0][2]}
    while waiting:
        folder, prefix, real = waiting.pop(0)
        try:
            with os.scandir(folder) as listing:
                entries = sorted(listing, key=lambda e: e.name)
        except OSError as error:
            if folder == argument:
                raise UsageError(f"The folder {prefix!r} cannot be read: {error.strerror or error}.") from None
            ignored[UNREADABLE] = ignored.get(UNREADABLE, 0) + 1
            continue
        for entry in entries:
            if entry.name.startswith("."):
                ignored[HIDDEN] += 1
                continue
            place = os.path.realpath(entry.path) if entry.is_symlink() else os.path.join(real, entry.name)
            if _is_folder(entry):
                if place not in visited:
                    visited.add(place)
                    waiting.append((entry.path, f"{prefix}{entry.name}/", place))
            elif _is_image(entry.name, ignored):
                yield entry.path, prefix + entry.name, place


def _is_folder(entry: "os.DirEntry[str]") -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False


def _is_image(name: str, ignored: Dict[str, int]) -> bool:
    extension = Path(name).suffix.lower()
    if extension in IMAGE_EXTENSIONS:
        return True
    kind = RAW if extension in RAW_EXTENSIONS else NOT_IMAGES
    ignored[kind] = ignored.get(kind, 0) + 1
    return False


def _read_one(file: str, shown: str, limits: Thresholds) -> Result:
    """Read a frame, or say why not; whatever a header holds, the job goes on."""
    try:
        shown.encode("utf-8")
    except UnicodeEncodeError:
        plain = shown.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
        return BrokenFrame(plain, _size(file), "unreadable-file", "The file's name is not valid text; rename the file.")
    try:
        return read_frame(file, shown, limits)
    except FrameError as error:
        return BrokenFrame(shown, _size(file), error.code, error.message)
    except Exception as error:  # a fault of ours must not stop the other frames
        LOG.exception("reading the header of %s", shown)
        return BrokenFrame(
            shown,
            _size(file),
            "unreadable-file",
            f"sensorgate failed on this header ({type(error).__name__}); report it.",
        )


def _size(file: str) -> int:
    try:
        return os.stat(file).st_size
    except OSError:
        return 0


def _read_all(
    files: Sequence[Tuple[str, str]],
    progress: Optional[Progress],
    cancel: Optional[Cancel],
    limits: Thresholds,
    found: Optional[Found],
) -> List[Result]:
    if len(files) > limits.parallel_read_files and sys.executable:
        return _read_parallel(files, progress, cancel, limits, found)
    results: List[Result] = []
    for number, (file, shown) in enumerate(files):
        if number % _STEP == 0:
            check(cancel)
            _tell(progress, number, len(files))
        results.append(_found(_read_one(file, shown, limits), found))
    _tell(progress, len(files), len(files))
    return results


def _found(result: Result, found: Optional[Found]) -> Result:
    if found is not None:
        found(result)
    return result


def _tell(progress: Optional[Progress], done: int, total: int) -> None:
    if progress is not None:
        progress("read", done, total)


def _read_parallel(
    files: Sequence[Tuple[str, str]],
    progress: Optional[Progress],
    cancel: Optional[Cancel],
    limits: Thresholds,
    found: Optional[Found],
) -> List[Result]:
    """Read with workers, each its share in order; what a worker that ended early left over is read here."""
    results: List[Optional[Result]] = [None] * len(files)
    answers: "queue.Queue[Tuple[int, Optional[str]]]" = queue.Queue()
    workers = [_start(files[share::_WORKERS], share, answers, limits) for share in range(_WORKERS)]
    done = [0] * _WORKERS
    shared: Dict[Any, Any] = {}
    running = {share for share, worker in enumerate(workers) if worker is not None}
    try:
        while running:
            check(cancel)
            try:
                share, line = answers.get(timeout=0.2)
            except queue.Empty:
                continue
            if line is None:
                running.discard(share)
                continue
            for item in json.loads(line):
                result = _unpack(item, shared)
                results[share + _WORKERS * done[share]] = result
                done[share] += 1
                if found is not None:
                    found(result)
            _tell(progress, sum(done), len(files))
    finally:
        for worker in workers:
            if worker is not None:
                worker.kill()
                worker.wait()
    for index, (file, shown) in enumerate(files):
        if results[index] is None:
            check(cancel)
            results[index] = _found(_read_one(file, shown, limits), found)
    _tell(progress, len(files), len(files))
    return [r for r in results if r is not None]


def _start(
    files: Sequence[Tuple[str, str]], share: int, answers: "queue.Queue[Tuple[int, Optional[str]]]", limits: Thresholds
) -> "Optional[subprocess.Popen[bytes]]":
    command = [sys.executable, "-c", _WORKER, os.path.dirname(os.path.abspath(__file__))]
    try:
        worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    except OSError:
        return None

    def relay() -> None:
        assert worker.stdin is not None and worker.stdout is not None
        try:
            with worker.stdin as stream:
                stream.write(json.dumps([dataclasses.asdict(limits), files]).encode("ascii"))
            for line in worker.stdout:
                if line.endswith(b"\n"):
                    answers.put((share, line.decode("ascii")))
        except (OSError, ValueError):
            pass  # the worker is gone: what it left over is read by the caller
        finally:
            worker.stdout.close()
            answers.put((share, None))

    threading.Thread(target=relay, daemon=True).start()
    return worker


def serve(asked: IO[str], answered: IO[str]) -> None:
    """The worker: thresholds and a list of (file, path) in, lines of lists of packed results out, as JSON."""
    batch: List[Any] = []
    values, files = json.load(asked)
    limits = Thresholds(**values)
    for number, (file, shown) in enumerate(files, 1):
        batch.append(_pack(_read_one(file, shown, limits)))
        if len(batch) == _STEP or number == len(files):
            answered.write(json.dumps(batch) + "\n")
            answered.flush()
            batch = []


def _row(value: Any) -> List[Any]:
    """A dataclass as its values in order: a third of the bytes and time of named fields."""
    return [getattr(value, f.name) for f in dataclasses.fields(value)]


def _pack(result: Result) -> List[Any]:
    """A result for ``_unpack``, which must give it back unchanged."""
    if isinstance(result, BrokenFrame):
        return ["broken", _row(result)]
    return ["frame", [{"calibration": _row(v)} if isinstance(v, FileCalibration) else v for v in _row(result)]]


def _unpack(item: List[Any], shared: Dict[Any, Any]) -> Result:
    """A result out of its row; equal texts, tuples and calibrations become one object in ``shared``."""
    kind, row = item
    return BrokenFrame(*row) if kind == "broken" else Frame(*(_value(v, shared) for v in row))


def _value(value: Any, shared: Dict[Any, Any]) -> Any:
    kind = type(value)
    if kind is str:
        return sys.intern(value)
    if kind is dict:
        value = FileCalibration(*(_value(v, shared) for v in value["calibration"]))
    elif kind is list:
        value = tuple(value)
    else:
        return value
    return shared.setdefault(value, value)
