"""Mutates headers by the million: every one must give a frame or a verdict, quickly and in bounded memory.

    python benchmarks/fuzz_headers.py [--count 1000000] [--seed 0]

The mutations are those of the test suite (segments, directories, XMP); a short
run of them is in ``make test``.
"""

from __future__ import annotations

import argparse
import random
import resource
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sensorgate.stages.errors import FrameError

from tests.stages.headers.build import read
from tests.stages.headers.test_damage import SEEDS, mutate

SLOW_S = 0.05


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    rng = random.Random(asked.seed)
    names = sorted(SEEDS)
    frames = errors = slow = 0
    worst = 0.0
    for number in range(asked.count):
        data = mutate(SEEDS[names[number % len(names)]], rng)
        before = time.process_time()
        try:
            read(data)
            frames += 1
        except FrameError:
            errors += 1
        except Exception as fault:
            kept = Path(f"fuzz-{number}.bin")
            kept.write_bytes(data)
            print(f"{type(fault).__name__}: {fault} (header kept in {kept})")
            return 1
        took = time.process_time() - before
        worst = max(worst, took)
        slow += took > SLOW_S
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{asked.count} headers: {frames} frames, {errors} verdicts, {slow} slower than {1000 * SLOW_S:.0f} ms")
    print(f"worst {1000 * worst:.1f} ms CPU, peak {peak_mb:.0f} MB")
    return 0 if not slow else 1


if __name__ == "__main__":
    sys.exit(main())
