"""A task's folder: what of it is the upload, what is ODM's, what is ours, and how a part's products come to its root.

ODM works in the folder of the part that it is given. When it is done, what it
made is moved to the task's root, where a node looks for products; before a
restart it is moved back, because ODM goes on from what it finds.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import shutil
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from ...stages.errors import SensorgateError
from ...stages.record import dumps, from_plain, write_text
from ..odm.folder import EXTENSIONS
from ..odm.project import OURS

FOLDER = "sensorgate_node"
IMAGES = "images"
REPORT = "odm_report/sensorgate"
TASK, MAIN = "task", "main"

# What stands in a part's folder before ODM starts; everything else there was made by ODM.
_INPUTS = frozenset((IMAGES, OURS, "gcp_list.txt", "geo.txt", "image_groups.txt"))
# What ODM leaves at a project's root.
_RESULT = re.compile(
    r"odm_.*|opensfm|submodels|entwine_pointcloud|potree_pointcloud|3d_tiles|.*_tiles|mve|pmvs|"
    r"(images|cameras|log|options)\.json|benchmark\.txt|img_list\.txt|.*_done\.txt"
)
_VIDEOS = (".mp4", ".mov", ".lrv", ".ts")
# What a node takes into its archive, as far as a part may have it.
PRODUCTS = (
    "odm_orthophoto",
    "odm_georeferencing",
    "odm_texturing",
    "odm_dem",
    "odm_report",
    "entwine_pointcloud",
    "orthophoto_tiles",
    "dsm_tiles",
    "dtm_tiles",
    "3d_tiles",
    "images.json",
    "cameras.json",
    "log.json",
)


@dataclass(frozen=True)
class Part:
    """One project of a task, as the alignment left it."""

    name: str
    spectrum: str
    route: str
    frames: int
    captures: int
    reasons: Tuple[str, ...] = ()
    options: Tuple[Mapping[str, Any], ...] = ()


@dataclass(frozen=True)
class State:
    """What an earlier run of the task found and where its products are.

    ``home`` is ``task`` where ODM worked at the root, ``main`` where it
    worked in the main part; ``moved`` are the names that were brought from
    there to the root. ``stages`` are entries of ``log.json``.
    """

    digest: str = ""
    home: str = TASK
    moved: Tuple[str, ...] = ()
    parts: Tuple[Part, ...] = ()
    stages: Tuple[Mapping[str, Any], ...] = ()


class Busy(SensorgateError):
    """Another run of the same task has not ended."""


@dataclass(frozen=True)
class Workplace:
    """The folder of one task."""

    root: Path

    @property
    def own(self) -> Path:
        """Our folder in it."""
        return self.root / FOLDER

    @property
    def run(self) -> Path:
        """Where the main job writes."""
        return self.own / "run"

    @property
    def report(self) -> Path:
        """The gate's report."""
        return self.own / "report"

    def part(self, name: str) -> Path:
        """A part's folder."""
        return self.run / "projects" / name

    def load(self) -> Optional[State]:
        """What an earlier run left, or ``None``."""
        try:
            return from_plain(State, json.loads((self.own / "state.json").read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def keep(self, state: State) -> None:
        """Keep the state for a restart."""
        write_text(self.own / "state.json", dumps(state))

    @contextlib.contextmanager
    def alone(self, patience_s: float) -> Iterator[None]:
        """Hold the task; an earlier run that is still ending is waited for. Raises ``Busy``."""
        import fcntl

        self.own.mkdir(exist_ok=True)
        with open(self.own / "lock", "w", encoding="utf-8") as stream:
            until = time.monotonic() + patience_s
            while True:
                try:
                    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except OSError as error:
                    if error.errno not in (errno.EAGAIN, errno.EACCES):
                        break  # a disk that knows no locks
                    if time.monotonic() > until:
                        raise Busy(
                            "An earlier run of this task is still busy in its folder. Try again later."
                        ) from None
                time.sleep(0.2)
            yield

    def images(self) -> Tuple[str, ...]:
        """Names of the image files, sorted."""
        return tuple(n for n in self._listed() if os.path.splitext(n)[1].lower() in EXTENSIONS)

    def videos(self) -> Tuple[str, ...]:
        """Names of the films, from which ODM takes frames by itself."""
        return tuple(n for n in self._listed() if os.path.splitext(n)[1].lower() in _VIDEOS)

    def _listed(self) -> List[str]:
        try:
            return sorted(os.listdir(self.root / IMAGES))
        except OSError:
            return []

    def is_submodel(self) -> bool:
        """Whether an ODM elsewhere sent this as a piece of a split survey, with a reconstruction begun."""
        solver = self.root / "opensfm"
        if (solver / "split_merge_stop_at_reconstruction.txt").exists() or (solver / "exif" / "empty").exists():
            return True
        return (solver / "camera_models.json").exists() and not (
            (self.root / "images.json").exists() or (self.own / "state.json").exists()
        )

    def digest(self, settings: Mapping[str, Any], files: Sequence[Optional[str]]) -> str:
        """What the parts depend on: names, sizes and times of the images, contents of the files, settings."""
        told = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
        for name in self._listed():
            with contextlib.suppress(OSError):
                about = os.stat(self.root / IMAGES / name)
                told.update(f"{name}\0{about.st_size}\0{about.st_mtime_ns}\n".encode("utf-8", "backslashreplace"))
        for file in files:
            told.update(b"\0-")
            if file is not None:
                with contextlib.suppress(OSError):
                    told.update(Path(file).read_bytes())
        return told.hexdigest()

    def has(self, parts: Sequence[Part]) -> bool:
        """Whether all parts are still there."""
        return bool(parts) and all((self.part(p.name) / IMAGES).is_dir() for p in parts)

    def take_back(self, state: State) -> State:
        """Bring the products at the root back to the part where ODM made them."""
        shutil.rmtree(self.root / REPORT, ignore_errors=True)
        if state.home == MAIN and state.parts:
            folder = self.part(state.parts[0].name)
            for name in state.moved:
                if (self.root / name).exists() and folder.is_dir():
                    _move(self.root / name, folder / name)
        state = replace(state, home=TASK, moved=())
        self.keep(state)
        return state

    def set_aside(self) -> None:
        """Put what an ODM made at the root before into our folder, so that two runs never mix."""
        names = [n for n in sorted(os.listdir(self.root)) if _RESULT.fullmatch(n)]
        if not names:
            return
        shelf = self.own / "earlier"
        shelf.mkdir(parents=True, exist_ok=True)
        for name in names:
            _move(self.root / name, shelf / name)

    def bring_up(self, state: State) -> State:
        """Move what ODM made in the main part to the task's root."""
        folder = self.part(state.parts[0].name)
        names = tuple(n for n in sorted(os.listdir(folder)) if n not in _INPUTS)
        state = replace(state, home=MAIN, moved=tuple(sorted({*state.moved, *names})))
        self.keep(state)
        for name in names:
            _move(folder / name, self.root / name)
        return state

    def put_report(self, source: Path, names: Sequence[str] = ("report.json", "report.html", "plan.json")) -> None:
        """Put the report where a node's archive takes it along."""
        target = self.root / REPORT
        target.mkdir(parents=True, exist_ok=True)
        for name in names:
            if (source / name).is_file():
                shutil.copyfile(source / name, target / name)

    def put_products(self, part: Part) -> int:
        """Link a part's products below the report; returns the number of files."""
        count = 0
        for name in PRODUCTS:
            source = self.part(part.name) / name
            target = self.root / REPORT / part.name / name
            if source.is_dir():
                for folder, _, files in os.walk(source):
                    for file in files:
                        origin = Path(folder) / file
                        count += _link(origin, target / origin.relative_to(source))
            elif source.is_file():
                count += _link(source, target)
        return count


def _move(source: Path, target: Path) -> None:
    if target.is_dir() and not target.is_symlink():
        shutil.rmtree(target)
    elif target.exists() or target.is_symlink():
        target.unlink()
    shutil.move(str(source), str(target))


def _link(source: Path, target: Path) -> int:
    if source.is_symlink() or not source.is_file():
        return 0
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
    return 1


def image_groups(text: str, renamed: Mapping[str, str]) -> str:
    """The lines of an ``image_groups.txt`` for the images of one part, with the names that they have there."""
    lines = []
    for line in text.splitlines():
        image, blank, group = line.strip().partition(" ")
        if blank and image in renamed:
            lines.append(f"{renamed[image]} {group.strip()}\n")
    return "".join(lines)


def names_in(report: Mapping[str, Any], part: str) -> Dict[str, str]:
    """Uploaded name -> name in the part, out of the main job's report."""
    return {
        str(f["path"]).rsplit("/", 1)[-1]: str(f["output"]).rsplit("/", 1)[-1]
        for f in report.get("frames", ())
        if f.get("subproject") == part and f.get("output")
    }
