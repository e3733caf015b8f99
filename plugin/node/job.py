"""Looks at a task's images and prepares its parts, in a process of its own: what goes wrong here stays here."""

from __future__ import annotations

import json
import os
import signal
import time
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple

from ...stages.assemble import groups_of
from ...stages.errors import MissingDependency, SensorgateError
from ...stages.finding import ERROR
from ...stages.record import dumps, from_plain, write_text
from ...stages.thresholds import DEFAULTS
from .. import pipeline
from ..inspection import Inspection, Settings, inspect
from ..report.terminal import lines
from .console import INFO, WARNING, Broadcast, Stage, say
from .decide import PREPARE, Decision, Seen, after_alignment, after_gate, parts_from
from .workplace import FOLDER, IMAGES, Part, Workplace

REQUEST, RESULT, FAULT = "request.json", "result.json", "fault.txt"
GATE_STAGE, HARMONIZE_STAGE = "mixed_gate", "mixed_harmonize"
_HARMONIZING = frozenset(("tones", "bands", "harmonize"))
_WIDTH = 150


@dataclass(frozen=True)
class Request:
    """What the task asks for. Paths of files are absolute; the images are in the task's folder."""

    name: str
    policy: str
    harmonized: bool
    videos: bool
    gsd_target: str
    align: bool
    force_gcp: bool
    gcp: Optional[str] = None
    geo: Optional[str] = None


@dataclass(frozen=True)
class Answer:
    """What came of it. ``parts`` (main first) only where they are prepared."""

    do: str
    reasons: Tuple[str, ...] = ()
    parts: Tuple[Part, ...] = ()
    stages: Tuple[Mapping[str, Any], ...] = ()
    images: int = 0


def settings_of(request: Request) -> Settings:
    """The request in the main job's terms; without a solver on this machine nothing is aligned."""
    target: Any = request.gsd_target
    if target not in ("finest", "coarsest"):
        target = float(target)
    return Settings(
        gsd_target=target, gcp=request.gcp, geo=request.geo, force_gcp=request.force_gcp, align=request.align
    )


def missing_solver() -> str:
    """Why nothing can be aligned here, or an empty text."""
    try:
        pipeline.require_solver("pycolmap")
    except MissingDependency as error:
        return f"{error.what} is not on this node for this machine and Python."
    return ""


def seen_of(inspection: Inspection) -> Seen:
    """What the policy wants to know of the gate."""
    survey = inspection.survey
    used = [f for f in survey.frames if f.excluded is None]
    changed = sum(
        len(a.frames) for a in inspection.assessed.plan.actions if a.scale != 1.0 or a.lut is not None or a.focal_mm
    )
    return Seen(
        verdict=inspection.verdict,
        frames=len(used),
        profiles=len({f.profile for f in used}),
        flights=len({f.flight for f in used}),
        groups=len(groups_of(survey)) if used else 0,
        findings=sum(1 for f in inspection.findings if f.severity != "info"),
        changes=changed,
        errors=tuple(f.message for f in inspection.findings if f.severity == ERROR),
    )


class _Work:
    """One request on its way through the two stages."""

    def __init__(self, place: Workplace, request: Request) -> None:
        self.place = place
        self.request = request
        self.broadcast = Broadcast(request.name)
        self.stages: List[Stage] = []
        self._step = ""
        self._told = 0.0
        self._from = 0.0
        self._to = DEFAULTS.node_gate_percent

    def begin(self, name: str) -> Stage:
        stage = Stage(name).begin()
        self.stages.append(stage)
        return stage

    def progress(self, what: str, done: int, total: int) -> None:
        """Hear of the stages; each step is said once, the percentages go out."""
        step = "gate" if what == "read" else "harmonize" if what in _HARMONIZING else "align"
        if step != self._step:
            self._step = step
            texts = {
                "gate": "gate: reading the images",
                "harmonize": "harmonize: writing frames that can be matched",
                "align": "align: proving which frames belong together",
            }
            self.stages[-1].say(INFO, texts[step])
            self._told = time.monotonic()
        elif time.monotonic() - self._told > DEFAULTS.node_silence_s:
            self._told = time.monotonic()
            say(INFO, f"{step}: {what}, {done} of {total}" if total else f"{step}: {what}")
        share = done / total if total else 0.0
        # Of the second stage the copies take about half, the alignment the rest.
        begin, size = {"gate": (0.0, 1.0), "harmonize": (0.0, 0.5), "align": (0.5, 0.5)}[step]
        self.broadcast(self._from + (self._to - self._from) * (begin + size * min(1.0, share)))

    def gate(self) -> Tuple[Inspection, Decision]:
        stage = self.begin(GATE_STAGE)
        settings = settings_of(self.request)
        inspection = inspect([IMAGES], settings, progress=self.progress)
        report = pipeline.gate([IMAGES], settings, inspection=inspection).report
        self._story(stage, report)
        self._keep_report(report)
        decision = after_gate(
            self.request.policy, seen_of(inspection), harmonized=self.request.harmonized, videos=self.request.videos
        )
        for reason in decision.reasons:
            stage.say(INFO, f"gate: {reason}")
        stage.end()
        self.broadcast(self._to)
        return inspection, decision

    def prepare(self, inspection: Inspection) -> Tuple[Decision, Tuple[Part, ...]]:
        stage = self.begin(HARMONIZE_STAGE)
        self._step, self._from, self._to = "", self._to, DEFAULTS.node_ahead_percent
        settings = inspection.settings
        lacking = missing_solver() if settings.align else ""
        if lacking:
            stage.say(WARNING, f"align: {lacking} The frames are grouped by their metadata; nothing is proven.")
            inspection = replace(inspection, settings=replace(settings, align=False))
        result = pipeline.run(
            [IMAGES],
            Path(os.path.relpath(self.place.run)),
            inspection.settings,
            resume=True,
            progress=self.progress,
            inspection=inspection,
        )
        parts = parts_from(result.report)
        decision = after_alignment(self.request.policy, parts)
        for part in parts:
            stage.say(INFO, f"route: {part.name}: {part.frames} frames, {part.route}")
            for reason in part.reasons:
                stage.say(INFO, f"route:   {reason}")
        stage.end()
        self.broadcast(self._to)
        return decision, parts

    def _story(self, stage: Stage, report: Dict[str, Any]) -> None:
        for line in lines(report, width=_WIDTH):
            if line.strip() and not line.startswith("Next:"):
                stage.say(INFO, line)

    def _keep_report(self, report: Dict[str, Any]) -> None:
        write_text(self.place.report / "report.json", dumps(report))
        try:
            from ..report.html import render

            write_text(self.place.report / "report.html", render(report))
        except MissingDependency as error:
            self.stages[-1].say(WARNING, f"There is no report.html: {error.what} is not on this node.")


def perform(place: Workplace, request: Request) -> Answer:
    """Look, decide and prepare; the caller's working folder is the task's."""
    work = _Work(place, request)
    inspection, decision = work.gate()
    parts: Tuple[Part, ...] = ()
    if decision.do == PREPARE:
        decision, parts = work.prepare(inspection)
    images = sum(1 for f in inspection.survey.frames if f.excluded is None)
    return Answer(decision.do, decision.reasons, parts, tuple(s.entry() for s in work.stages), images)


def main() -> int:
    """Take the request from our folder in the working folder, leave the answer beside it."""

    def stop(number: int, frame: Any) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, stop)
    place = Workplace(Path.cwd())
    request = from_plain(Request, json.loads((place.own / REQUEST).read_text(encoding="utf-8")))
    try:
        answer = perform(place, request)
    except KeyboardInterrupt:
        return 130
    except SensorgateError as error:
        say(WARNING, f"sensorgate: {error}")
        return error.exit_code
    except Exception as error:
        say(WARNING, f"sensorgate: an unexpected fault ({type(error).__name__}: {error}), noted in {FOLDER}/{FAULT}.")
        write_text(place.own / FAULT, traceback.format_exc())
        return 1
    write_text(place.own / RESULT, dumps(answer))
    return 0
