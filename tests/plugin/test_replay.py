"""A run done again by its plan: the same bytes elsewhere, every difference named, nothing taken on trust."""

from __future__ import annotations

import copy
import dataclasses
import json
import shutil
from pathlib import Path

import pytest

pytest.importorskip("cv2")

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sensorgate.plugin import pipeline
from sensorgate.plugin.cli import main
from sensorgate.plugin.inspection import Settings
from sensorgate.plugin.plan import Names, plan_record
from sensorgate.plugin.plan_diff import differences, moved
from sensorgate.plugin.plan_file import read_plan
from sensorgate.plugin.replay import replay_record, settings_of, told
from sensorgate.stages.errors import UsageError
from sensorgate.stages.thresholds import DEFAULTS

from tests import simulator
from tests.plugin.test_run import SCHEMA, SOLVER_FILES, digests


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A survey with ground control, run without alignment and with a changed threshold."""
    home = tmp_path_factory.mktemp("first")
    truth = simulator.render("tiny", home / "survey", seed=0)
    (home / "limits.json").write_text('{"gsd_trigger": 0.08, "min_inliers": 31}')
    control = ["--gcp", str(home / "survey" / truth.gcp_file)] if truth.gcp_file else []
    limits = ["--thresholds", str(home / "limits.json"), "--no-align"]
    main(["run", str(home / "survey/images"), "--out", str(home / "out"), *control, *limits])
    return home


@pytest.fixture
def elsewhere(first, tmp_path):
    """The same imagery on another machine: another folder, nothing of the first run but its plan."""
    shutil.copytree(first / "survey", tmp_path / "there/flown")
    shutil.copy(first / "out/plan.json", tmp_path / "plan.json")
    return tmp_path


def replay(home, *more, images="there/flown/images", out="out"):
    code = main(["run", str(home / images), "--plan", str(home / "plan.json"), "--out", str(home / out), *more])
    return code, json.loads((home / out / "report.json").read_text(encoding="utf-8"))


def test_elsewhere_the_same_projects_and_the_same_plan_to_the_byte(first, elsewhere, capsys):
    code, report = replay(elsewhere)
    assert report["replay"]["differences"] == []
    assert report["replay"]["same"] and code == 1
    assert digests(elsewhere / "out", SOLVER_FILES) == digests(first / "out", SOLVER_FILES)
    assert (elsewhere / "out/plan.json").read_bytes() == (first / "out/plan.json").read_bytes()
    assert report["thresholds"]["changed"] == {"gsd_trigger": 0.08, "min_inliers": 31}
    assert "nothing differs from the plan" in capsys.readouterr().out


def test_the_plan_names_no_place(first):
    text = (first / "out/plan.json").read_text(encoding="utf-8")
    assert str(first) not in text and first.name not in text


def test_the_report_of_a_replay_fits_its_schema(elsewhere):
    import jsonschema

    _, report = replay(elsewhere)
    jsonschema.validate(report, json.loads(SCHEMA.read_text(encoding="utf-8")))


def test_what_happened_to_the_input_is_named(elsewhere, capsys):
    frames = sorted((elsewhere / "there/flown/images").rglob("*.JPG")) or sorted(
        (elsewhere / "there/flown/images").rglob("*.jpg")
    )
    changed, gone, renamed = frames[0], frames[1], frames[2]
    changed.write_bytes(changed.read_bytes() + b"\0")
    gone.unlink()
    renamed.rename(renamed.with_name(f"z-{renamed.name}"))
    _, report = replay(elsewhere)
    said = {d["message"]: d["subjects"] for d in report["replay"]["differences"] if d["about"] == "input"}
    assert len(said) == 3
    by_word = {w: s for m, s in said.items() for w in ("missing", "other content", "another name") if w in m}
    assert [s.rsplit("/", 1)[-1] for s in by_word["missing"]] == [gone.name]
    assert [s.rsplit("/", 1)[-1] for s in by_word["other content"]] == [changed.name]
    assert [s.rsplit("/", 1)[-1] for s in by_word["another name"]] == [f"z-{renamed.name}"]
    assert any(d["about"] == "output" for d in report["replay"]["differences"])
    assert not report["replay"]["same"]
    out = capsys.readouterr()
    assert changed.name in out.out and "differ from the plan" in out.out
    assert gone.name in out.err, "said before the hours of work, not only after"


@pytest.mark.parametrize(
    ("more", "name"),
    [
        (["--gsd-trigger", "0.2"], "gsd_trigger"),
        (["--gsd-target", "coarsest"], "--gsd-target"),
        (["--max-dim", "900"], "--max-dim"),
        (["--calibration", "sheet.csv"], "--calibration"),
        (["--calibrations", "store"], "--calibrations"),
    ],
)
def test_a_command_that_contradicts_the_plan_is_refused(elsewhere, capsys, more, name):
    command = ["run", str(elsewhere / "there/flown/images"), "--plan", str(elsewhere / "plan.json")]
    assert main([*command, "--out", str(elsewhere / "out"), *more]) == 2
    assert name in capsys.readouterr().err
    assert not (elsewhere / "out").exists()


def test_agreeing_with_the_plan_is_allowed(elsewhere):
    plan = read_plan(str(elsewhere / "plan.json"))
    limits = DEFAULTS.replaced({"gsd_trigger": 0.08})
    found = settings_of(plan, Settings(thresholds=limits, align=False), [elsewhere / "there/flown"])
    assert found.thresholds.min_inliers == 31 and found.align is False


def edited(home: Path, change):
    record = json.loads((home / "plan.json").read_text(encoding="utf-8"))
    change(record)
    (home / "plan.json").write_text(json.dumps(record), encoding="utf-8")


def _set(*keys_and_value):
    *keys, value = keys_and_value

    def change(record):
        for key in keys[:-1]:
            record = record[key]
        record[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        _set("thresholds", "all", "no_such_number", 1),
        _set("thresholds", "all", "gsd_trigger", "big"),
        _set("thresholds", "all", "gsd_trigger", 10**400),
        _set("thresholds", "all", "max_xmp_bytes", 1 << 40),
        _set("settings", "options", "engine", "rm -rf"),
        _set("settings", "options", "thresholds", {}),
        _set("settings", "options", "max_dim", True),
        _set("settings", "options", "work", "/tmp"),
        _set("settings", "files", "geo", {"name": "../../etc/passwd", "sha256": "0" * 64}),
        _set("settings", "files", "geo", {"name": "geo.txt", "sha256": "0" * 64}),
        _set("settings", "files", "shadow", {"name": "shadow", "sha256": "0" * 64}),
        _set("settings", "stored", [{"key": 1}]),
        _set("inputs", "files", ["a"]),
        _set("subprojects", [{"name": 1}]),
        _set("schema_version", "1.0"),
        _set("schema_version", "99"),
    ],
)
def test_a_plan_is_not_trusted(elsewhere, change, capsys):
    edited(elsewhere, change)
    command = ["run", str(elsewhere / "there/flown/images"), "--plan", str(elsewhere / "plan.json")]
    assert main([*command, "--out", str(elsewhere / "out")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("sensorgate: ") and "Traceback" not in said and len(said) < 600
    assert not (elsewhere / "out").exists()


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 100_000, b'{"schema_version": 2}'])
def test_what_is_no_plan_is_refused(tmp_path, data):
    (tmp_path / "plan.json").write_bytes(data)
    with pytest.raises(UsageError):
        read_plan(str(tmp_path / "plan.json"))


def test_a_plan_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr("sensorgate.plugin.plan_file.MAX_PLAN_BYTES", 100)
    (tmp_path / "plan.json").write_bytes(b" " * 101)
    with pytest.raises(UsageError, match="too large"):
        read_plan(str(tmp_path / "plan.json"))


def test_a_file_of_the_plan_with_other_content_is_a_difference(first, elsewhere):
    plan = json.loads((elsewhere / "plan.json").read_text(encoding="utf-8"))
    if "gcp" not in plan["settings"]["files"]:
        pytest.skip("this story has no ground control")
    name = plan["settings"]["files"]["gcp"]["name"]
    other = elsewhere / "other.txt"
    other.write_text((elsewhere / "there/flown" / name).read_text() + "\n")
    _, report = replay(elsewhere, "--gcp", str(other))
    assert [d["subjects"] for d in report["replay"]["differences"] if d["about"] == "setting"] == [["gcp"]]


# --- laws ------------------------------------------------------------------------------------


def record_of(settings: Settings, home: Path):
    home.mkdir(exist_ok=True)
    report = {
        "versions": {},
        "inputs": {"options": settings.options(), "elevation": None},
        "thresholds": {"changed": {}, "all": dataclasses.asdict(settings.thresholds)},
        "subprojects": [],
        "frames": [],
    }
    bare = pipeline.inspect([str(home)], settings)
    return json.loads(json.dumps(plan_record(report, bare, {}, {})))


@settings(deadline=None)
@given(
    trigger=st.floats(0.001, 10.0),
    inliers=st.integers(1, 1000),
    target=st.one_of(st.sampled_from(["finest", "coarsest"]), st.floats(0.1, 100.0)),
    force=st.booleans(),
    align=st.booleans(),
    look=st.booleans(),
    engine=st.sampled_from(["pycolmap", "colmap"]),
    ground=st.one_of(st.none(), st.floats(-100.0, 4000.0)),
    max_dim=st.one_of(st.none(), st.integers(200, 20000)),
)
def test_settings_come_back_out_of_a_plan_as_they_went_in(
    tmp_path_factory, trigger, inliers, target, force, align, look, engine, ground, max_dim
):
    home = tmp_path_factory.getbasetemp() / "bare"
    wanted = Settings(
        thresholds=DEFAULTS.replaced({"gsd_trigger": trigger, "min_inliers": inliers}),
        gsd_target=target,
        force_gcp=force,
        align=align,
        engine=engine,
        ground_m=ground,
        max_dim=max_dim,
    )
    (home.parent / "bare.json").write_text(json.dumps(record_of(wanted, home)))
    assert settings_of(read_plan(str(home.parent / "bare.json")), Settings()) == wanted


def leaves(value, at=()):
    if isinstance(value, dict):
        for key in value:
            yield from leaves(value[key], (*at, key))
    elif isinstance(value, list):
        for index in range(len(value)):
            yield from leaves(value[index], (*at, index))
    else:
        yield at


def branches(value, at=()):
    """The way to every value of a JSON, inner ones too."""
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield (*at, key)
        yield from branches(value[key], (*at, key))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=150)
@given(data=st.data())
def test_a_plan_bent_anywhere_is_refused_or_works(first, tmp_path, data):
    """Whatever stands in a plan from elsewhere: a sentence for the user, never a fault of ours."""
    whole = json.loads((first / "out/plan.json").read_text(encoding="utf-8"))
    bent = copy.deepcopy(whole)
    section = data.draw(st.sampled_from(sorted(whole)))
    place, at = bent, data.draw(st.sampled_from([(section,), *branches(whole[section], (section,))]))
    for key in at[:-1]:
        place = place[key]
    place[at[-1]] = data.draw(JSON)
    (tmp_path / "plan.json").write_text(json.dumps(bent), encoding="utf-8")
    try:
        plan = read_plan(str(tmp_path / "plan.json"))
        settings_of(plan, Settings(), [first / "survey"])
    except UsageError as error:
        assert len(str(error)) < 500 and str(error).isprintable()
        return
    assert told(replay_record(plan, whole))


# Said of the same thing elsewhere in the plan, or a sentence for people.
SILENT = {"schema_version", "changed", "digest", "gains", "reasons", "elevation", "spectrum"}


def test_every_change_of_a_plan_is_told(first):
    plan = json.loads((first / "out/plan.json").read_text(encoding="utf-8"))
    assert differences(plan, plan) == ()
    untold = []
    for at in list(leaves(plan)):
        if SILENT & set(map(str, at)) or (at[:2] == ("settings", "files") and at[-1] == "name"):
            continue
        other = copy.deepcopy(plan)
        place = other
        for key in at[:-1]:
            place = place[key]
        before = place[at[-1]]
        place[at[-1]] = "0" * 64 if isinstance(before, str) else 123456 if before != 123456 else 0
        if not differences(plan, other):
            untold.append(at)
    assert untold == []


@settings(deadline=None)
@given(st.data())
def test_moved_files_are_told_once_and_by_content(data):
    names = data.draw(st.lists(st.text("abc/", min_size=1, max_size=4), unique=True, max_size=6))
    before = {n: f"{i:064x}" for i, n in enumerate(names)}
    after = {f"moved/{n}": d for n, d in before.items()}
    twin = moved({"inputs": {"files": before}}, {"inputs": {"files": after}})
    assert twin == {f"moved/{n}": n for n in names}


@pytest.mark.parametrize(
    ("paths", "shown", "name"),
    [
        (["/a/b"], "/a/b/c/d.jpg", "c/d.jpg"),
        (["/a/b/"], "/a/b/c/d.jpg", "c/d.jpg"),
        (["."], "./d.jpg", "d.jpg"),
        (["x/y.jpg"], "x/y.jpg", "y.jpg"),
        (["/a", "/b"], "/b/d.jpg", "2/d.jpg"),
        (["/b", "/a"], "/b/d.jpg", "1/d.jpg"),
        (["/a/b", "/a"], "/a/b/d.jpg", "2/b/d.jpg"),
    ],
)
def test_names_do_not_depend_on_where_the_argument_lies(paths, shown, name):
    assert Names(paths)(shown) == name


def test_the_terminal_gets_no_control_characters_and_few_lines():
    each = {"about": "input", "message": "a\x1b[31m" + "x" * 300}
    lines = told({"differences": [each] * 50}, 100)
    assert len(lines) < 45 and all(line.isprintable() and len(line) <= 100 for line in lines)
    assert "38 more" in lines[-1]
