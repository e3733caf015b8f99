"""``sensorgate run``: from a mixed folder to ODM projects."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, List, Sequence

from ...stages.errors import UsageError
from .. import pipeline
from ..plan_file import read_plan
from ..replay import settings_of, told
from ..report.terminal import lines
from .common import (
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


def register(verbs: Any) -> None:
    """Add the verb to the parser."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "run",
        help="write one ODM project for each group of frames that belongs together",
        description="Exit code 0: everything is placed and proceeds. 1: something is isolated, unproven or left out. "
        "3: nothing was written. 2: wrong usage. 4: something is not installed. 130: interrupted.",
    )
    add_input(parser)
    parser.add_argument("--out", required=True, metavar="DIR", help="an empty or new folder for the projects")
    parser.add_argument("--gcp", metavar="FILE", help="ground control points in ODM's gcp_list.txt format")
    parser.add_argument(
        "--check-points",
        metavar="NAMES|N",
        help="ground control to hold out and measure: names, or how many (points named check... always are)",
    )
    parser.add_argument("--force-gcp", action="store_true", help="let ground control replace GPS where it is enough")
    parser.add_argument("--geo", metavar="FILE", help="positions in ODM's geo.txt format")
    parser.add_argument(
        "--control-points", metavar="FILE", help="points seen in two bands of a rig (JSON or CSV); they win"
    )
    parser.add_argument("--engine", choices=("pycolmap", "colmap"), default="pycolmap", help="solver of the alignment")
    parser.add_argument(
        "--plan", metavar="FILE", help="do the run of this plan.json again, with its settings, and say what differs"
    )
    parser.add_argument("--max-dim", type=int, metavar="PX", help="longer side of the frames in the alignment")
    parser.add_argument("--no-align", action="store_true", help="write projects by metadata alone (unproven)")
    parser.add_argument("--resume", action="store_true", help="go on with an interrupted run")
    parser.add_argument("--work", metavar="DIR", help="scratch folder (default: .work in the output folder)")
    add_output(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    """Run the main job and print its story."""
    if args.max_dim is not None and not 200 <= args.max_dim <= 20000:
        raise UsageError(f"--max-dim takes 200 to 20000 pixels, not {args.max_dim}.")
    settings = pipeline.Settings(
        thresholds=thresholds_from(args),
        calibration=args.calibration,
        calibrations=args.calibrations,
        **ground_from(args.ground),
        look=args.look,
        gsd_target=gsd_target_from(args.gsd_target),
        gcp=args.gcp,
        force_gcp=args.force_gcp,
        check_points=args.check_points,
        geo=args.geo,
        engine=args.engine,
        max_dim=args.max_dim,
        align=not args.no_align,
        control_points=args.control_points,
    )
    plan = read_plan(args.plan) if args.plan else None
    if plan is not None:
        settings = settings_of(plan, settings, _folders(args.paths))
    bars = progress_bars()
    try:
        result = pipeline.run(
            args.paths,
            Path(args.out),
            settings,
            work=Path(args.work) if args.work else None,
            resume=args.resume,
            progress=bars,
            plan=plan,
        )
    finally:
        bars.close()
    emit_json(args.json, result.report)
    show(lines(result.report, **screen(), out=args.out), args)
    if plan is not None:
        show(["", *told(result.report["replay"])], args)
    if args.json != "-":
        print(f"\nReport: {Path(args.out) / 'report.html'}")
    return result.exit_code


def _folders(paths: Sequence[str]) -> List[Path]:
    """Where the small files of a survey usually lie: in its folder, or beside it."""
    given = [Path(p) for p in paths]
    return [folder for path in given for folder in (path, path.resolve().parent)]
