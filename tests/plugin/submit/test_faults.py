"""Something goes wrong at every HTTP call: the ledger's end state is the node's, no image lost, none doubled."""

from __future__ import annotations

import pytest
from sensorgate.plugin.submit.errors import NotSent, Unsure
from sensorgate.plugin.submit.patience import Patience

from . import trial
from .node_parts import MUTE, TORN, Behaviour

CALLS = 33  # requests of a submission without faults, give or take


def test_without_faults(tmp_path):
    wrong, calls = trial.run(tmp_path, {})
    assert wrong == [] and 25 <= calls <= 45


@pytest.mark.parametrize("kind", trial.KINDS)
def test_one_fault_at_every_third_request(tmp_path, kind):
    # The benchmark does every request and a thousand mixtures.
    for number in range(trial.KINDS.index(kind) % 3, CALLS, 3):
        wrong, _ = trial.run(tmp_path / str(number), {number: kind})
        assert wrong == [], f"{kind} at request {number}"


@pytest.mark.parametrize("cluster", [False, True])
def test_several_faults(tmp_path, cluster):
    for number, faults in enumerate(trial.several(15, 2 * CALLS, seed=7 + cluster)):
        wrong, _ = trial.run(tmp_path / str(number), faults, behaviour=Behaviour(cluster=cluster), threads=3)
        assert wrong == [], faults


@pytest.mark.parametrize("kind", [MUTE, TORN])
def test_the_trial_sees_what_it_looks_for(tmp_path, kind, monkeypatch):
    """A client that simply sends again, as others do, doubles images or is caught by the count and sends all again."""
    asking = Patience.keep_asking
    monkeypatch.setattr(
        Patience,
        "keep_asking",
        lambda self, call, repeat=(NotSent, Unsure): asking(self, call, repeat=(NotSent, Unsure)),
    )
    monkeypatch.setattr("sensorgate.plugin.submit.transfer.Transfer._compare", lambda *a: None)
    found = [trial.run(tmp_path / str(n), {n: kind})[0] for n in range(4, 16)]
    assert any("the node has" in w for wrong in found for w in wrong)
