"""``sensorgate webodm``: the archive that WebODM's admin page takes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..webodm.archive import write_archive
from .common import add_output, emit_json, show

ROOT = Path(__file__).resolve().parents[2]


def register(verbs: Any) -> None:
    """Add the verb to the parser."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "webodm",
        help="write the plugin archive for WebODM",
        description="Writes a zip file to be uploaded in WebODM under Administration, Plugins, Load Plugin (.zip).",
    )
    parser.add_argument("--out", required=True, metavar="FILE.zip", help="the archive to write")
    add_output(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    """Write the archive and say how to install it."""
    size = write_archive(Path(args.out), ROOT)
    emit_json(args.json, {"archive": args.out, "bytes": size})
    show(
        [
            f"Wrote {args.out} ({size / 1e6:.1f} MB).",
            "In WebODM: Administration, Plugins, Load Plugin (.zip). For an upgrade delete the old plugin first.",
            "Then restart WebODM, worker included (./webodm.sh restart).",
        ],
        args,
    )
    return 0
