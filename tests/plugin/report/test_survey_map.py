"""Each site at its own scale; nothing of the survey is lost from the map without a word."""

from __future__ import annotations

import math
import re
from typing import Any, Dict, List, Tuple

from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.plugin.report import sites
from sensorgate.plugin.report.survey_map import survey_map
from sensorgate.plugin.report.view import View

from tests.plugin.report.sample import sample

Spot = Tuple[float, float]


def block(latitude: float, longitude: float, size_m: float = 200.0, side: int = 4) -> List[Spot]:
    """A square lattice of positions around a place."""
    step = size_m / (side - 1) / sites.METRES_PER_DEGREE
    across = step / math.cos(math.radians(latitude))
    return [(latitude + i * step, longitude + j * across) for i in range(side) for j in range(side)]


def moved(report: Dict[str, Any], payload: str, north_m: float) -> Dict[str, Any]:
    for frame in report["frames"]:
        if frame["payload"] == payload and frame["latitude"]:
            frame["latitude"] += north_m / sites.METRES_PER_DEGREE
    return report


def test_two_blocks_a_few_kilometres_apart_are_two_sites() -> None:
    spots = block(47.2, 8.7) + block(47.2, 8.74, side=3)
    assert [len(s) for s in sites.split_sites(spots)] == [16, 9]
    assert sites.Site(spots[16:]).words_from(sites.Site(spots[:16])) == "3.0 km east"


def test_two_flights_of_one_long_corridor_are_one_site() -> None:
    corridor = [(10.0 + i * 0.0005, 20.0) for i in range(100)]
    gap = [(10.07 + i * 0.0005, 20.0) for i in range(100)]  # 2 km on, each 5.5 km long
    assert len(sites.split_sites(corridor + gap)) == 1


def test_a_site_on_the_date_line_is_one() -> None:
    west = block(-33.0, 179.9975)
    assert len(sites.split_sites([*west, (-33.0, -179.9995)])) == 1
    assert (-33.0, -179.9995) in sites.Site(west) and (-33.0, -179.9) not in sites.Site(west)
    assert sites.Site([(-33.0, -179.9)]).words_from(sites.Site(west)).endswith(" km east")


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(-85, 85), st.floats(-180, 180)), max_size=120))
def test_every_position_is_in_one_site(spots: List[Spot]) -> None:
    found = sites.split_sites(spots)
    assert sorted(i for s in found for i in s) == list(range(len(spots)))
    assert [len(s) for s in found] == sorted((len(s) for s in found), reverse=True)


def test_distant_sites_do_not_share_a_scale() -> None:
    drawn = survey_map(View(moved(sample(20), "phantom-3", 5000.0)))
    assert len(drawn.panels) == 2 and "km north of site 1" in drawn.panels[1].caption
    bars = [re.findall(r'class="bar-text"[^>]*>([^<]+)<', p.drawing) for p in drawn.panels]
    assert all(bar[-1] == "N" and bar[0].endswith(" m") for bar in bars)


def test_lone_frames_are_told_not_drawn() -> None:
    report = sample(20)
    stray = next(f for f in report["frames"] if f["payload"] == "rededge" and not f["reason"])
    stray["latitude"] += 9000.0 / sites.METRES_PER_DEGREE
    drawn = survey_map(View(report))
    assert len(drawn.panels) == 1 and "Not drawn: 1 frame " in drawn.note and "of site 1" in drawn.note
    assert "2 frames without a position" in drawn.note  # the broken file and the one at 0, 0


def test_check_points_look_unlike_ground_control() -> None:
    (panel,) = survey_map(View(sample(20))).panels
    assert panel.drawing.count("ground control,") == 6 and panel.drawing.count("check point,") == 2
    shapes = {re.sub(r"^M[\d.]+ [\d.]+", "", d) for d in re.findall(r'<path d="([^"]+)" class="gcp"', panel.drawing)}
    assert len(shapes) == 2


def test_a_point_without_a_position_is_no_mark() -> None:
    report = sample(20)
    report["inputs"]["gcp"][0]["latitude"] = None
    assert survey_map(View(report)).panels[0].drawing.count("ground control,") == 5
