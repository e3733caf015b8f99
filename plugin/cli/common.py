"""What all verbs share: arguments, thresholds, output, progress bars, exit codes."""

from __future__ import annotations

import argparse
import json
import logging
import math
import os
import shutil
import sys
from pathlib import Path
from typing import Any, Dict, List, Optional, Set, Tuple, Union

from ...stages.errors import UsageError
from ...stages.frame import BrokenFrame, Frame
from ...stages.grouping import camera_name
from ...stages.progress import Progress
from ...stages.record import dumps, write_text
from ...stages.thresholds import DEFAULTS, Thresholds
from ..report.view import clean_text

LOG = logging.getLogger("sensorgate")
_MAX_SETTINGS_BYTES = 1 << 20
STORY_WIDTH = 100


def add_input(parser: argparse.ArgumentParser) -> None:
    """Arguments of verbs that read imagery."""
    parser.add_argument("paths", nargs="+", metavar="PATH", help="folders or image files")
    parser.add_argument("--calibration", metavar="FILE", help="your own calibration sheet (JSON or CSV); it wins")
    parser.add_argument(
        "--calibrations", metavar="DIR", help="calibrations that earlier surveys proved; run adds what it proves"
    )
    parser.add_argument(
        "--ground", metavar="FILE|METRES", help="elevation model, or the ground's altitude, for heights above ground"
    )
    parser.add_argument(
        "--gsd-target", default="finest", metavar="finest|coarsest|CM", help="ground resolution to bring frames to"
    )
    parser.add_argument(
        "--gsd-trigger", metavar="RATIO", help="bring frames to it when they are farther off than this: 0.05 or 5%%"
    )
    parser.add_argument("--look", action="store_true", help="also look at some pixels for infrared-converted cameras")
    parser.add_argument("--thresholds", metavar="FILE.json", help="change thresholds by name")


def add_output(parser: argparse.ArgumentParser) -> None:
    """Arguments of every verb."""
    parser.add_argument("--json", metavar="FILE", help="write the report as JSON (- for standard output)")
    parser.add_argument("--log", metavar="FILE", help="write the log there instead of standard error")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="say more")


def start_logging(args: argparse.Namespace) -> None:
    """Log to the file asked for, else to standard error; warnings only unless -v."""
    level = [logging.WARNING, logging.INFO, logging.DEBUG][min(args.verbose, 2)]
    if args.log:
        try:
            handler: logging.Handler = logging.FileHandler(args.log, encoding="utf-8")
        except OSError as error:
            raise UsageError(f"Cannot write the log to {args.log}: {error.strerror}.") from error
        level = min(level, logging.INFO)
    else:
        handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
    root = logging.getLogger("sensorgate")
    root.handlers[:] = [handler]
    root.setLevel(level)
    root.propagate = False
    # Libraries warn about single damaged tags; that is for the log, not for the screen.
    logging.captureWarnings(True)
    warned = logging.getLogger("py.warnings")
    warned.handlers[:] = [handler]
    warned.setLevel(logging.WARNING if level <= logging.INFO else logging.ERROR)
    warned.propagate = False


def read_settings(path: str, what: str) -> Dict[str, Any]:
    """Read a small JSON object; anything else is a ``UsageError``."""
    file = Path(path)
    try:
        if file.stat().st_size > _MAX_SETTINGS_BYTES:
            raise UsageError(f"{path} is too large for {what}.")
        value = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"Cannot read {what} from {path}: {error.strerror}.") from error
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path} is not valid JSON: {error}.") from error
    if not isinstance(value, dict):
        raise UsageError(f"{path} must hold a JSON object of names and values.")
    return value


def thresholds_from(args: argparse.Namespace) -> Thresholds:
    """The defaults with the changes of ``--thresholds`` and, where the verb has it, ``--gsd-trigger``."""
    limits = DEFAULTS.replaced(read_settings(args.thresholds, "thresholds")) if args.thresholds else DEFAULTS
    trigger = getattr(args, "gsd_trigger", None)
    return limits if trigger is None else limits.replaced({"gsd_trigger": trigger_from(trigger)})


def trigger_from(text: str) -> float:
    """A ratio above 0 and at most 10, as ``0.05`` or ``5%``."""
    number = text.strip()
    percent = number.endswith("%")
    try:
        value = float(number[:-1] if percent else number) / (100.0 if percent else 1.0)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= 10.0:
        raise UsageError(f"--gsd-trigger takes a ratio such as 0.05 or 5%, not {text!r}.")
    return value


def ground_from(text: Optional[str]) -> Dict[str, Any]:
    """``--ground`` as settings: a number is the ground's altitude in metres, anything else an elevation model."""
    if text is None:
        return {}
    if Path(text).is_file():
        return {"dem": text}
    try:
        value = float(text)
    except ValueError:
        return {"dem": text}
    if not DEFAULTS.ground_min_m <= value <= DEFAULTS.ground_max_m:
        raise UsageError(f"--ground takes an elevation model or the ground's altitude in metres, not {text!r}.")
    return {"ground_m": value}


def gsd_target_from(text: str) -> "str | float":
    """``finest``, ``coarsest`` or a positive number of centimetres."""
    if text in ("finest", "coarsest"):
        return text
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e4:
        raise UsageError(f"--gsd-target takes finest, coarsest or a number of centimetres, not {text!r}.")
    return value


def emit_json(target: Optional[str], value: Any) -> None:
    """Write ``value`` where ``--json`` says."""
    if target is None:
        return
    if target == "-":
        sys.stdout.write(dumps(value))
        return
    try:
        write_text(target, dumps(value))
    except OSError as error:
        raise UsageError(f"Cannot write {target}: {error.strerror}.") from error


def show(lines: List[str], args: argparse.Namespace) -> None:
    """Print the table, unless standard output carries the JSON."""
    if args.json != "-":
        text = "\n".join(lines) + "\n"
        encoding = sys.stdout.encoding or "utf-8"
        sys.stdout.write(text.encode(encoding, "replace").decode(encoding))


def screen() -> Dict[str, Any]:
    """Width and colour of the story on standard output: 100 columns or the terminal's fewer.

    Colour only where a terminal shows it and nobody asked for none (no-color.org).
    """
    if not sys.stdout.isatty():
        return {"width": STORY_WIDTH, "colour": False}
    plain = bool(os.environ.get("NO_COLOR")) or os.environ.get("TERM") == "dumb"
    return {"width": min(STORY_WIDTH, shutil.get_terminal_size((STORY_WIDTH, 24)).columns), "colour": not plain}


class Bars:
    """Progress on standard error: one bar per stage on a terminal, nothing elsewhere."""

    def __init__(self) -> None:
        self._stage = ""
        self._bar: Any = None
        self._live = sys.stderr.isatty()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show ``done`` of ``total`` for ``stage``."""
        if not self._live:
            return
        if stage != self._stage:
            self.close()
            self._stage = stage
            try:
                from tqdm import tqdm

                self._bar = tqdm(total=total or None, desc=f"{stage:<12}", unit="", file=sys.stderr, leave=True)
            except ImportError:
                self._bar = None
        if self._bar is not None:
            self._bar.total = total or None
            self._bar.update(done - self._bar.n)
        else:
            sys.stderr.write(f"\r{stage:<12} {done}/{total or '?'}")
            sys.stderr.flush()

    def say(self, text: str) -> None:
        """Print a line above the bar; nothing where there is no terminal."""
        if not self._live:
            return
        text = clean_text(text)  # names come from files, and a terminal obeys control characters
        if self._bar is not None:
            self._bar.write(text, file=sys.stderr)
        else:
            sys.stderr.write(f"\r{text}\n")

    def close(self) -> None:
        """End the current bar."""
        if self._bar is not None:
            self._bar.close()
        elif self._stage and self._live:
            sys.stderr.write("\n")
        self._bar = None
        self._stage = ""


class Sightings:
    """Says on a terminal what is found while the reading goes on: each new camera once, each bad file."""

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self._cameras: Set[Tuple[str, str, int, int]] = set()

    def __call__(self, result: Union[Frame, BrokenFrame]) -> None:
        """Hear of one file."""
        if isinstance(result, BrokenFrame):
            self._bars.say(f"{result.path}: {result.message}")
            return
        camera = (result.make, result.model, result.width, result.height)
        if camera not in self._cameras:
            self._cameras.add(camera)
            name = camera_name(result.make, result.model)
            self._bars.say(f"camera: {name}, {result.width} x {result.height} px (first in {result.path})")


def progress_bars() -> Bars:
    """A fresh set of bars; usable as a ``Progress``."""
    bars = Bars()
    _: Progress = bars
    return bars
