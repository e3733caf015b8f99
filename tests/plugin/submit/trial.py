"""One submission with something going wrong, and whether ledger and node agree at its end.

Used by the suite with some hundred faults and by ``benchmarks/submit_faults.py`` with a thousand.
"""

from __future__ import annotations

import random
import threading
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Tuple

from sensorgate.plugin.odm.wire import CALIBRATION_INPUT
from sensorgate.plugin.submit import Settings, Submission, submit
from sensorgate.plugin.submit.client import NodeClient
from sensorgate.plugin.submit.ledger import CANCELED, DISCARDED, DONE, LOST, OPEN, Ledger

from .making import CALIBRATION, files_of, project, quick
from .node_double import NodeDouble
from .node_parts import FAULTS, Behaviour

DIES_BEFORE, DIES_AFTER = "client-dies-before", "client-dies-after"
KINDS = (*FAULTS, DIES_BEFORE, DIES_AFTER)


class Died(BaseException):
    """The client's process ends here."""


class Mortal:
    """Lets the client die at its n-th request, before or after it was carried out; then it lives on for good."""

    def __init__(self, at: Dict[int, str]) -> None:
        self.at = dict(at)
        self.number = 0
        self.dead = False
        self.lock = threading.Lock()

    def around(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def ask(client: NodeClient, *args: Any, **values: Any) -> Any:
            with self.lock:
                number = self.number
                self.number += 1
                how = self.at.pop(number, None)
                if how == DIES_BEFORE:
                    self.dead = True
                if self.dead:
                    raise Died
            result = call(client, *args, **values)
            with self.lock:
                if how == DIES_AFTER:
                    self.dead = True
                if self.dead:
                    raise Died
            return result

        return ask


def make(root: Path) -> None:
    """Two projects: one with a calibration and text files, one without."""
    project(
        root,
        "rgb",
        ("A.JPG", "B.JPG", "C.JPG"),
        calibration=CALIBRATION,
        geo="EPSG:4326\nA.JPG 1 2 3\n",
        options=[{"name": "use-fixed-camera-params", "value": True}],
    )
    project(root, "thermal", ("T1.JPG", "T2.JPG"), options=[{"name": "dsm", "value": True}])


def wrong(root: Path, node: NodeDouble, result: Optional[Submission]) -> List[str]:
    """What is wrong at the end: empty when the ledger's state is the node's, and every image is there once."""
    found: List[str] = []
    ledger = Ledger.open(root / "submit.json")
    known: Dict[str, str] = {}
    for entry in ledger.entries:
        good = 0
        for attempt in entry.attempts:
            known[attempt.uuid] = attempt.state
            task = node.tasks.get(attempt.uuid)
            if attempt.state in (LOST, DISCARDED):
                if task is not None and attempt.state == DISCARDED:
                    found.append(f"{entry.name}: a discarded task is on the node")
                continue
            if task is None and attempt.state == "fetched" and node.deaths:
                task = node.forgotten.get(attempt.uuid)  # the products were here before the node died
            if task is None:
                found.append(f"{entry.name}: {attempt.state} in the ledger, unknown to the node")
                continue
            if attempt.state == CANCELED and task.status != 50:
                found.append(f"{entry.name}: cancelled in the ledger, {task.status} on the node")
            if attempt.state == "fetched":
                good += 1
                want = files_of(root / "projects" / entry.name)
                has = {k: v for k, v in task.images.items() if k != CALIBRATION_INPUT}
                if has != want:
                    found.append(f"{entry.name}: the node has {sorted(has)}, sent were {sorted(want)}")
        if entry.state == DONE and good != 1:
            found.append(f"{entry.name}: done with {good} good tasks")
        if entry.state != DONE:
            found.append(f"{entry.name}: {entry.state} {entry.reasons}")
        if any(a.state in OPEN for a in entry.attempts):
            found.append(f"{entry.name}: something is still open")
    for uuid, task in node.tasks.items():
        if uuid not in known:
            found.append(f"the node has a task that the ledger does not know ({task.name})")
    alive = [t.name for u, t in node.tasks.items() if t.status not in (50,) and known.get(u) not in (LOST, None)]
    if len(alive) != len(set(alive)):
        found.append(f"duplicates on the node: {sorted(alive)}")
    if result is not None and result.exit_code not in (0, 1, 3):
        found.append(f"exit code {result.exit_code}")
    return found


def run(
    root: Path,
    faults: Dict[int, str],
    *,
    behaviour: Optional[Behaviour] = None,
    rounds: int = 12,
    threads: int = 1,
) -> Tuple[List[str], int]:
    """Submit with ``faults`` (request number -> kind); start anew after each death. What is wrong, and the requests."""
    make(root)
    at_node = {n: k for n, k in faults.items() if k in FAULTS}
    mortal = Mortal({n: k for n, k in faults.items() if k not in FAULTS})
    limits = quick(submit_upload_threads=threads)
    original = NodeClient.ask
    node = NodeDouble(behaviour or Behaviour(), lambda n, m, p: at_node.pop(n, None))
    with node:
        NodeClient.ask = mortal.around(original)  # type: ignore[method-assign]
        try:
            result: Optional[Submission] = None
            for _ in range(rounds):
                mortal.dead = False
                try:
                    result = submit(root, node.url, Settings(thresholds=limits, parallel=2, reroutes=0))
                except Died:
                    continue
                except Exception as error:
                    if getattr(error, "exit_code", None) != 3:
                        return [f"{type(error).__name__}: {error}"], len(node.requests)
                    continue
                if all(e.state == DONE for e in result.entries):
                    break
        finally:
            NodeClient.ask = original  # type: ignore[method-assign]
        return wrong(root, node, result), len(node.requests)


def single(calls: int) -> List[Dict[int, str]]:
    """Every kind of fault at every request, one at a time."""
    return [{n: k} for n in range(calls) for k in KINDS]


def several(count: int, calls: int, seed: int) -> List[Dict[int, str]]:
    """Two to five faults in one submission."""
    chance = random.Random(seed)
    return [{chance.randrange(calls): chance.choice(KINDS) for _ in range(chance.randint(2, 5))} for _ in range(count)]
