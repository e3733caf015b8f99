"""Names on which the sender of a project and the adapter on a processing node agree."""

from __future__ import annotations

from typing import Any, Dict, Mapping

# The calibration travels as a file among the images, because a node's own quoting destroys JSON in option
# values. It is ODM's cameras format, {} where nothing is known; the adapter hands ODM its path, and takes its
# presence for the word that the project comes harmonized. ODM itself passes over a .json file.
CALIBRATION_INPUT = "sensorgate_calibration.json"

# The option by which a node says that it has the adapter, and what a project that is harmonized already asks of it:
# look and say, change nothing.
POLICY_OPTION = "mixed-sensor-policy"
POLICY_FOR_HARMONIZED = "report"

# Where an ODM without the adapter finds a calibration that no option gave: its own file of overrides.
OVERRIDES = "opensfm/camera_models_overrides.json"

# What NodeODM takes for the reference that ODM's ``align`` lays a reconstruction on.
ALIGN_INPUT = "align.laz"

_PRIOR = ("focal", "focal_x", "focal_y", "c_x", "c_y", "k1", "k2", "p1", "p2", "k3")
_PLAIN = ("width", "height", "projection_type")


def opensfm_overrides(cameras: Mapping[str, Mapping[str, Any]]) -> Dict[str, Dict[str, Any]]:
    """A cameras file as ODM itself would write it for OpenSfM: ids with ``v2 ``, each value also as its own prior."""
    result: Dict[str, Dict[str, Any]] = {}
    for key in sorted(cameras):
        camera = cameras[key]
        entry: Dict[str, Any] = {name: camera[name] for name in _PLAIN if name in camera}
        for name in _PRIOR:
            if name in camera:
                entry[name] = camera[name]
                entry[f"{name}_prior"] = camera[name]
        result[key if key.startswith("v2 ") else f"v2 {key}"] = entry
    return result
