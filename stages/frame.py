"""Frame: what one image file says of itself, read without decoding a pixel.

A frame holds facts of the file only. What they mean (spectrum, true
intrinsics, height above ground) is decided by the pure functions of
``spectrum``, ``intrinsics`` and ``flight``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

from .record import slotted

ELLIPSOID, SEA_LEVEL = "ellipsoid", "sea level"
# What drone-dji:AltitudeType says of it.
_ALTITUDE_ZERO = {"rtkalt": ELLIPSOID, "gpsfusionalt": SEA_LEVEL}


@dataclass(frozen=True)
class FileCalibration:
    """A camera calibration that the file itself carries (XMP).

    ``source`` is ``xmp-camera`` (Pix4D/MicaSense/Parrot ``Camera:`` tags),
    ``xmp-dewarp`` (DJI ``DewarpData``) or ``xmp-calibrated`` (DJI
    ``CalibratedFocalLength``, pixels). Exactly one of ``focal_mm`` and
    ``focal_px`` is set. ``center_px`` is the principal point in pixels of the
    frame as stored, ``None`` when the file does not say. ``distortion`` is
    k1, k2, p1, p2, k3 in OpenCV order on ray-normalised coordinates for
    ``projection`` ``brown``; for ``fisheye`` it is the Parrot polynomial.
    ``fisheye_affine`` is Parrot's C, D, E, F in pixels. ``aspect_ratio`` is focal
    down over focal across (fy / fx) where the file gives both; ``focal_px`` is
    then their mean.
    """

    source: str
    projection: str = "brown"
    focal_mm: Optional[float] = None
    focal_px: Optional[float] = None
    center_px: Optional[Tuple[float, float]] = None
    distortion: Optional[Tuple[float, ...]] = None
    fisheye_affine: Optional[Tuple[float, ...]] = None
    aspect_ratio: float = 1.0


@slotted
@dataclass(frozen=True)
class Frame:
    """One image's metadata. Absent strings are ``""``, absent numbers ``None``.

    ``path`` is the argument as given plus the relative part, with ``/``.
    ``time`` is ``DateTimeOriginal`` with sub-seconds as ISO text without a
    zone. ``altitude_m`` is the signed GPS altitude, ``relative_altitude_m``
    the height above take-off (DJI). ``rtk_std_m`` is longitude, latitude,
    height. ``bands`` are the band names as the file spells them.
    ``rotation_deg`` is the rig's relative rotation (x, y, z). ``radiometry``
    names the tags that belong to pixel positions or raw numbers
    (``black-level``, ``vignette``, ``row-gradient``). ``problems`` are codes
    of what in the header could not be read as it should be, each
    ``code:detail``. ``original_width`` and ``original_height`` are the size
    that the camera wrote, where the file says that it was resampled.
    """

    path: str
    size_bytes: int
    format: str
    width: int
    height: int
    bits: int = 8
    channels: int = 3
    sample_format: str = "uint"
    pages: int = 1
    orientation: Optional[int] = None
    make: str = ""
    model: str = ""
    serial: str = ""
    lens: str = ""
    software: str = ""
    xmp_make: str = ""
    xmp_model: str = ""
    xmp_lens: str = ""
    focal_mm: Optional[float] = None
    focal_35mm: Optional[float] = None
    digital_zoom: Optional[float] = None
    focal_plane_x_res: Optional[float] = None
    focal_plane_y_res: Optional[float] = None
    focal_plane_unit: Optional[int] = None
    exif_width: Optional[int] = None
    exif_height: Optional[int] = None
    f_number: Optional[float] = None
    exposure_s: Optional[float] = None
    iso: Optional[float] = None
    time: Optional[str] = None
    latitude: Optional[float] = None
    longitude: Optional[float] = None
    gps_reference_missing: bool = False
    altitude_m: Optional[float] = None
    relative_altitude_m: Optional[float] = None
    altitude_type: str = ""
    rtk_flag: Optional[int] = None
    rtk_std_m: Optional[Tuple[float, float, float]] = None
    speed_mps: Optional[float] = None
    yaw_deg: Optional[float] = None
    pitch_deg: Optional[float] = None
    roll_deg: Optional[float] = None
    bands: Tuple[str, ...] = ()
    wavelength_nm: Optional[float] = None
    capture_id: str = ""
    sequence: Optional[int] = None
    image_source: str = ""
    projection: str = ""
    calibration: Optional[FileCalibration] = None
    dewarp_flag: Optional[int] = None
    rig_name: str = ""
    rig_index: Optional[int] = None
    rotation_deg: Optional[Tuple[float, float, float]] = None
    thermal_payload: str = ""
    radiometry: Tuple[str, ...] = ()
    panel: bool = False
    has_makernote: bool = False
    xmp_namespaces: Tuple[str, ...] = ()
    xmp_blocks: int = 0
    problems: Tuple[str, ...] = ()
    original_width: Optional[int] = None
    original_height: Optional[int] = None

    @property
    def name(self) -> str:
        """The file's name without its folder."""
        return self.path.rsplit("/", 1)[-1]

    @property
    def altitude_zero(self) -> str:
        """What the GPS altitude counts from where the file says so: ``ELLIPSOID``, ``SEA_LEVEL`` or nothing."""
        return _ALTITUDE_ZERO.get(self.altitude_type.replace(" ", "").lower(), "")

    @property
    def camera_size(self) -> Tuple[int, int]:
        """Width and height that the camera wrote: what calibration sheets know it by."""
        if self.original_width is None or self.original_height is None:
            return self.width, self.height
        return self.original_width, self.original_height

    @property
    def has_gps(self) -> bool:
        """A position is there and is not the 0,0 that cameras write before a fix."""
        return (
            self.latitude is not None
            and self.longitude is not None
            and not (abs(self.latitude) < 1e-6 and abs(self.longitude) < 1e-6)
        )


@dataclass(frozen=True)
class BrokenFrame:
    """An image file that could not be read, with the finding code that says why."""

    path: str
    size_bytes: int
    code: str
    message: str
