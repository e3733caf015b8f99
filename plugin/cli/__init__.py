"""The command line: one module per verb, each a thin shell around one library call."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from typing import Any, List, Optional

from ...stages.errors import Cancelled, SensorgateError
from ..version import VERSION
from . import fuse, gate, node, outcome, run, submit, webodm
from .common import LOG, start_logging

VERBS = (gate, run, submit, outcome, fuse, node, webodm)


def build_parser() -> argparse.ArgumentParser:
    """The parser with every verb."""
    parser = argparse.ArgumentParser(
        prog="sensorgate",
        description="Reads which true cameras made the frames, says what would go wrong in OpenDroneMap, "
        "and writes projects that reconstruct.",
    )
    parser.add_argument("--version", action="version", version=f"sensorgate {VERSION}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for verb in VERBS:
        verb.register(verbs)
    return parser


def main(argv: Optional[List[str]] = None) -> int:
    """Run one verb and return its exit code; no traceback reaches the user for bad input."""
    args = build_parser().parse_args(argv)

    def stop(signum: int, frame: Any) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, stop)
    try:
        start_logging(args)
        code: int = args.call(args)
        sys.stdout.flush()
        return code
    except SensorgateError as error:
        print(f"sensorgate: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("\nsensorgate: stopped. What was finished is kept for --resume.", file=sys.stderr)
        return Cancelled.exit_code
    except BrokenPipeError:
        # The reader of our output went away; there is nobody left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 0
    except Exception as error:
        LOG.debug("unexpected", exc_info=True)
        print(
            f"sensorgate: an unexpected fault ({type(error).__name__}: {error}). "
            "Please report it with the output of the same command and -vv.",
            file=sys.stderr,
        )
        return 1
