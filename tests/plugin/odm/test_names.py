from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st
from sensorgate.plugin.odm.names import mask_name, output_names, safe

BAND = re.compile(r"^(.+)[-_]\w+(\.[A-Za-z]{3,4})$")  # ODM's rule for bands by file name


def test_unique_names_stay() -> None:
    frames = {"a/DJI_0001.JPG": "p4", "b/IMG_0001_1.tif": "re", "b/IMG_0001_2.tif": "re"}
    assert output_names(frames) == {p: p.split("/")[1] for p in frames}


def test_the_same_name_in_two_payloads_gets_the_payload_in_front() -> None:
    names = output_names({"a/DJI_0001.JPG": "p4", "b/dji_0001.jpg": "m2", "b/DJI_0002.JPG": "m2"})
    assert names["a/DJI_0001.JPG"] == "p4_DJI_0001.JPG"
    assert names["b/dji_0001.jpg"] == "m2_dji_0001.jpg"
    assert names["b/DJI_0002.JPG"] == "m2_DJI_0002.JPG" or names["b/DJI_0002.JPG"] == "DJI_0002.JPG"


def test_one_folder_of_a_payload_after_another() -> None:
    names = output_names({"f1/DJI_0001.JPG": "p4", "f2/DJI_0001.JPG": "p4", "f3/DJI_0001.JPG": "p4"})
    assert names == {
        "f1/DJI_0001.JPG": "p4_DJI_0001.JPG",
        "f2/DJI_0001.JPG": "p4-2_DJI_0001.JPG",
        "f3/DJI_0001.JPG": "p4-3_DJI_0001.JPG",
    }


def test_bands_of_a_capture_are_renamed_alike() -> None:
    frames = {"a/IMG_0001_1.tif": "red edge", "a/IMG_0001_2.tif": "red edge", "b/IMG_0001_1.tif": "altum"}
    names = output_names(frames)
    keys = {BAND.sub(r"\1\2", names[p]) for p in ("a/IMG_0001_1.tif", "a/IMG_0001_2.tif")}
    assert keys == {"red_edge_IMG_0001.tif"}
    assert names["b/IMG_0001_1.tif"] == "altum_IMG_0001_1.tif"


def test_a_capture_that_lacks_a_band_does_not_take_a_neighbours() -> None:
    names = output_names({"000/IMG_1.tif": "re", "001/IMG_1.tif": "re", "001/IMG_2.tif": "re"})
    assert names == {
        "000/IMG_1.tif": "re_IMG_1.tif",
        "001/IMG_1.tif": "re-2_IMG_1.tif",
        "001/IMG_2.tif": "re-2_IMG_2.tif",
    }


def test_what_odm_and_shells_cannot_take_goes() -> None:
    assert output_names({"a/DJI 1 (2)&$.JPG": "p"}) == {"a/DJI 1 (2)&$.JPG": "DJI_1_2.JPG"}
    assert output_names({"a/kamera_mask.JPG": "p"}) == {"a/kamera_mask.JPG": "kamera_masked.JPG"}
    assert safe("../..") == "image"
    assert safe("CON") == "CON_1"
    assert safe("Ä ö") == "image"


def test_masks_follow_their_image() -> None:
    assert mask_name("p4_DJI_0001.JPG", "DJI_0001_mask.png") == "p4_DJI_0001_mask.png"


names = st.text(alphabet="aA1_- .ÄJPG/", min_size=1, max_size=12)


@given(st.dictionaries(names, st.sampled_from(["p4", "P4", "m 2"]), max_size=12))
def test_names_are_unique_safe_and_do_not_depend_on_order(frames: dict) -> None:
    found = output_names(frames)
    assert set(found) == set(frames)
    assert len({n.lower() for n in found.values()}) == len(frames)
    assert all(re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", n) for n in found.values())
    assert output_names(dict(reversed(list(frames.items())))) == found
