"""Parrot's files: the ANAFI's JPEG, and the Sequoia's four 16-bit TIFFs beside a JPEG of its own."""

from __future__ import annotations

import hashlib
import math
from typing import List, Tuple

import numpy as np

from .camera import Camera
from .claim import Claim, exif_tags, gps_tags, image_tags, jpeg_block, moment, packet, sequence
from .exif import Directory, jpeg_file, tiff_file

_TERMS = ((0, 0), (1, 0), (2, 0), (3, 0), (4, 0), (0, 1), (0, 2), (0, 3), (0, 4), (1, 1), (1, 2), (1, 3), (2, 1),
          (2, 2), (3, 1))  # fmt: skip


def _id(*parts: object) -> str:
    return hashlib.md5("/".join(map(str, parts)).encode()).hexdigest().upper()


def anafi(claim: Claim, pixels: np.ndarray) -> bytes:
    """ANAFI: big-endian JPEG, angles in elements of Parrot's own namespace, height above take-off as a rational."""
    r = claim.reported
    image = image_tags(claim)
    image[0x010E] = ("ascii", "")
    exif = exif_tags(claim, 2.4, (1, 1200), 100)
    exif[0xA217] = ("short", 2)
    element = "   <{0}>{1}</{0}>\n".format
    body = '  <rdf:Description rdf:about=""\n    xmlns:drone-parrot="http://www.parrot.com/drone-parrot/1.0/"\n'
    body += '    xmlns:Camera="http://pix4d.com/camera/1.0/">\n'
    for part, angle in (("Roll", r.roll_deg), ("Pitch", r.pitch_deg), ("Yaw", (r.yaw_deg + 180.0) % 360.0 - 180.0)):
        body += element(f"drone-parrot:Camera{part}Degree", f"{angle:.6f}")
    for part, angle in (("Roll", 0.4), ("Pitch", -3.1), ("Yaw", (r.yaw_deg + 180.0) % 360.0 - 180.0)):
        body += element(f"drone-parrot:Drone{part}Degree", f"{angle:.6f}")
    if r.relative_altitude_m is not None and claim.has("relative-altitude"):
        body += element("Camera:AboveGroundAltitude", f"{round(r.relative_altitude_m * 1000)}/1000")
    body += "  </rdf:Description>\n"
    xmp = packet(body) if claim.has("xmp") else ""
    return jpeg_file(pixels, claim.payload.jpeg_quality, jpeg_block(claim, pixels, image, exif), xmp)


def _attributes(claim: Claim, items: List[Tuple[str, str]], elements: str) -> str:
    body = '  <rdf:Description rdf:about=""\n    xmlns:Camera="http://pix4d.com/camera/1.0/"\n'
    body += '    xmlns:sensefly="http://ns.sensefly.com/sensefly/1.0/"\n'
    body += "\n".join(f'   Camera:{name}="{value}"' for name, value in items)
    return packet(body + ">\n" + elements + "  </rdf:Description>\n", pad=2048)


def _motion(claim: Claim) -> List[Tuple[str, str]]:
    """Attitude in Pix4D's axes, where a pitch of 0 looks straight down."""
    r = claim.reported
    return [
        ("Yaw", f"{(r.yaw_deg + 180.0) % 360.0 - 180.0:.4f}"),
        ("Pitch", f"{r.pitch_deg + 90.0:.4f}"),
        ("Roll", f"{r.roll_deg:.4f}"),
    ]


def _flight(claim: Claim) -> List[Tuple[str, str]]:
    return [
        ("GPSXYAccuracy", "2.301"),
        ("GPSZAccuracy", "3.419"),
        ("FlightUUID", _id("flight", claim.payload.id)),
    ]


def _vignetting(amount: float) -> np.ndarray:
    """Coefficients of the polynomial in x, y = 0..1 over the frame that levels it when divided by."""
    y, x = np.mgrid[0:1:25j, 0:1:33j]
    aspect = 0.75**2
    r2 = ((2 * x - 1) ** 2 + aspect * (2 * y - 1) ** 2) / (1 + aspect)
    falloff = 1.0 - amount * (0.55 * r2 + 0.45 * r2 * r2)
    columns = np.stack([(x**a * y**b).ravel() for a, b in _TERMS], axis=1)
    return np.asarray(np.linalg.lstsq(columns, falloff.ravel(), rcond=None)[0])


def _subsec(claim: Claim, exif: Directory) -> None:
    """To the microsecond; the camera's own clock counts from its start, in 1970."""
    if not claim.has("time"):
        return
    exif[0x9004] = ("ascii", "1970:01:01 00:04:37")
    for tag in (0x9290, 0x9291):
        exif[tag] = ("ascii", f"{moment(claim).microsecond:06d}")


def _principal_mm(claim: Claim, camera: Camera) -> str:
    pixel = claim.payload.sensor_width_mm / camera.width
    cx, cy = camera.principal_px
    return f"{(cx + 0.5) * pixel:.6f},{(cy + 0.5) * pixel:.6f}"


def sequoia(claim: Claim, pixels: np.ndarray) -> bytes:
    """One band of a Sequoia: 16-bit TIFF in one strip behind its directories, fisheye calibration in attributes."""
    r, band, camera = claim.reported, claim.band, claim.camera
    items = [("RigName", "Sequoia"), ("RigCameraIndex", str(band.rig_index)), *_motion(claim)]
    items += [("BandGain", "1.000000"), ("SensorTemperature", "46.818176"), ("LineReadoutTime", "23076")]
    if claim.has("focal"):
        affine = camera.focal_px * math.pi / 2.0
        p2, p3 = camera.fisheye or (0.0, 0.0)
        items += [
            ("PrincipalPoint", _principal_mm(claim, camera)),
            ("ModelType", "fisheye"),
            ("FisheyeAffineSymmetric", "1"),
            ("FisheyeAffineMatrix", f"{affine:.9f},0,0,{affine:.9f}"),
            ("FisheyePolynomial", f"0,1,{p2:.9g},{p3:.9g}"),
        ]
    items += _flight(claim)
    if r.capture_id:
        items.append(("CaptureUUID", _id("capture", r.capture_id)))
    items += [("CalibrationMeasurement", "1,0.00423728813559322,420"), ("CalibrationPicture", "0")]
    elements = sequence("Camera:BandName", (r.band_name,)) if r.band_name else ""
    if band.wavelength_nm:
        elements += sequence("Camera:CentralWavelength", (f"{band.wavelength_nm:.6f}",))
        elements += sequence("Camera:WavelengthFWHM", (f"{band.fwhm_nm:.6f}",))
    elements += sequence("Camera:BlackCurrent", ("74.000000",))
    names = ",".join(f"{a},{b}" for a, b in _TERMS)
    elements += sequence("Camera:VignettingPolynomial2DName", (names,))
    amount = claim.payload.vignette
    elements += sequence("Camera:VignettingPolynomial2D", (",".join(f"{v:.16g}" for v in _vignetting(amount)),))
    image = image_tags(claim)
    for tag in (0x011A, 0x011B, 0x0128):
        image.pop(tag)
    if claim.has("xmp"):
        image[0x02BC] = ("byte", _attributes(claim, items, elements).encode("utf-8"))
    if band.wavelength_nm:
        image[0x010E] = ("ascii", f"{band.wavelength_nm:.0f} nm")
    image[0xC619] = ("short", [2, 2])
    image[0xC61A] = ("long", [4800] * 4)
    if claim.has("serial") and r.serial:
        image[0xC62F] = ("ascii", r.serial)
    exif = exif_tags(claim, 2.2, (1, 867), 100)
    exif.pop(0xA404)
    _subsec(claim, exif)
    return tiff_file(pixels, image, exif, gps_tags(claim, (2, 2, 0, 0)), directories_first=True)


def sequoia_rgb(claim: Claim, pixels: np.ndarray) -> bytes:
    """The Sequoia's RGB camera: a JPEG with a perspective calibration and no capture id."""
    camera = claim.camera
    items = [("RigName", "Sequoia"), *_motion(claim), ("LineReadoutTime", "47500")]
    if claim.has("focal"):
        pixel = claim.payload.sensor_width_mm / camera.width
        k1, k2, p1, p2, k3 = camera.distortion
        items += [
            ("PrincipalPoint", _principal_mm(claim, camera)),
            ("ModelType", "perspective"),
            ("PerspectiveFocalLength", f"{camera.focal_px * pixel:.6f}"),
            ("PerspectiveDistortion", ",".join(f"{v:.9f}" for v in (k1, k2, k3, p1, p2))),
        ]
    xmp = _attributes(claim, items + _flight(claim), sequence("Camera:BandName", ("Red", "Green", "Blue")))
    exif = exif_tags(claim, 2.3, (1, 333), 125)
    exif.pop(0xA404)
    _subsec(claim, exif)
    image = image_tags(claim)
    if claim.has("serial") and claim.reported.serial:
        image[0xC62F] = ("ascii", claim.reported.serial)
    block = jpeg_block(claim, pixels, image, exif)
    return jpeg_file(pixels, claim.payload.jpeg_quality, block, xmp if claim.has("xmp") else "")
