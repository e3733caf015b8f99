"""Ground control on a block of 5 x 5 frames, 40 m apart, at the edge of zone 15."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, List, Sequence, Tuple

import pytest
from sensorgate.plugin.odm.gcp import GcpFrame, read_gcp
from sensorgate.plugin.odm.gcp_check import held_out
from sensorgate.plugin.odm.gcp_place import PlacedGcps, place
from sensorgate.plugin.odm.gcp_project import gcp_for_project
from sensorgate.stages.align.model import ControlFit
from sensorgate.stages.geo import flatness, hull_area_m2
from sensorgate.stages.srs import lonlat_to_utm, utm_to_lonlat

EAST, NORTH = 577000.0, 5188000.0
CORNERS = [(0.0, 0.0), (160.0, 0.0), (160.0, 160.0), (0.0, 160.0), (80.0, 80.0)]


def frames(prefix: str = "a", east: float = EAST) -> List[GcpFrame]:
    made = []
    for i in range(25):
        lon, lat = utm_to_lonlat(east + i % 5 * 40, NORTH + i // 5 * 40, 15, True)
        name = f"IMG_{i:02d}.JPG"
        made.append(GcpFrame(f"{prefix}/{name}", f"{prefix}_{name}", 4000, 3000, 4000, 3000, (lat, lon)))
    return made


def text(points: Sequence[Tuple[float, float]] = CORNERS, images: int = 3, header: str = "WGS84 UTM 15N") -> str:
    rows = [header]
    for n, (e, north) in enumerate(points):
        rows += [
            f"{EAST + e:.3f} {NORTH + north:.3f} 198.5 {100 + k} 200 IMG_{(n + k) % 25:02d}.JPG p{n}"
            for k in range(images)
        ]
    return "\n".join(rows) + "\n"


def codes(placed: PlacedGcps) -> List[str]:
    return [f.code for f in placed.findings]


def test_good_ground_control_is_written_with_the_projects_names() -> None:
    placed = place(read_gcp(text()), frames())
    assert placed.findings == ()
    decision = gcp_for_project("rgb", placed, frames())
    assert decision.points == 5
    assert decision.findings == ()
    assert decision.text == text().replace(" IMG_", " a_IMG_")


@pytest.mark.parametrize(
    ("points", "images", "code"),
    [
        (CORNERS[:4], 3, "gcp-few-points"),
        (CORNERS, 2, "gcp-few-points"),
        ([(i * 40.0, i * 40.0) for i in range(5)], 3, "gcp-collinear"),
        ([(e / 3, n / 3) for e, n in CORNERS], 3, "gcp-hull-small"),
    ],
)
def test_too_little_ground_control_leaves_gps_on(points: list, images: int, code: str) -> None:
    decision = gcp_for_project("rgb", place(read_gcp(text(points, images)), frames()), frames())
    assert decision.text is None
    assert [f.code for f in decision.findings] == [code]
    assert "GPS stays" in decision.findings[0].message


def test_check_points_stand_in_no_list() -> None:
    five = place(read_gcp(text()), frames())
    placed = held_out(place(read_gcp(text([*CORNERS, (40.0, 100.0)])), frames()), "1")
    assert [f.code for f in placed.findings] == ["gcp-check-points"]
    decision = gcp_for_project("rgb", placed, frames())
    assert decision.text is not None and decision.points == 5
    (out,) = placed.findings[0].subjects
    assert out in ("p4", "p5") and f" {out}" not in decision.text
    assert held_out(five, None) == five
    few = gcp_for_project("rgb", held_out(five, "p4"), frames())
    assert few.text is None and [f.code for f in few.findings] == ["gcp-few-points"]


def test_what_the_alignment_contradicts_is_not_written() -> None:
    placed = place(read_gcp(text([*CORNERS, (40.0, 100.0)])), frames())
    one = gcp_for_project("rgb", placed, frames(), fit=ControlFit(5, outliers=("p5",), verdict="pass"))
    assert one.text is not None and " p5" not in one.text and [f.code for f in one.findings] == ["gcp-outlier"]
    none = gcp_for_project("rgb", placed, frames(), fit=ControlFit(6, verdict="fail"))
    assert none.text is None and [f.code for f in none.findings] == ["gcp-contradicted"]


def test_a_block_without_gps_has_nothing_to_lose() -> None:
    blind = [replace(f, position=None) for f in frames()]
    placed = place(read_gcp(text(CORNERS[:3])), blind)
    assert gcp_for_project("rgb", placed, blind).text is not None
    assert gcp_for_project("rgb", place(read_gcp(text(CORNERS[:2])), blind), blind).text is None


def test_points_without_a_height_are_told_apart_and_kept() -> None:
    flat = text().replace(" 198.5 ", " nan ")
    placed = place(read_gcp(flat), frames())
    assert placed.findings == () and len(placed.marks) == 15
    decision = gcp_for_project("rgb", placed, frames())
    assert decision.points == 5 and decision.text is not None and decision.text.count(" nan ") == 15


def test_each_project_gets_its_own_lines() -> None:
    both = [*frames(), *frames("b", EAST + 50000)]
    mine = text()
    theirs = "".join(
        line.replace(f"{EAST + e:.3f} ", f"{EAST + 50000 + e:.3f} ") + "\n"
        for e, line in ((float(row.split()[0]) - EAST, row) for row in mine.splitlines()[1:])
    )
    placed = place(read_gcp(mine + theirs), both)
    assert placed.findings == ()  # the shared names are parted by place
    first, second = gcp_for_project("a", placed, both[:25]), gcp_for_project("b", placed, both[25:])
    assert first.text is not None and second.text is not None
    assert len(first.text.splitlines()) == len(second.text.splitlines()) == 16
    assert gcp_for_project("c", placed, []).text is None


def test_a_shared_name_that_place_cannot_part_is_refused() -> None:
    placed = place(read_gcp(text()), [*frames(), *frames("b", EAST + 20)])
    assert set(codes(placed)) == {"gcp-image-ambiguous"}
    assert placed.marks == ()


def test_swapped_columns_are_recognised() -> None:
    rows = [r.split() for r in text().splitlines()[1:]]
    turned = "WGS84 UTM 15N\n" + "".join(" ".join([r[1], r[0], *r[2:]]) + "\n" for r in rows)
    placed = place(read_gcp(turned), frames())
    assert codes(placed) == ["gcp-axes-swapped"]
    assert placed.marks == ()
    geographic = "EPSG:4326\n"
    for r in rows:
        lon, lat = utm_to_lonlat(float(r[0]), float(r[1]), 15, True)
        geographic += f"{lat:.8f} {lon:.8f} {' '.join(r[2:])}\n"
    assert codes(place(read_gcp(geographic), frames())) == ["gcp-axes-swapped"]


@pytest.mark.parametrize("header", ["WGS84 UTM 16N", "EPSG:32614", "WGS84 UTM 15S"])
def test_a_wrong_zone_is_named(header: str) -> None:
    placed = place(read_gcp(text(header=header)), frames())
    assert codes(placed) == ["gcp-wrong-zone"]
    assert "WGS84 UTM 15N" in placed.findings[0].remedy


def test_one_far_point_is_left_out_and_the_rest_stays() -> None:
    points = [*CORNERS, (80.0, 20.0)]
    moved = text(points).replace(f"{EAST + 80:.3f} {NORTH + 20:.3f}", f"{EAST + 9080:.3f} {NORTH + 20:.3f}")
    placed = place(read_gcp(moved), frames())
    assert codes(placed) == ["gcp-far"]
    assert placed.findings[0].subjects == ("p5",)
    assert placed.findings[0].measured == pytest.approx(9000, abs=150)
    assert gcp_for_project("rgb", placed, frames()).points == 5


def test_points_over_the_zones_edge_are_not_far() -> None:
    # the same ground in the next zone's coordinates is right, not wrong
    rows: Dict[str, str] = {}
    for row in text().splitlines()[1:]:
        words = row.split()
        x, y = lonlat_to_utm(*utm_to_lonlat(float(words[0]), float(words[1]), 15, True), 16, True)
        rows[row] = f"{x:.4f} {y:.4f} {' '.join(words[2:])}"
    assert place(read_gcp("WGS84 UTM 16N\n" + "\n".join(rows.values())), frames()).findings == ()


def test_names_in_another_case_unknown_ones_and_pixels_outside() -> None:
    rows = text().splitlines()
    rows[1] = rows[1].replace("IMG_00.JPG", "img_00.jpg")
    rows[2] = rows[2].replace("IMG_01.JPG", "IMG_77.JPG")
    rows[3] = rows[3].replace(" 102 200 ", " 102 3200 ")
    placed = place(read_gcp("\n".join(rows)), frames())
    assert codes(placed) == ["gcp-pixel-outside", "gcp-image-case", "gcp-image-unknown"]
    assert placed.findings[2].odm_message is not None
    assert placed.findings[2].odm_message.startswith("GCP line ignored (image not found): 577000.0 5188000.0 198.5")
    assert len(placed.marks) == 13


def test_a_mark_that_stands_there_twice_is_written_once() -> None:
    rows = text().splitlines()
    near = rows[1].replace(" 100 200 ", " 100.4 199.8 ")
    placed = place(read_gcp("\n".join([*rows, rows[4], near]) + "\n"), frames())
    assert codes(placed) == ["gcp-repeated-mark"]
    assert placed.findings[0].measured == 2.0 and "lines 17, 18" in placed.findings[0].message
    assert gcp_for_project("rgb", placed, frames()).text == text().replace(" IMG_", " a_IMG_")


def test_marks_that_contradict_each_other_are_both_left_out() -> None:
    rows = text([*CORNERS, (40.0, 100.0)], images=4).splitlines()
    rows.append(rows[1].replace(" 100 200 IMG_00.JPG", " 900 200 img_00.jpg"))  # the same frame, spelled otherwise
    placed = place(read_gcp("\n".join(rows) + "\n"), frames())
    assert codes(placed) == ["gcp-contradicting-marks", "gcp-image-case"]
    said = placed.findings[0]
    assert said.subjects == ("p0", "a/IMG_00.JPG") and "Lines 2, 26" in said.message and "900 200" in said.message
    assert len(placed.marks) == 23
    decision = gcp_for_project("rgb", placed, frames())
    assert decision.points == 6 and decision.text is not None and "a_IMG_00.JPG p0" not in decision.text


def test_the_same_pixel_for_two_points_is_no_contradiction() -> None:
    rows = text().splitlines()
    other = rows[1].replace(f"{EAST:.3f}", f"{EAST + 3:.3f}")
    assert place(read_gcp("\n".join([*rows, other])), frames()).findings == ()


def test_marks_on_secondary_bands_do_not_count() -> None:
    banded = [replace(f, primary=i % 2 == 0) for i, f in enumerate(frames())]
    decision = gcp_for_project("ms", place(read_gcp(text()), banded), banded)
    assert [f.code for f in decision.findings] == ["gcp-secondary-band", "gcp-few-points"]


def test_hull_and_flatness() -> None:
    square = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (1.0, 1.0), (1.0, 0.0)]
    assert hull_area_m2(square) == pytest.approx(4.0)
    assert hull_area_m2(square[:2]) == 0.0
    assert flatness([(0.0, 0.0), (1.0, 1.0), (3.0, 3.0)]) == pytest.approx(0.0, abs=1e-7)
    assert flatness([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]) == pytest.approx(1.0)
    assert flatness([(1.0, 1.0)]) == 0.0


def test_a_mark_that_the_alignment_finds_astray_is_left_out_and_named() -> None:
    placed = place(read_gcp(text(images=4)), frames())
    astray = (("p1", "a/IMG_02.JPG"),)
    decision = gcp_for_project("rgb", placed, frames(), fit=ControlFit(5, verdict="pass", astray=astray))
    assert decision.text is not None and decision.points == 5
    assert len(decision.text.splitlines()) == 1 + 5 * 4 - 1
    assert not [r for r in decision.text.splitlines() if "a_IMG_02.JPG p1" in r]
    (finding,) = decision.findings
    assert finding.code == "gcp-mark-astray" and finding.subjects == ("p1", "a/IMG_02.JPG")
    assert "p1 on IMG_02.JPG" in finding.message


def test_without_gps_nobody_is_told_that_gps_stays() -> None:
    blind = [replace(f, position=None) for f in frames()]
    placed = place(read_gcp(text(CORNERS[:2])), blind)
    for fit in (None, ControlFit(5, verdict="fail")):
        (finding,) = gcp_for_project("rgb", placed, blind, fit=fit).findings
        assert "GPS stays" not in finding.message and "their GPS gives" not in finding.message
