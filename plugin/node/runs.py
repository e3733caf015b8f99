"""ODM's runs within one task: on the images as they came, or part by part with each part's options."""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.record import dumps, write_text
from ...stages.thresholds import DEFAULTS, Thresholds
from ..odm.project import CALIBRATION, OURS
from ..odm.wire import CALIBRATION_INPUT
from . import options
from .child import Children, Heard
from .command import Command, Grammar, Word, spelled
from .console import ERROR, INFO, WARNING, Broadcast, prepend_stages, say
from .workplace import IMAGES, REPORT, Part, State, Workplace, image_groups, names_in

_ANSI = re.compile(r"\x1b\[[0-9;]*m")
_FINISHED = re.compile(r"Finished (\w+) stage")
# Where ODM's progress stands at the end of each stage of a survey that is not split.
_PERCENT = {
    "dataset": 5.0,
    "opensfm": 25.0,
    "openmvs": 50.0,
    "odm_filterpoints": 52.0,
    "odm_meshing": 60.0,
    "mvs_texturing": 70.0,
    "odm_georeferencing": 80.0,
    "odm_dem": 90.0,
    "odm_orthophoto": 98.0,
    "odm_report": 99.0,
    "odm_postprocess": 100.0,
}


@dataclass(frozen=True)
class _Odm:
    """ODM's run of one part: its folder as ODM is told it, and its share of the task's progress."""

    project_path: str
    name: str
    words: Tuple[Word, ...]


class Runs:
    """Starts ODM for one command line."""

    def __init__(
        self, odm: Path, grammar: Grammar, command: Command, children: Children, limits: Thresholds = DEFAULTS
    ) -> None:
        self.odm = odm
        self.grammar = grammar
        self.command = command
        self.children = children
        self.limits = limits

    def _odm(self, words: Sequence[str], heard: Heard) -> int:
        return self.children.run([str(self.odm / "run.sh"), *words], cwd=self.odm, heard=heard)

    def as_asked(self, more: Sequence[str] = ()) -> int:
        """ODM with its own words, as if we were not there, and with a calibration that came with the images."""
        words = [part for word in self.command.words for part in word.spelled()]
        return self._odm([*more, *words], self._passing_on(lambda percent: percent))

    def _passing_on(self, of_task: Callable[[float], float]) -> Heard:
        """Hear of the ends of ODM's stages and tell every node how far the task is."""
        broadcast = Broadcast(self.command.name)

        def heard(line: str) -> None:
            found = _FINISHED.search(_ANSI.sub("", line))
            if found and found.group(1) in _PERCENT:
                broadcast(of_task(_PERCENT[found.group(1)]))

        return heard

    def cameras(self, place: Workplace) -> List[str]:
        """``--cameras`` with the calibration that was sent among the images, where nobody gave another."""
        file = place.root / IMAGES / CALIBRATION_INPUT
        if not file.is_file() or self.command.has("cameras"):
            return []
        try:
            if file.stat().st_size > self.limits.node_calibration_bytes:
                raise ValueError("it is too large")
            cameras = json.loads(file.read_text(encoding="utf-8"))
            if not isinstance(cameras, dict):
                raise ValueError("it is no list of cameras")
        except (OSError, ValueError, RecursionError) as error:
            say(WARNING, f"{CALIBRATION_INPUT} cannot be used: {error}.")
            return []
        if not cameras:
            return []
        say(INFO, f"The calibration of {len(cameras)} cameras came with the images and is given to ODM.")
        return ["--cameras", str(file)]

    def on_parts(self, place: Workplace, state: State) -> int:
        """ODM on the main part, its products where a node wants them, then the others."""
        main, others = state.parts[0], state.parts[1:]
        alone = options.MAIN_ONLY in self.command.ours or not others
        total = sum(p.frames for p in state.parts) if not alone else main.frames
        if others:
            say(INFO, f"ODM takes {main.name} first ({main.frames} frames); its products are those of this task.")
        run = self._part(place, main, alone)
        code = self._run_part(run, 0, main.frames, total, alone)
        state = place.bring_up(state)
        put_report(place, place.run, state.stages, code)
        if code != 0:
            say(ERROR, f"ODM ended with code {code} on {main.name}. The report is in {place.own.name}/run/report.html.")
            return code
        done = main.frames
        told = [_told(main, 0, True)]
        for part in others:
            told.append(_told(part, None, False))
            if not alone:
                say(INFO, f"ODM takes {part.name} ({part.frames} frames); products go below odm_report/sensorgate.")
                outcome = self._run_part(self._part(place, part, False), done, part.frames, total, False)
                done += part.frames
                prepend_stages(place.part(part.name) / "log.json", state.stages)
                files = place.put_products(part)
                told[-1] = _told(part, outcome, False)
                if outcome != 0:
                    say(WARNING, f"ODM ended with code {outcome} on {part.name}; {files} files of it are kept.")
        write_text(place.root / REPORT / "parts.json", dumps(told))
        for line in _summary(told):
            say(INFO, line)
        return 0

    def _part(self, place: Workplace, part: Part, alone: bool) -> _Odm:
        """ODM's words for one part."""
        folder = place.part(part.name)
        words = self._words(place, part)
        if alone:
            # Under the task's own name ODM's progress reaches the node as it is.
            link = place.run / "projects" / self.command.name
            if link.is_symlink() or not link.exists():
                try:
                    if not link.is_symlink():
                        link.symlink_to(folder.name, target_is_directory=True)
                    return _Odm(str(link.parent), link.name, words)
                except OSError:
                    pass  # a disk without links: progress goes stage by stage
        return _Odm(str(folder.parent), folder.name, words)

    def _words(self, place: Workplace, part: Part) -> Tuple[Word, ...]:
        folder = place.part(part.name)
        lens = self.command.value("camera-lens")
        own_cameras = self.command.has("cameras") or lens not in (None, "auto")
        drop = ["gcp", "geo", "split-image-groups"]
        if options.FORCE_GCP in self.command.ours and (folder / "gcp_list.txt").is_file():
            drop += ["use-exif", "force-gps"]
        more: List[Word] = []
        for option in part.options:
            name, value = str(option["name"]), option["value"]
            if f"--{name}" not in self.grammar.names or value is False:
                continue
            if own_cameras and name == "use-fixed-camera-params":
                say(INFO, "The cameras or the lens were given with the task, so nothing is held fixed by us.")
                continue
            drop.append(name)
            more.append(Word(f"--{name}", None if value is True else str(value)))
        calibration = folder / CALIBRATION
        if calibration.is_file() and not own_cameras:
            more.append(Word("--cameras", str(calibration)))
        groups = self._groups(place, part)
        if groups is not None:
            more.append(Word("--split-image-groups", groups))
        return (*self.command.without(*drop), *more)

    def _groups(self, place: Workplace, part: Part) -> Optional[str]:
        """The user's groups for a split, under the names that the images have in this part."""
        given = file_of(self.command, "split-image-groups", place.root / "image_groups.txt")
        if given is None:
            return None
        try:
            report = json.loads((place.run / "report.json").read_text(encoding="utf-8"))
            text = Path(given).read_text(encoding="utf-8")
        except (OSError, ValueError):
            return None
        target = place.part(part.name) / OURS / "image_groups.txt"
        write_text(target, image_groups(text, names_in(report, part.name)))
        return str(target)

    def _run_part(self, run: _Odm, done: int, frames: int, total: int, alone: bool) -> int:
        ahead = self.limits.node_ahead_percent

        def of_task(percent: float) -> float:
            # ODM's first stage ends at more than ours take, so a part that is alone needs no scale.
            return percent if alone else ahead + (100.0 - ahead) * (done + frames * percent / 100.0) / max(1, total)

        return self._odm(spelled(run.words, run.project_path, run.name), self._passing_on(of_task))


def put_report(place: Workplace, source: Path, stages: Sequence[Mapping[str, Any]], code: int) -> None:
    """Our stages into ODM's log and our report into the archive."""
    prepend_stages(place.root / "log.json", stages)
    if code == 0 or (place.root / "odm_report").is_dir():
        place.put_report(source)


def file_of(command: Command, option: str, usual: Path) -> Optional[str]:
    """What ODM would take for an option: the file that is named, else the one at the project's root."""
    named = command.value(option)
    if named is not None:
        return os.path.abspath(named) if os.path.isfile(named) else None
    return str(usual) if usual.is_file() else None


def _told(part: Part, code: Optional[int], main: bool) -> Dict[str, Any]:
    return {
        "name": part.name,
        "main": main,
        "frames": part.frames,
        "route": part.route,
        "reasons": list(part.reasons),
        "exit_code": code,
    }


def _summary(told: Sequence[Mapping[str, Any]]) -> List[str]:
    """What became of each part, for the last lines of the console."""
    if len(told) < 2:
        return []
    result = [f"This task held {len(told)} parts. The report is odm_report/sensorgate/report.html in the archive."]
    for part in told:
        if part["main"]:
            became = "these are the products of the task"
        elif part["exit_code"] is None:
            became = "not processed, as asked"
        elif part["exit_code"] == 0:
            became = f"products in odm_report/sensorgate/{part['name']}"
        else:
            became = f"ODM could not process it (code {part['exit_code']})"
        result.append(f"  {part['name']}: {part['frames']} frames, {part['route']}: {became}")
    return result
