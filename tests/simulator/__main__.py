"""``python -m tests.simulator STORY OUT_DIR [--seed N] [--frames-scale S]``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import List, Optional

from .run import render
from .stories import STORIES


def main(arguments: Optional[List[str]] = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.simulator", description="Render a mixed drone survey.")
    parser.add_argument("story", choices=list(STORIES), help="what to render")
    parser.add_argument("out", type=Path, help="output folder: images/, gcp_list.txt, truth.json")
    parser.add_argument("--seed", type=int, default=0, help="another world and other noise (default 0)")
    parser.add_argument("--frames-scale", type=float, default=1.0, help="frame size in pixels, times this")
    chosen = parser.parse_args(arguments)

    def progress(done: int, total: int) -> None:
        if sys.stderr.isatty():
            print(f"\r{done}/{total} frames", end="\n" if done == total else "", file=sys.stderr)

    truth = render(chosen.story, chosen.out, chosen.seed, chosen.frames_scale, progress)
    for payload in truth.payloads:
        print(f"{payload.id:12} {payload.make} {payload.model}: {payload.frames} files, {payload.route}")
    print(f"{len(truth.frames)} files in {chosen.out / truth.images}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
