"""``sensorgate node``: the folder that a NodeODM takes as its odm_path."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..node.folder import summary, write_folder
from ..node.libraries import PYTHONS
from .common import add_output, emit_json, show


def register(verbs: Any) -> None:
    """Add the verb to the parser."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "node",
        help="write the folder that puts sensorgate ahead of ODM on a processing node",
        description="NodeODM or NodeODX takes the folder as odm_path. It works without internet, and ODM and the "
        "node stay as they are. Exit code 0: written. 2: wrong usage. 4: pip is missing.",
    )
    parser.add_argument("--odm", required=True, metavar="ODM_DIR", help="ODM's folder where the node runs, as /code")
    parser.add_argument("--out", required=True, metavar="DIR", help="the folder to write")
    parser.add_argument("--python", choices=PYTHONS, default=PYTHONS[0], help="ODM's Python: 3.12 for 3.6, 3.9 before")
    parser.add_argument("--wheels", metavar="DIR", help="take libraries from these wheels instead of the internet")
    parser.add_argument("--machine", metavar="NAME", help="the node's machine if not this one's: x86_64 or aarch64")
    add_output(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    """Write the folder and say what it holds."""
    written = write_folder(
        Path(args.odm),
        Path(args.out),
        python=args.python,
        wheels=Path(args.wheels) if args.wheels else None,
        machine=args.machine,
    )
    emit_json(
        args.json,
        {"libraries": list(written.carried), "missing": [m.name for m in written.missing], "notes": written.notes},
    )
    show(summary(written), args)
    return 0
