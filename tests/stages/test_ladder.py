"""What falls into pieces over one ground, or fails by a hair: more is tried before anything is said."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.stages.route import prove

from tests.stages.test_route import _block, solver

__all__ = ["solver"]

# Of the 18 frames of payload a.
FEW, ONE, MANY = {f"a/{i:03d}.jpg" for i in range(4)}, {"a/000.jpg"}, {f"a/{i:03d}.jpg" for i in range(8)}


def in_pieces(made, astray, healed=()):
    """The solver leaves ``astray`` in a model of their own, but not on the ``healed`` rungs and not by themselves."""
    plain = made.__class__.__call__

    def call(asked, workspace, **more):
        inside = {f.path for f in asked.frames}
        gone = astray if more["rung"] not in healed and inside - astray else set()
        made.place = lambda path: int(path in gone)
        found = plain(made, asked, workspace, **more)
        payloads = tuple(
            replace(p, in_main_component=p.frames - len(gone & inside) * (p.payload == "a"))
            for p in found.report.payloads
        )
        return replace(found, report=replace(found.report, payloads=payloads))

    return call


@pytest.fixture
def pieces(solver, monkeypatch):
    from sensorgate.stages import ladder

    def use(astray, healed=()):
        made = solver(lambda rung, names: {})
        monkeypatch.setattr(ladder, "align_once", in_pieces(made, astray, healed))
        return made

    return use


@pytest.mark.parametrize("astray", [FEW, MANY])
def test_pieces_that_the_mixed_settings_join_are_one_project(pieces, tmp_path, astray):
    made = pieces(astray, healed=("mixed",))
    (group,) = prove(_block("a"), tmp_path).groups
    assert (group.route, len(group.frames)) == ("proceed", 18)
    assert [c[0] for c in made.calls] == ["quick", "mixed"]
    assert made.calls[1][3] == 1, "pairs between the pieces are sought by likeness"
    assert "fell into pieces" in group.reasons[0]


def test_a_frame_astray_stays_and_the_block_proceeds(pieces, tmp_path):
    pieces(ONE)
    (group,) = prove(_block("a"), tmp_path).groups
    assert (group.route, len(group.frames), group.alignment.rung) == ("proceed", 18, "quick")


def test_several_frames_astray_leave_the_block_unproven(pieces, tmp_path):
    pieces(FEW)
    (group,) = prove(_block("a"), tmp_path).groups
    assert (group.route, len(group.frames)) == ("unproven", 18)
    assert group.reasons[0] == "4 of 18 frames make models of their own: it is not one piece"


def test_a_piece_as_large_as_a_survey_leaves(pieces, tmp_path):
    pieces(MANY)
    found = {len(g.frames): g.route for g in prove(_block("a"), tmp_path).groups}
    assert found == {10: "proceed", 8: "isolate"}


def test_what_fails_by_a_hair_is_decided_by_the_reference(solver, tmp_path):
    made = solver(lambda rung, names: {"b": "fail"} if rung == "quick" else {})
    made.close = ("quick",)
    (group,) = prove(_block("ab"), tmp_path).groups
    assert [c[0] for c in made.calls] == ["quick", "reference"] and group.route == "proceed"


def test_what_fails_clearly_is_not_tried_by_the_reference(solver, tmp_path):
    made = solver(lambda rung, names: {"b": "fail"} if len(names) > 1 else {})
    prove(_block("ab"), tmp_path)
    assert "reference" not in [c[0] for c in made.calls]


def test_an_unproven_payload_keeps_what_was_said_of_it_together(solver, tmp_path):
    solver(lambda rung, names: dict.fromkeys({"b"} & set(names), "unproven"))
    found = {g.payloads: g.reasons for g in prove(_block("ab"), tmp_path).groups}
    assert found[("a",)] == ("a said",)
    assert found[("b",)][0] == "b said"
