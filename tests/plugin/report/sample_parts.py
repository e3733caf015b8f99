# ruff: noqa: E501 - a table of sample values reads better with one record per line
"""Cameras and flights of the sample survey: four drones over one quarry."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Optional, Tuple

LATITUDE, LONGITUDE = 46.8421, -92.0317
METRES_PER_DEGREE = 111_320.0
Json = Dict[str, Any]


def grid(count: int, west_m: float, south_m: float, width_m: float, depth_m: float) -> List[Tuple[float, float]]:
    """Latitude and longitude of a lawn-mower flight in flying order."""
    lines = max(2, round(math.sqrt(count * depth_m / width_m)))
    per_line = math.ceil(count / lines)
    spots = []
    for index in range(count):
        line, step = divmod(index, per_line)
        along = step / max(1, per_line - 1)
        along = along if line % 2 == 0 else 1.0 - along
        wobble = 1.5 * math.sin(index * 1.7)
        spots.append(
            (
                LATITUDE + (south_m + depth_m * line / max(1, lines - 1) + wobble) / METRES_PER_DEGREE,
                LONGITUDE + (west_m + width_m * along) / (METRES_PER_DEGREE * math.cos(math.radians(LATITUDE))),
            )
        )
    return spots


def intrinsics(
    ratio: Optional[float], source: str, focal_mm: Optional[float], width_mm: Optional[float], **more: Any
) -> Json:
    return {
        "focal_ratio": ratio,
        "focal_source": source,
        "focal_mm": focal_mm,
        "sensor_width_mm": width_mm,
        "sensor_width_source": more.get("width_source", "sheet" if width_mm else "unknown"),
        "center_ratio": None,
        "distortion": more.get("distortion"),
        "distortion_source": more.get("distortion_source", "unknown"),
        "projection": "brown",
    }


def profile(ident: str, spectrum: str, make: str, model: str, size: Tuple[int, int], inner: Json, **more: Any) -> Json:
    band = more.get("band", "")
    return {
        "id": ident,
        "family": " / ".join(p for p in (make, model, more.get("lens", ""), spectrum, band) if p),
        "spectrum": spectrum,
        "band": band,
        "make": make,
        "model": model,
        "lens": more.get("lens", ""),
        "serial": more.get("serial", ""),
        "mode": "",
        "width": size[0],
        "height": size[1],
        "frames": [],
        "intrinsics": inner,
        "focal_mm_min": more.get("focal_min", inner["focal_mm"]),
        "focal_mm_max": more.get("focal_max", inner["focal_mm"]),
        "focal_variance": more.get("variance", 0.0),
        "family_focal_variance": more.get("variance", 0.0),
        "corrected_in_camera": more.get("corrected", False),
        "thermal_reading": more.get("thermal_reading", ""),
        "lock": more.get("lock", False),
        "lock_reason": more.get("lock_reason", "The focal lengths agree; nothing needs to be held."),
        "odm_camera_ids": [],
    }


PROFILES = (
    profile(
        "dji-fc6310-rgb", "rgb", "DJI", "FC6310", (5472, 3648),
        intrinsics(8.8 / 13.2, "sheet", 8.8, 13.2, distortion=[0, 0, 0, 0, 0], distortion_source="corrected-in-camera"),
        serial="0f9b21c4", focal_min=8.6, focal_max=9.0, variance=0.0455, corrected=True, lock=True,
        lock_reason="Focal tags spread 4.5 % in this family (limit 3 %) and the sheet's 8.80 mm is trusted: held.",
    ),
    profile(
        "hasselblad-l1d-20c-rgb", "rgb", "Hasselblad", "L1D-20c", (5472, 3648),
        intrinsics(10.26 / 13.2, "xmp-calibrated", 10.26, 13.2), serial="163DF8C0012",
    ),
    profile(
        "dji-fc300x-rgb", "rgb", "DJI", "FC300X", (4000, 3000),
        intrinsics(3.61 / 6.17, "equivalent-35mm", 3.61, 6.17, width_source="generic-width"),
        lock_reason="The focal is a rounded 35 mm equivalent: never held.",
    ),
    *(
        profile(
            f"micasense-rededge-{band.lower().replace(' ', '-')}", "multispectral", "MicaSense", "RedEdge-M", (1280, 960),
            intrinsics(5.43 / 4.8, "xmp-camera", 5.43 + 0.01 * i, 4.8, width_source="focal-plane",
                       distortion=[-0.09, 0.15, 0, 0, -0.03], distortion_source="xmp-camera"),
            band=band, serial="RX01-1809051-SC", lock=True,
            lock_reason="Every band carries its factory calibration in XMP: held.",
        )
        for i, band in enumerate(("Blue", "Green", "Red", "NIR", "Red edge"))
    ),
    profile(
        "dji-xt2-thermal", "thermal", "DJI", "XT2", (640, 512),
        intrinsics(13.0 / 10.88, "sheet", 13.0, 10.88),
        thermal_reading="ODM 3.6 reads these R-JPEG frames as a palette picture, not as temperature.",
        lock=True, lock_reason="There is no focal tag; the sheet's 13 mm at 17 um is held, or ODM assumes 0.85.",
    ),
)  # fmt: skip

# payload, primary profile, profiles, flights: (count share, west, south, width, depth, height, sub-project)
PLAN: Tuple[Tuple[str, str, Tuple[str, ...], Tuple[Tuple[float, float, float, float, float, float], ...], str], ...] = (
    ("phantom-4-pro", "rgb", ("dji-fc6310-rgb",), ((1.0, 0, 0, 420, 260, 118), (0.6, 200, 40, 360, 220, 119)), "rgb"),
    ("mavic-2-pro", "rgb", ("hasselblad-l1d-20c-rgb",), ((0.9, 60, 30, 380, 240, 90),), "rgb"),
    ("phantom-3", "rgb", ("dji-fc300x-rgb",), ((0.5, 430, 150, 240, 200, 95),), "rgb-phantom-3"),
    (
        "rededge", "multispectral",
        tuple(f"micasense-rededge-{b}" for b in ("green", "blue", "red", "nir", "red-edge")),
        ((0.7, 20, 10, 400, 240, 80),), "multispectral",
    ),
    ("xt2-thermal", "thermal", ("dji-xt2-thermal",), ((0.4, 120, 60, 220, 150, 60),), "thermal"),
)  # fmt: skip


def frame_of(
    path: str, prof: Json, flight: str, payload: str, spot: Tuple[float, float], height: float, index: int
) -> Json:
    ratio = prof["intrinsics"]["focal_ratio"]
    jitter = 0.2 * math.sin(index * 2.1) if prof["id"] == "dji-fc6310-rgb" else 0.0
    focal = round(prof["intrinsics"]["focal_mm"] + jitter, 2)
    shown = {"dji-xt2-thermal": "0.85"}.get(prof["id"], f"{focal / prof['intrinsics']['sensor_width_mm']:.6f}"[:6])
    return {
        "path": path,
        "subproject": None,
        "output": None,
        "reason": None,
        "profile": prof["id"],
        "flight": flight,
        "payload": payload,
        "role": "survey",
        "spectrum": prof["spectrum"],
        "band": prof["band"],
        "capture": f"{payload}-{index:05d}",
        "make": prof["make"],
        "model": prof["model"],
        "serial": prof["serial"],
        "width": prof["width"],
        "height": prof["height"],
        "focal_mm": focal,
        "focal_source": prof["intrinsics"]["focal_source"],
        "sensor_width_mm": prof["intrinsics"]["sensor_width_mm"],
        "sensor_width_source": prof["intrinsics"]["sensor_width_source"],
        "altitude_m": 402.0 + height + 0.8 * math.sin(index),
        "height_m": height + 0.8 * math.sin(index),
        "height_source": "relative-altitude",
        "gsd_cm": round(100.0 * (height + 0.8 * math.sin(index)) / ratio / prof["width"], 3),
        "gsd_after_cm": None,
        "latitude": spot[0],
        "longitude": spot[1],
        "gps": {"rtk_fixed": False, "sigma_horizontal_m": 3.0, "sigma_vertical_m": 5.0},
        "odm_camera_id": f"v2 {prof['make']} {prof['model']} {prof['width']} {prof['height']} brown {shown}".lower(),
        "intrinsics_notes": [],
        "original_tags": None,
        "change": None,
    }
