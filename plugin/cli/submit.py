"""``sensorgate submit``: the written sub-projects onto a processing node."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Dict, Sequence

from ...stages.errors import UsageError
from ..submit import Settings, lines, record, submit
from ..submit.anchor import CHOICES, ISOLATED
from ..submit.ledger import Attempt
from .common import Bars, add_output, emit_json, progress_bars, show, thresholds_from


def register(verbs: Any) -> None:
    """Add the verb to the parser."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "submit",
        help="process the projects on a NodeODM, NodeODX or ClusterODM",
        description="Exit code 0: all projects are done. 1: something was rerouted, failed or left out. "
        "3: the node cannot be used or went away. 130: interrupted. The same command goes on where it stopped.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder that sensorgate run wrote")
    parser.add_argument("--node", required=True, metavar="URL", help="for example http://localhost:3000?token=...")
    parser.add_argument("--token", metavar="TEXT", help="the node's token (or SENSORGATE_NODE_TOKEN)")
    parser.add_argument("--ledger", metavar="FILE", help="what was sent, and its fate (default: DIR/submit.json)")
    parser.add_argument("--resume", action="store_true", help="go on with the ledger's submission; it must exist")
    parser.add_argument("--include-unproven", action="store_true", help="also submit projects that nothing proved")
    parser.add_argument(
        "--assets", default="all.zip", metavar="LIST", help="all.zip, none, or paths like odm_orthophoto,odm_dem"
    )
    parser.add_argument("--align", choices=CHOICES, default=ISOLATED, help="which projects are laid on the anchor's")
    parser.add_argument("--reroutes", type=int, metavar="N", help="how often a failed project is tried another way")
    parser.add_argument("--parallel", type=int, metavar="N", help="projects at once (default: the node's slots + 1)")
    parser.add_argument("--no-wait", action="store_true", help="leave once everything is sent")
    parser.add_argument("--retry", action="store_true", help="take up again what failed or was refused")
    parser.add_argument("--thresholds", metavar="FILE.json", help="change thresholds by name")
    add_output(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    """Submit and print what became of each payload."""
    if args.parallel is not None and not 1 <= args.parallel <= 256:
        raise UsageError(f"--parallel takes 1 to 256, not {args.parallel}.")
    if args.reroutes is not None and not 0 <= args.reroutes <= 10:
        raise UsageError(f"--reroutes takes 0 to 10, not {args.reroutes}.")
    ledger = Path(args.ledger) if args.ledger else Path(args.folder) / "submit.json"
    if args.resume and not ledger.is_file():
        raise UsageError(f"There is no submission to go on with: {ledger} does not exist.")
    bars = progress_bars()
    try:
        result = submit(
            Path(args.folder),
            args.node,
            Settings(
                token=args.token,
                include_unproven=args.include_unproven,
                ledger=args.ledger,
                assets=tuple(a.strip().strip("/") for a in args.assets.split(",") if a.strip()) or ("none",),
                reroutes=args.reroutes,
                align=args.align,
                parallel=args.parallel,
                wait=not args.no_wait,
                retry=args.retry,
                thresholds=thresholds_from(args),
            ),
            progress=bars,
            tell=_Phases(bars),
            ask_cancel=_ask,
        )
    finally:
        bars.close()
    emit_json(args.json, record(result))
    show(lines(result), args)
    return result.exit_code


class _Phases:
    """Says on a terminal when a project enters another phase."""

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self._phases: Dict[str, str] = {}

    def __call__(self, name: str, phase: str, share: float) -> None:
        """Hear of one project's progress."""
        if self._phases.get(name) != phase:
            self._phases[name] = phase
            self._bars.say(f"{name}: {phase}")


def _ask(running: Sequence[Attempt]) -> bool:
    """On a terminal ask; elsewhere leave the tasks alone and say so."""
    count = f"{len(running)} task{'s' if len(running) > 1 else ''}"
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        print(f"\nsensorgate: {count} go on at the node; the same command takes them up again.", file=sys.stderr)
        return False
    sys.stderr.write(f"\n{count} may still run on the node. Cancel them there? [y/N] ")
    sys.stderr.flush()
    try:
        return sys.stdin.readline().strip().lower() in ("y", "yes")
    except KeyboardInterrupt:
        return False
