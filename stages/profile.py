"""CameraProfile: the frames that one true camera made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

from .intrinsics import Intrinsics
from .record import slotted

RGB = "rgb"
MULTISPECTRAL = "multispectral"
THERMAL = "thermal"
SPECTRA = (RGB, MULTISPECTRAL, THERMAL)


@slotted
@dataclass(frozen=True)
class SurveyFrame:
    """A frame placed in its survey: what it is, how it looked, whether it is used.

    ``role`` is ``survey``, ``panel``, ``transit``, ``horizon``, ``duplicate``
    or ``broken``; only ``survey`` frames reach the solver. ``excluded`` is the
    finding code when the frame goes into no project. ``capture`` is shared by
    the frames that one trigger made. ``height_m`` is above ground,
    ``height_source`` is ``relative-altitude``, ``relative-altitude+dem`` (turned
    from above take-off to above ground), ``dem`` or ``ground-option`` (GPS
    altitude minus that ground), or ``unknown``. ``ground_m`` is the ground
    under the frame on the datum of the elevation model, where one was given.
    """

    path: str
    profile: str
    flight: str
    payload: str
    capture: str
    spectrum: str
    band: str
    spectrum_evidence: str
    role: str
    intrinsics: Intrinsics
    height_m: Optional[float] = None
    height_source: str = "unknown"
    height_sigma_m: Optional[float] = None
    gsd_cm: Optional[float] = None
    excluded: Optional[str] = None
    ground_m: Optional[float] = None


@dataclass(frozen=True)
class CameraProfile:
    """One true camera. ``family`` is make, model, lens, spectrum and band.

    ``focal_variance`` is (max-min)/mean over the profile's frames,
    ``family_focal_variance`` over the whole family before it was split;
    ``lock_reason`` says why ``lock`` is or is not set. ``corrected_in_camera`` is set where
    the camera writes frames whose lens distortion it already removed.
    """

    id: str
    family: str
    spectrum: str
    band: str
    make: str
    model: str
    lens: str
    serial: str
    mode: str
    width: int
    height: int
    frames: Tuple[str, ...]
    intrinsics: Intrinsics
    focal_mm_min: Optional[float] = None
    focal_mm_max: Optional[float] = None
    focal_variance: float = 0.0
    family_focal_variance: float = 0.0
    corrected_in_camera: bool = False
    thermal_reading: str = ""
    lock: bool = False
    lock_reason: str = ""


@dataclass(frozen=True)
class Flight:
    """A profile's frames of one session, in time order. ``gsd_cm`` and ``height_m`` are medians.

    ``relief_m`` is how much the ground under its survey frames varies, where
    an elevation model says.
    """

    id: str
    profile: str
    frames: Tuple[str, ...]
    start: Optional[str] = None
    end: Optional[str] = None
    height_m: Optional[float] = None
    height_source: str = "unknown"
    height_sigma_m: Optional[float] = None
    gsd_cm: Optional[float] = None
    relief_m: Optional[float] = None


@dataclass(frozen=True)
class Payload:
    """Profiles that enter a reconstruction as one: a camera, or all bands of one rig.

    ``primary`` is the profile whose frames the solver sees.
    """

    id: str
    spectrum: str
    profiles: Tuple[str, ...]
    primary: str
    bands: Tuple[str, ...] = ()
