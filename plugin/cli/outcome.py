"""``sensorgate outcome``: what became of an ODM run, and what the router would do."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..odm.outcome import read_outcome
from ..odm.outcome_lines import lines, record
from .common import add_output, emit_json, show, thresholds_from


def register(verbs: Any) -> None:
    """Add the verb to the parser."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "outcome",
        help="say what became of an ODM run and what to do next",
        description="Exit code 0: finished, and its payloads belong together. 1: it failed, or is unproven, or part "
        "of it must be routed again. 3: the folder holds nothing of ODM. 2: wrong usage.",
    )
    parser.add_argument("path", metavar="ODM_PROJECT", help="project folder, finished or not, or an unpacked all.zip")
    parser.add_argument("--thresholds", metavar="FILE.json", help="change thresholds by name")
    add_output(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    """Read the run and print its story."""
    folder = Path(args.path)
    outcome = read_outcome(folder, thresholds_from(args))
    emit_json(args.json, record(outcome))
    show(lines(outcome, folder.absolute().name), args)
    return outcome.exit_code
