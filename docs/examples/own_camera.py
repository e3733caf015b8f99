"""What a calibration sheet of your own changes: focal, width and their sources, per camera.

python docs/examples/own_camera.py SURVEY docs/examples/my_cameras.csv
"""

from __future__ import annotations

import sys
from typing import Dict, Optional

from sensorgate.plugin import pipeline


def cameras(survey: str, sheet: Optional[str]) -> Dict[str, str]:
    """Profile id -> focal over width, sensor width and their sources, in words."""
    report = pipeline.gate([survey], pipeline.Settings(calibration=sheet)).report
    told = {}
    for profile in report["profiles"]:
        camera = profile["intrinsics"]
        ratio, width = camera["focal_ratio"], camera["sensor_width_mm"]
        told[profile["id"]] = (
            f"focal {'unknown' if ratio is None else f'{ratio:.4f}'} ({camera['focal_source']}), "
            f"sensor {'unknown' if width is None else f'{width:.2f} mm'} ({camera['sensor_width_source']})"
        )
    return told


def main(survey: str, sheet: str) -> int:
    """Print every camera without and with the sheet; 1 where the sheet changes none."""
    before, after = cameras(survey, None), cameras(survey, sheet)
    for name in sorted(after):
        print(f"{name}\n  without: {before.get(name, 'another profile')}\n  with:    {after[name]}")
    return 0 if before != after else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2]))
