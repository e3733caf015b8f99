"""Policies: pure decisions."""

from __future__ import annotations

import itertools

import pytest
from sensorgate.plugin.node.decide import AS_IS, PREPARE, REFUSE, Seen, after_alignment, after_gate, ordered, parts_from
from sensorgate.plugin.node.workplace import Part

CLEAN = Seen(verdict="consistent", frames=20, profiles=1, flights=1, groups=1, findings=0, changes=0)
MIXED = Seen(verdict="inconsistent", frames=40, profiles=3, flights=2, groups=2, findings=2, changes=5)
ONE_GROUP = Seen(verdict="inconsistent", frames=40, profiles=2, flights=2, groups=1, findings=1, changes=5)
BLOCKED = Seen(verdict="blocked", frames=0, profiles=0, flights=0, groups=0, findings=1, changes=0)


@pytest.mark.parametrize(
    ("policy", "seen", "do"),
    [
        ("report", MIXED, AS_IS),
        ("report", BLOCKED, AS_IS),
        ("auto", CLEAN, AS_IS),
        ("auto", MIXED, PREPARE),
        ("auto", BLOCKED, AS_IS),
        ("strict", CLEAN, AS_IS),
        ("strict", MIXED, REFUSE),
        ("strict", ONE_GROUP, PREPARE),
        ("strict", BLOCKED, REFUSE),
    ],
)
def test_what_follows_from_the_gate(policy, seen, do):
    assert after_gate(policy, seen, harmonized=False, videos=False).do == do


def test_two_flights_or_a_warning_are_not_clean():
    for change in ({"flights": 2}, {"findings": 1}, {"profiles": 2}, {"changes": 1}, {"verdict": "inconsistent"}):
        seen = Seen(**{**vars(CLEAN), **change})
        assert after_gate("auto", seen, harmonized=False, videos=False).do == PREPARE


def test_films_and_prepared_projects_go_to_odm_unchanged():
    assert after_gate("auto", MIXED, harmonized=False, videos=True).do == AS_IS
    assert after_gate("auto", MIXED, harmonized=True, videos=False).do == AS_IS
    assert after_gate("strict", MIXED, harmonized=True, videos=False).do == REFUSE
    assert after_gate("strict", BLOCKED, harmonized=False, videos=True).do == AS_IS


def part(name, spectrum="rgb", route="proceed", captures=10):
    return Part(name, spectrum, route, captures, captures, ("because",))


def test_the_main_part_is_proven_then_large_then_visible():
    parts = [
        part("thermal", "thermal", captures=30),
        part("multispectral", "multispectral", captures=30),
        part("rgb", captures=30),
        part("stranger", route="isolate", captures=90),
        part("few", captures=3),
    ]
    names = [p.name for p in ordered(parts)]
    assert names == ["rgb", "multispectral", "thermal", "few", "stranger"]
    assert all([p.name for p in ordered(o)] == names for o in itertools.permutations(parts))


def test_strict_takes_one_proven_part_and_names_the_others():
    assert after_alignment("strict", [part("rgb")]).do == PREPARE
    refused = after_alignment("strict", [part("rgb"), part("thermal", "thermal", "isolate")])
    assert refused.do == REFUSE
    assert any("thermal: 10 frames, isolate. because" in r for r in refused.reasons)
    assert after_alignment("strict", [part("rgb", route="unproven")]).do == REFUSE
    assert after_alignment("auto", [part("rgb", route="unproven"), part("b")]).do == PREPARE


def test_bands_of_a_capture_count_once():
    frames = [{"path": f"{c}_{b}", "payload": "rig", "capture": c} for c in "abc" for b in range(5)]
    frames += [{"path": f"j{n}", "payload": "rgb", "capture": ""} for n in range(4)]
    own = {"ms": frames[:15], "rgb": frames[15:]}
    projects = [
        {
            "name": name,
            "spectrum": {"ms": "multispectral"}.get(name, name),
            "route": "proceed",
            "reasons": [],
            "options": [],
            "frames": [f["path"] for f in held],
        }
        for name, held in own.items()
    ]
    report = {"frames": frames, "subprojects": projects}
    assert [(p.name, p.captures, p.frames) for p in parts_from(report)] == [("rgb", 4, 4), ("ms", 3, 15)]
