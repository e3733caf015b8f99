"""Frames of made-up folders, as small as a rule needs them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

from sensorgate.plugin.odm.predict import Prediction, predict
from sensorgate.stages.frame import Frame
from sensorgate.stages.intrinsics import Intrinsics
from sensorgate.stages.profile import CameraProfile

REAL = Path(__file__).resolve().parents[3].parent / "shared/data/real_frames"


def frame(path: str = "s/IMG_0001.JPG", **tags: Any) -> Frame:
    base: Dict[str, Any] = {
        "path": path,
        "size_bytes": 1,
        "format": "jpeg",
        "width": 4000,
        "height": 3000,
        "make": "DJI",
        "model": "FC6310",
        "focal_mm": 8.8,
        "focal_35mm": 24.0,
        "latitude": 46.8,
        "longitude": -91.9,
        "altitude_m": 200.0,
    }
    return Frame(**{**base, **tags})


def survey(count: int = 4, folder: str = "s", **tags: Any) -> List[Frame]:
    return [frame(f"{folder}/IMG_{i:04d}.JPG", time=f"2024-05-01T10:00:{i:02d}", **tags) for i in range(count)]


def rig(captures: int, bands: Sequence[str], folder: str = "m", **tags: Any) -> List[Frame]:
    """A multi-band camera's captures, complete, with capture ids."""
    return [
        frame(
            f"{folder}/IMG_{c:04d}_{i + 1}.tif",
            **{
                "format": "tiff",
                "make": "MicaSense",
                "model": "RedEdge-M",
                "width": 1280,
                "height": 960,
                "channels": 1,
                "bits": 16,
                "bands": (band,),
                "capture_id": f"{folder}{c}",
                "rig_index": i,
                "xmp_namespaces": ("Camera", "MicaSense"),
                "focal_mm": 5.5,
                "focal_35mm": None,
                "focal_plane_x_res": 266.666667,
                "focal_plane_unit": 4,
                **tags,
            },
        )
        for c in range(captures)
        for i, band in enumerate(bands)
    ]


def profile(name: str, ratio: Optional[float] = 24 / 36, source: str = "sheet", spectrum: str = "rgb") -> CameraProfile:
    return CameraProfile(
        id=name,
        family=name,
        spectrum=spectrum,
        band="",
        make="",
        model="",
        lens="",
        serial="",
        mode="",
        width=4000,
        height=3000,
        frames=(),
        intrinsics=Intrinsics(focal_ratio=ratio, focal_source=source),
    )


def said(groups: Sequence[Tuple[CameraProfile, Sequence[Frame]]]) -> Prediction:
    """The prediction for frames grouped by their true camera."""
    profile_of = {f.path: p.id for p, members in groups for f in members}
    return predict([f for _, members in groups for f in members], profile_of, [p for p, _ in groups])


def codes(prediction: Prediction) -> List[str]:
    return [f.code for f in prediction.findings]


def one(groups: Sequence[Tuple[CameraProfile, Sequence[Frame]]], code: str) -> Any:
    """The one finding of this code."""
    (found,) = [f for f in said(groups).findings if f.code == code]
    return found


__all__ = ["REAL", "codes", "frame", "one", "profile", "replace", "rig", "said", "survey"]
