"""A task's folder between runs, and what is said of it."""

from __future__ import annotations

import json
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.node import workplace
from sensorgate.plugin.node.console import Stage, plain, prepend_stages
from sensorgate.plugin.node.task import holds_points
from sensorgate.plugin.node.workplace import Busy, Part, State, Workplace, image_groups, names_in

PARTS = (Part("rgb", "rgb", "proceed", 8, 8), Part("thermal", "thermal", "proceed", 3, 3))
MADE = {"opensfm/reconstruction.json": "[]", "odm_orthophoto/odm_orthophoto.tif": "tif", "images.json": "[]"}


@pytest.fixture
def place(tmp_path):
    made = Workplace(tmp_path / "task")
    (made.root / "images").mkdir(parents=True)
    (made.root / "images/a.jpg").write_text("a")
    for part in PARTS:
        for name, text in {"images/a.jpg": "a", "sensorgate/options.json": "[]", "geo.txt": "g", **MADE}.items():
            path = made.part(part.name) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
    return made


def tree(folder):
    return {str(p.relative_to(folder)): p.read_text() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_products_come_up_and_go_back_whole(place):
    before = tree(place.part("rgb"))
    state = place.bring_up(State(digest="d", parts=PARTS))
    assert {k: v for k, v in tree(place.root).items() if not k.startswith(("sensorgate_node", "images/"))} == MADE
    assert set(tree(place.part("rgb"))) == {"images/a.jpg", "sensorgate/options.json", "geo.txt"}
    assert place.load() == state
    place.put_report(place.run)
    state = place.take_back(state)
    assert tree(place.part("rgb")) == before
    assert state.moved == () and place.load() == state
    assert not (place.root / "opensfm").exists()


@pytest.mark.parametrize("after", (0, 1, 2))
def test_a_kill_while_moving_loses_nothing(place, monkeypatch, after):
    before = tree(place.part("rgb"))
    count = 0
    real = workplace._move

    def dying(source, target):
        nonlocal count
        if count == after:
            raise KeyboardInterrupt
        count += 1
        real(source, target)

    monkeypatch.setattr(workplace, "_move", dying)
    with pytest.raises(KeyboardInterrupt):
        place.bring_up(State(digest="d", parts=PARTS))
    monkeypatch.setattr(workplace, "_move", real)
    state = place.load()
    assert state is not None
    place.take_back(state)
    assert tree(place.part("rgb")) == before


def test_what_stood_at_the_root_before_is_kept_aside(place):
    (place.root / "odm_dem").mkdir()
    (place.root / "odm_dem/dsm.tif").write_text("mine")
    (place.root / "notes.odt").write_text("mine")
    place.set_aside()
    assert (place.own / "earlier/odm_dem/dsm.tif").read_text() == "mine"
    assert (place.root / "notes.odt").exists() and (place.root / "images/a.jpg").exists()


def test_products_are_linked_below_the_report(place):
    assert place.put_products(PARTS[1]) == 2
    target = place.root / "odm_report/sensorgate/thermal/odm_orthophoto/odm_orthophoto.tif"
    assert os.path.samefile(target, place.part("thermal") / "odm_orthophoto/odm_orthophoto.tif")


def test_one_run_at_a_time(place):
    with place.alone(1.0), pytest.raises(Busy), Workplace(place.root).alone(0.0):
        pass
    with place.alone(0.0):
        pass


def test_the_digest_sees_images_files_and_settings(place, tmp_path):
    points = tmp_path / "gcp.txt"
    points.write_text("a")
    digests = {place.digest({"x": 1}, (str(points), None)), place.digest({"x": 2}, (str(points), None))}
    points.write_text("b")
    digests.add(place.digest({"x": 1}, (str(points), None)))
    digests.add(place.digest({"x": 1}, (None, str(points))))
    (place.root / "images/b.jpg").write_text("b")
    digests.add(place.digest({"x": 1}, (str(points), None)))
    assert len(digests) == 5
    assert place.digest({"x": 1}, (None, None)) == place.digest({"x": 1}, (None, None))


def test_odms_own_earlier_run_is_no_piece_of_a_split(place):
    (place.root / "opensfm").mkdir()
    (place.root / "opensfm/camera_models.json").write_text("{}")
    assert place.is_submodel()
    (place.root / "images.json").write_text("[]")
    assert not place.is_submodel()


def test_a_state_that_is_no_state_counts_as_none(place):
    place.own.mkdir(exist_ok=True)
    for text in ("", "[]", "{", '{"parts": 3}'):
        (place.own / "state.json").write_text(text)
        assert place.load() is None


def test_groups_keep_to_the_part_and_its_names():
    report = {
        "frames": [
            {"path": "images/a.jpg", "subproject": "rgb", "output": "projects/rgb/images/a_1.jpg"},
            {"path": "images/b.jpg", "subproject": "thermal", "output": "projects/thermal/images/b.jpg"},
            {"path": "images/c.jpg", "subproject": None, "output": None},
        ]
    }
    text = "a.jpg north\nb.jpg north\nc.jpg south\n\nodd\n"
    assert image_groups(text, names_in(report, "rgb")) == "a_1.jpg north\n"
    assert image_groups(text, names_in(report, "thermal")) == "b.jpg north\n"


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("EPSG:4326\n8.7 47.2 440 100 200 a.jpg gcp1\n", True),
        ("WGS84 UTM 32N\n544256.7\t5320919.9\t5\t3044\t2622\tIMG_0525.jpg\n", True),
        ("flown in the morning, 1 2 3\n", False),
        ("1 2 3 4 5\n", False),
        ("", False),
        ("\0\xff" * 100, False),
    ],
)
def test_ground_control_is_told_from_notes(tmp_path, text, holds):
    file = tmp_path / "x.txt"
    file.write_text(text, encoding="latin-1")
    assert holds_points(file) is holds


def test_our_stages_stand_first_in_odms_log_and_once(tmp_path, capfd):
    log = tmp_path / "log.json"
    odm = {"name": "dataset", "startTime": "2026-01-01T10:00:05", "messages": []}
    log.write_text(json.dumps({"startTime": "2026-01-01T10:00:05", "endTime": "2026-01-01T10:00:09", "stages": [odm]}))
    stage = Stage("mixed_gate").begin()
    stage.end()
    entry = {**stage.entry(), "startTime": "2026-01-01T10:00:00"}
    for _ in range(2):
        prepend_stages(log, [entry])
        record = json.loads(log.read_text())
        assert [s["name"] for s in record["stages"]] == ["mixed_gate", "dataset"]
        assert record["totalTime"] == 9.0
    assert record["stages"][0]["messages"][0] == {"message": "Running mixed_gate stage", "type": "info"}
    assert capfd.readouterr().out.splitlines()[0] == "[INFO]    Running mixed_gate stage"
    for damaged in ("", "[]", '{"stages": 3}'):
        log.write_text(damaged)
        prepend_stages(log, [entry])
        assert log.read_text() == damaged


@given(st.text())
def test_what_is_said_is_printable_ascii(text):
    said = plain(text)
    assert said.isascii() and said.isprintable()
