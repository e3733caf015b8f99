"""The camera id that ODM 3.6 gives a frame, and the focal ratio inside it.

ODM shares one set of intrinsics among all frames of one id, and finds the
entries of a cameras file by it. The id is make, model, decoded size,
projection and the focal ratio cut to six characters; serial, lens, zoom and
band are not part of it.

The rules were read from ODM 3.6.0 and compared with it on real frames.
"""

from __future__ import annotations

import functools
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Optional

from ...stages.frame import Frame

DEFAULT_RATIO = 0.85
PREFIX = "v2 "

# What ODM takes as a projection; "fisheye" becomes "fisheye_opencv" first.
_PROJECTIONS = ("perspective", "fisheye", "fisheye_opencv", "brown", "dual", "equirectangular", "spherical")
_MM_PER_UNIT = {2: 25.4, 3: 10, 4: 1, 5: 0.001}
_LENS_MM = re.compile(r"([\d\.]+)mm")
_TABLE = Path(__file__).with_name("sensor_widths_3_6_0.json")


@dataclass(frozen=True)
class OdmFocal:
    """The focal ratio that ODM computes from a frame's tags.

    ``how`` is ``equivalent-35mm``, ``focal-plane``, ``sensor-table``,
    ``default`` or ``crash``. ``ratio`` is ``None`` where ODM would die on the
    tags (``crash``). ``sure`` is false where ODM's own sensor table decides
    and may know the model: then ``ratio`` is the default it falls back to.
    ``why`` is one sentence.
    """

    ratio: Optional[float]
    how: str
    sure: bool
    why: str


@functools.lru_cache(maxsize=1)
def _table() -> Dict[str, Any]:
    loaded: Dict[str, Any] = json.loads(_TABLE.read_text(encoding="utf-8"))
    return loaded


def odm_make_model(frame: Frame) -> "tuple[str, str]":
    """Make and model as ODM takes them: EXIF, and XMP only where EXIF is empty."""
    return (frame.make.strip() or frame.xmp_make).strip(), (frame.model.strip() or frame.xmp_model).strip()


def _zero_denominator(frame: Frame, tag: str) -> bool:
    return f"focal-plane-rational-zero:{tag}" in frame.problems


def _not_positive(frame: Frame, tag: str) -> bool:
    return f"exif-not-positive:{tag}" in frame.problems


def _focal_plane_width_mm(frame: Frame, width: int, scale: float) -> Optional[float]:
    """Sensor width by the focal-plane tags, ``None`` where ODM does not use them.

    Raises ``ArithmeticError`` where ODM compares a number with nothing and dies.
    """
    unit = frame.focal_plane_unit
    mm_per_unit = _MM_PER_UNIT.get(unit) if unit is not None else None
    if mm_per_unit is None:
        return None
    pixels_per_unit = frame.focal_plane_x_res
    if pixels_per_unit is None and _zero_denominator(frame, "FocalPlaneXResolution"):
        raise ArithmeticError("FocalPlaneXResolution has a zero denominator")
    if pixels_per_unit is None and _not_positive(frame, "FocalPlaneXResolution"):
        if _zero_denominator(frame, "FocalPlaneYResolution"):
            raise ArithmeticError("FocalPlaneYResolution has a zero denominator")
        pixels_per_unit = frame.focal_plane_y_res
    if pixels_per_unit is None or pixels_per_unit <= 0:
        return None
    pixels_per_unit *= scale
    # The order of the operations is ODM's: the id holds four decimals of the result.
    return width * (1 / pixels_per_unit) * mm_per_unit


def _lens_focal_mm(text: str) -> Optional[float]:
    """The focal in a lens name such as ``35.0 mm``; raises ``ValueError`` as ODM does on ``1.2.3mm``."""
    found = _LENS_MM.search(text)
    return float(found.group(1)) if found else None


def sensor_string(frame: Frame) -> str:
    """The key of ODM's sensor table: make and model in lower case, the make taken out of the model."""
    make, model = odm_make_model(frame)
    if make != "unknown" and make:
        model = model.replace(make, "")
    return (make + " " + model.strip()).strip().lower()


def table_width_mm(key: str) -> "tuple[Optional[float], bool]":
    """Width that ODM's sensor table gives for ``key``, and whether that is certain.

    The table has thousands of rows; the makes that fly are known here in
    full, so for them "not in the table" is certain as well.
    """
    width = _table()["widths_mm"].get(key)
    if width is not None:
        return float(width), True
    make_known = not key or any(key == make or key.startswith(make + " ") for make in _table()["makes"])
    return None, make_known


def odm_focal_ratio(
    frame: Frame,
    width: Optional[int] = None,
    height: Optional[int] = None,
    focal_mm: Optional[float] = None,
    focal_35mm: Optional[float] = None,
    focal_plane_scale: float = 1.0,
) -> OdmFocal:
    """The focal ratio ODM computes for a frame, as it is or as it will be written.

    ``width`` is that of the written frame in pixels, ``focal_mm`` and
    ``focal_35mm`` are tags that harmonizing replaces, ``focal_plane_scale``
    is what it multiplies the focal-plane resolution with (new over old
    width where the tag is rewritten, 1 where it is left).
    """
    del height  # the ratio goes by width alone; taken so that both functions are called alike
    pixels = frame.width if width is None else width
    try:
        sensor_mm = _focal_plane_width_mm(frame, pixels, focal_plane_scale)
    except ArithmeticError as error:
        return OdmFocal(None, "crash", True, f"{error}: ODM stops with a TypeError when it reads this frame.")

    focal = frame.focal_mm if focal_mm is None else focal_mm
    if focal is None and frame.xmp_lens:
        try:
            focal = _lens_focal_mm(frame.xmp_lens)
        except ValueError:  # ODM gives up on the frame here, even beside a good 35 mm focal
            return OdmFocal(DEFAULT_RATIO, "default", True, "The lens name in XMP holds no number that ODM can read.")
    equivalent = frame.focal_35mm if focal_35mm is None else focal_35mm
    if equivalent is not None and equivalent > 0:
        return OdmFocal(equivalent / 36.0, "equivalent-35mm", True, "ODM takes FocalLengthIn35mmFilm / 36.")
    if not focal:
        return OdmFocal(DEFAULT_RATIO, "default", True, "The frame has no focal length, so ODM takes 0.85.")
    if sensor_mm:
        return OdmFocal(focal / sensor_mm, "focal-plane", True, "ODM takes FocalLength over the focal-plane width.")

    key = sensor_string(frame)
    table_mm, known = table_width_mm(key)
    if table_mm:
        return OdmFocal(focal / table_mm, "sensor-table", True, f"ODM's sensor table has {table_mm:g} mm for {key!r}.")
    if known:
        return OdmFocal(DEFAULT_RATIO, "default", True, f"ODM's sensor table does not know {key!r}, so it takes 0.85.")
    return OdmFocal(
        DEFAULT_RATIO, "sensor-table", False, f"ODM's own sensor table may know {key!r}; if it does not, it takes 0.85."
    )


def odm_projection(frame: Frame) -> str:
    """The projection type that ODM starts from: XMP ModelType, else Brown."""
    named = frame.projection.lower()
    if named == "fisheye":
        named = "fisheye_opencv"
    return named if named in _PROJECTIONS else "brown"


def camera_id(
    frame: Frame,
    width: Optional[int] = None,
    height: Optional[int] = None,
    focal_mm: Optional[float] = None,
    focal_35mm: Optional[float] = None,
    focal_plane_scale: float = 1.0,
) -> str:
    """ODM's id of a frame, ``v2 `` in front; ``""`` where ODM would die on its tags.

    The arguments are those of ``odm_focal_ratio``; ask that one whether the
    ratio in the id is sure.
    """
    focal = odm_focal_ratio(frame, width, height, focal_mm, focal_35mm, focal_plane_scale)
    if focal.ratio is None:
        return ""
    make, model = odm_make_model(frame)
    parts = [
        "v2",
        make,
        model,
        str(int(frame.width if width is None else width)),
        str(int(frame.height if height is None else height)),
        odm_projection(frame),
        str(float(focal.ratio))[:6],
    ]
    return " ".join(parts).lower()


def file_key(identity: str) -> str:
    """The id as a cameras file spells it: without ``v2 ``."""
    return identity[len(PREFIX) :] if identity.startswith(PREFIX) else identity
