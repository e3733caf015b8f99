"""What comes out of a project that failed: every frame in exactly one new project, texts cut to them."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.submit.parcel import Item, Parcel, read_parcel, said_of
from sensorgate.plugin.submit.reroute import FEATURES, build, frames_of, plan

from .making import CALIBRATION, CAMERA, LOCK, files_of, project, report

FRAMES = {"A1.JPG": "a", "A2.JPG": "a", "B1.JPG": "b/rgb", "B2.JPG": "b/rgb", "C1.JPG": "c"}


def parcel(frames=FRAMES, options=()) -> Parcel:
    items = tuple(Item(n, n, 1) for n in sorted(frames))
    return Parcel("rgb", "rgb", items, options, None, "proceed", (), tuple(sorted(set(frames.values()))), "d")


def known(frames=FRAMES):
    return {n: (p, CAMERA) for n, p in frames.items()}


def test_isolate_gives_each_payload_its_own():
    parts = plan(parcel(), "isolate", ("why",), known())
    assert [p.payloads for p in parts] == [("a",), ("b/rgb",), ("c",)]
    assert sorted(n for p in parts for n in p.frames) == sorted(FRAMES)
    assert all(p.route == "isolate" and p.reasons == ("why",) for p in parts)


def test_one_payload_cannot_be_taken_apart():
    one = {"A.JPG": "a", "B.JPG": "a"}
    assert plan(parcel(one), "isolate", (), known(one)) == ()


def test_pairwise_keeps_what_stands_and_sets_the_rest_apart():
    parts = plan(parcel(), "pairwise", ("why",), known(), {"C1.JPG": "no pair"})
    assert [(p.name, p.route) for p in parts] == [("rgb-rest", "pairwise"), ("rgb-c", "isolate")]
    assert parts[1].reasons == ("why", "no pair")


def test_pairwise_without_a_guilty_one_tries_more_features_once_then_isolates():
    (again,) = plan(parcel(), "pairwise", (), known(), {})
    assert again.name == "rgb-again" and again.options[0][0] == FEATURES and sorted(again.frames) == sorted(FRAMES)
    tried = parcel(options=({"name": FEATURES, "value": 20000},))
    assert len(plan(tried, "pairwise", (), known(), {})) == 3


@given(
    st.dictionaries(st.from_regex(r"[A-Z][0-9]{1,3}\.JPG", fullmatch=True), st.sampled_from("abcd"), min_size=1),
    st.sampled_from(["pairwise", "isolate"]),
    st.data(),
)
def test_no_frame_is_lost_or_doubled(frames, route, data):
    refused = data.draw(st.none() | st.sets(st.sampled_from(sorted(set(frames.values())))))
    apart = None if refused is None else {n: "why" for n, p in frames.items() if p in refused}
    parts = plan(parcel(frames), route, (), known(frames), apart)
    if parts:
        assert sorted(n for p in parts for n in p.frames) == sorted(frames)
        assert len({p.name for p in parts}) == len(parts)


def test_folders_are_cut_to_their_frames(tmp_path):
    marks = "".join(f"{x} {x} 1 10 10 {n} p{x}\n" for x in range(6) for n in ("A1.JPG", "A2.JPG", "A3.JPG", "B1.JPG"))
    old = project(
        tmp_path,
        "rgb",
        ("A1.JPG", "A2.JPG", "A3.JPG", "A1_mask.png", "B1.JPG"),
        gcp=f"EPSG:32633\n{marks}",
        geo="EPSG:4326\nA1.JPG 1 2 3\nB1.JPG 1 2 3\n",
        calibration={**CALIBRATION, "other cam 1 1 brown 0.5": {"focal_x": 0.5}},
        options=[LOCK, {"name": "dsm", "value": True}],
    )
    payloads = {"A1.JPG": "a", "A2.JPG": "a", "A3.JPG": "a", "B1.JPG": "b"}
    report(tmp_path, [{"name": "rgb", "route": "proceed", "payload_of": payloads}])
    seen = frames_of(json.loads((tmp_path / "report.json").read_text()))
    whole = read_parcel(old, {"payloads": ["a", "b"]})
    first, second = (build(whole, part, seen) for part in plan(whole, "isolate", ("why",), seen))
    assert sorted(files_of(first)) == ["A1.JPG", "A1_mask.png", "A2.JPG", "A3.JPG"] and sorted(files_of(second)) == [
        "B1.JPG"
    ]
    assert {**files_of(first), **files_of(second)} == files_of(old)
    assert "B1" not in (first / "gcp_list.txt").read_text() and (first / "gcp_list.txt").read_text().count("\n") == 19
    assert not (second / "gcp_list.txt").exists()  # six points in one image each replace no GPS
    assert (second / "geo.txt").read_text() == "EPSG:4326\nB1.JPG 1 2 3\n"
    assert json.loads((first / "sensorgate/calibration.json").read_text()) == CALIBRATION
    assert LOCK in json.loads((first / "sensorgate/options.json").read_text())
    child = read_parcel(first, said_of(first))
    assert (child.parent, child.route, child.payloads) == ("rgb", "isolate", ("a",))
    assert build(whole, plan(whole, "isolate", ("why",), seen)[0], seen) == first  # a second time changes nothing


def test_without_calibration_for_its_frames_nothing_is_locked(tmp_path):
    old = project(tmp_path, "rgb", ("A1.JPG", "B1.JPG"), calibration=CALIBRATION, options=[LOCK])
    seen = {"A1.JPG": ("a", CAMERA), "B1.JPG": ("b", "another cam 1 1 brown 0.5")}
    whole = read_parcel(old, {"payloads": ["a", "b"]})
    first, second = (build(whole, part, seen) for part in plan(whole, "isolate", (), seen))
    assert json.loads((first / "sensorgate/options.json").read_text()) == [LOCK]
    assert json.loads((second / "sensorgate/options.json").read_text()) == []
    assert not (second / "sensorgate/calibration.json").exists()
