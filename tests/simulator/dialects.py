"""How each maker's files say what they say: a table of functions, one per dialect.

A dialect takes what the header shall claim and the pixels, and gives the
bytes of the file. What may be missing or broken in it stands in ``claim``.
"""

from __future__ import annotations

import math
from typing import Callable, Dict, Tuple

import numpy as np

from . import flir, parrot
from .camera import Camera
from .claim import (
    BLACK_LEVEL,
    Claim,
    exif_tags,
    gps_tags,
    image_tags,
    jpeg_block,
    moment,
    packet,
    sequence,
)
from .exif import jpeg_file, tiff_file

__all__ = ["BLACK_LEVEL", "WRITERS", "Claim"]


def _dji_xmp(claim: Claim) -> str:
    """DJI's packet: one description, everything in attributes."""
    r, camera = claim.reported, claim.camera
    stamp = moment(claim).strftime("%Y-%m-%d %H:%M:%S")
    items = [("xmp:ModifyDate", stamp), ("xmp:CreateDate", stamp)] if claim.has("time") else []
    if claim.has("model"):
        items += [("tiff:Make", r.make), ("tiff:Model", r.model)]
    items.append(("dc:format", "image/jpg"))
    if claim.has("gps") and r.latitude is not None and r.longitude is not None:
        items += [("drone-dji:GpsStatus", "RTK" if r.rtk_flag else "GPS")]
        if r.altitude_m is not None:
            items.append(("drone-dji:AltitudeType", "RtkAlt" if r.rtk_flag else "GpsFusionAlt"))
        items += [("drone-dji:GpsLatitude", f"{r.latitude:+.9f}"), ("drone-dji:GpsLongitude", f"{r.longitude:+.9f}")]
        if r.altitude_m is not None:
            items.append(("drone-dji:AbsoluteAltitude", f"{r.altitude_m:+.3f}"))
    if r.relative_altitude_m is not None and claim.has("relative-altitude"):
        items.append(("drone-dji:RelativeAltitude", f"{r.relative_altitude_m:+.3f}"))
    items += [
        ("drone-dji:GimbalRollDegree", f"{r.roll_deg:+.2f}"),
        ("drone-dji:GimbalYawDegree", f"{(r.yaw_deg + 180.0) % 360.0 - 180.0:+.2f}"),
        ("drone-dji:GimbalPitchDegree", f"{r.pitch_deg:+.2f}"),
        ("drone-dji:FlightRollDegree", "+0.40"),
        ("drone-dji:FlightYawDegree", f"{(r.yaw_deg + 180.0) % 360.0 - 180.0:+.2f}"),
        ("drone-dji:FlightPitchDegree", "-3.10"),
    ]
    if r.speed_mps != (0.0, 0.0, 0.0):
        items += [(f"drone-dji:Flight{axis}Speed", f"{v:+.2f}") for axis, v in zip("XYZ", r.speed_mps)]
    if r.rtk_flag is not None and r.rtk_std_m is not None:
        items.append(("drone-dji:RtkFlag", str(r.rtk_flag)))
        items += [(f"drone-dji:RtkStd{n}", f"{v:.5f}") for n, v in zip(("Lon", "Lat", "Hgt"), r.rtk_std_m)]
    if r.capture_id:
        items.append(("drone-dji:CaptureUUID", r.capture_id))
    if claim.has("serial") and r.serial:
        items.append(("drone-dji:CameraSerialNumber", r.serial))
    if claim.has("focal") and claim.payload.calibration:
        cx, cy = camera.principal_px
        f = camera.focal_px
        if claim.payload.calibration == "calibrated":
            items += [
                ("drone-dji:CalibratedFocalLength", f"{f:.6f}"),
                ("drone-dji:CalibratedOpticalCenterX", f"{cx:.6f}"),
                ("drone-dji:CalibratedOpticalCenterY", f"{cy:.6f}"),
            ]
        else:
            # Focal and centre in pixels, the centre from the middle of the frame, then k1, k2, p1, p2, k3.
            numbers = (f, f, *camera.center_px, *camera.distortion)
            items += [("drone-dji:DewarpData", "2024-01-09;" + ",".join(f"{v:.9f}" for v in numbers))]
            items += [("drone-dji:DewarpFlag", "0")]
    spaces = (
        ("tiff", "http://ns.adobe.com/tiff/1.0/"),
        ("exif", "http://ns.adobe.com/exif/1.0/"),
        ("xmp", "http://ns.adobe.com/xap/1.0/"),
        ("dc", "http://purl.org/dc/elements/1.1/"),
        ("crs", "http://ns.adobe.com/camera-raw-settings/1.0/"),
        ("drone-dji", "http://www.dji.com/drone-dji/1.0/"),
    )
    body = '  <rdf:Description rdf:about="DJI Meta Data"\n'
    body += "".join(f'    xmlns:{k}="{v}"\n' for k, v in spaces)
    body += "".join(f'   {k}="{v}"\n' for k, v in items)
    return packet(body + '   crs:HasCrop="False">\n  </rdf:Description>\n')


def dji(claim: Claim, pixels: np.ndarray) -> bytes:
    """DJI RGB: JPEG, EXIF with 35 mm focal, XMP in attributes."""
    image = image_tags(claim)
    image[0x010E] = ("ascii", "default")
    image[0x9C9C] = ("byte", "0.9.142".encode("utf-16-le"))
    block = jpeg_block(claim, pixels, image, exif_tags(claim, 2.8, (1, 800), 100))
    xmp = _dji_xmp(claim) if claim.has("xmp") else ""
    return jpeg_file(pixels, claim.payload.jpeg_quality, block, xmp)


def dji_thermal(claim: Claim, pixels: np.ndarray) -> bytes:
    """DJI thermal: palette JPEG with the raw counts in APP3 and calibration in APP4 and APP5."""
    image = image_tags(claim)
    image[0x010E] = ("ascii", "WhiteHot")
    block = jpeg_block(claim, pixels, image, exif_tags(claim, 1.0, (1, 60), 100))
    segments = []
    if claim.has("raw") and claim.celsius is not None:
        counts = np.clip(claim.celsius * 64.0 + 17000.0, 0, 65535).astype("<u2").tobytes()
        table = np.linspace(0x4000, 0x1200, 11909).astype("<u2").tobytes()
        conditions = np.array([25.0, 5.0, 0.95, 0.5, 25.0], "<f4").tobytes().ljust(224, b"\0")
        segments = [(0xE3, counts), (0xE4, conditions), (0xE5, table)]
    xmp = _dji_xmp(claim) if claim.has("xmp") else ""
    return jpeg_file(pixels, claim.payload.jpeg_quality, block, xmp, segments)


def generic(claim: Claim, pixels: np.ndarray) -> bytes:
    """A compact camera under a wing: EXIF only, focal-plane tags, no XMP."""
    exif = exif_tags(claim, 4.0, (1, 1000), 100)
    exif[0xA217] = ("short", 2)
    block = jpeg_block(claim, pixels, image_tags(claim), exif)
    return jpeg_file(pixels, claim.payload.jpeg_quality, block)


def _vignetting(amount: float, camera: Camera) -> Tuple[float, ...]:
    """The polynomial in pixel radius whose product with the counts levels the frame (MicaSense: I / (1 + k.r^i))."""
    radius = math.hypot(camera.width / 2, camera.height / 2)
    r = np.linspace(0.0, 1.0, 60)
    falloff = 1.0 - amount * (0.55 * r**2 + 0.45 * r**4)
    powers = np.stack([r**i for i in range(1, 7)], axis=1)
    solved = np.linalg.lstsq(powers, falloff - 1.0, rcond=None)[0]
    return tuple(float(c / radius ** (i + 1)) for i, c in enumerate(solved))


def micasense(claim: Claim, pixels: np.ndarray) -> bytes:
    """MicaSense: one 16-bit TIFF per band, calibration and capture in XMP elements at the end of the file."""
    r, band, camera = claim.reported, claim.band, claim.camera
    pixel_mm = claim.payload.sensor_width_mm / claim.payload.bands[0].camera.width
    cx, cy = camera.principal_px
    k1, k2, p1, p2, k3 = camera.distortion
    description = '   <rdf:Description rdf:about="Pix4D Camera Information"\n     xmlns:{}="{}">\n'
    flat = "    <{0}>{1}</{0}>\n".format
    xmp = description.format("MicaSense", "http://micasense.com/MicaSense/1.0/")
    xmp += flat("MicaSense:BootTimestamp", int(r.time_s))
    xmp += sequence(
        "MicaSense:RadiometricCalibration", ("0.00024034012984746906", "8.4484068029562534e-08", "-5.56e-06")
    )
    xmp += flat("MicaSense:FlightId", "Xr" + claim.payload.serial.ljust(18, "q")[:18])
    if r.capture_id:
        xmp += flat("MicaSense:CaptureId", r.capture_id)
    xmp += flat("MicaSense:TriggerMethod", 4)
    xmp += sequence("MicaSense:DarkRowValue", (5032, 5035, 5015, 5033))
    xmp += "   </rdf:Description>\n" + description.format("Camera", "http://pix4d.com/1.0")
    if r.band_name:
        xmp += flat("Camera:BandName", r.band_name)
    if band.wavelength_nm:
        xmp += flat("Camera:CentralWavelength", f"{band.wavelength_nm:g}") + flat(
            "Camera:WavelengthFWHM", f"{band.fwhm_nm:g}"
        )
    xmp += sequence("Camera:VignettingCenter", (f"{cx:.6f}", f"{cy:.6f}"))
    xmp += sequence("Camera:VignettingPolynomial", (f"{v:.17g}" for v in _vignetting(claim.payload.vignette, camera)))
    xmp += flat("Camera:ModelType", "perspective")
    if claim.has("focal"):
        xmp += flat("Camera:PrincipalPoint", f"{cx * pixel_mm:.6f},{cy * pixel_mm:.6f}")
        if claim.payload.options.get("focal_in_pixels"):
            xmp += flat("Camera:PerspectiveFocalLength", f"{camera.focal_px:.9f}")
        else:
            xmp += flat("Camera:PerspectiveFocalLength", f"{camera.focal_px * pixel_mm:.6f}")
            xmp += flat("Camera:PerspectiveFocalLengthUnits", "mm")
        # Pix4D's order: three radial terms, then the tangential two.
        xmp += sequence("Camera:PerspectiveDistortion", (f"{v:.12g}" for v in (k1, k2, k3, p1, p2)))
    xmp += flat("Camera:BandSensitivity", "0.15843822484782541")
    xmp += flat("Camera:RigName", claim.payload.options.get("rig_name", "RedEdge-M"))
    xmp += flat("Camera:RigCameraIndex", band.rig_index)
    xmp += flat("Camera:RigRelatives", ", ".join(f"{v:.6f}" for v in band.tilt_deg))
    xmp += flat("Camera:Irradiance", "0.41153082251548767")
    xmp += "   </rdf:Description>\n" + description.format("DLS", "http://micasense.com/DLS/1.0/")
    xmp += flat("DLS:Serial", "DL06-1912233-SC") + flat("DLS:SpectralIrradiance", "0.41153082251548767")
    xmp += "   </rdf:Description>\n"
    image = image_tags(claim)
    if claim.has("xmp"):
        image[0x02BC] = ("byte", packet(xmp).encode("utf-8"))
    image[0xC619] = ("short", [2, 2])
    image[0xC61A] = ("rational", [(BLACK_LEVEL, 1)] * 4)
    exif = exif_tags(claim, 2.8, (1, 556), 100, subsec=True)
    for tag in (0xA002, 0xA003, 0xA404):
        exif.pop(tag)
    return tiff_file(pixels, image, exif, gps_tags(claim, (2, 2, 0, 0)))


WRITERS: Dict[str, Callable[[Claim, np.ndarray], bytes]] = {
    "dji": dji,
    "dji-thermal": dji_thermal,
    "generic": generic,
    "micasense": micasense,
    "parrot": parrot.anafi,
    "parrot-sequoia": parrot.sequoia,
    "parrot-sequoia-rgb": parrot.sequoia_rgb,
    "flir": flir.tlinear_tiff,
    "flir-jpeg": flir.radiometric_jpeg,
}
