"""One task of a node from NodeODM's call to its exit code: sensorgate's look first, then ODM on what came of it."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from ...stages.errors import Cancelled
from ...stages.record import dumps, from_plain, to_plain, write_text
from ...stages.thresholds import DEFAULTS, Thresholds
from ..odm.project import CALIBRATION, OURS
from ..odm.wire import CALIBRATION_INPUT
from ..version import VERSION
from . import options
from .child import Children, Heard, Stopped
from .command import Command, Grammar, Word, parse, read_grammar, spelled
from .console import ERROR, INFO, WARNING, Broadcast, prepend_stages, say, write_refusal_log
from .decide import AS_IS, REFUSE, after_alignment
from .job import REQUEST, RESULT, Answer, Request
from .workplace import IMAGES, Busy, Part, State, Workplace, image_groups, names_in

# EX_DATAERR: a node shows it as "Processing failed (65)", and no program of ODM ends with it.
REFUSED = 65
USAGE = 2
# What a node keeps beside the ground control, and how much of a file tells what it is.
_NO_POINTS = ("geo.txt", "image_groups.txt")
_MOST_TEXT = 1 << 20
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
_BOOT = (
    "import importlib, json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "sys.exit(importlib.import_module(sys.argv[2]).main())"
)


def main(arguments: Sequence[str], home: Optional[Path] = None) -> int:
    """Run the task that a node's command line describes and return its exit code.

    ODM's own exit code where ODM ran; 65 where the policy refuses the
    task, 2 for a wrong value of one of our options, 130 when it was stopped.
    """
    odm = home if home is not None else Path(os.environ["SENSORGATE_ODM"])
    grammar = read_grammar(odm)
    try:
        command = parse(arguments, grammar)
    except options.WrongOption as error:
        say(ERROR, str(error))
        return USAGE
    children = Children(DEFAULTS.node_grace_s)
    children.listen()
    try:
        return Task(odm, grammar, command, children).run()
    except Stopped:
        say(WARNING, "Stopped. A restart goes on from here.")
        return Cancelled.exit_code
    except Busy as error:
        say(ERROR, str(error))
        return 1


@dataclass(frozen=True)
class _Odm:
    """ODM's run of one part: its folder as ODM is told it, and its share of the task's progress."""

    project_path: str
    name: str
    words: Tuple[Word, ...]


class Task:
    """A command line on one project folder."""

    def __init__(
        self, odm: Path, grammar: Grammar, command: Command, children: Children, limits: Thresholds = DEFAULTS
    ) -> None:
        self.odm = odm
        self.grammar = grammar
        self.command = command
        self.children = children
        self.limits = limits
        self.policy = command.ours.get(options.POLICY, options.AUTO)
        root = None if command.project_path is None else Path(command.project_path, command.name)
        self.place = Workplace(root.absolute()) if root is not None and (root / IMAGES).is_dir() else None

    def run(self) -> int:
        """The whole task."""
        place = self.place
        if place is None or not os.access(place.root, os.W_OK):
            return self._odm_as_asked()
        if place.is_submodel():
            say(INFO, "A piece of a split survey: it was looked at before it was split.")
            return self._odm_as_asked()
        if self.policy == options.OFF and place.load() is None:
            return self._odm_as_asked(self._cameras(place))
        with place.alone(self.limits.node_lock_wait_s):
            return self._in(place)

    def _in(self, place: Workplace) -> int:
        state = place.load() or State()
        state = place.take_back(state)
        if self.policy == options.OFF:
            place.keep(State())
            return self._odm_as_asked(self._cameras(place))
        request = self._request(place)
        digest = self._digest(place, request)
        if self.policy != options.REPORT and state.digest == digest and place.has(state.parts):
            say(INFO, "The frames were prepared by an earlier run of this task and have not changed.")
            decision = after_alignment(self.policy, state.parts)
            answer: Optional[Answer] = Answer(decision.do, decision.reasons, state.parts, state.stages)
        else:
            _clear(place)
            answer = self._look(place, request)
        if answer is None:
            if self.policy == options.STRICT:
                why = "sensorgate could not look at the frames, so nothing is proven. The lines above say why."
                return self._refuse(place, Answer(REFUSE, (why,)))
            say(WARNING, "sensorgate could not look at the frames; ODM takes them as they are.")
            answer = Answer(AS_IS)
        if answer.parts:
            state = State(digest=digest, parts=answer.parts, stages=answer.stages)
        else:
            state = State(stages=answer.stages)
        place.keep(state)
        if answer.do == REFUSE:
            return self._refuse(place, answer)
        if answer.do == AS_IS:
            code = self._odm_as_asked(self._cameras(place))
            self._report(place, place.report, answer.stages, code)
            return code
        place.set_aside()
        return self._parts(place, state)

    # --- sensorgate's own part ----------------------------------------------------------

    def _request(self, place: Workplace) -> Request:
        ours = self.command.ours
        return Request(
            name=self.command.name,
            policy=self.policy,
            harmonized=(place.root / IMAGES / CALIBRATION_INPUT).is_file(),
            videos=bool(place.videos()),
            gsd_target=ours.get(options.GSD, "finest"),
            align=options.NO_ALIGN not in ours,
            force_gcp=options.FORCE_GCP in ours,
            gcp=self._gcp(place),
            geo=self._file("geo", place.root / "geo.txt"),
        )

    def _file(self, option: str, usual: Path) -> Optional[str]:
        """What ODM would take: the file that is named, else the one at the project's root."""
        named = self.command.value(option)
        if named is not None:
            return os.path.abspath(named) if os.path.isfile(named) else None
        return str(usual) if usual.is_file() else None

    def _gcp(self, place: Workplace) -> Optional[str]:
        """The ground control; a node takes the first text file by name for it, whatever it holds."""
        taken = self._file("gcp", place.root / "gcp_list.txt")
        if taken is None or holds_points(Path(taken)):
            return taken
        beside = [p for p in sorted(Path(taken).parent.glob("*.txt")) if p.name not in _NO_POINTS and holds_points(p)]
        if not beside or Path(taken).parent == place.root:
            return taken
        say(WARNING, f"{Path(taken).name} holds no ground control points; {beside[0].name} beside it is taken.")
        self.command = self.command.with_value("gcp", str(beside[0]))
        return str(beside[0])

    def _digest(self, place: Workplace, request: Request) -> str:
        solver = importlib.util.find_spec("pycolmap") is not None
        settings = {
            **to_plain(replace(request, policy="", name="", gcp=None, geo=None)),
            "version": VERSION,
            "solver": solver,
        }
        return place.digest(settings, (request.gcp, request.geo))

    def _look(self, place: Workplace, request: Request) -> Optional[Answer]:
        """Let the other process look; ``None`` where it could not."""
        result = place.own / RESULT
        if result.exists():
            result.unlink()
        write_text(place.own / REQUEST, dumps(request))
        environment = dict(os.environ, PYTHONPATH=os.pathsep.join(p for p in sys.path if p))
        module = f"{__package__}.job"
        command = [sys.executable, "-B", "-c", _BOOT, json.dumps([p for p in sys.path if p]), module]
        code = self.children.run(command, cwd=place.root, env=environment)
        if code == 137:
            say(WARNING, "sensorgate ran out of memory, or was killed.")
        try:
            return from_plain(Answer, json.loads(result.read_text(encoding="utf-8"))) if code == 0 else None
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def _refuse(self, place: Workplace, answer: Answer) -> int:
        say(ERROR, f"Refused by {options.POLICY} {self.policy}: this task was not processed.")
        for reason in answer.reasons:
            say(ERROR, reason)
        say(
            ERROR,
            "What to do: send each camera's frames as a task of its own, "
            f"or restart this task with {options.POLICY} auto, which splits them.",
        )
        message = " ".join(answer.reasons)
        write_refusal_log(
            place.root / "log.json",
            answer.stages,
            version=self._version(),
            images=answer.images,
            code=REFUSED,
            message=message,
        )
        place.put_report(place.report)
        if answer.parts:
            place.put_report(place.run)
        return REFUSED

    def _version(self) -> str:
        try:
            return (self.odm / "VERSION").read_text(encoding="utf-8").split("\n")[0].strip()
        except (OSError, ValueError):
            return "?"

    def _report(self, place: Workplace, source: Path, stages: Sequence[Mapping[str, Any]], code: int) -> None:
        """Our stages into ODM's log and our report into the archive."""
        prepend_stages(place.root / "log.json", stages)
        if code == 0 or (place.root / "odm_report").is_dir():
            place.put_report(source)

    # --- ODM -----------------------------------------------------------------------------

    def _odm(self, words: Sequence[str], heard: Heard) -> int:
        return self.children.run([str(self.odm / "run.sh"), *words], cwd=self.odm, heard=heard)

    def _odm_as_asked(self, more: Sequence[str] = ()) -> int:
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

    def _cameras(self, place: Workplace) -> List[str]:
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

    def _parts(self, place: Workplace, state: State) -> int:
        """ODM on the main part, its products where a node wants them, then the others."""
        main, others = state.parts[0], state.parts[1:]
        alone = options.MAIN_ONLY in self.command.ours or not others
        total = sum(p.frames for p in state.parts) if not alone else main.frames
        if others:
            say(INFO, f"ODM takes {main.name} first ({main.frames} frames); its products are those of this task.")
        run = self._part(place, main, alone)
        code = self._run_part(run, 0, main.frames, total, alone)
        state = place.bring_up(state)
        self._report(place, place.run, state.stages, code)
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
        write_text(place.root / "odm_report/sensorgate/parts.json", dumps(told))
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
        given = self._file("split-image-groups", place.root / "image_groups.txt")
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


def holds_points(file: Path) -> bool:
    """Whether a line of the file is one of ground control: five numbers and an image's name."""
    try:
        with open(file, encoding="utf-8", errors="replace") as stream:
            lines = stream.read(_MOST_TEXT).splitlines()
    except OSError:
        return False
    for line in lines:
        words = line.split()
        try:
            if len([float(w) for w in words[:5]]) == 5 and len(words) > 5:
                return True
        except ValueError:
            continue
    return False


def _clear(place: Workplace) -> None:
    """Parts made of other images or settings go, an interrupted main job stays for its resumption."""
    import shutil

    if (place.run / "projects").exists():
        shutil.rmtree(place.run, ignore_errors=True)


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


__all__ = ["REFUSED", "Task", "main"]
