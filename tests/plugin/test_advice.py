"""Advice on how projects came out."""

from __future__ import annotations

from dataclasses import replace

from sensorgate.plugin.advice import advice
from sensorgate.stages.align.model import AlignedFrame, AlignmentReport, Bowing, GpsFit, PayloadAlignment
from sensorgate.stages.proven import ISOLATE, PAIRWISE, PROCEED, UNPROVEN, ProvenGroup
from sensorgate.stages.thresholds import DEFAULTS

REPORT = AlignmentReport(
    "rgb", "pycolmap", "quick", (), 30, 1, 0.4, "a", GpsFit(30), 60.0, Bowing(0.05, 0.1, 50.0), (), (), (), (), 0, None
)


def group(route=PROCEED, frames=30, bowing=REPORT.bowing):
    paths = tuple(f"{route}{frames}/{i}" for i in range(frames))
    return ProvenGroup("g", ("a",), paths, route, (), replace(REPORT, bowing=bowing))


def codes(*groups, has_gcp=False, area=(1, 1, 1)):
    projects = [(f"p{i}", "rgb", a, g) for i, (g, a) in enumerate(zip(groups, area))]
    return {f.code: f for f in advice(projects, has_gcp, DEFAULTS)}


def test_nothing_is_said_of_what_is_good():
    assert codes(group(), group(UNPROVEN)) == {}


def test_a_called_bow_asks_for_control():
    assert "--gcp" in codes(group(bowing=Bowing(-0.6, 0.1, 50.0)))["block-bows"].remedy
    assert codes(group(bowing=Bowing(-0.6, 0.3, 50.0))) == {}
    assert codes(group(bowing=Bowing())) == {}


def test_pairwise_asks_for_control_where_there_is_none():
    assert "--gcp" in codes(group(PAIRWISE))["joined-pairwise"].remedy
    assert "--gcp" not in codes(group(PAIRWISE), has_gcp=True)["joined-pairwise"].remedy


def test_what_stands_alone_over_proven_ground_is_aligned_to_the_largest():
    found = codes(group(ISOLATE, 8), group(frames=20), group(frames=40))["align-to-anchor"]
    assert found.subjects == ("p0",) and "p2" in found.remedy
    assert codes(group(ISOLATE, 8), group(), area=(2, 1)) == {}
    assert codes(replace(group(ISOLATE, 8), alignment=None), group()) == {}


def test_pairwise_again_and_again_is_a_warning_about_the_flights():
    found = list(advice([(n, "rgb", 1, group(PAIRWISE)) for n in ("a", "b")], False, DEFAULTS))
    assert [(f.code, f.severity, f.subjects) for f in found] == [("joined-pairwise", "warning", ("a", "b"))]
    assert "--gcp" in found[0].remedy and "overlap" in found[0].remedy


def test_positions_that_lie_apart_are_said_with_the_way_to_lay_them_together():
    fit = GpsFit(20)
    payloads = (
        PayloadAlignment("a", 20, 20, 20, 0.4, fit, fit, verdict="pass"),
        PayloadAlignment("b", 20, 20, 20, 0.4, fit, fit, verdict="pass", gps_offset_m=(30.2, -1.0, 0.4)),
    )
    shifted = group()
    shifted = replace(shifted, alignment=replace(shifted.alignment, payloads=payloads))
    found = codes(shifted)["positions-shifted"]
    assert found.subjects == ("b", "p0") and found.measured == 30.2
    assert "+30.2 m east" in found.message and "align" in found.remedy and "--gcp" in found.remedy
    assert "--gcp" not in codes(shifted, has_gcp=True)["positions-shifted"].remedy
    assert codes(replace(shifted, route=UNPROVEN)) == {}


def test_frames_without_a_place_are_named_and_many_of_them_are_a_warning():
    def left_out(lost, route=PROCEED, piece=0):
        frames = tuple(AlignedFrame(f"{i}.jpg", i >= lost, 0 if i != 19 else piece) for i in range(20))
        return replace(group(route), alignment=replace(REPORT, frames=frames))

    few = codes(left_out(1))["frames-unplaced"]
    assert (few.severity, few.subjects, few.measured) == ("info", ("0.jpg",), 0.05)
    many = codes(left_out(6))["frames-unplaced"]
    assert many.severity == "warning" and len(many.subjects) == 6 and "6 of 20" in many.message
    assert codes(left_out(0, piece=1))["frames-unplaced"].subjects == ("19.jpg",)
    assert codes(left_out(0)) == {} and codes(left_out(6, UNPROVEN)) == {}
