"""Each rule: the folder that calls it, and one that must not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict, List

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.odm.camera_id import camera_id
from sensorgate.plugin.odm.predict import RULES, predict
from sensorgate.stages.finding import SEVERITIES
from sensorgate.stages.read import scan

from tests.plugin.odm.folders import REAL, codes, frame, one, profile, rig, said, survey

RGB = profile("p")
MS = profile("re", 1.1458, "focal-plane", "multispectral")
BANDS = ("Blue", "Green", "Red", "NIR", "Rededge")


def test_a_plain_survey_and_a_complete_rig_have_nothing_to_be_said() -> None:
    assert codes(said([(RGB, survey())])) == []
    prediction = said([(MS, rig(3, BANDS))])
    assert codes(prediction) == []
    assert prediction.notes[1].startswith(
        "It would see 5 bands (Red, Green, Blue, NIR, Rededge) and solve 3 frames of Green"
    )
    assert sorted(prediction.fates.values()).count("solver") == 3


SINGLE: Dict[str, Dict[str, Any]] = {
    "odm-crash-focal-plane": {
        "focal_plane_unit": 2,
        "problems": ("focal-plane-rational-zero:FocalPlaneXResolution",),
    },
    "odm-crash-xmp-encoding": {"problems": ("xmp-not-utf8:byte 191",)},
    "odm-xmp-malformed": {"problems": ("xmp-malformed:duplicate attribute",)},
    "odm-name-mask": {"path": "s/IMG_9_mask.JPG"},
    "odm-format-unknown": {"path": "s/IMG_9.jpe"},
    "odm-tiff-unreadable": {"path": "s/IMG_9.tif", "channels": 5},
    "odm-panel-solved": {"panel": True},
    "odm-panorama-shape": {"width": 4000, "height": 2000},
    "odm-gps-zero": {"latitude": 0.0, "longitude": 0.0},
    "odm-gps-reference-missing": {"gps_reference_missing": True},
    "odm-altitude-missing": {"altitude_m": None},
    "odm-altitude-zero": {"altitude_m": 0.0},
    "odm-gps-exhaustive": {"latitude": None, "longitude": None},
    "odm-accuracy-mixed": {"rtk_std_m": (0.01, 0.01, 0.02), "rtk_flag": 50},
    "odm-rtk-not-fixed": {"rtk_std_m": (0.8, 0.8, 1.2), "rtk_flag": 16},
    "odm-xmp-blocks": {"xmp_blocks": 3, "pitch_deg": -90.0},
    "odm-positions-apart": {"longitude": 12.0},
    "odm-camera-anonymous": {"make": "", "model": ""},
    "odm-focal-from-table": {"make": "NIKON", "model": "D90", "focal_35mm": None},
    "odm-projection-lost": {"projection": "dual"},
    "odm-zoom-ignored": {"digital_zoom": 2.0},
    "odm-focal-default": {"focal_35mm": None, "focal_mm": None},
    "odm-focal-off": {"focal_35mm": 28.0},
    "odm-camera-split": {"focal_35mm": 25.0},
    "odm-feature-scale": {"width": 1000, "height": 750},
}


@pytest.mark.parametrize("code", sorted(SINGLE))
def test_one_odd_frame_is_found_and_named(code: str) -> None:
    odd = frame(**{"path": "s/IMG_9.JPG", **SINGLE[code]})
    plain = survey()
    assert code not in codes(said([(RGB, plain)]))
    found = one([(RGB, [*plain, odd])], code)
    expected = {f.path for f in plain} if code == "odm-accuracy-mixed" else {odd.path}
    if code in ("odm-positions-apart", "odm-camera-split"):
        expected = {odd.path, *(f.path for f in plain)}
    assert set(found.subjects) == expected
    assert found.severity in SEVERITIES


def test_odms_own_words() -> None:
    texts = {
        code: one([(RGB, [*survey(), frame(**{"path": "s/IMG_9.JPG", **SINGLE[code]})])], code).odm_message
        for code in ("odm-gps-reference-missing", "odm-xmp-malformed", "odm-gps-exhaustive", "odm-altitude-zero")
    }
    assert texts == {
        "odm-gps-reference-missing": "GPS position for IMG_9.JPG might be incorrect, GPSLatitudeRef tag is missing "
        "(assuming N)",
        "odm-xmp-malformed": "IMG_9.JPG has malformed XMP XML (but we fixed it)",
        "odm-gps-exhaustive": "GPS position not available for IMG_9.JPG",
        "odm-altitude-zero": "More than 5% of images have zero altitude, this might be an indicator that the images "
        "have no altitude information",
    }


def test_frames_on_which_odm_dies_have_no_id_and_their_fate() -> None:
    odd = frame(**{"path": "s/IMG_9.JPG", **SINGLE["odm-crash-focal-plane"]})
    prediction = said([(RGB, [*survey(), odd])])
    assert odd.path not in prediction.camera_ids
    assert prediction.fates[odd.path] == "stops-odm"
    assert prediction.camera_ids["s/IMG_0000.JPG"] == "v2 dji fc6310 4000 3000 brown 0.6666"


def test_no_position_at_all() -> None:
    blind = survey(latitude=None, longitude=None, altitude_m=None)
    assert codes(said([(RGB, blind)])) == ["odm-gps-none"]


def test_exhaustive_matching_is_counted() -> None:
    found = one([(RGB, [*survey(60), frame("s/x.JPG", latitude=None, longitude=None)])], "odm-gps-exhaustive")
    assert found.measured == 61 * 60 / 2


def test_a_zero_position_a_quarter_of_the_globe_away_costs_the_georeference() -> None:
    zero = frame("s/x.JPG", latitude=0.0, longitude=0.0)
    assert "not be georeferenced" in one([(RGB, [*survey(), zero])], "odm-gps-zero").odm_message
    near = survey(longitude=7.0)
    assert "possibly corrupted" in one([(RGB, [*near, zero])], "odm-gps-zero").odm_message


def test_the_date_line_parts_nothing() -> None:
    west, east = survey(2, longitude=-179.9), survey(2, "t", longitude=179.9)
    assert "odm-positions-apart" not in codes(said([(RGB, [*west, *east])]))


def test_the_same_name_in_two_folders() -> None:
    found = one([(RGB, [*survey(3, "a"), *survey(2, "b")])], "odm-name-collision")
    assert found.measured == 2.0
    assert len(found.subjects) == 4


def test_nothing_that_odm_opens() -> None:
    prediction = said([(RGB, [frame("s/a.jpe"), frame("s/b.jpe")])])
    assert codes(prediction) == ["odm-no-images", "odm-format-unknown"]
    assert prediction.notes == ("ODM would use 0 of 2 frames.",)


def test_two_true_cameras_under_one_id() -> None:
    groups = [(profile("wide"), survey(2, "a")), (profile("tele", 1.4), survey(2, "b", serial="2"))]
    found = one(groups, "odm-cameras-merged")
    assert found.severity == "error"
    assert found.measured == pytest.approx(1.1)
    twins = [(profile("body-1"), survey(2, "a")), (profile("body-2"), survey(2, "b", serial="2"))]
    assert one(twins, "odm-cameras-merged").severity == "warning"


def test_bands_of_a_rig_may_share_an_id() -> None:
    groups = [
        (profile(b, 1.1458, "focal-plane", "multispectral"), [f for f in rig(3, BANDS) if f.bands == (b,)])
        for b in BANDS
    ]
    assert codes(said(groups)) == []


def test_thermal_and_colour_in_one_solution() -> None:
    thermal = profile("t", 1.6, "sheet", "thermal")
    heat = survey(2, "t", width=640, height=512, model="ZH20T", focal_35mm=58.0)
    found = one([(RGB, survey()), (thermal, heat)], "odm-spectra-mixed")
    assert found.severity == "error"
    assert set(found.subjects) == {f.path for f in heat}
    assert "odm-spectra-mixed" not in codes(said([(thermal, heat)]))
    m30t = [replace(f, model="M30T") for f in heat]
    assert "odm-thermal-picture" in codes(said([(thermal, m30t)]))
    assert "odm-thermal-picture" not in codes(said([(thermal, heat)]))


def test_an_rgb_drone_beside_a_rig() -> None:
    unequal = said([(RGB, survey(4)), (MS, rig(2, BANDS))])
    assert codes(unequal)[0] == "odm-crash-band-count"
    assert set(unequal.fates.values()) == {"stops-odm"}
    equal = one([(RGB, survey(2)), (MS, rig(2, BANDS))], "odm-band-dropped")
    assert equal.severity == "error"
    assert equal.odm_message == "Skipping RGB band (2 images)"


def test_a_rigs_own_colour_frames_are_dropped_with_a_warning() -> None:
    own = rig(2, ("RGB", "Green", "Red", "NIR"), make="DJI", model="M3M")
    assert one([(MS, own)], "odm-band-dropped").severity == "warning"


def test_incomplete_captures_weigh_by_their_share() -> None:
    few = [f for f in rig(20, BANDS) if f.name != "IMG_0003_2.tif"]
    assert one([(MS, few)], "odm-captures-excluded").severity == "warning"
    altum = rig(4, (*BANDS, "LWIR"), "a", model="Altum")
    both = one([(MS, rig(4, BANDS, "b")), (MS, altum)], "odm-captures-excluded")
    assert both.severity == "error"
    assert set(both.subjects) == {f"b/IMG_{c:04d}_{i}.tif" for c in range(4) for i in range(1, 6)}


def test_bands_that_odm_only_misses_after_solving() -> None:
    lonely = [f for f in rig(3, ("Green", "NIR")) if f.path != "m/IMG_0002_2.tif"]
    extra = frame("m/IMG_0009_2.tif", **{**_tags(lonely[1]), "capture_id": "m9"})
    found = one([(MS, [*lonely, extra])], "odm-crash-bands-late")
    assert "no primary band match" in found.odm_message


def _tags(like: Any) -> Dict[str, Any]:
    return {k: getattr(like, k) for k in ("make", "model", "width", "height", "bands", "xmp_namespaces", "channels")}


def test_more_bands_than_odm_counts() -> None:
    many = rig(1, [f"B{i}" for i in range(11)])
    assert one([(MS, many)], "odm-bands-too-many").measured == 11


def test_multispectral_frames_without_a_band_name() -> None:
    bare = [replace(f, bands=()) for f in rig(2, BANDS)]
    assert one([(MS, bare)], "odm-band-unnamed").severity == "warning"
    split = [(profile(f"b{i}", 1.1, "sheet", "multispectral"), bare[i::5]) for i in range(5)]
    assert one(split, "odm-band-unnamed").severity == "error"


def test_secondary_bands_of_another_size() -> None:
    altum = [replace(f, width=160, height=120) if f.bands == ("LWIR",) else f for f in rig(2, (*BANDS, "LWIR"))]
    assert set(one([(MS, altum)], "odm-band-size").subjects) == {"m/IMG_0000_6.tif", "m/IMG_0001_6.tif"}


def test_two_rigs_of_the_same_bands() -> None:
    found = one([(MS, rig(3, BANDS)), (MS, rig(2, BANDS, "n", model="RedEdge-P"))], "odm-rigs-mixed")
    assert len(found.subjects) == 10


def test_bands_matched_by_name() -> None:
    assert "odm-bands-by-name" in codes(said([(MS, rig(2, BANDS, capture_id=""))]))


def test_the_listing_order_decides_beside_a_mavic_3_multispectral() -> None:
    m3m = rig(2, ("RGB", "Green", "Red", "NIR"), make="DJI", model="M3M")
    other = rig(2, ("RGB", "Green", "Red", "NIR"), "n")
    assert "odm-band-order" in codes(said([(MS, [*m3m, *other])]))


def test_a_better_focal_is_not_outdone_by_a_guess() -> None:
    guess = profile("p", 0.9, "generic-width")
    assert "odm-focal-off" not in codes(said([(guess, survey())]))
    portrait = survey(width=3000, height=4000)
    assert "odm-focal-off" not in codes(said([(profile("p", 24 / 36 * 4 / 3), portrait)]))


odd_frames = st.lists(st.sampled_from(sorted(SINGLE)), max_size=4, unique=True)


@given(odd_frames, st.randoms())
def test_the_order_of_the_frames_changes_nothing(chosen: List[str], random: Any) -> None:
    frames = [*survey(), *rig(2, BANDS)]
    frames += [
        frame(**{"path": f"o/IMG_{i}.JPG", **SINGLE[c]}) for i, c in enumerate(chosen) if "path" not in SINGLE[c]
    ]
    profile_of = {f.path: "p" for f in frames}
    first = predict(frames, profile_of, [RGB])
    random.shuffle(frames)
    assert predict(frames, profile_of, [RGB]) == first
    assert set(first.fates) == {f.path for f in frames}
    for found in first.findings:
        assert found.code.startswith("odm-")
        assert set(found.subjects) <= set(first.fates)
        assert found.subjects and found.message and found.remedy


def test_an_empty_folder_and_unplaced_frames() -> None:
    assert predict([], {}).findings == ()
    assert predict(survey(), {}).notes[0] == "ODM would use 4 of 4 frames."
    assert len(RULES) >= 25


real = pytest.mark.skipif(not REAL.is_dir(), reason="the real frames are not on this machine")

# What ODM 3.6.0 did with these folders of real frames: cameras, frames it solved, frames it used.
OBSERVED = {
    "brighton_p3_rgb": ({"v2 dji fc300s 4000 2250 brown 0.5555"}, 18, 18),
    "caliterra_canon_rgb": ({"v2 canon canon powershot sx260 hs 4000 3000 brown 0.7260"}, 4, 4),
    "garfield_sequoia_rgb_ms": (
        {"v2 parrot sequoia 1280 960 fisheye_opencv 0.8333", "v2 parrot sequoia 4608 3456 perspective 0.7777"},
        3,
        9,
    ),
    "micasense_rededge_capture": ({"v2 micasense rededge 1280 960 perspective 1.1458"}, 1, 5),
    "thermal_samples": (
        {
            "v2 dji m30t 1280 1024 brown 1.1111",
            "v2 flir systems ab flir e40 320 240 brown 0.85",
            "v2 dji xt s 640 512 brown 0.85",
            "v2 dji zh20t 640 512 brown 1.6111",
            "v2 dji mavic2-enterprise-advanced 640 512 brown 0.85",
            "v2 dji flir 640 512 brown 0.85",
        },
        5,
        6,
    ),
}


@real
@pytest.mark.parametrize("folder", sorted(OBSERVED))
def test_real_folders_as_odm_took_them(folder: str) -> None:
    frames = scan([str(REAL / folder)]).frames
    prediction = predict(frames, {})
    cameras, solved, used = OBSERVED[folder]
    assert {camera_id(f) for f in frames} == cameras
    fates = list(prediction.fates.values())
    assert (fates.count("solver"), fates.count("solver") + fates.count("band")) == (solved, used)


@real
def test_real_mixes_as_odm_took_them() -> None:
    def frames(*parts: str) -> list:
        return list(scan([str(REAL / p) for p in parts]).frames)

    mixed = predict(frames("brighton_p3_rgb", "micasense_rededge_capture"), {})
    assert [f.code for f in mixed.findings] == ["odm-crash-band-count"]
    one_each = predict(frames("brighton_p3_rgb/DJI_0018.JPG", "micasense_rededge_capture"), {})
    assert [f.code for f in one_each.findings] == ["odm-band-dropped"]
    both_rigs = predict(
        [f for f in frames("garfield_sequoia_rgb_ms", "micasense_rededge_capture") if not f.name.endswith("RGB.JPG")],
        {},
    )
    assert [f.code for f in both_rigs.findings] == ["odm-captures-excluded"]
