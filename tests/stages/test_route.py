from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from sensorgate.stages import ladder
from sensorgate.stages.align.blocks import blocks
from sensorgate.stages.align.model import AlignmentReport, Bowing, GpsFit, LockDecision, PayloadAlignment
from sensorgate.stages.align.ties import Ties
from sensorgate.stages.align.worker import SolverFailed
from sensorgate.stages.errors import UsageError
from sensorgate.stages.record import from_plain, to_plain
from sensorgate.stages.route import PipelineRouter, Proof, ProvenGroup, apart, prove
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import frames, grid, request

GOOD = {"inliers": 120, "mean_reproj_error": 0.8, "components": 1}


@dataclass(frozen=True)
class Found:
    """What the ladder reads of an alignment."""

    report: AlignmentReport
    request: object
    solution: object
    plan: object
    job: object = None


class Solver:
    """Stands in for the alignment: a verdict per payload from a rule on who is there and on which rung."""

    def __init__(self, rule, linked=5):
        self.rule = rule
        self.linked = linked
        self.strong = lambda name, names: 5
        self.calls = []
        self.decide = lambda names: ()
        self.place = lambda path: 0
        self.close = ()

    def __call__(self, asked, workspace, *, rung, extra=(), start=None, **_):
        names = sorted({f.payload for f in asked.frames})
        self.calls.append((rung, tuple(names), start is not None, len(extra)))
        verdicts = self.rule(rung, names)
        if verdicts == "dies":
            raise SolverFailed("the solver ended with code -6")
        payloads = tuple(
            PayloadAlignment(
                n,
                18,
                18,
                18,
                0.5,
                GpsFit(18),
                GpsFit(18),
                verdict=verdicts.get(n, "pass"),
                reasons=(f"{n} said",),
                strong_cross_pairs=self.strong(n, names),
                cross_pairs=self.linked,
                close=rung in self.close,
            )
            for n in names
        )
        worst = next(v for v in ("fail", "unproven", "pass") if v in {p.verdict for p in payloads})
        report = AlignmentReport(
            asked.name, "pycolmap", rung, (), 18, 1, 0.5, names[0], GpsFit(18), 60.0, Bowing(), payloads, (), (), (),
            0, 100, verdict=worst, decisions=self.decide(names),
        )  # fmt: skip
        found = SimpleNamespace(
            models=1, stored=f"{rung} {names}", model=np.asarray([self.place(f.path) for f in asked.frames])
        )
        plan = SimpleNamespace(areas=[0] * len(asked.frames))
        return Found(report, asked, found, plan)


@pytest.fixture
def solver(monkeypatch):
    def use(rule):
        made = Solver(rule)
        monkeypatch.setattr(ladder, "align_once", made)
        monkeypatch.setattr(ladder, "tie_by_control", lambda *_: SimpleNamespace(holds=False, text="no control points"))
        return made

    return use


def _block(names="abc"):
    return request(*[frames(grid(), n, 5000.0 * i) for i, n in enumerate(names)])


def _passed(aligned, payload, limits):
    """What control joins, passes."""
    payloads = tuple(replace(p, verdict="pass") for p in aligned.report.payloads)
    report = replace(aligned.report, payloads=payloads, verdict="pass")
    return replace(aligned, report=report)


def _routes(proof: Proof):
    return {g.payloads: g.route for g in proof.groups}


def test_all_good_is_one_project_and_one_attempt(solver, tmp_path):
    made = solver(lambda rung, names: {})
    proof = prove(_block(), tmp_path)
    assert _routes(proof) == {("a", "b", "c"): "proceed"}
    assert [c[0] for c in made.calls] == ["quick"]


def test_what_passes_close_to_a_limit_is_decided_by_the_reference(solver, tmp_path):
    made = solver(lambda rung, names: {})
    made.close = ("quick",)
    proof = prove(_block("ab"), tmp_path)
    assert [c[0] for c in made.calls] == ["quick", "reference"]
    assert proof.groups[0].alignment.rung == "reference"
    made.calls.clear()
    made.rule = lambda rung, names: {"b": "fail"} if rung == "reference" or "a" not in names else {}
    prove(_block("ab"), tmp_path)
    assert [c[0] for c in made.calls][:3] == ["quick", "reference", "mixed"]


def test_the_bad_leaves_and_the_good_proceed(solver, tmp_path):
    made = solver(lambda rung, names: {"b": "fail"} if len(names) > 1 else {})
    proof = prove(_block(), tmp_path)
    assert _routes(proof) == {("a", "c"): "proceed", ("b",): "isolate"}
    rungs = [c[0] for c in made.calls]
    assert rungs.index("mixed") < rungs.index("pairwise") < rungs.index("alone")
    assert next(c for c in made.calls if c[0] == "mixed")[3] == 1
    isolated = next(g for g in proof.groups if g.route == "isolate")
    assert "no control points" in isolated.reasons


def test_without_one_verified_pair_no_pairwise_run_is_wasted(solver, tmp_path):
    made = solver(lambda rung, names: {"b": "fail"} if len(names) > 1 else {})
    made.linked = 0
    proof = prove(_block(), tmp_path)
    assert _routes(proof) == {("a", "c"): "proceed", ("b",): "isolate"}
    assert "pairwise" not in [c[0] for c in made.calls]


@pytest.mark.parametrize(("strong", "rungs"), [(2, ["quick", "quick", "alone"]), (3, ["quick", "mixed"])])
def test_what_has_no_ties_costs_no_further_rung(solver, tmp_path, monkeypatch, strong, rungs):
    asked_for = []

    def ties(asked, payloads, *_, rung, **__):
        asked_for.append((tuple(payloads), rung))
        return {p: Ties(90, strong, strong) for p in payloads}

    monkeypatch.setattr(ladder, "ties_of", ties)
    made = solver(lambda rung, names: {"b": "fail"} if len(names) > 1 else {})
    made.strong = lambda name, names: 0 if "b" in names and (name == "b" or len(names) == 1) else 5
    proof = prove(_block(), tmp_path)
    assert _routes(proof) == {("a", "c"): "proceed", ("b",): "isolate"}
    assert [c[0] for c in made.calls][: len(rungs)] == rungs
    assert asked_for == [(("b",), "mixed")]
    isolated = next(g for g in proof.groups if g.route == "isolate")
    assert (strong < 3) == any(f"{strong} of 90 pairs" in r for r in isolated.reasons)


def test_no_rung_is_climbed_twice_with_the_same_numbers(solver, tmp_path):
    made = solver(lambda rung, names: dict.fromkeys(names, "fail"))
    prove(_block("ab"), tmp_path)
    same = {"quick": "quick", "alone": "quick", "mixed": "mixed", "pairwise": "mixed"}
    seen = [(same[rung], names, start, extra) for rung, names, start, extra in made.calls]
    assert len(seen) == len(set(seen))


def test_mixed_settings_may_be_enough(solver, tmp_path):
    solver(lambda rung, names: {"b": "fail"} if rung == "quick" else {})
    proof = prove(_block(), tmp_path)
    assert _routes(proof) == {("a", "b", "c"): "proceed"}
    assert any("mixed" in r for r in proof.groups[0].reasons)


def test_pairwise_may_be_enough(solver, tmp_path):
    made = solver(lambda rung, names: {"b": "fail"} if rung in ("quick", "mixed") and "b" in names else {})
    proof = prove(_block(), tmp_path)
    assert _routes(proof) == {("a", "b", "c"): "pairwise"}
    assert any(c[0] == "pairwise" and c[2] for c in made.calls)


def test_ground_control_ties_what_matches_cannot(solver, tmp_path, monkeypatch):
    solver(lambda rung, names: {"b": "fail"} if len(names) > 1 else {})
    monkeypatch.setattr(ladder, "tie_by_control", lambda *_: SimpleNamespace(holds=True, text="tied by 5 points"))
    monkeypatch.setattr(ladder, "joined_by_control", _passed)
    found = prove(_block(), tmp_path).groups
    assert "b" in found[0].payloads and found[0].route == "pairwise"
    assert any("tied by 5 points" in r for r in found[0].reasons)


def test_several_guilty_that_fit_each_other_share_a_project(solver, tmp_path):
    def rule(rung, names):
        return {"b": "fail", "d": "fail"} if "a" in names and {"b", "d"} & set(names) else {}

    solver(rule)
    proof = prove(_block("abcd"), tmp_path)
    assert _routes(proof) == {("a", "c"): "proceed", ("b", "d"): "isolate"}


def test_one_bad_payload_that_spoils_everybody_leaves_first(solver, tmp_path):
    def rule(rung, names):
        return dict.fromkeys(names, "fail") if "c" in names and len(names) > 1 else {}

    made = solver(rule)

    def worst_is_c(report):
        return "c"

    route_worst, ladder._worst = ladder._worst, worst_is_c
    try:
        proof = prove(_block(), tmp_path)
    finally:
        ladder._worst = route_worst
    assert _routes(proof) == {("a", "b"): "proceed", ("c",): "isolate"}
    assert made.calls


def test_unproven_is_a_group_of_its_own(solver, tmp_path):
    solver(lambda rung, names: {"b": "unproven"} if "b" in names else {})
    proof = prove(_block(), tmp_path)
    assert _routes(proof) == {("a", "c"): "proceed", ("b",): "unproven"}


def test_a_payload_that_fails_even_alone_is_unproven_not_dropped(solver, tmp_path):
    solver(lambda rung, names: {"b": "fail"} if "b" in names else {})
    assert _routes(prove(_block(), tmp_path)) == {("a", "c"): "proceed", ("b",): "unproven"}


def test_a_solver_that_dies_does_not_take_the_job(solver, tmp_path):
    solver(lambda rung, names: "dies" if "b" in names else {})
    found = prove(_block(), tmp_path)
    assert _routes(found) == {("a",): "isolate", ("b",): "unproven", ("c",): "isolate"}
    assert any("-6" in r for g in found.groups if g.payloads == ("b",) for r in g.reasons)


@pytest.mark.parametrize("seed", range(6))
def test_every_payload_ends_in_exactly_one_group(solver, tmp_path, seed):
    draw = np.random.default_rng(seed)

    def rule(rung, names):
        return {n: str(draw.choice(["pass", "fail", "unproven"])) for n in names}

    solver(rule)
    asked = _block("abcde")
    proof = prove(asked, tmp_path)
    assert sorted(p for g in proof.groups for p in g.payloads) == list("abcde")
    assert sorted(f for g in proof.groups for f in g.frames) == sorted(f.path for f in asked.frames)
    assert len({g.name for g in proof.groups}) == len(proof.groups)
    assert from_plain(Proof, to_plain(proof)) == proof


def test_payloads_over_other_ground_are_proven_apart(solver, tmp_path):
    made = solver(lambda rung, names: {})
    far = frames(grid() + np.array([4000.0, 0.0, 0.0]), "z", 9000.0)
    proof = prove(request(frames(grid(), "a"), far), tmp_path)
    assert _routes(proof) == {("a",): "proceed", ("z",): "proceed"}
    assert all(len(c[1]) == 1 for c in made.calls)


def test_a_payload_over_two_grounds_holds_both_sides_in_one_block():
    two = frames(np.concatenate([grid(), grid() + np.array([4000.0, 0.0, 0.0])]), "a")
    asked = request(two, frames(grid() + np.array([4000.0, 0.0, 0.0]), "b", 9000.0))
    assert [sorted({f.payload for f in b.frames}) for b in blocks(asked, DEFAULTS)] == [["a", "b"]]


def test_without_position_a_payload_stays_with_the_largest_block():
    lost = [replace(f, position=None) for f in frames(grid(1, 4), "n", 9000.0)]
    far = frames(grid(2, 6) + np.array([4000.0, 0.0, 0.0]), "z", 9000.0)
    asked = request(frames(grid(), "a"), lost, far)
    assert [sorted({f.payload for f in b.frames}) for b in blocks(asked, DEFAULTS)] == [["a", "n"], ["z"]]


def test_the_router_accepts_what_the_document_accepts():
    assert PipelineRouter().evaluate_alignment(GOOD) == "proceed_bundle_adjustment"
    assert PipelineRouter(200).evaluate_alignment(GOOD) == "fallback_pairwise"
    assert PipelineRouter(30, 0.5).evaluate_alignment(GOOD) == "fallback_pairwise"
    assert PipelineRouter().evaluate_alignment({**GOOD, "inliers": 30, "mean_reproj_error": 2.0}).startswith("proceed")


@pytest.mark.parametrize("name", sorted(GOOD))
@pytest.mark.parametrize("value", [None, math.nan, math.inf, "many", True, "absent"])
def test_a_figure_that_is_missing_or_no_number_is_a_fallback(name, value):
    figures = {k: v for k, v in GOOD.items() if k != name or value != "absent"}
    if value != "absent":
        figures[name] = value
    # The matches of a pair have no components: that one figure may be absent.
    expected = "proceed_bundle_adjustment" if (name, value) == ("components", "absent") else "fallback_pairwise"
    assert PipelineRouter().evaluate_alignment(figures) == expected


def test_a_report_proceeds_only_with_its_own_verdict():
    passing = Solver(lambda rung, names: {})(_block("a"), None, rung="quick").report
    assert PipelineRouter().evaluate_alignment(passing) == "proceed_bundle_adjustment"
    assert PipelineRouter().evaluate_alignment(replace(passing, verdict="unproven")) == "fallback_pairwise"
    assert PipelineRouter().evaluate_alignment(replace(passing, components=2)) == "fallback_pairwise"
    assert PipelineRouter().evaluate_alignment(replace(passing, components=2, areas=2)) == "proceed_bundle_adjustment"


def test_the_fallback_goes_payload_by_payload(solver, tmp_path):
    made = solver(lambda rung, names: {})
    report = PipelineRouter().execute_fallback("fallback_pairwise", _block(), workspace=tmp_path)
    assert isinstance(report, AlignmentReport) and len(report.payloads) == 3
    assert [c[:3] for c in made.calls] == [
        ("pairwise", ("a",), False),
        ("pairwise", ("a", "b"), True),
        ("pairwise", ("a", "b", "c"), True),
    ]


def test_an_unknown_strategy_is_a_usage_error():
    with pytest.raises(UsageError, match="fallback_pairwise"):
        PipelineRouter().execute_fallback("magic", _block())


def test_a_block_elsewhere_is_isolated_and_says_so():
    def group(name, count, label="proceed"):
        return ProvenGroup(name, (name,), tuple(f"{name}/{i}" for i in range(count)), label, ("fits",))

    given = [
        ("rgb", 0, group("a", 4)),
        ("rgb", 1, group("b", 3)),
        ("rgb", 1, group("c", 2)),
        ("thermal", 1, group("t", 2)),
    ]
    assert [g.name for g in apart(given)] == ["a", "b", "c", "t"]
    assert [g.route for g in apart(given)] == ["isolate", "proceed", "proceed", "proceed"]
    # What is unproven keeps its route, and its frames count for the place that it stands over.
    found = apart([*given, ("rgb", 0, group("d", 2, "unproven"))])
    assert [g.route for g in found] == ["proceed", "isolate", "isolate", "proceed", "unproven"]
    assert found[1].reasons[0].startswith("It stands over another place") and found[1].frames == given[1][2].frames


def _decision(profile, hold=False, supported=False):
    return LockDecision(profile, hold, 0.6, (0.0, 0.0), (0.0,) * 5, "focal sheet", "said", supported)


def _held_and_free(names):
    return tuple(_decision(n, hold=n == "a") for n in names)


def test_what_must_be_held_parts_from_what_cannot_be(solver, tmp_path):
    made = solver(lambda rung, names: {})
    made.decide = _held_and_free
    proof = prove(_block(), tmp_path)
    assert _routes(proof) == {("a",): "isolate", ("b", "c"): "proceed"}
    assert any("must be held" in r and "b, c" in r for g in proof.groups if g.payloads == ("a",) for r in g.reasons)
    assert any("a must be" in r for g in proof.groups if g.payloads == ("b", "c") for r in g.reasons)
    assert sorted(f for g in proof.groups for f in g.frames) == sorted(f.path for f in _block().frames)


def test_a_supported_self_calibration_is_held_beside_it(solver, tmp_path):
    made = solver(lambda rung, names: {})
    made.decide = lambda names: tuple(_decision(n, hold=n == "a", supported=n != "a") for n in names)
    (group,) = prove(_block(), tmp_path).groups
    assert group.route == "proceed" and all(d.hold for d in group.locked)
    assert any("a lock is for all" in d.reason for d in group.locked)


def test_a_side_that_is_nothing_alone_stays(solver, tmp_path):
    made = solver(lambda rung, names: {} if len(names) == 3 else dict.fromkeys(names, "unproven"))
    made.decide = _held_and_free
    assert _routes(prove(_block(), tmp_path)) == {("a", "b", "c"): "proceed"}


def test_nothing_to_hold_or_nothing_free_is_no_split(solver, tmp_path):
    for hold in (True, False):
        made = solver(lambda rung, names: {})
        made.decide = lambda names, hold=hold: tuple(_decision(n, hold=hold) for n in names)
        assert _routes(prove(_block(), tmp_path)) == {("a", "b", "c"): "proceed"}
        assert len(made.calls) == 1


@pytest.mark.parametrize("verdict", ["pass", "fail", "unproven"])
def test_a_payload_that_is_two_surveys_becomes_two_projects(monkeypatch, tmp_path, verdict):
    second = {f"a/{i:03d}.jpg" for i in range(11, 18)}

    class Two(Solver):
        def __call__(self, asked, workspace, **more):
            whole = len(asked.frames) == 18
            self.place = lambda path: int(whole and path in second)
            self.rule = lambda rung, names: dict.fromkeys(names, verdict if whole else "pass")
            return super().__call__(asked, workspace, **more)

    monkeypatch.setattr(ladder, "align_once", Two(None))
    proof = prove(_block("a"), tmp_path)
    assert sorted(len(g.frames) for g in proof.groups) == [7, 11]
    assert next(g for g in proof.groups if len(g.frames) == 7).route == "isolate"
    assert any("model of their own" in r for g in proof.groups for r in g.reasons)
    assert {g.name for g in proof.groups} == {"block", "block-2"}
