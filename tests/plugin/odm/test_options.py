from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.odm.options import (
    Option,
    OptionNeeds,
    as_node_options,
    odm_3_6_options,
    option_names,
    options_for,
    validate,
)

NEVER = {"use-exif", "sfm-algorithm", "cameras", "gcp", "geo"}


def names(needs: OptionNeeds, **more: object) -> list:
    return [o.name for o in options_for(needs, **more)]  # type: ignore[arg-type]


def test_a_lock_needs_a_cameras_file_that_covers_every_camera() -> None:
    assert names(OptionNeeds(lock=True, cameras_cover_all=False)) == []
    assert names(OptionNeeds(lock=False, cameras_cover_all=True)) == []
    assert names(OptionNeeds(lock=True, cameras_cover_all=True)) == ["use-fixed-camera-params"]


def test_aligned_bands_keep_their_primary_and_are_not_aligned_again() -> None:
    found = options_for(OptionNeeds(bands_aligned=True, primary_band="Green"))
    assert [(o.name, o.value) for o in found] == [("primary-band", "Green"), ("skip-band-alignment", True)]
    assert names(OptionNeeds(primary_band="Green")) == []
    assert options_for(OptionNeeds(bands_aligned=True, primary_band="Red edge"))[0].value == "Rededge"


def test_changed_pixels_are_not_calibrated_to_reflectance() -> None:
    found = options_for(OptionNeeds(radiometry_changed=True))
    assert [(o.name, o.value) for o in found] == [("radiometric-calibration", "none")]
    both = options_for(OptionNeeds(radiometry_changed=True, radiometry_applied=True))
    assert [(o.name, o.value) for o in both] == [("radiometric-calibration", "none")]


def test_what_the_bands_have_applied_the_primary_gets_from_odm() -> None:
    found = options_for(OptionNeeds(radiometry_applied=True))
    assert [(o.name, o.value) for o in found] == [("radiometric-calibration", "camera")]


def test_gps_accuracy_would_overrule_the_accuracies_of_geo_txt() -> None:
    assert names(OptionNeeds(gps_accuracy_m=0.03)) == ["gps-accuracy"]
    assert names(OptionNeeds(gps_accuracy_m=0.03, geo_has_accuracies=True)) == []
    assert names(OptionNeeds(gps_accuracy_m=float("nan"))) == []


def test_force_gcp_is_said_only_to_a_stack_that_has_it() -> None:
    needs = OptionNeeds(has_gcp=True, force_gcp=True)
    own = [*odm_3_6_options(), {"name": "force-gcp", "type": "bool", "value": "false", "domain": "bool"}]
    assert names(needs) == []
    assert names(needs, option_list=own) == ["force-gcp"]


def test_gps_beside_ground_control_is_kept_for_rtk_only_and_not_when_gcps_are_forced() -> None:
    assert names(OptionNeeds(has_gcp=True)) == []
    assert names(OptionNeeds(has_gcp=True, keep_gps=True)) == ["force-gps"]
    assert names(OptionNeeds(has_gcp=True, keep_gps=True, force_gcp=True)) == []
    assert names(OptionNeeds(keep_gps=True)) == []


@given(
    st.builds(
        OptionNeeds,
        lock=st.booleans(),
        cameras_cover_all=st.booleans(),
        bands_aligned=st.booleans(),
        primary_band=st.none() | st.text(max_size=5),
        radiometry_changed=st.booleans(),
        has_gcp=st.booleans(),
        force_gcp=st.booleans(),
        keep_gps=st.booleans(),
        gps_accuracy_m=st.none() | st.floats(),
        geo_has_accuracies=st.booleans(),
    )
)
def test_whatever_the_verdict_the_stack_takes_every_option(needs: OptionNeeds) -> None:
    found = options_for(needs)
    assert validate(found, odm_3_6_options()) == ()
    assert not NEVER & {o.name for o in found}
    assert all(o.reason for o in found)
    assert options_for(needs, []) == ()


def test_a_value_that_the_stack_would_refuse_is_not_emitted() -> None:
    needs = OptionNeeds(radiometry_applied=True, gps_accuracy_m=0.03)
    old = [
        {"name": "radiometric-calibration", "type": "enum", "domain": ["none"]},
        {"name": "gps-accuracy", "type": "float", "domain": "positive float"},
    ]
    assert [o.name for o in options_for(needs, old)] == ["gps-accuracy"]


def test_the_list_holds_odm_3_6() -> None:
    known = option_names(odm_3_6_options())
    assert "use-fixed-camera-params" in known
    assert "force-gcp" not in known
    assert len(known) == len(set(known)) == len(odm_3_6_options())


def test_unknown_names_get_the_nearest_known_one() -> None:
    problems = validate([{"name": "use_fixed_camera_params", "value": True}], odm_3_6_options())
    assert [p.nearest for p in problems] == ["use-fixed-camera-params"]
    problems = validate([{"name": "force-gcp", "value": True}], odm_3_6_options())
    assert "no option named force-gcp" in problems[0].message
    assert validate([{"name": "qqqqqqqq", "value": 1}], odm_3_6_options())[0].nearest is None


def test_values_are_held_against_type_and_domain() -> None:
    bad = {
        "dsm": "yes",
        "min-num-features": "80zz",
        "feature-quality": "super",
        "mesh-octree-depth": 20,
        "orthophoto-resolution": 0.0,
        "matcher-neighbors": -1,
        "crop": float("nan"),
        "boundary": "{",
        "primary-band": 3,
        "video-limit": 2.5,
    }
    for name, value in bad.items():
        assert [p.name for p in validate([{"name": name, "value": value}], odm_3_6_options())] == [name], name
    good = {"dsm": "true", "min-num-features": "8000", "feature-quality": "ultra", "crop": 0, "boundary": "{}"}
    assert validate([{"name": n, "value": v} for n, v in good.items()], odm_3_6_options()) == ()
    assert len(validate([{"name": "dsm", "value": True}] * 2, odm_3_6_options())) == 1


def test_false_flags_are_left_out_of_what_a_node_gets() -> None:
    options = [Option("dsm", False, "r"), Option("crop", 0.0, "r"), Option("dtm", True, "r")]
    assert as_node_options(options) == [{"name": "crop", "value": 0.0}, {"name": "dtm", "value": True}]
