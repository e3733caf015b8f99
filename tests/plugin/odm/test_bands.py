"""ODM's band rules, with outcomes as ODM 3.6.0 gave them for the same folders."""

from __future__ import annotations

from typing import List, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.odm.bands import OdmPhoto, band_name, band_outcome, odm_photo, primary_band

from tests.plugin.odm.folders import frame

BANDS = ("Blue", "Green", "Red", "NIR", "Rededge")


def photo(name: str, band: str, capture: str = "", model: str = "X") -> OdmPhoto:
    return OdmPhoto(name, name, band, "0", "DJI", model, capture, 10, 10)


def captures(count: int, bands: Sequence[str] = BANDS, model: str = "X", ids: bool = True) -> List[OdmPhoto]:
    return [
        photo(f"IMG_{c:04d}_{i}.tif", b, f"u{c}" if ids else "", model)
        for c in range(count)
        for i, b in enumerate(bands)
    ]


def test_one_camera_stays_one_camera() -> None:
    outcome = band_outcome([photo("a.jpg", "RGB"), photo("b.jpg", "RGB")])
    assert outcome.bands == ()
    assert outcome.solver == ("a.jpg", "b.jpg")


def test_a_complete_rig_is_solved_by_its_green_band() -> None:
    outcome = band_outcome(captures(3))
    assert outcome.bands == ("Red", "Green", "Blue", "NIR", "Rededge")
    assert outcome.primary == "Green"
    assert len(outcome.solver) == 3
    assert len(outcome.kept) == 15
    assert (outcome.stop, outcome.late_stop, outcome.messages) == (None, None, ())


def test_a_capture_without_one_band_is_dropped_whole() -> None:
    present = [p for p in captures(3) if p.name != "IMG_0001_3.tif"]
    outcome = band_outcome(present)
    assert set(outcome.excluded) == {f"IMG_0001_{i}.tif" for i in (0, 1, 2, 4)}
    assert outcome.messages[0] == (
        'Multi-camera setup detected, but band "NIR" (identified from "IMG_0000_3.tif") has only 2 images '
        "(instead of 3), perhaps images are missing or are corrupted."
    )
    assert "Excluding IMG_0001_0.tif" in outcome.messages
    assert outcome.late_stop is None


def test_rgb_drone_and_rig_in_different_numbers_stop_odm() -> None:
    outcome = band_outcome([photo("DJI_0001.JPG", "RGB", "t1"), photo("DJI_0002.JPG", "RGB", "t2"), *captures(1)])
    assert outcome.stop is not None
    assert outcome.stop.startswith("Cannot match bands by filename on IMG_0000_0.tif")
    assert outcome.messages[-1].endswith("(no primary band match), will use filenames instead")


def test_rgb_drone_and_rig_in_equal_numbers_lose_the_rgb() -> None:
    outcome = band_outcome([photo("DJI_0001.JPG", "RGB", "t1"), *captures(1)])
    assert outcome.skipped == {"RGB": ("DJI_0001.JPG",)}
    assert outcome.messages[-1] == "Skipping RGB band (1 images)"
    assert outcome.solver == ("IMG_0000_1.tif",)


def test_a_rig_without_blue_loses_red_and_green_to_the_rgb() -> None:
    outcome = band_outcome(captures(2, ("RedGreenBlue", "Green", "Red", "NIR")))
    assert set(outcome.skipped) == {"Red", "Green"}
    assert outcome.primary == "RedGreenBlue"


def test_a_mavic_3_multispectral_loses_the_rgb_if_it_is_listed_first() -> None:
    rig = captures(2, ("RGB", "Green", "Red", "NIR"), "M3M")
    assert set(band_outcome(rig).skipped) == {"RGB"}
    mixed = [
        photo("z.jpg", "RGB", "u7"),
        photo("z_1.tif", "Green", "u7"),
        photo("z_2.tif", "Red", "u7"),
        photo("z_3.tif", "NIR", "u7"),
    ]
    assert band_outcome([*rig, *mixed]).order_matters
    assert not band_outcome(rig).order_matters


def test_only_colour_left_after_trimming_stops_late() -> None:
    outcome = band_outcome(captures(2, ("RGB", "Green", "Red")))
    assert outcome.bands == ("RGB",)
    assert outcome.late_stop is not None and outcome.late_stop.startswith("Cannot write ")


def test_names_without_ids_that_map_to_one_key_stop_late() -> None:
    # as a P4 Multispectral writes them: the number carries capture and band
    names = [f"DJI_{c:03d}{i}.TIF" for c in range(1, 3) for i in range(5)]
    outcome = band_outcome([photo(n, b) for n, b in zip(names, BANDS * 2)])
    assert outcome.by_filename
    assert outcome.late_stop is not None


def test_eleven_bands_are_no_bands() -> None:
    outcome = band_outcome(captures(1, [f"B{i}" for i in range(11)]))
    assert outcome.bands == ()
    assert len(outcome.solver) == 11


@pytest.mark.parametrize(
    ("tags", "name"),
    [
        ({"bands": ("Red", "Green", "Blue"), "xmp_namespaces": ("Camera",)}, "RedGreenBlue"),
        ({"bands": ("Red edge",), "xmp_namespaces": ("Camera",)}, "Rededge"),
        ({"bands": ("LWIR",), "xmp_namespaces": ("FLIR",)}, "LWIR"),
        ({"bands": ("LWIR",), "xmp_namespaces": ("DJI",)}, "RGB"),
        ({}, "RGB"),
        ({"make": "AeroVironment", "model": "Quantix", "path": "q/IMG_12_GRN.jpg"}, "Green"),
    ],
)
def test_band_names_as_odm_reads_them(tags: dict, name: str) -> None:
    assert band_name(frame(**tags)) == name


def test_captures_are_told_by_id_before_time() -> None:
    assert odm_photo(frame(capture_id="u", time="t")).capture == "u"
    assert odm_photo(frame(time="t")).capture == "t"
    assert odm_photo(frame(make="AeroVironment", model="Quantix", path="q/IMG_12_GRN.jpg")).capture == "12"


def test_primary_band_is_colour_then_green_then_blue_then_the_first() -> None:
    assert primary_band(["Red", "Green", "RGB"]) == "RGB"
    assert primary_band(["Red", "Blue", "G"]) == "G"
    assert primary_band(["NIR", "Blue"]) == "Blue"
    assert primary_band(["NIR", "Rededge"]) == "NIR"


photos = st.lists(
    st.builds(
        photo,
        st.builds("IMG_{:04d}_{}.tif".format, st.integers(0, 4), st.integers(0, 5)),
        st.sampled_from(["RGB", "Red", "Green", "Blue", "NIR", "LWIR"]),
        st.sampled_from(["", "u1", "u2", "u3"]),
        st.sampled_from(["M3M", "X"]),
    ),
    max_size=14,
    unique_by=lambda p: p.name,
)


@given(photos)
def test_no_photo_is_lost_or_doubled(present: List[OdmPhoto]) -> None:
    outcome = band_outcome(present)
    gone = [p for members in outcome.skipped.values() for p in members]
    everything = [*outcome.kept, *outcome.excluded, *gone]
    assert set(outcome.solver) <= set(outcome.kept)
    if outcome.stop is None:
        assert sorted(everything) == sorted(p.path for p in present)
    else:
        assert everything == []
