from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.stages.align.calibrate import choose
from sensorgate.stages.align.candidates import flown_height
from sensorgate.stages.align.model import AlignCamera, Bowing
from sensorgate.stages.align.solution import CameraSetting
from sensorgate.stages.align.trials import Geometry, Outcome, Trial, setting_for, trials_by_heights, trials_for
from sensorgate.stages.align.vertical import BOTH, DISAGREE, MODEL, VerticalScale
from sensorgate.stages.intrinsics import Intrinsics
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import frames, grid

STRAIGHT = (0.0, 0.0, 0.0, 0.0, 0.0)
BENT = (-0.1, 0.02, 0.001, 0.0, 0.0)
CORRECTED = AlignCamera(
    "p", 4000, 3000, Intrinsics(focal_ratio=0.6, focal_source="sheet", distortion_source="corrected-in-camera"), True
)
XMP = AlignCamera(
    "p",
    4000,
    3000,
    Intrinsics(focal_ratio=0.6, focal_source="xmp-dewarp", distortion=BENT, distortion_source="xmp-dewarp"),
)
GUESSED = AlignCamera("p", 4000, 3000, Intrinsics(focal_ratio=0.6, focal_source="equivalent-35mm"))
TRUSTED_FOCAL = AlignCamera("p", 4000, 3000, Intrinsics(focal_ratio=0.6, focal_source="sheet"))
NADIR = Geometry(0.0)
GOOD = Geometry(0.3)
FLAT = Bowing(0.02, 0.1, 50.0)
BOWED = Bowing(-0.9, 0.1, 50.0)


def _outcomes(camera, bows=None, errors=None, heights=None, focal=0.66, misfits=None):
    """One outcome per trial; the dictionaries give figures by trial name."""
    found = []
    for trial in trials_for(camera):
        bow = (bows or {}).get(trial.distortion_source, FLAT)
        found.append(
            Outcome(
                trial=trial,
                error_px=(errors or {}).get(trial.name, 0.40),
                gps_horizontal_m=0.5,
                gps_vertical_m=0.2,
                misfit=(misfits or {}).get(trial.name, 0.1),
                height_m=(heights or {}).get(trial.focal_source, 40.0),
                relief_m=1.0,
                bowing=bow,
                solved_focal=trial.focal if trial.focal is not None else focal,
                solved_distortion=trial.distortion if trial.distortion is not None else (0.01, 0.02, 0.0, 0.0, 0.0),
                focal_sigma=0.001,
            )
        )
    return tuple(found)


def _surfaces(outcomes):
    """Surfaces differ as the camera bows do."""
    return {
        (i, j): Bowing(a.bowing.bowing_m - b.bowing.bowing_m, 0.01, 50.0)
        for i, a in enumerate(outcomes)
        for j, b in enumerate(outcomes)
        if i < j
    }


def _chosen(camera, geometry=NADIR, flown=40.0, **figures):
    outcomes = _outcomes(camera, **figures)
    index, decision, veto = choose(outcomes, _surfaces(outcomes), camera, geometry, flown, DEFAULTS)
    return outcomes[index].trial, decision, dict(zip((o.trial.name for o in outcomes), veto))


def test_candidates_are_trusted_focals_times_distortions():
    assert [t.name for t in trials_for(XMP)] == [
        "focal xmp-dewarp, distortion none",
        "focal xmp-dewarp, distortion xmp-dewarp",
        "focal xmp-dewarp, distortion solved",
        "focal solved, distortion none",
        "focal solved, distortion xmp-dewarp",
        "focal solved, distortion solved",
    ]
    assert {t.focal_source for t in trials_for(GUESSED)} == {"equivalent-35mm", "solved"}


def test_bowing_chooses_the_distortion_although_its_reprojection_is_best():
    best = {"focal sheet, distortion solved": 0.37, "focal solved, distortion solved": 0.37}
    trial, decision, _ = _chosen(TRUSTED_FOCAL, bows={"solved": BOWED}, errors=best)
    assert trial == Trial("focal sheet, distortion none", "sheet", "none", 0.6, STRAIGHT)
    assert decision.hold and decision.focal_ratio == 0.6 and decision.distortion == STRAIGHT
    assert "bowing" in decision.reason


def test_bowing_can_overrule_a_sheet_that_says_corrected():
    trial, decision, _ = _chosen(CORRECTED, bows={"none": BOWED})
    assert trial.distortion_source == "solved"
    assert not decision.hold


@pytest.mark.parametrize(("camera", "bend"), [(CORRECTED, "none"), (XMP, "xmp-dewarp"), (TRUSTED_FOCAL, "solved")])
def test_where_bowing_says_nothing_the_lens_is_as_known(camera, bend):
    trial, decision, _ = _chosen(camera)
    assert trial.distortion_source == bend
    assert decision.hold is (bend != "solved")


def test_a_guess_is_never_held():
    _, decision, _ = _chosen(GUESSED)
    assert not decision.hold and decision.focal_ratio == 0.6


def test_a_bow_within_its_error_is_not_called():
    trial, _, _ = _chosen(XMP, bows={"xmp-dewarp": Bowing(-0.25, 0.1, 50.0)})
    assert trial.distortion_source == "xmp-dewarp"


def test_bowing_is_not_called_where_the_surfaces_agree():
    outcomes = _outcomes(XMP, bows={"xmp-dewarp": BOWED})
    same = {k: Bowing(0.001, 0.01, 50.0) for k in _surfaces(outcomes)}
    index, _, _ = choose(outcomes, same, XMP, NADIR, 40.0, DEFAULTS)
    assert outcomes[index].trial.distortion_source == "xmp-dewarp"


def test_height_vetoes_but_does_not_rank():
    heights = {"sheet": 41.5, "solved": 40.0}
    trial, decision, veto = _chosen(CORRECTED, heights=heights)
    assert trial.focal_source == "sheet" and decision.hold
    heights = {"sheet": 55.0, "solved": 40.0}
    trial, decision, veto = _chosen(CORRECTED, heights=heights)
    assert trial.focal_source == "solved" and not decision.hold
    assert "above ground" in veto["focal sheet, distortion none"]


def test_held_may_cost_a_tenth_of_reprojection_and_no_more():
    for cost, held in ((1.10, True), (1.11, False)):
        errors = {"focal sheet, distortion none": 0.40 * cost, "focal sheet, distortion solved": 0.40 * cost}
        _, decision, _ = _chosen(CORRECTED, errors=errors)
        assert decision.hold is held


def test_held_may_not_cost_gps_fit():
    outcomes = [
        replace(o, gps_horizontal_m=1.5) if o.trial.focal_source == "sheet" else o for o in _outcomes(CORRECTED)
    ]
    _, decision, _ = choose(tuple(outcomes), {}, CORRECTED, NADIR, 40.0, DEFAULTS)
    assert not decision.hold


def test_with_good_geometry_what_was_solved_stands():
    trial, decision, _ = _chosen(CORRECTED, geometry=GOOD)
    assert trial.focal_source == "solved" and not decision.hold
    assert decision.focal_ratio == 0.66


def test_an_uncertain_focal_is_weak_geometry():
    outcomes = tuple(replace(o, focal_sigma=0.05) for o in _outcomes(CORRECTED))
    index, decision, _ = choose(outcomes, {}, CORRECTED, GOOD, 40.0, DEFAULTS)
    assert outcomes[index].trial.focal_source == "sheet" and decision.hold


def _measured(camera, sigma, true=0.6):
    """Outcomes of a nadir block whose heights are measured: each focal's error is the error of its heights."""
    return tuple(replace(o, scale=VerticalScale(true / o.solved_focal, sigma)) for o in _outcomes(camera))


def test_measured_heights_rule_out_what_they_contradict_and_put_the_focal_right():
    geometry = Geometry(0.0, height_sigma=0.003)
    outcomes = _measured(GUESSED, 0.003, true=0.62)
    more = trials_by_heights(outcomes, geometry, DEFAULTS)
    assert [(t.focal, t.distortion_source) for t in more] == [(0.62, "none"), (0.62, "solved")]
    right = tuple(replace(outcomes[0], trial=t, solved_focal=0.62, scale=VerticalScale(1.001, 0.003)) for t in more)
    found = (*outcomes, *right)
    index, decision, veto = choose(found, {}, GUESSED, geometry, None, DEFAULTS)
    assert found[index].trial.focal_source == "heights"
    assert decision.focal_ratio == 0.62 and decision.supported and not decision.hold
    assert "off the measured ones" in veto[0] and not any(veto[len(outcomes) :])
    again = trials_by_heights(found, geometry, DEFAULTS)
    assert [t.focal for t in again] == [0.62062, 0.62062]


def test_heights_known_to_plain_gps_fix_nothing_and_rule_nothing_out():
    geometry = Geometry(0.0, height_sigma=0.12)
    outcomes = _measured(TRUSTED_FOCAL, 0.12)
    assert trials_by_heights(outcomes, geometry, DEFAULTS) == ()
    index, _, veto = choose(outcomes, {}, TRUSTED_FOCAL, geometry, None, DEFAULTS)
    assert outcomes[index].trial.focal_source == "sheet" and not any(veto)


def test_tilted_views_and_control_need_no_heights():
    for geometry in (Geometry(0.3, height_sigma=0.003), Geometry(0.0, True, 0.003)):
        assert trials_by_heights(_measured(GUESSED, 0.003), geometry, DEFAULTS) == ()


def _by_model(camera, true, sigma=0.003):
    """The choice on a nadir block over ground that an elevation model knows, and what it calls for."""
    geometry = Geometry(0.0, height_sigma=sigma, height_by=MODEL)
    outcomes = tuple(
        replace(o, scale=VerticalScale(true / o.solved_focal, sigma, MODEL)) for o in _outcomes(camera, focal=0.64)
    )
    more = trials_by_heights(outcomes, geometry, DEFAULTS)
    put_right = tuple(
        replace(outcomes[0], trial=t, solved_focal=t.focal, scale=VerticalScale(1.0, sigma, MODEL)) for t in more
    )
    found = (*outcomes, *put_right)
    index, decision, veto = choose(found, {}, camera, geometry, None, DEFAULTS)
    return found[index].trial, decision, dict(zip((o.trial.name for o in found), veto))


def test_an_elevation_model_refuses_a_focal_four_percent_off_and_puts_it_right():
    trial, decision, veto = _by_model(CORRECTED, true=0.6 / 1.04)
    assert trial.focal_source == "heights" and trial.focal == pytest.approx(0.6 / 1.04, abs=1e-6)
    assert "+4.0% off the measured ones" in veto["focal sheet, distortion none"]
    assert MODEL in decision.reason and decision.supported
    # No node that solves the block again has the model: what it fixed is held.
    assert decision.hold


def test_an_elevation_model_leaves_a_trusted_focal_that_it_confirms():
    trial, decision, _ = _by_model(CORRECTED, true=0.603)
    assert trial.focal_source == "sheet" and decision.hold
    assert "confirms within 0.5%" in decision.reason


def test_an_elevation_model_takes_the_place_of_a_guess():
    trial, decision, _ = _by_model(GUESSED, true=0.603)
    assert trial.focal_source == "heights" and trial.focal == pytest.approx(0.603, abs=1e-6)
    # Its distortion is solved: held, that would be a guess.
    assert trial.distortion_source == "solved" and not decision.hold


def test_an_elevation_model_that_cannot_tell_says_so():
    trial, decision, veto = _by_model(CORRECTED, true=0.6 / 1.04, sigma=0.27)
    assert trial.focal_source == "sheet" and not any(veto.values())
    assert "cannot choose it: they tell the vertical scale to 27.0%, 1.0% is needed" in decision.reason
    _, decision, _ = _chosen(CORRECTED, geometry=Geometry(0.0, height_by=MODEL))
    assert "too little ground" in decision.reason


def test_heights_that_contradict_each_other_fix_nothing():
    assert Geometry(0.0, height_sigma=0.003, height_by=BOTH).strong(DEFAULTS)
    apart = Geometry(0.0, height_sigma=0.003, height_by=DISAGREE)
    assert not apart.strong(DEFAULTS) and trials_by_heights(_measured(GUESSED, 0.003), apart, DEFAULTS) == ()


def test_weak_geometry_and_what_it_leaves_uncertain_are_said():
    _, decision, _ = _chosen(CORRECTED)
    assert "weak geometry" in decision.reason
    _, decision, _ = _chosen(AlignCamera("p", 4000, 3000, Intrinsics()))
    assert "focal solved to 0.2%" in decision.reason and "weak geometry" in decision.reason
    _, decision, _ = _chosen(CORRECTED, geometry=GOOD)
    assert "weak geometry" not in decision.reason


DRIFT = 0.04


def test_frames_that_claim_several_focals_are_one_camera_held_where_something_trusted_says_which():
    _, decision, _ = _chosen(replace(CORRECTED, focal_variance=DRIFT))
    assert decision.hold and decision.focal_ratio == 0.6


def test_without_a_trusted_source_they_are_solved_once_as_one_camera_and_marked():
    trial, decision, _ = _chosen(replace(GUESSED, focal_variance=DRIFT))
    assert trial.focal_source == "solved" and not decision.hold
    assert "claim focals 4.0% apart" in decision.reason and "solved once as one camera" in decision.reason
    trial, _, _ = _chosen(replace(GUESSED, focal_variance=0.02))
    assert trial.focal_source == "equivalent-35mm"


def test_good_geometry_settles_them_and_what_it_solved_is_held():
    trial, decision, _ = _chosen(replace(GUESSED, focal_variance=DRIFT), geometry=GOOD)
    assert trial.focal_source == "solved" and decision.hold and decision.supported
    _, plain, _ = _chosen(GUESSED, geometry=GOOD)
    assert not plain.hold and plain.supported


def test_what_stands_only_when_held_is_held_whatever_the_geometry():
    names = [t.name for t in trials_for(CORRECTED) if t.focal is None]
    trial, decision, _ = _chosen(CORRECTED, geometry=GOOD, errors=dict.fromkeys(names))
    assert trial.focal_source == "sheet" and trial.focal == 0.6
    _, decision, _ = _chosen(XMP, geometry=Geometry(0.0), errors=dict.fromkeys(names))
    assert decision.hold


def test_gps_and_missing_figures_veto():
    names = [t.name for t in trials_for(CORRECTED)]
    _, _, veto = _chosen(CORRECTED, misfits={names[0]: 1.4}, errors={names[1]: None, names[2]: float("nan")})
    assert "GPS" in veto[names[0]] and veto[names[1]] and veto[names[2]] and not veto[names[3]]


def test_when_all_are_ruled_out_nothing_is_held():
    names = [t.name for t in trials_for(CORRECTED)]
    trial, decision, _ = _chosen(CORRECTED, misfits=dict.fromkeys(names, 3.0))
    assert trial.focal_source == trial.distortion_source == "solved" and not decision.hold


def test_a_setting_moves_only_what_its_trial_solves():
    current = CameraSetting("p", 1200, 900, 0.62, distortion=(0.05, 0.01, 0.0, 0.0, 0.0))
    for trial in trials_for(XMP):
        setting = setting_for(trial, current)
        assert setting.solve_focal is (trial.focal is None)
        assert setting.solve_distortion is (trial.distortion is None)
        assert not setting.solve_center
        assert setting_for(trial, current, tilted=True).solve_center is (trial.distortion is None)
        if trial.distortion is not None:
            assert setting.distortion == trial.distortion


def test_a_height_from_a_plain_gps_altitude_rules_nothing_out():
    (frame,) = frames(grid(1, 1))
    assert flown_height(replace(frame, height_sigma_m=5.0), DEFAULTS) is None
    assert flown_height(replace(frame, height_sigma_m=2.0), DEFAULTS) == frame.height_m
    assert flown_height(frame, DEFAULTS) == frame.height_m
