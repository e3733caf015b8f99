from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Callable

import numpy as np
import pytest
from sensorgate.plugin.cli import main
from sensorgate.plugin.odm.outcome import Outcome, read_outcome
from sensorgate.plugin.odm.outcome_lines import lines, record
from sensorgate.stages.errors import BlockedError, UsageError
from sensorgate.stages.route import PipelineRouter

from tests.frames import REAL
from tests.plugin.odm.odm_project import NO_PROJECT, Block, Frame, fly_block, write_control, write_project, write_split
from tests.simulator.catalogue import phantom4pro

P4 = "dji fc330 1332 1000 brown 0.5850"
P4P = "dji fc6310 1368 912 brown 0.6666"
Make = Callable[[Block], Path]


@pytest.fixture()
def make(tmp_path: Path) -> Make:
    return lambda block: write_project(block, tmp_path / "project")


def routes(outcome: Outcome) -> dict:
    return {p.payload: (p.verdict, p.route) for p in outcome.payloads}


def bent(rows: np.ndarray) -> np.ndarray:
    """A block stretched by half again towards the east: no similarity undoes that."""
    return rows * (1.5, 1.0, 1.0)


def test_a_good_run_proceeds_with_true_figures(make: Make) -> None:
    block = fly_block()
    found = read_outcome(make(block))
    assert (found.state, found.route, found.exit_code) == ("finished", "proceed", 0)
    assert (found.frames, found.registered, found.components) == (30, 30, (30,))
    assert routes(found) == {P4: ("pass", "proceed"), P4P: ("pass", "proceed")}
    report = found.alignment
    assert report is not None and report.engine == "odm 3.6.0" and report.verdict == "pass"
    # A 2-D normal error of 0.6 px has a mean length of 0.6 * sqrt(pi / 2).
    assert report.mean_reproj_error_px == pytest.approx(0.752, abs=0.02)
    assert report.height_m == pytest.approx(60.0, abs=1.5)
    assert found.ties_from == "matches" and found.notes == () and found.advice == ()
    assert PipelineRouter().evaluate_alignment(report) == "proceed_bundle_adjustment"


def test_pieces_that_odm_merged_are_told_apart(make: Make) -> None:
    block = fly_block()
    for frame in block.of("p4p"):
        frame.component = 1
    found = read_outcome(make(block))
    assert found.odm.components == 1 and found.components == (15, 15)
    assert found.alignment is not None and found.alignment.components == 2
    verdicts = sorted(routes(found).values())
    assert verdicts == [("fail", "isolate"), ("pass", "proceed")]
    assert (found.route, found.exit_code) == ("isolate", 1)
    assert any("in 2 separate pieces" in line for line in lines(found, "project"))


def test_pieces_are_told_apart_without_reports(make: Make) -> None:
    block = fly_block()
    for frame in block.of("p4p"):
        frame.component = 1
    folder = make(block)
    for name in ("reports", "matches"):
        shutil.rmtree(folder / "opensfm" / name)
    found = read_outcome(folder)
    assert found.components == (15, 15) and found.ties_from == "shared points"
    assert found.exit_code == 1


def test_a_bent_payload_is_refused_though_it_is_tied_and_fits_its_pixels(make: Make) -> None:
    block = fly_block()
    block.warps["bent"] = bent
    block.ties = 60
    for frame in block.of("p4"):
        frame.group = "bent"
    found = read_outcome(make(block))
    assert routes(found) == {P4: ("fail", "pairwise"), P4P: ("pass", "proceed")}
    assert found.route == "pairwise" and any("off its GPS" in r for r in found.reasons)
    report = found.alignment
    assert report is not None and report.registered == 30
    assert report.mean_reproj_error_px is not None and report.mean_reproj_error_px < 1.0


def test_shifted_positions_of_one_camera_are_an_offset_and_no_geometry(make: Make) -> None:
    block = fly_block()
    for frame in block.of("p4"):
        frame.gps = (frame.gps[0], frame.gps[1] + 30.0 / 76000.0, frame.gps[2])
    found = read_outcome(make(block))
    report = found.alignment
    assert report is not None and report.anchor is not None
    moved = [p for p in report.payloads if p.gps_offset_m is not None]
    assert len(moved) == 1 and abs(moved[0].gps_offset_m[0]) == pytest.approx(30.0, abs=3.0)
    assert found.route == "proceed" and any("geo.txt" in a for a in found.advice)


def test_a_payload_that_falls_apart_by_itself_has_nobody_to_be_parted_from(make: Make) -> None:
    block = fly_block()
    few = block.of("p4")[:2]  # too few to stand, and too few to blame
    block.frames = [*block.of("p4p"), *few]
    for index, frame in enumerate(block.of("p4p")):
        frame.component = index // 5
    found = read_outcome(make(block))
    assert routes(found)[P4P] == ("fail", "unproven") and found.route == "unproven"
    assert any("separating helps nothing" in a for a in found.advice)
    assert not any("pairwise" in a or "holds by itself" in a for a in found.advice)


def test_two_places_in_one_run_are_to_be_parted(make: Make) -> None:
    block = fly_block()
    for frame in block.of("p4"):
        frame.component, frame.gps = 1, (frame.gps[0] + 0.1, *frame.gps[1:])
    found = read_outcome(make(block))
    assert found.alignment is not None and found.alignment.areas == 2
    assert found.exit_code == 1 and any("2 places that cannot overlap" in a for a in found.advice)


def test_a_small_piece_beside_a_good_model_is_unproven(make: Make) -> None:
    block = fly_block((phantom4pro(),))
    for frame in block.frames[:4]:
        frame.component = 1
    found = read_outcome(make(block))
    assert routes(found) == {P4P: ("pass", "proceed")} and found.components == (11, 4)
    assert (found.route, found.exit_code) == ("unproven", 1) and "2 separate pieces of one place" in found.reasons[0]


def test_frames_that_odm_lost_are_found_by_counting(make: Make) -> None:
    block = fly_block()
    lost = block.of("p4")[:9]
    for frame in lost:
        frame.placed = False
    found = read_outcome(make(block))
    assert found.missing == tuple(sorted(f.name for f in lost))
    assert routes(found)[P4] == ("fail", "pairwise")


def test_errors_beyond_four_pixels_count(make: Make) -> None:
    block = fly_block()
    block.noise_px["p4"] = 4.0
    found = read_outcome(make(block))
    mine = next(c for c in found.cameras if "fc330" in c.id)
    assert mine.errors is not None and mine.errors.mean_px == pytest.approx(5.01, abs=0.15)
    assert mine.errors.odm_px is not None and mine.errors.odm_px < 3.0  # what ODM's cut makes of it
    assert routes(found)[P4][0] == "fail"


def test_few_mismatches_in_the_tracks_condemn_nobody_and_many_do(tmp_path: Path) -> None:
    block = fly_block()
    block.outliers = 0.05
    found = read_outcome(write_project(block, tmp_path / "few"))
    assert found.alignment is not None and found.alignment.mean_reproj_error_px == pytest.approx(0.752, abs=0.02)
    assert found.cameras[0].errors is not None and found.cameras[0].errors.beyond == pytest.approx(0.05, abs=0.01)
    block.outliers = 0.3
    assert read_outcome(write_project(block, tmp_path / "many")).exit_code == 1


def test_a_focal_that_odm_moved_is_said(make: Make) -> None:
    block = fly_block()
    block.start_focal = 0.9
    found = read_outcome(make(block))
    assert found.cameras[0].focal_change == pytest.approx(1 / 0.9 - 1, abs=1e-4)
    assert any("moved the focal length" in a for a in found.advice)


def test_what_a_node_sends_back_is_judged_and_stays_unproven(make: Make) -> None:
    folder = make(fly_block())
    shutil.rmtree(folder / "opensfm")
    found = read_outcome(folder)
    assert (found.state, found.route, found.exit_code) == ("finished", "unproven", 1)
    assert {p.verdict for p in found.payloads} == {"unproven"}
    report = found.alignment
    assert report is not None and report.registered == 30
    assert report.gps.horizontal_m is not None and report.gps.horizontal_m < 3.0
    assert any("matches" in r for r in found.reasons)


def test_what_a_node_sends_back_still_contradicts_a_wrong_model(make: Make) -> None:
    block = fly_block()
    block.warps["bent"] = bent
    for frame in block.of("p4"):
        frame.group = "bent"
    folder = make(block)
    shutil.rmtree(folder / "opensfm")
    assert routes(read_outcome(folder))[P4][0] == "fail"


def test_reports_that_a_node_sends_back_tell_ties_and_pieces(make: Make) -> None:
    block = fly_block()
    for frame in block.of("p4p"):
        frame.component = 1
    folder = make(block)
    for name in ("reconstruction.json", "reconstruction.topocentric.json", "tracks.csv"):
        (folder / "opensfm" / name).unlink()
    shutil.rmtree(folder / "opensfm/matches")
    found = read_outcome(folder)
    assert found.ties_from == "common tracks" and found.components == (15, 15)
    assert sorted(p.verdict for p in found.payloads) == ["fail", "unproven"] and found.exit_code == 1


def test_pieces_that_only_the_log_tells_of(make: Make) -> None:
    block = fly_block()
    for frame in block.of("p4p"):
        frame.component = 1
    folder = make(block)
    shutil.rmtree(folder / "opensfm")
    found = read_outcome(folder)
    assert found.alignment is not None and found.alignment.components == 2
    assert found.exit_code == 1 and {p.verdict for p in found.payloads} == {"fail"}


def planned(
    block: Block,
    out: Path,
    flight: Callable[[Frame], str] = lambda f: f"{f.payload.id}:1",
    spectrum: Callable[[Frame], str] = lambda f: "rgb",
) -> Path:
    """A project inside the output of the run that wrote it, whose report names payloads and flights."""
    folder = write_project(block, out / "projects/rgb")
    (folder / "sensorgate").mkdir()
    rows = [
        {
            "path": f"survey/{f.payload.id}/{f.name}",
            "output": f"projects/rgb/images/{f.name}",
            "profile": f.payload.id,
            "flight": flight(f),
            "spectrum": spectrum(f),
            "payload": f.payload.id,
            "width": f.camera.width,
            "height": f.camera.height,
            "latitude": f.gps[0],
            "longitude": f.gps[1],
            "altitude_m": f.gps[2],
            "height_m": 60.0,
            "gps": {"rtk_fixed": False, "time": "2024-05-01T10:00:00"},
        }
        for f in block.frames
    ]
    report = {"frames": rows, "subprojects": [{"name": "rgb", "route": "proceed"}]}
    (out / "report.json").write_text(json.dumps(report))
    return folder


def test_the_run_that_wrote_the_project_names_its_payloads(tmp_path: Path) -> None:
    folder = planned(fly_block(), tmp_path / "out")
    found = read_outcome(folder)
    assert routes(found) == {"p4": ("pass", "proceed"), "p4p": ("pass", "proceed")}
    assert found.alignment is not None and found.alignment.frames[0].path.startswith("survey/p4/")
    # What the run had proven before stays proven where a node sends no matches back.
    shutil.rmtree(folder / "opensfm")
    assert read_outcome(folder).route == "proceed"


def test_spectra_in_one_run_are_parted_however_well_it_looks(tmp_path: Path) -> None:
    folder = planned(fly_block(), tmp_path / "out", spectrum=lambda f: "thermal" if f.payload.id == "p4" else "rgb")
    found = read_outcome(folder)
    assert (found.route, found.exit_code) == ("isolate", 1) and "2 spectra" in found.reasons[0]


def test_a_flight_whose_altitudes_lie_higher_is_no_bent_model(tmp_path: Path) -> None:
    block = fly_block((phantom4pro(),), strips=6)
    later = [f for i, f in enumerate(block.frames) if (i // 5) % 2]  # every other strip: no tilt explains the step
    second = {f.name for f in later}
    for frame in later:
        frame.gps = (frame.gps[0], frame.gps[1], frame.gps[2] + 35.0)
    folder = planned(block, tmp_path / "out", lambda f: f"p4p:{2 if f.name in second else 1}")
    found = read_outcome(folder)
    assert routes(found) == {"p4p": ("pass", "proceed")}
    assert found.alignment is not None
    [(flight, up)] = found.alignment.payloads[0].flight_offsets_m
    assert flight == "p4p:2" and up == pytest.approx(35.0, abs=1.5)


def test_ground_control_proves_a_run_without_positions(tmp_path: Path) -> None:
    block = fly_block((phantom4pro(),))
    for frame in block.frames:
        frame.gps = (0.0, 0.0, 0.0)
    folder = write_project(block, tmp_path / "project")
    assert read_outcome(folder).route == "unproven"
    write_control(block, folder)
    found = read_outcome(folder)
    assert found.route == "proceed" and found.alignment is not None
    control = found.alignment.control
    assert control is not None and control.verdict == "pass" and control.points == 6
    assert control.horizontal_m is not None and control.horizontal_m < 0.05
    assert any("control points fit" in r for r in found.reasons)


def test_ground_control_contradicts_a_bent_run_without_positions(tmp_path: Path) -> None:
    block = fly_block((phantom4pro(),))
    block.warps["bent"] = bent
    for frame in block.frames:
        frame.gps, frame.group = (0.0, 0.0, 0.0), "bent"
    folder = write_control(block, write_project(block, tmp_path / "project"))
    found = read_outcome(folder)
    assert found.exit_code == 1 and found.payloads[0].verdict == "fail"
    assert any("control points fit" in r and "is the limit" in r for r in found.reasons)


def test_a_ground_control_list_that_means_nothing_is_noted(tmp_path: Path) -> None:
    folder = write_project(fly_block(), tmp_path / "project")
    (folder / "gcp_list.txt").write_text("no such system\n1 2 3 4 5 a.jpg\n")
    found = read_outcome(folder)
    assert found.route == "proceed" and len(found.notes) == 1


def test_a_split_run_is_judged_by_its_parts(tmp_path: Path) -> None:
    folder = write_split(fly_block(strips=4), tmp_path / "project")
    found = read_outcome(folder)
    assert (found.state, found.route, found.exit_code) == ("finished", "proceed", 0)
    assert (found.frames, found.registered, found.missing) == (40, 40, ())
    assert [(s.name, s.registered) for s in found.submodels] == [("submodel_0000", 26), ("submodel_0001", 20)]
    assert found.components == (26, 20) and routes(found) == {P4: ("pass", "proceed"), P4P: ("pass", "proceed")}
    report = found.alignment
    assert report is not None and (report.components, report.areas) == (2, 2) and report.verdict == "pass"
    assert PipelineRouter().evaluate_alignment(report) == "proceed_bundle_adjustment"
    assert any("in 2 parts" in line for line in lines(found, "project"))
    json.dumps(record(found), allow_nan=False)
    shutil.rmtree(folder / "submodels/submodel_0000")
    shutil.rmtree(folder / "submodels/submodel_0001")
    gone = read_outcome(folder)
    assert gone.exit_code == 1 and any("parts are gone" in n for n in gone.notes)


def test_a_split_run_that_lost_a_part_is_no_success(tmp_path: Path) -> None:
    folder = write_split(fly_block(strips=4), tmp_path / "project", overlap=-2)
    lost = folder / "submodels/submodel_0001/opensfm"
    for name in ("reconstruction.json", "reconstruction.topocentric.json"):
        (lost / name).unlink()
    shutil.rmtree(lost.parent / "odm_report")
    found = read_outcome(folder)
    assert (found.registered, len(found.missing)) == (16, 24) and found.exit_code == 1
    assert {p.verdict for p in found.payloads} == {"fail"}
    assert found.alignment is not None and found.alignment.payloads[0].reasons == (
        "8 of its 20 frames are in any part",
    )


def test_one_bad_part_of_a_split_run_condemns_the_payload_that_is_bad_in_it(tmp_path: Path) -> None:
    block = fly_block(strips=4)
    folder = write_split(block, tmp_path / "project")
    block.warps["bent"] = bent
    block.ties = 60
    second = folder / "submodels/submodel_0001"
    shutil.rmtree(second)
    late = [f for p in ("p4", "p4p") for f in block.of(p)[10:]]
    frames = [replace(f, group="bent" if f.payload.id == "p4" else "") for f in late]
    write_project(replace(block, frames=frames), second)
    found = read_outcome(folder)
    assert routes(found) == {P4: ("fail", "pairwise"), P4P: ("pass", "proceed")}
    assert found.exit_code == 1 and all("submodel_0001" in r for r in found.reasons)


def test_a_run_that_failed_early_says_why(make: Make) -> None:
    block = fly_block()
    for frame in block.frames:
        frame.placed = False
    block.error = NO_PROJECT
    found = read_outcome(make(block))
    assert (found.state, found.route, found.exit_code) == ("failed", "isolate", 1) or found.route == "pairwise"
    assert found.console.cause is not None and found.console.cause.code == "no-reconstruction"
    assert any("ODM failed in its opensfm stage" in r for r in found.reasons)
    assert found.registered == 0 and len(found.missing) == 30


def test_a_run_of_one_camera_that_failed_has_nobody_to_separate(make: Make) -> None:
    block = fly_block((phantom4pro(),))
    for frame in block.frames:
        frame.placed = False
    block.error = NO_PROJECT
    assert read_outcome(make(block)).route == "unproven"


def test_an_interrupted_run_is_unfinished(make: Make) -> None:
    block = fly_block()
    block.success = False
    found = read_outcome(make(block))
    assert (found.state, found.exit_code) == ("unfinished", 1)


def test_damaged_files_are_noted_and_leave_open_what_they_said(make: Make) -> None:
    folder = make(fly_block())
    for name in ("reconstruction.topocentric.json", "reports/reconstruction.json", "stats/stats.json", "tracks.csv"):
        path = folder / "opensfm" / name
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    (folder / "log.json").write_text('{"success": tr')
    (folder / "images.json").write_text("[1, 2")
    found = read_outcome(folder)
    assert found.exit_code == 1 and len(found.notes) >= 4
    json.dumps(record(found), allow_nan=False)


@pytest.mark.parametrize("cut", range(0, 100, 7))
def test_a_model_cut_anywhere_is_no_crash(tmp_path: Path, cut: int) -> None:
    folder = write_project(fly_block(strips=2, per_strip=3), tmp_path / "p")
    for name in ("reconstruction.topocentric.json", "tracks.csv"):
        path = folder / "opensfm" / name
        path.write_bytes(path.read_bytes()[: path.stat().st_size * cut // 100])
    assert read_outcome(folder).exit_code == 1


def test_the_same_folder_gives_the_same_bytes(make: Make) -> None:
    folder = make(fly_block())
    assert json.dumps(record(read_outcome(folder))) == json.dumps(record(read_outcome(folder)))


def test_folders_that_hold_nothing_of_odm(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(BlockedError):
        read_outcome(tmp_path)
    with pytest.raises(UsageError):
        read_outcome(tmp_path / "none")
    assert main(["outcome", str(tmp_path)]) == 3
    assert main(["outcome", str(tmp_path / "none")]) == 2
    assert "holds nothing that ODM wrote" in capsys.readouterr().err


def test_the_verb_prints_a_few_plain_lines(make: Make, capsys: pytest.CaptureFixture, tmp_path: Path) -> None:
    folder = make(fly_block())
    target = tmp_path / "outcome.json"
    assert main(["outcome", str(folder), "--json", str(target)]) == 0
    said = capsys.readouterr().out
    assert "project: ODM 3.6.0 finished." in said and "Route: PROCEED" in said
    assert str(tmp_path) not in said and str(tmp_path) not in target.read_text()
    assert json.loads(target.read_text())["route"] == "proceed"


@pytest.mark.skipif(not (REAL / "brighton_p3_rgb").is_dir(), reason="the real frames are not there")
def test_images_are_read_by_ourselves(tmp_path: Path) -> None:
    folder = tmp_path / "project"
    (folder / "images").mkdir(parents=True)
    for source in sorted((REAL / "brighton_p3_rgb").glob("*.JPG"))[:8]:
        shutil.copy(source, folder / "images")
    log = {"stages": [], "success": False, "error": {"code": 1, "message": NO_PROJECT}}
    (folder / "log.json").write_text(json.dumps(log))
    found = read_outcome(folder)
    assert found.frames == 8 and found.grouped_by == "the images"
    assert [p.payload for p in found.payloads] == ["dji-fc300s"]
