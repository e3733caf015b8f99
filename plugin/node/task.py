"""One task of a node from NodeODM's call to its exit code: sensorgate's look first, then ODM on what came of it."""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Optional, Sequence

from ...stages.errors import Cancelled
from ...stages.record import dumps, from_plain, to_plain, write_text
from ...stages.thresholds import DEFAULTS
from ..odm.wire import CALIBRATION_INPUT
from ..version import VERSION
from . import options
from .child import Children, Stopped
from .command import parse, read_grammar
from .console import ERROR, INFO, WARNING, say, write_refusal_log
from .decide import AS_IS, REFUSE, after_alignment
from .job import REQUEST, RESULT, Answer, Request
from .runs import Runs, file_of, put_report
from .workplace import IMAGES, Busy, State, Workplace

# EX_DATAERR: a node shows it as "Processing failed (65)", and no program of ODM ends with it.
REFUSED = 65
USAGE = 2
# What a node keeps beside the ground control, and how much of a file tells what it is.
_NO_POINTS = ("geo.txt", "image_groups.txt")
_MOST_TEXT = 1 << 20
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
        command = parse(arguments, grammar).absolute()
    except options.WrongOption as error:
        say(ERROR, str(error))
        return USAGE
    children = Children(DEFAULTS.node_grace_s)
    children.listen()
    try:
        return Task(Runs(odm, grammar, command, children)).run()
    except Stopped:
        say(WARNING, "Stopped. A restart goes on from here.")
        return Cancelled.exit_code
    except Busy as error:
        say(ERROR, str(error))
        return 1


class Task:
    """A command line on one project folder."""

    def __init__(self, runs: Runs) -> None:
        command = runs.command
        self.runs = runs
        self.limits = runs.limits
        self.policy = command.ours.get(options.POLICY, options.AUTO)
        root = None if command.project_path is None else Path(command.project_path, command.name)
        self.place = Workplace(root.absolute()) if root is not None and (root / IMAGES).is_dir() else None

    def run(self) -> int:
        """The whole task."""
        place = self.place
        if place is None or not os.access(place.root, os.W_OK):
            return self.runs.as_asked()
        if place.is_submodel():
            say(INFO, "A piece of a split survey: it was looked at before it was split.")
            return self.runs.as_asked()
        if self.policy == options.OFF and place.load() is None:
            return self.runs.as_asked(self.runs.cameras(place))
        with place.alone(self.limits.node_lock_wait_s):
            return self._in(place)

    def _in(self, place: Workplace) -> int:
        state = place.load() or State()
        state = place.take_back(state)
        if self.policy == options.OFF:
            place.keep(State())
            return self.runs.as_asked(self.runs.cameras(place))
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
            code = self.runs.as_asked(self.runs.cameras(place))
            put_report(place, place.report, answer.stages, code)
            return code
        place.set_aside()
        return self.runs.on_parts(place, state)

    # --- sensorgate's own part ----------------------------------------------------------

    def _request(self, place: Workplace) -> Request:
        ours = self.runs.command.ours
        return Request(
            name=self.runs.command.name,
            policy=self.policy,
            harmonized=(place.root / IMAGES / CALIBRATION_INPUT).is_file(),
            videos=bool(place.videos()),
            gsd_target=ours.get(options.GSD, "finest"),
            align=options.NO_ALIGN not in ours,
            force_gcp=options.FORCE_GCP in ours,
            gcp=self._gcp(place),
            geo=file_of(self.runs.command, "geo", place.root / "geo.txt"),
        )

    def _gcp(self, place: Workplace) -> Optional[str]:
        """The ground control; a node takes the first text file by name for it, whatever it holds."""
        taken = file_of(self.runs.command, "gcp", place.root / "gcp_list.txt")
        if taken is None or holds_points(Path(taken)):
            return taken
        beside = [p for p in sorted(Path(taken).parent.glob("*.txt")) if p.name not in _NO_POINTS and holds_points(p)]
        if not beside or Path(taken).parent == place.root:
            return taken
        say(WARNING, f"{Path(taken).name} holds no ground control points; {beside[0].name} beside it is taken.")
        self.runs.command = self.runs.command.with_value("gcp", str(beside[0]))
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
        code = self.runs.children.run(command, cwd=place.root, env=environment)
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
            return (self.runs.odm / "VERSION").read_text(encoding="utf-8").split("\n")[0].strip()
        except (OSError, ValueError):
            return "?"


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


__all__ = ["REFUSED", "Task", "main"]
