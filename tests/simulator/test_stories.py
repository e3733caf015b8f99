"""Every named story can be built, and is what it says."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulator import stories
from tests.simulator.dialects import WRITERS
from tests.simulator.stories import STORIES, build


@pytest.mark.parametrize("name", list(STORIES))
def test_every_story_is_sound(name):
    survey = build(name, 0)
    paths = [s.path for s in survey.shots]
    assert len(set(paths)) == len(paths)
    assert len({p.rsplit("/", 1)[-1] for p in paths}) == len(paths)
    assert {s.payload for s in survey.shots} == {p.id for p in survey.payloads}
    assert all(p.dialect in WRITERS for p in survey.payloads)
    assert {lie.path for lie in survey.file_lies} <= set(paths)
    assert build(name, 0) == survey


def test_the_demo_is_the_mix_it_promises():
    survey = build("demo", 0)
    counts = {p.id: sum(s.payload == p.id for s in survey.shots) for p in survey.payloads}
    assert counts == {"p4p": 18, "p4": 12, "rededge": 50, "thermal": 14, "compact": 8}
    gsd = {}
    for shot in survey.shots:
        camera = shot.optics(survey.payload(shot.payload))
        gsd.setdefault(shot.payload, []).append(shot.position[2] / camera.focal_px)
    assert np.median(gsd["p4"]) / np.median(gsd["p4p"]) == pytest.approx(1.4, abs=0.06)
    projects = {p.id: p.project for p in survey.payloads}
    assert projects["p4p"] == projects["p4"]
    assert len(set(projects.values())) == 4
    assert survey.payload("compact").route == "isolate"
    assert all(s.reported.focal_mm is None for s in survey.shots if s.payload == "thermal")


def test_unknown_story_names_the_known():
    with pytest.raises(ValueError, match="demo"):
        build("no-such-story")


def test_stories_module_lists_what_the_command_offers(capsys):
    from tests.simulator.__main__ import main

    with pytest.raises(SystemExit):
        main(["--help"])
    shown = capsys.readouterr().out
    assert all(name in shown for name in stories.STORIES)
