"""Whether ODM 3.6 reads a thermal frame as temperature or as a picture only, and what would make it temperature.

ODM takes a frame as thermal when its band is named LWIR, or when it is a
640 x 512 frame of DJI's MAVIC2-ENTERPRISE-ADVANCED or ZH20T. Of those it
converts, with ``radiometric-calibration`` other than ``none``: MicaSense Altum
(hundredths of a kelvin), the Mavic's radiometric JPEG (DJI's raw data), and
ZH20T TIFFs in hundredths of a kelvin. Floating-point TIFFs of one channel pass
through with their values as they are.
"""

from __future__ import annotations

from ...stages.frame import Frame
from .camera_id import odm_make_model

_M2EA, _ZH20T = "MAVIC2-ENTERPRISE-ADVANCED", "ZH20T"
_SIZE = (640, 512)
_OPTION = "with radiometric-calibration camera"
_LOST = "A frame that was saved anew by other software has lost its raw temperatures."
_ORIGINALS = "Take the files as the camera wrote them."


def known_as_thermal(frame: Frame, band: str) -> bool:
    """ODM treats the frame as thermal; ``band`` is the band name that ODM sees (``RGB`` where the file names none)."""
    if band.upper() == "LWIR":
        return True
    make, model = odm_make_model(frame)
    return make == "DJI" and model in (_M2EA, _ZH20T) and (frame.width, frame.height) == _SIZE


def thermal_reading(frame: Frame, band: str) -> str:
    """One or two sentences: temperature or picture, and the step that makes it temperature.

    ``band`` is the band as ODM names it: ``LWIR`` only where the file itself
    says so (``frame.bands``).
    """
    make, model = odm_make_model(frame)
    if frame.sample_format == "float" and frame.channels == 1:
        return (
            "ODM 3.6 keeps the values of these floating-point TIFFs as they are: temperature, if they hold degrees. "
            "Set radiometric-calibration none."
        )
    if not known_as_thermal(frame, band):
        return f"ODM 3.6 does not know these frames as thermal and reads {_picture(frame)}. {_step(frame)}"
    if make.lower() == "micasense" and model.startswith("Altum"):
        return f"ODM 3.6 reads these frames as temperature in degrees Celsius {_OPTION}; without it as raw numbers."
    if model == _M2EA:
        if frame.thermal_payload:
            return f"ODM 3.6 reads the raw data of these frames as temperature in degrees Celsius {_OPTION}."
        return f"ODM 3.6 would take these frames for radiometric ones, but their raw data is gone. {_LOST} {_ORIGINALS}"
    if model == _ZH20T:
        if frame.format == "tiff" and frame.bits == 16:
            return (
                f"ODM 3.6 reads these TIFFs as temperature in degrees Celsius {_OPTION}, if they hold hundredths of a "
                "kelvin (no value below 23315)."
            )
        return f"ODM 3.6 knows the camera but does not read its raw data: {_picture(frame)} only. {_step(frame)}"
    return (
        "ODM 3.6 knows these frames as thermal but has no conversion for the camera: "
        f"{_picture(frame)} only. {_step(frame)} Set radiometric-calibration none."
    )


def _picture(frame: Frame) -> str:
    return "raw numbers" if frame.channels == 1 and frame.bits > 8 else "the colours of the palette"


def _step(frame: Frame) -> str:
    """What makes it temperature."""
    if frame.thermal_payload.lower().startswith("flir"):
        return "For temperatures convert them to floating-point TIFFs with FLIR's tools, Exif and GPS kept."
    if frame.thermal_payload:
        return "For temperatures convert them to floating-point TIFFs with DJI's Thermal SDK, Exif and GPS kept."
    if frame.channels == 1 and frame.bits > 8:
        return "For temperatures scale them to degrees and save floating-point TIFFs, Exif and GPS kept."
    return f"They hold no raw temperatures. {_LOST}"


__all__ = ["known_as_thermal", "thermal_reading"]
