"""``sensorgate fuse``: the sub-projects' orthophotos on one grid, in one file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .. import fuse as fusing
from .common import add_output, emit_json, progress_bars, show, thresholds_from


def register(verbs: Any) -> None:
    """Add the verb to the parser."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "fuse",
        help="put the orthophotos of all sub-projects into one file",
        description="Exit code 0: all orthophotos are in one file and lie on each other. 1: something was left out, "
        "lies apart or could not be compared. 3: none can be used. 4: GDAL is missing.",
    )
    parser.add_argument("paths", nargs="+", metavar="DIR", help="folder that sensorgate run wrote, or orthophoto files")
    parser.add_argument("--out", required=True, metavar="FILE.tif", help="cloud-optimized GeoTIFF to write")
    parser.add_argument("--thresholds", metavar="FILE.json", help="change thresholds by name")
    add_output(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    """Fuse and print what came of it."""
    bars = progress_bars()
    try:
        fusion = fusing.fuse(
            [Path(p) for p in args.paths], Path(args.out), thresholds=thresholds_from(args), progress=bars
        )
    finally:
        bars.close()
    emit_json(args.json, fusing.record(fusion))
    show(fusing.lines(fusion), args)
    return 1 if fusion.findings else 0
