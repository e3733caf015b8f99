"""The calibration store: what it keeps, what it never overwrites, and what it refuses to read."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.stages.calibrations import (
    AGREES,
    BETTER,
    DOUBTED,
    KEPT,
    KNOWN,
    REPLACED,
    Entry,
    Key,
    Measurement,
    entry_name,
    key_of,
    read_store,
    store_digest,
    survey_digest,
    updated,
    with_stored,
    worth_keeping,
    write_entry,
)
from sensorgate.stages.errors import UsageError
from sensorgate.stages.intrinsics import STORED
from sensorgate.stages.thresholds import DEFAULTS

from tests.frames import strip, survey_of

KEY = Key("DJI", "FC6310", "A1", 5472, 3648)
GOOD = Measurement(0.668, 0.0002, (0.001, -0.002), (0.01, -0.02, 0.0, 0.0, 0.0), 60, "first")


def seen(survey, focal=0.668, sigma=0.0002, frames=60):
    return replace(GOOD, focal_ratio=focal, focal_sigma=sigma, frames=frames, survey=survey)


def after(*surveys):
    entry, said = None, []
    for survey in surveys:
        entry, word = updated(entry, KEY, survey, DEFAULTS)
        said.append(word)
    return entry, said


def test_the_better_of_two_that_agree_is_kept_whole():
    better = replace(seen("second", 0.6682, 0.0001), distortion=(0.011, -0.021, 0.0, 0.0, 0.0))
    entry, said = after(GOOD, better, seen("third", 0.6679, 0.0004))
    assert said == [KEPT, BETTER, AGREES]
    assert entry.best == better and entry.surveys == ("first", "second", "third")


def test_an_outlier_never_overwrites_and_a_repeat_counts_once():
    wild = seen("wild", 0.70, 0.00001, 500)
    entry, said = after(GOOD, wild, wild, GOOD)
    assert said == [KEPT, DOUBTED, KNOWN, KNOWN]
    assert entry.best == GOOD and [d.survey for d in entry.doubts] == ["wild"]


def test_an_agreeing_survey_clears_the_doubts():
    entry, said = after(GOOD, seen("a", 0.70), seen("b", 0.70), seen("c"), seen("d", 0.70), seen("e", 0.70))
    assert said == [KEPT, DOUBTED, DOUBTED, AGREES, DOUBTED, DOUBTED]
    assert entry.best.focal_ratio == 0.668


def test_a_changed_lens_takes_its_place_after_three_surveys_that_agree():
    entry, said = after(GOOD, seen("a", 0.70), seen("b", 0.7003), seen("c", 0.7001, 0.0001))
    assert said[-1] == REPLACED and entry.best.survey == "c" and entry.doubts == ()
    entry, said = after(GOOD, seen("a", 0.70), seen("b", 0.62), seen("c", 0.75))
    assert said == [KEPT, DOUBTED, DOUBTED, DOUBTED] and entry.best == GOOD


@given(st.lists(st.tuples(st.floats(0.5, 0.9), st.floats(1e-5, 1e-2)), max_size=12))
def test_whatever_comes_one_measurement_stands_and_every_survey_counts_once(measured):
    entry = None
    for number, (focal, sigma) in enumerate(measured):
        entry, _ = updated(entry, KEY, seen(str(number), focal, sigma), DEFAULTS)
        again, word = updated(entry, KEY, seen(str(number), focal, sigma), DEFAULTS)
        assert (again, word) == (entry, KNOWN)
    if entry is not None:
        doubted = [d.survey for d in entry.doubts]
        assert entry.best.survey in entry.surveys
        assert len({*entry.surveys, *doubted}) == len(entry.surveys) + len(doubted)
        assert len(doubted) < DEFAULTS.stored_doubts


def test_what_is_weak_is_not_offered():
    assert worth_keeping(GOOD, DEFAULTS)
    assert not worth_keeping(seen("s", sigma=0.004), DEFAULTS)
    assert not worth_keeping(seen("s", sigma=0.0), DEFAULTS)
    assert not worth_keeping(seen("s", frames=8), DEFAULTS)


def test_to_disk_and_back(tmp_path: Path):
    entry, _ = after(GOOD, seen("a", 0.70))
    assert read_store(tmp_path / "none") == {}
    write_entry(tmp_path, entry)
    assert read_store(tmp_path) == {KEY: entry}
    assert store_digest(read_store(tmp_path)) == store_digest({KEY: entry}) != store_digest({})


@pytest.mark.parametrize(
    "text",
    ("", "[]", "{", '{"key": 3}', "{" * 3000, '{"key": {"make": "../../etc", "model": "", "serial": "", "width": 1}}'),
)
def test_a_file_that_is_no_entry_is_named(tmp_path: Path, text: str):
    (tmp_path / "odd.json").write_text(text)
    with pytest.raises(UsageError, match=r"odd\.json"):
        read_store(tmp_path)


def test_an_entry_under_anothers_name_or_with_odd_numbers_is_refused(tmp_path: Path):
    write_entry(tmp_path, Entry(KEY, GOOD, ("first",)))
    name = entry_name(KEY)
    text = (tmp_path / name).read_text()
    (tmp_path / name).write_text(text.replace("0.668", "-0.668"))
    with pytest.raises(UsageError):
        read_store(tmp_path)
    (tmp_path / name).rename(tmp_path / "other.json")
    (tmp_path / "other.json").write_text(text)
    with pytest.raises(UsageError):
        read_store(tmp_path)


def test_an_aspect_comes_back_and_an_entry_without_one_has_square_pixels(tmp_path: Path):
    entry = Entry(KEY, replace(GOOD, aspect_ratio=0.998089), ("first",))
    write_entry(tmp_path, entry)
    assert read_store(tmp_path) == {KEY: entry}
    file = tmp_path / entry_name(KEY)
    text = file.read_text()
    plain = json.loads(text)
    del plain["best"]["aspect_ratio"]
    file.write_text(json.dumps(plain))
    assert read_store(tmp_path)[KEY].best == GOOD
    file.write_text(text.replace("0.998089", "-0.998089"))
    with pytest.raises(UsageError):
        read_store(tmp_path)


def test_names_stay_in_the_folder():
    assert "/" not in entry_name(Key("../..", "a/b", "c\x00", 1, 1))


def stored_for(survey, focal):
    (profile,) = survey.profiles
    key = key_of(profile)
    entry = Entry(key, replace(GOOD, focal_ratio=focal), ("first", "second"))
    return with_stored(survey.profiles, {f.path: f.intrinsics for f in survey.frames}, {key: entry}, DEFAULTS)


def test_a_profile_takes_over_what_its_body_proved():
    survey = survey_of(strip(count=8, serial="A1"))
    own = survey.profiles[0].intrinsics.focal_ratio
    (profile,), known = stored_for(survey, own * 1.01)
    assert profile.intrinsics.focal_source == STORED and profile.intrinsics.complete
    assert profile.intrinsics.focal_ratio == pytest.approx(own * 1.01)
    assert profile.intrinsics.distortion == GOOD.distortion
    assert {i.focal_source for i in known.values()} == {STORED}
    assert "2 earlier surveys" in profile.intrinsics.notes[-1]


def test_tags_of_another_lens_keep_the_store_out():
    survey = survey_of(strip(count=8, serial="A1"))
    (profile,), _ = stored_for(survey, survey.profiles[0].intrinsics.focal_ratio * 1.3)
    assert profile == survey.profiles[0]


def test_a_survey_is_the_same_in_another_folder_and_order():
    frames = strip(count=4)
    moved = [replace(f, path="elsewhere/" + f.path.rsplit("/", 1)[-1]) for f in frames[::-1]]
    assert survey_digest(moved) == survey_digest(frames) != survey_digest(frames[1:])


def test_a_body_without_a_serial_is_not_kept():
    assert key_of(survey_of(strip(count=8)).profiles[0]) is None
