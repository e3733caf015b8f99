"""The calibration as OpenSfM finds it, where no option can carry it."""

from __future__ import annotations

from sensorgate.plugin.odm.folder import EXTENSIONS, extension
from sensorgate.plugin.odm.wire import CALIBRATION_INPUT, opensfm_overrides

CAMERA = {
    "projection_type": "brown",
    "width": 64,
    "height": 48,
    "focal_x": 0.66,
    "focal_y": 0.66,
    "k1": -0.1,
    "k4": 1.0,
}


def test_overrides_are_spelled_as_odm_writes_them():
    told = opensfm_overrides({"dji fc6310 64 48 brown 0.6666": CAMERA})
    assert told == {
        "v2 dji fc6310 64 48 brown 0.6666": {
            "width": 64,
            "height": 48,
            "projection_type": "brown",
            "focal_x": 0.66,
            "focal_x_prior": 0.66,
            "focal_y": 0.66,
            "focal_y_prior": 0.66,
            "k1": -0.1,
            "k1_prior": -0.1,
        }
    }
    assert opensfm_overrides({f"v2 {k}": CAMERA for k in ("a",)}).keys() == {"v2 a"}


def test_the_file_among_the_images_is_no_image():
    # Neither an image for ODM nor a text file that a node would move away.
    assert extension(CALIBRATION_INPUT) not in EXTENSIONS and not CALIBRATION_INPUT.endswith(".txt")
