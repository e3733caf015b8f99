"""Large blocks: every frame joins the group of its sample, and links tie payloads into one project."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.align.judge import UNPROVEN
from sensorgate.stages.large import climb_sampled
from sensorgate.stages.proven import ISOLATE, PROCEED, group_of
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import frames, grid, request

SMALL = DEFAULTS.replaced({"sample_above": 40, "sample_frames": 24})
EAST = np.array([1.0, 0.0, 0.0])
WIDTH = float(np.ptp(grid(12, 12)[:, 0]))


class Climber:
    """Stands where the ladder stands: everything shares one project but the payloads that are named."""

    def __init__(self, alone=(), route=ISOLATE):
        self.alone, self.route, self.sizes = set(alone), route, []

    def climb(self, part, route):
        self.sizes.append(len(part.frames))
        groups = []
        for payloads in [{f.payload for f in part.frames} - self.alone, *({p} for p in sorted(self.alone))]:
            chosen = tuple(f for f in part.frames if f.payload in payloads)
            if chosen:
                label = self.route if payloads & self.alone else route
                groups.append(group_of(replace(part, frames=chosen), label, ("seen",), None))
        return groups


def chain(*names):
    return request(*(frames(grid(12, 12) + i * 0.9 * WIDTH * EAST, name, 9000.0 * i) for i, name in enumerate(names)))


def homes(block, groups):
    found = [p for g in groups for p in g.frames]
    assert sorted(found) == sorted(f.path for f in block.frames)
    return {frozenset(g.payloads): g for g in groups}


def test_a_chain_of_payloads_becomes_one_project():
    block, climber = chain("a", "b", "c"), Climber()
    (group,) = climb_sampled(climber, block, SMALL)
    assert set(group.payloads) == {"a", "b", "c"} and group.route == PROCEED
    assert len(group.frames) == len(block.frames) == 432
    assert max(climber.sizes) <= SMALL.sample_frames and len(climber.sizes) == 2
    assert any("tied on where it meets" in r for r in group.reasons)
    assert group.reasons[0].startswith("judged by a sample: 36 of 432")


def test_a_link_that_breaks_stands_alone():
    block = chain("a", "b", "c")
    for alone, route in (("c", ISOLATE), ("a", UNPROVEN)):
        found = homes(block, climb_sampled(Climber({alone}, route), block, SMALL))
        rest = frozenset({"a", "b", "c"} - {alone})
        assert set(found) == {rest, frozenset({alone})}
        assert found[frozenset({alone})].route == route and found[rest].route == PROCEED
        assert len(found[frozenset({alone})].frames) == 144


def test_a_small_block_is_climbed_whole():
    block, climber = chain("a"), Climber()
    (group,) = climb_sampled(climber, block, DEFAULTS)
    assert climber.sizes == [144] and group.reasons == ("seen",)


def test_a_payload_that_parts_takes_the_frames_of_each_flight_along():
    """Two surveys under one payload: what the sample shows of each flight holds for the rest of it."""
    block = chain("a")
    block = replace(block, frames=tuple(replace(f, flight=f"a/{i // 72}") for i, f in enumerate(block.frames)))
    flight = {f.path: f.flight for f in block.frames}

    class Parting(Climber):
        def climb(self, part, route):
            flown = [tuple(f for f in part.frames if f.flight == name) for name in ("a/0", "a/1")]
            return [group_of(replace(part, frames=f), route, ("seen",), None) for f in flown]

    first, second = climb_sampled(Parting(), block, SMALL)
    assert {flight[p] for p in first.frames} == {"a/0"} and {flight[p] for p in second.frames} == {"a/1"}
    assert len(first.frames) == len(second.frames) == 72


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.integers(2, 9), st.floats(-500, 500)), min_size=1, max_size=4), st.booleans())
def test_no_frame_is_lost_or_doubled(blocks, blind):
    groups = [frames(grid(9, n) + place * EAST, f"p{i}", 9000.0 * i) for i, (n, place) in enumerate(blocks)]
    if blind:
        groups[0] = [replace(f, position=None) for f in groups[0]]
    block = request(*groups)
    homes(block, climb_sampled(Climber({"p1"}), block, SMALL))
