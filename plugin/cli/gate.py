"""``sensorgate gate``: the verdict on a folder before anything is spent on it."""

from __future__ import annotations

import argparse
from typing import Any

from ...stages.finding import ERROR
from ...stages.record import write_text
from .. import pipeline
from ..report.terminal import lines
from .common import (
    Sightings,
    add_input,
    add_output,
    emit_json,
    ground_from,
    gsd_target_from,
    progress_bars,
    screen,
    show,
    thresholds_from,
)

EXIT = {"consistent": 0, "inconsistent": 1, "blocked": 3}


def register(verbs: Any) -> None:
    """Add the verb to the parser."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "gate",
        help="say which cameras made these frames and what would go wrong",
        description="Exit code 0: consistent, safe to queue. 1: inconsistent, sensorgate run can fix it. "
        "3: blocked, no usable frame. 2: wrong usage.",
    )
    add_input(parser)
    parser.add_argument("--html", metavar="FILE", help="write the report as a web page")
    parser.add_argument("--assert", dest="assertions", action="store_true", help="one line per failed assertion")
    add_output(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    """Run the gate and print its story."""
    bars = progress_bars()
    try:
        result = pipeline.gate(
            args.paths,
            pipeline.Settings(
                thresholds=thresholds_from(args),
                calibration=args.calibration,
                calibrations=args.calibrations,
                **ground_from(args.ground),
                look=args.look,
                gsd_target=gsd_target_from(args.gsd_target),
            ),
            progress=bars,
            found=Sightings(bars),
        )
    finally:
        bars.close()
    emit_json(args.json, result.report)
    if args.html:
        from ..report.html import render

        write_text(args.html, render(result.report))
    if args.assertions:
        failed = [f for f in result.report["findings"] if f["severity"] == ERROR]
        show([f"FAILED {f['code']}: {f['message']}" for f in failed] or ["OK consistent"], args)
    else:
        show(lines(result.report, **screen()), args)
    return EXIT[result.report["verdict"]]
