from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Dict, List, Sequence, Tuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.errors import UsageError
from sensorgate.stages.finding import Finding
from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize import FlightAction, HarmonizePlan, Lut, plan
from sensorgate.stages.harmonize.plan import lut_id
from sensorgate.stages.intrinsics import Intrinsics
from sensorgate.stages.profile import MULTISPECTRAL, RGB, THERMAL, CameraProfile, Flight, SurveyFrame
from sensorgate.stages.record import from_plain, to_plain
from sensorgate.stages.thresholds import DEFAULTS

Made = Tuple[List[SurveyFrame], List[Frame], CameraProfile, Flight]
CODES = ("gsd-mixed", "gsd-native", "gsd-unknown", "not-reflectance")


def flown(
    name: str,
    gsd: Any,
    *,
    height: Any = 100.0,
    sigma: float = 2.0,
    count: int = 4,
    size: Tuple[int, int] = (4000, 3000),
    latitude: float = 46.0,
    gps: bool = True,
    spectrum: str = RGB,
    payload: str = "",
    family: str = "",
    folder: str = "",
    focals: Sequence[Any] = (8.8,),
    equivalents: Sequence[Any] = (24.0,),
    **header: Any,
) -> Made:
    surveyed, files = [], []
    intrinsics = Intrinsics(focal_ratio=0.7)
    header.setdefault("format", "jpeg")
    for i in range(count):
        path = f"{folder or name}/{name}_{i}.jpg"
        place = {"latitude": latitude + i * 1e-4, "longitude": 7.0} if gps else {}
        focal = {"focal_mm": focals[i % len(focals)], "focal_35mm": equivalents[i % len(equivalents)]}
        files.append(Frame(path, 1, width=size[0], height=size[1], **focal, **place, **header))
        surveyed.append(
            SurveyFrame(
                path,
                name,
                f"{name}:1",
                payload or name,
                f"c{i}",
                spectrum,
                name,
                "",
                "survey",
                intrinsics,
                height_m=height,
                height_sigma_m=sigma,
                gsd_cm=gsd,
            )
        )
    paths = tuple(f.path for f in files)
    profile = CameraProfile(name, family or name, spectrum, name, "A", "B", "", "S", "", *size, paths, intrinsics)
    return surveyed, files, profile, Flight(f"{name}:1", name, paths, height_m=height, gsd_cm=gsd)


def decide(*flights: Made, **options: Any) -> Tuple[Dict[str, FlightAction], Tuple[Finding, ...]]:
    result, findings = planned(*flights, **options)
    return {a.profile: a for a in result.actions}, findings


def planned(*flights: Made, **options: Any) -> Tuple[HarmonizePlan, Tuple[Finding, ...]]:
    frames = [f for made in flights for f in made[0]]
    files = {f.path: f for made in flights for f in made[1]}
    limits = options.pop("limits", DEFAULTS)
    return plan(frames, files, [m[2] for m in flights], [m[3] for m in flights], limits, **options)


def codes(findings: Sequence[Finding]) -> List[Tuple[str, str]]:
    return [(f.severity, f.code) for f in findings]


def test_coarse_is_brought_to_fine():
    actions, findings = decide(flown("fine", 2.0), flown("coarse", 3.0))
    assert actions["fine"].scale == 1.0
    assert (actions["coarse"].scale, actions["coarse"].out_width, actions["coarse"].out_height) == (1.5, 6000, 4500)
    assert codes(findings) == [("error", "gsd-mixed")]
    assert findings[0].measured == pytest.approx(0.5) and findings[0].threshold == 0.05


@pytest.mark.parametrize("ratio, acts", [(1.04, False), (1.06, True)])
def test_the_trigger_is_five_per_cent(ratio, acts):
    actions, findings = decide(flown("a", 2.0), flown("b", 2.0 * ratio))
    assert (actions["b"].scale != 1.0) == acts == bool(findings)


@pytest.mark.parametrize("sigma, acts", [(2.0, True), (6.0, False)])
def test_no_difference_within_the_height_s_own_spread(sigma, acts):
    actions, _ = decide(flown("a", 2.0), flown("b", 2.2, sigma=sigma))
    assert (actions["b"].scale != 1.0) == acts


def test_one_scale_per_flight_from_its_median():
    coarse = flown("coarse", 3.0, count=9)
    coarse[0][0] = replace(coarse[0][0], gsd_cm=9.0)
    action = decide(flown("fine", 2.0), coarse)[0]["coarse"]
    assert action.scale == 1.5 and len(action.frames) == 9


def test_transit_frames_and_excluded_frames_count_for_nothing():
    coarse = flown("coarse", 2.0, count=6)
    coarse[0][0] = replace(coarse[0][0], gsd_cm=0.2, role="transit")
    coarse[0][1] = replace(coarse[0][1], gsd_cm=0.2, excluded="duplicate")
    actions, findings = decide(flown("fine", 2.0), coarse)
    assert not findings and len(actions["coarse"].frames) == 4


def test_other_ground_and_other_spectra_are_no_reason():
    actions, findings = decide(
        flown("here", 2.0),
        flown("far", 5.0, latitude=46.1),
        flown("heat", 12.0, spectrum=THERMAL, bits=16, format="tiff"),
    )
    assert {a.scale for a in actions.values()} == {1.0} and not findings


def test_without_positions_the_folder_is_the_ground():
    together, _ = decide(flown("a", 2.0, gps=False, folder="x"), flown("b", 3.0, gps=False, folder="x"))
    apart, _ = decide(flown("a", 2.0, gps=False, folder="x"), flown("b", 3.0, gps=False, folder="y"))
    mixed, _ = decide(flown("a", 2.0, folder="x"), flown("b", 3.0, gps=False, folder="x"))
    assert together["b"].scale == mixed["b"].scale == 1.5 and apart["b"].scale == 1.0


def test_beyond_four_times_frames_stay_and_agree_among_themselves():
    actions, findings = decide(
        flown("tele", 1.0), flown("a", 10.0, size=(2000, 1500)), flown("b", 15.0, size=(2000, 1500))
    )
    assert actions["a"].scale == 1.0 and actions["b"].scale == 1.5
    assert codes(findings) == [("error", "gsd-mixed"), ("warning", "gsd-native")]
    assert findings[1].subjects == ("a:1",)


def test_no_frame_grows_beyond_sixty_megapixels_unasked():
    big = flown("big", 3.0, size=(8000, 6000))
    actions, findings = decide(flown("fine", 2.0), big)
    assert actions["big"].scale == 1.0 and codes(findings) == [("warning", "gsd-native")]
    asked, _ = decide(flown("fine", 2.0), big, gsd_target=2.0)
    assert asked["big"].out_width == 12000


def test_targets_by_hand():
    made = (flown("fine", 2.0), flown("coarse", 4.0))
    coarsest, _ = decide(*made, gsd_target="coarsest")
    assert (coarsest["fine"].scale, coarsest["coarse"].scale) == (0.5, 1.0)
    number, _ = decide(*made, gsd_target="2.5")
    assert (number["fine"].scale, number["coarse"].scale) == (0.8, 1.6)
    for bad in ("fine", 0, -1, math.nan, math.inf, "", None):
        with pytest.raises(UsageError, match="--gsd-target"):
            decide(*made, gsd_target=bad)


def test_unknown_resolution_keeps_pixels_and_says_so():
    actions, findings = decide(flown("known", 2.0), flown("blind", None, height=None))
    assert actions["blind"].scale == 1.0 and actions["blind"].target_gsd_cm is None
    assert codes(findings) == [("warning", "gsd-unknown")]
    _, alone = decide(flown("blind", None, height=None))
    assert codes(alone) == [("info", "gsd-unknown")]


RAW = {
    "spectrum": MULTISPECTRAL,
    "format": "tiff",
    "bits": 16,
    "channels": 1,
    "radiometry": ("black-level", "vignette"),
}


def test_raw_multispectral_frames_keep_their_pixels_unless_asked():
    made = (flown("low", 4.0, **RAW), flown("high", 6.0, **RAW))
    actions, findings = decide(*made)
    assert actions["high"].scale == 1.0 and not actions["high"].radiometric_none
    assert codes(findings) == [("warning", "gsd-native")] and any("vignette" in r for r in actions["high"].reasons)
    asked, findings = decide(*made, gsd_target=4.0)
    assert asked["high"].scale == 1.5 and asked["high"].radiometric_none and not asked["low"].radiometric_none
    assert ("warning", "not-reflectance") in codes(findings)


def test_bands_of_one_rig_share_one_scale():
    reflectance = {**RAW, "radiometry": ()}
    green, lwir = (
        flown(f"{band}-high", gsd, payload="rig", size=size, **reflectance)
        for band, gsd, size in (("green", 6.0, (1200, 900)), ("lwir", 60.0, (160, 120)))
    )
    actions, _ = decide(flown("green-low", 4.0, payload="other", **reflectance), green, lwir)
    assert actions["green-high"].scale == actions["lwir-high"].scale == 1.5
    assert (actions["lwir-high"].out_width, actions["lwir-high"].out_height) == (240, 180)


@pytest.mark.parametrize(
    "header, word",
    [
        ({"spectrum": THERMAL, "thermal_payload": "dji"}, "raw temperatures"),
        ({"spectrum": THERMAL}, "thermal JPEGs"),
        ({"format": "dng", "bits": 16}, "dng"),
        ({"format": "tiff", "pages": 3}, "several pages"),
        ({"format": "tiff", "channels": 12}, "12 channels"),
        ({"format": "tiff", "bits": 32}, "32 bits"),
        ({"channels": 4}, "4 channels"),
    ],
)
def test_what_must_not_be_reencoded_stays(header, word):
    fine = flown("fine", 2.0, spectrum=header.get("spectrum", RGB))
    for target in ("finest", 1.0):
        actions, findings = decide(fine, flown("coarse", 3.0, **header), gsd_target=target)
        assert actions["coarse"].scale == 1.0
        assert any(word in r for r in actions["coarse"].reasons)
        assert "gsd-native" in {f.code for f in findings}


def test_one_camera_at_two_sizes_becomes_one_size():
    """The same camera at the same height, half the pixels: the height's noise must not leave two sizes."""
    full = flown("full", 2.0, family="cam")
    half = flown("half", 3.95, family="cam", size=(2000, 1500))
    action = decide(full, half)[0]["half"]
    assert (action.out_width, action.out_height) == (4000, 3000) and action.scale == 2.0
    cropped = decide(full, flown("wide", 3.95, family="cam", size=(2000, 1125)))[0]["wide"]
    assert cropped.out_width == round(2000 * 1.975)
    lower = decide(full, flown("low", 3.0, family="cam", size=(2000, 1500)))[0]["low"]
    assert lower.out_width == 3000


def test_one_focal_tag_per_profile():
    jitter = flown("jitter", 2.0, focals=(4.386, 4.387, 4.390, 4.400))
    steady = flown("steady", 2.0)
    missing = flown("missing", 2.0, equivalents=(24.0, None))
    zeros = flown("zeros", 2.0, equivalents=(0.0,))
    actions, _ = decide(jitter, steady, missing, zeros)
    tags = {name: (a.focal_mm, a.focal_35mm) for name, a in actions.items()}
    assert tags == {"jitter": (4.387, None), "steady": (None, None), "missing": (None, 24.0), "zeros": (None, None)}
    raw, _ = decide(flown("raw", 2.0, focals=(4.3, 4.4), format="dng"))
    assert raw["raw"].focal_mm is None


def table(profile: str) -> Lut:
    return Lut(lut_id(profile, f"{profile}:1"), (tuple(range(256)),) * 3, (20.0,) * 3, "x", 6)


def test_tables_are_written_into_colour_frames_of_eight_bits_only():
    made = (
        flown("colour", 2.0),
        flown("deep", 2.0, format="tiff", bits=16),
        flown("heat", 9.0, spectrum=THERMAL),
        flown("plain", 2.0),
    )
    result, _ = planned(*made, luts=[table(n) for n in ("heat", "deep", "colour", "nobody")])
    actions = {a.profile: a for a in result.actions}
    assert {n for n, a in actions.items() if a.write_lut} == {"colour"}
    assert {n for n, a in actions.items() if a.lut} == {"colour", "deep", "heat"}
    assert [t.id for t in result.luts] == ["colour|colour:1", "deep|deep:1", "heat|heat:1"]


GSDS = st.lists(st.one_of(st.none(), st.floats(0.3, 60.0)), min_size=1, max_size=6)


@given(GSDS, st.sampled_from(["finest", "coarsest", 3.0]))
@settings(max_examples=80, deadline=None)
def test_laws_of_any_mix(gsds, target):
    made = [flown(f"p{i}", g) for i, g in enumerate(gsds)]
    result, findings = planned(*made, gsd_target=target)
    mirrored, again = planned(*reversed(made), gsd_target=target)
    assert (mirrored, again) == (result, findings)
    assert from_plain(HarmonizePlan, to_plain(result)) == result
    assert {f.code for f in findings} <= set(CODES)
    for action in result.actions:
        assert action.reasons
        assert action.scale == action.out_width / 4000
        assert abs(action.out_height - 3000 * action.scale) <= 0.5 + 1e-9
        if target == "finest":
            assert action.scale >= 1.0
            assert action.out_width * action.out_height <= 60e6 * 1.001
        if action.scale != 1.0 and action.gsd_cm and action.target_gsd_cm:
            assert action.gsd_cm / action.scale == pytest.approx(action.target_gsd_cm, rel=0.6 / action.out_width)


@given(GSDS)
@settings(max_examples=60, deadline=None)
def test_harmonized_frames_need_no_harmonizing(gsds):
    """Planning again over what was written finds nothing to do: the job closes its own loop."""
    made = [flown(f"p{i}", g) for i, g in enumerate(gsds)]
    actions, _ = decide(*made)
    written = [
        flown(
            f"p{i}",
            g / actions[f"p{i}"].scale if g else None,
            size=(actions[f"p{i}"].out_width, actions[f"p{i}"].out_height),
        )
        for i, g in enumerate(gsds)
    ]
    again, findings = decide(*written)
    assert {a.scale for a in again.values()} == {1.0}
    assert "error" not in {f.severity for f in findings}
