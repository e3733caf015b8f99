"""Bands of a rendered rig against the truth, of real rigs against held-out points, and what must be refused."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np
import pytest
from sensorgate.stages.errors import Cancelled, UsageError
from sensorgate.stages.finding import Finding
from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize import tiff
from sensorgate.stages.harmonize.bands import plan_bands
from sensorgate.stages.harmonize.bands_apply import apply_bands
from sensorgate.stages.harmonize.bands_lens import sample_places
from sensorgate.stages.harmonize.bands_model import BandPlan
from sensorgate.stages.harmonize.bands_work import warp_pixels
from sensorgate.stages.harmonize.control_points import ControlPair
from sensorgate.stages.read import read_frame, scan
from sensorgate.stages.record import from_plain, to_plain
from sensorgate.stages.sensors import load_sheet
from sensorgate.stages.survey import Survey, build
from sensorgate.stages.thresholds import DEFAULTS

from tests.simulator import Plan, catalogue, fly, render
from tests.simulator import Survey as Flown
from tests.simulator.camera import Camera, distort, undistort
from tests.simulator.stories import GROUND
from tests.simulator.truth import TrueFrame, Truth

from .samples import exiftool, real

# One capture and few features, where the outcome does not hang on them.
QUICK = DEFAULTS.replaced({"band_captures": 1, "band_features": 500})


@dataclass(frozen=True)
class Rendered:
    truth: Truth
    folder: Path
    survey: Survey
    plan: BandPlan
    findings: Tuple[Finding, ...]

    @property
    def sources(self) -> Dict[str, Path]:
        return {p: Path(p) for p in self.survey.file_of()}


def surveyed(folder: Path) -> Survey:
    return build(scan([str(folder)]), load_sheet(None, DEFAULTS), DEFAULTS)


def planned(survey: Survey, **more: object) -> Tuple[BandPlan, Tuple[Finding, ...]]:
    files = survey.file_of()
    sources = {p: Path(p) for p in files}
    limits = more.pop("limits", DEFAULTS)
    return plan_bands(survey.frames, files, survey.payloads, sources, limits, **more)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rendered:
    folder = tmp_path_factory.mktemp("rig")
    camera = catalogue.with_band_size(catalogue.micasense(), 0.5)
    shots = fly(camera, Plan(90.0, 1, 3, forward=0.75), GROUND, 0)
    truth = render(Flown("rig", (GROUND,), (camera,), shots), folder)
    survey = surveyed(folder / "images")
    return Rendered(truth, folder / "images", survey, *planned(survey))


def true_places(primary: TrueFrame, band: TrueFrame, at: np.ndarray) -> np.ndarray:
    """Where the band sees the ground that the primary sees at ``at``, by the cameras that rendered both."""

    def camera(frame: TrueFrame) -> Camera:
        c = frame.camera
        return Camera(c.width, c.height, c.focal_ratio, c.center_px, c.distortion)  # type: ignore[arg-type]

    one, two = camera(primary), camera(band)
    rays = undistort((at - np.array(one.principal_px)) / one.focal_px, one.distortion)
    world = np.concatenate((rays, np.ones((*rays.shape[:-1], 1))), axis=-1) @ np.array(primary.rotation)
    ground = np.array(primary.center_m) - world / world[..., 2:] * primary.mean_height_m
    local = (ground - np.array(band.center_m)) @ np.array(band.rotation).T
    return distort(local[..., :2] / local[..., 2:], two.distortion) * two.focal_px + np.array(two.principal_px)


def test_every_band_lies_where_the_cameras_put_it(rig: Rendered) -> None:
    plan = rig.plan.rigs[0]
    assert len(plan.aligned) == 4 and not plan.refused and not plan.mismatched
    assert plan.primary_band == "Green" and plan.skip_band_alignment
    truth = {f.path: f for f in rig.truth.frames}
    for fitted in rig.plan.fits:
        assert fitted.state == "warp" and fitted.held_out is not None and fitted.cross_check is not None
        assert fitted.primary_lens is not None and fitted.band_lens is not None
        places = sample_places(fitted.primary_lens, fitted.band_lens, np.array(fitted.matrix))
        at = np.stack(np.meshgrid(np.arange(10, 630, 31), np.arange(10, 470, 23)), -1)
        for primary, band in fitted.pairs:
            true = true_places(
                truth[Path(primary).name.join(("rededge/", ""))], truth[f"rededge/{Path(band).name}"], at
            )
            away = np.hypot(*np.moveaxis(places[at[..., 1], at[..., 0]] - true, -1, 0))
            assert np.median(away) < 0.3 and away.max() < 1.0, (fitted.band, np.median(away), away.max())


def test_reported_residual_is_honest(rig: Rendered) -> None:
    for fitted in rig.plan.fits:
        assert fitted.held_out is not None and fitted.plain_homography is not None
        assert fitted.held_out.median_px < 0.3
        assert fitted.held_out.median_px <= fitted.plain_homography.median_px * 1.05
        assert len(fitted.sampled) == 3 and all(c.pooled is not None for c in fitted.sampled)


def test_plan_goes_to_json_and_back(rig: Rendered) -> None:
    assert from_plain(BandPlan, json.loads(json.dumps(to_plain(rig.plan)))) == rig.plan
    assert len(rig.plan.warped()) == 12
    assert {f.code for f in rig.findings} == {"bands-registered"}


def written(rig: Rendered, out: Path, **more: object) -> Dict[str, Path]:
    targets = {p: out / Path(p).name for p in rig.plan.warped()}
    done, broken = apply_bands(
        rig.plan, rig.survey.frames, rig.survey.file_of(), rig.sources, targets, thresholds=DEFAULTS, **more
    )  # type: ignore[arg-type]
    assert not broken
    return {h.path: Path(h.file) for h in done}


def test_warped_frames_keep_what_they_are(rig: Rendered, tmp_path: Path) -> None:
    before = {p: Path(p).read_bytes() for p in rig.sources}
    files = written(rig, tmp_path)
    assert {p: Path(p).read_bytes() for p in rig.sources} == before
    assert sorted(files) == list(rig.plan.warped())
    primaries = {f.path for f in rig.survey.frames if f.profile == rig.plan.rigs[0].primary}
    assert not primaries & set(files)
    for path, file in files.items():
        old, new = rig.survey.file_of()[path], read_frame(file)
        same = ("width", "height", "bits", "channels", "bands", "capture_id", "time", "latitude", "altitude_m", "make",
                "model", "serial", "focal_mm", "focal_plane_x_res", "calibration", "rotation_deg")  # fmt: skip
        assert [getattr(new, n) for n in same] == [getattr(old, n) for n in same]
        assert tiff.decode(file.read_bytes(), DEFAULTS).dtype == np.uint16


def test_ratios_of_the_bands_are_those_of_the_ground(rig: Rendered, tmp_path: Path) -> None:
    """A vignetted band, levelled and warped, against the same band levelled where it stood."""
    assert rig.plan.rigs[0].radiometry == "applied"
    files = written(rig, tmp_path)
    from sensorgate.stages.harmonize.bands_radiometry import correction_of

    for fitted in rig.plan.fits[:2]:
        path = fitted.pairs[0][1]
        data = Path(path).read_bytes()
        correction = correction_of(data, DEFAULTS)
        assert correction is not None and correction.black > 1000
        level = correction.applied(tiff.decode(data, DEFAULTS))[:, :, 0]
        out = tiff.decode(files[path].read_bytes(), DEFAULTS)[:, :, 0].astype(np.float64)
        after = correction_of(files[path].read_bytes(), DEFAULTS)
        assert after is not None and after.black == 0 and not any(after.polynomial)
        seen = out > 0
        assert seen.mean() > 0.9
        places = sample_places(fitted.primary_lens, fitted.band_lens, np.array(fitted.matrix))  # type: ignore[arg-type]
        x, y = np.rint(places[..., 0]).astype(int), np.rint(places[..., 1]).astype(int)
        inside = seen & (x > 8) & (y > 8) & (x < 631) & (y < 471)
        for block in (np.s_[:160, :200], np.s_[160:320, 200:440], np.s_[320:, 440:]):
            ok = inside[block]
            ratio = out[block][ok].mean() / level[y[block][ok], x[block][ok]].mean()
            assert abs(ratio - 1.0) < 0.004, (fitted.band, ratio)


def test_finished_frames_are_kept_and_a_spoiled_one_is_done_again(rig: Rendered, tmp_path: Path) -> None:
    journal = tmp_path / "journal"
    files = written(rig, tmp_path / "out", journal=journal)
    content = {p: f.read_bytes() for p, f in files.items()}
    stamps = {p: f.stat().st_mtime_ns for p, f in files.items()}
    spoiled = sorted(files)[3]
    files[spoiled].write_bytes(b"half")
    again = written(rig, tmp_path / "out", journal=journal)
    assert {p: f.read_bytes() for p, f in again.items()} == content
    assert [p for p, f in again.items() if f.stat().st_mtime_ns != stamps[p]] == [spoiled]


def test_a_resampled_primary_gives_its_bands_its_size(rig: Rendered, tmp_path: Path) -> None:
    fitted = rig.plan.fits[0]
    primary, path = fitted.pairs[0]
    done, broken = apply_bands(
        rig.plan, rig.survey.frames, rig.survey.file_of(), rig.sources, {path: tmp_path / "a.tif"}, thresholds=DEFAULTS,
        sizes={primary: (800, 600)},
    )  # fmt: skip
    assert not broken and [(h.width, h.height, h.how) for h in done] == [(800, 600, "warped")]
    old, new = rig.survey.file_of()[path], read_frame(tmp_path / "a.tif")
    assert (new.width, new.height) == (800, 600)
    assert old.focal_plane_x_res is not None and new.focal_plane_x_res == pytest.approx(old.focal_plane_x_res * 1.25)


def test_originals_are_no_targets_and_work_can_be_stopped(rig: Rendered, tmp_path: Path) -> None:
    path = rig.plan.warped()[0]
    arguments = (rig.plan, rig.survey.frames, rig.survey.file_of(), rig.sources)
    with pytest.raises(UsageError, match="originals"):
        apply_bands(*arguments, {path: Path(path)}, thresholds=DEFAULTS)
    with pytest.raises(Cancelled):
        apply_bands(*arguments, {path: tmp_path / "a.tif"}, thresholds=DEFAULTS, cancel=lambda: True)
    assert not list(tmp_path.iterdir())


def test_vanished_and_changed_frames_are_named_and_the_rest_done(rig: Rendered, tmp_path: Path) -> None:
    sources = dict(rig.sources)
    gone, changed, *_ = rig.plan.warped()
    sources[gone] = tmp_path / "absent.tif"
    sources[changed] = tmp_path / "short.tif"
    sources[changed].write_bytes(Path(changed).read_bytes()[:-9])
    targets = {p: tmp_path / "out" / Path(p).name for p in rig.plan.warped()}
    done, broken = apply_bands(rig.plan, rig.survey.frames, rig.survey.file_of(), sources, targets, thresholds=DEFAULTS)
    assert {b.path: b.code for b in broken} == {gone: "frame-vanished", changed: "frame-changed"}
    assert len(done) == len(rig.plan.warped()) - 2


def exchanged(rig: Rendered, swap: Dict[str, str], **more: object) -> Tuple[BandPlan, Tuple[Finding, ...]]:
    """Plan with the pixels of other files behind some paths."""
    sources = {p: rig.folder / "rededge" / swap.get(Path(p).name, Path(p).name) for p in rig.sources}
    survey = rig.survey
    limits = more.pop("limits", DEFAULTS)
    return plan_bands(survey.frames, survey.file_of(), survey.payloads, sources, limits, **more)  # type: ignore[arg-type]


def test_a_band_file_of_another_capture_is_named(rig: Rendered) -> None:
    plan, findings = exchanged(rig, {"IMG_0002_4.tif": "IMG_0003_4.tif"})
    assert [Path(p).name for p in plan.rigs[0].mismatched] == ["IMG_0002_4.tif"]
    assert not plan.rigs[0].refused
    assert {f.code for f in findings} == {"bands-registered", "band-capture-mismatch"}


def test_a_band_that_never_fits_is_refused_and_never_warped(rig: Rendered) -> None:
    swap = {f"IMG_000{i}_4.tif": f"IMG_000{i % 3 + 1}_4.tif" for i in (1, 2, 3)}
    plan, findings = exchanged(rig, swap)
    assert [p.rsplit("/", 1)[1] for p in plan.rigs[0].refused] == ["nir"]
    assert len(plan.rigs[0].aligned) == 3 and plan.rigs[0].skip_band_alignment
    assert not [p for p in plan.warped() if p.endswith("_4.tif")]
    refused_frames = sorted(b for f in plan.fits if f.state == "refused" for _, b in f.pairs)
    assert [Path(p).name for p in refused_frames] == [f"IMG_000{i}_4.tif" for i in (1, 2, 3)]
    refused = next(f for f in findings if f.code == "band-refused")
    assert "NIR" in refused.message and "--control-points" in refused.remedy


def test_the_users_points_win_where_given(rig: Rendered) -> None:
    swap = {f"IMG_000{i}_4.tif": f"IMG_000{i % 3 + 1}_4.tif" for i in (1, 2, 3)}
    truth = {f.path: f for f in rig.truth.frames}
    at = np.array([[40, 50], [600, 60], [50, 430], [590, 420], [320, 240], [330, 60], [60, 250], [500, 300]], float)
    there = true_places(truth["rededge/IMG_0001_2.tif"], truth["rededge/IMG_0001_4.tif"], at)
    points = tuple((float(a), float(b), float(c), float(d)) for (a, b), (c, d) in zip(at, there))
    by_file = ControlPair("IMG_0001_2.tif", "IMG_0001_4.tif", points)
    by_band = ControlPair("nir", "green", by_file.turned().points)
    for pair in (by_file, by_band):
        plan, _ = exchanged(rig, swap, control=[pair], limits=QUICK)
        nir = [f for f in plan.fits if f.band == "NIR"]
        assert {(f.source, f.state) for f in nir} == {("control-points", "warp")}
        places = sample_places(nir[0].primary_lens, nir[0].band_lens, np.array(nir[0].matrix))  # type: ignore[arg-type]
        assert np.abs(places[at[:, 1].astype(int), at[:, 0].astype(int)] - there).max() < 0.2


def test_points_for_nobody_are_told(rig: Rendered) -> None:
    few = ControlPair("Green", "NIR", ((1.0, 2.0, 3.0, 4.0),))
    plan, findings = planned(rig.survey, limits=QUICK, control=[few, replace(few, b="Ultraviolet")])
    told = [f for f in findings if f.code == "control-points-unused"]
    assert [f.subjects for f in told] == [("Green / Ultraviolet",)]
    assert [f.reason for f in plan.fits if f.band == "NIR"] == [
        "1 control points were given; 6 are needed, not on one line"
    ]


def test_bands_that_were_aligned_before_are_left_alone(rig: Rendered, tmp_path: Path) -> None:
    files = written(rig, tmp_path)
    for path in rig.sources:
        if path not in files:
            shutil.copyfile(path, tmp_path / Path(path).name)
    plan, findings = planned(surveyed(tmp_path), limits=QUICK)
    assert {f.state for f in plan.fits} == {"aligned"}
    assert not plan.warped() and plan.rigs[0].skip_band_alignment
    assert plan.rigs[0].radiometry == "applied", "the bands are levelled, the primary waits for its reader"
    assert {f.code for f in findings} == {"bands-already-aligned"}


def test_sampling_is_one_interpolation_and_no_more() -> None:
    from sensorgate.stages.harmonize.bands_lens import Lens

    lens = Lens(200, 150, 220.0, (99.5, 74.5))
    pixels = np.random.default_rng(0).integers(0, 65536, (150, 200, 1), dtype=np.uint16)
    assert np.array_equal(warp_pixels(pixels, lens, lens, np.eye(3)), pixels)
    floats = pixels.astype(np.float32)
    floats[5, 5] = np.nan
    moved = warp_pixels(floats, lens, replace(lens, center_px=(159.5, 74.5)), np.eye(3), np.nan)
    assert np.array_equal(moved[10:, :140], floats[10:, 60:])
    assert np.isnan(moved[:, 141:]).all()


@pytest.mark.parametrize("folder", ["micasense_rededge_capture", "garfield_sequoia_rgb_ms"])
def test_real_rigs_are_registered_below_half_a_pixel(folder: str, tmp_path: Path) -> None:
    survey = surveyed(real(folder))
    plan, _ = planned(survey)
    assert len(plan.rigs) == 1 and not plan.rigs[0].refused and not plan.rigs[0].mismatched
    for fitted in plan.fits:
        assert fitted.held_out is not None and fitted.plain_homography is not None
        assert fitted.held_out.median_px < 0.5 and fitted.held_out.p95_px < 1.2
        assert fitted.held_out.median_px <= 1.05 * fitted.plain_homography.median_px
        assert fitted.cross_check is None or fitted.cross_check.median_px < 0.7
    assert plan.rigs[0].radiometry == ("applied" if "rededge" in folder else "kept")
    path = plan.warped()[0]
    targets = {path: tmp_path / Path(path).name}
    sources = {p: Path(p) for p in survey.file_of()}
    done, broken = apply_bands(plan, survey.frames, survey.file_of(), sources, targets, thresholds=DEFAULTS)
    assert len(done) == 1 and not broken
    changed = tag_names(exiftool(Path(path), "-a", "-G1", "-s"), exiftool(targets[path], "-a", "-G1", "-s"))
    allowed = {"BlackLevel", "VignettingPolynomial", "RadiometricCalibration"} if "rededge" in folder else set()
    assert changed - {"StripOffsets", "StripByteCounts", "RowsPerStrip"} <= allowed


def tag_names(before: str, after: str) -> set:
    """Names of the tags that two listings do not share, what belongs to the file system left out."""

    def lines(text: str) -> List[str]:
        return [line for line in text.splitlines() if not line.startswith(("[System]", "[ExifTool]", "[Composite]"))]

    return {line.split("]")[1].split(":")[0].strip() for line in set(lines(before)) ^ set(lines(after))}


def test_frames_of_one_band_only_have_nothing_to_align() -> None:
    survey = surveyed(real("brighton_p3_rgb"))
    plan, findings = planned(survey)
    assert plan == BandPlan() and not findings
    assert isinstance(survey.files[0], Frame)
