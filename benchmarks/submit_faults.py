"""A thousand submissions to a simulated node, with something going wrong at every HTTP call.

python benchmarks/submit_faults.py [--count 1000] [--seed 1]

Each ends with the ledger's state held against the node's, and the node's images held against the project's, byte for
byte. Prints what was wrong, by kind of fault; ends with 1 where anything was.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.plugin.submit import trial
from tests.plugin.submit.node_parts import Behaviour


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as clean:
        wrong, calls = trial.run(Path(clean), {})
    print(f"a submission without faults takes {calls} requests: {wrong or 'nothing wrong'}")
    ones = trial.single(calls)
    cases = [*ones, *trial.several(max(0, args.count - len(ones)), 2 * calls, args.seed)][: args.count]
    kinds: Counter = Counter()
    bad = requests = 0
    began = time.monotonic()
    for number, case in enumerate(cases):
        # A cluster answers otherwise than a single node; several threads bring the races in.
        behaviour = Behaviour(cluster=number % 4 == 3, adapter=number % 3 == 1)
        with tempfile.TemporaryDirectory() as folder:
            wrong, asked = trial.run(Path(folder), case, behaviour=behaviour, threads=1 + number % 3)
        requests += asked
        kinds.update(case.values())
        if wrong:
            bad += 1
            print(f"{case}: {'; '.join(wrong)}")
    took = time.monotonic() - began
    print(f"{len(cases)} submissions, {requests} requests, {sum(kinds.values())} faults, {took:.0f} s: {bad} wrong")
    for kind, count in sorted(kinds.items()):
        print(f"  {count:5d} {kind}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
