"""How each maker's files say what they say: a table of functions, one per dialect.

A dialect takes what the header shall claim and the pixels, and gives the
bytes of the file. ``Reported.drop`` takes groups away: ``focal`` (37386,
41989, focal-plane tags, calibration), ``focal35``, ``focal-plane``, ``gps``,
``xmp``, ``time``, ``serial``, ``model``, ``relative-altitude``, ``raw``.
"""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass
from typing import Callable, Dict, Iterable, Optional, Tuple

import numpy as np

from .camera import Camera
from .exif import Directory, jpeg_file, small_jpeg, tiff_block, tiff_file, tiff_header
from .survey import Band, Payload, Reported

DAY = datetime.datetime(2024, 6, 18)
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
BLACK_LEVEL = 4800


@dataclass(frozen=True)
class Claim:
    """All that a dialect needs for one file."""

    payload: Payload
    band: Band
    camera: Camera
    reported: Reported
    name: str
    celsius: Optional[np.ndarray] = None

    def has(self, group: str) -> bool:
        return group not in self.reported.drop


def _moment(claim: Claim) -> datetime.datetime:
    return DAY + datetime.timedelta(seconds=claim.reported.time_s)


def _dms(degrees: float) -> list:
    value = abs(degrees)
    whole = int(value)
    minutes = int((value - whole) * 60)
    seconds = (value - whole - minutes / 60.0) * 3600.0
    return [(whole, 1), (minutes, 1), (round(seconds * 100000), 100000)]


def _gps(claim: Claim, version: Tuple[int, ...] = (2, 3, 0, 0)) -> Directory:
    r = claim.reported
    if not claim.has("gps") or r.latitude is None or r.longitude is None:
        return {}
    tags: Directory = {
        0: ("byte", version),
        1: ("ascii", "N" if r.latitude >= 0 else "S"),
        2: ("rational", _dms(r.latitude)),
        3: ("ascii", "E" if r.longitude >= 0 else "W"),
        4: ("rational", _dms(r.longitude)),
    }
    if r.altitude_m is not None:
        tags[5] = ("byte", 0 if r.altitude_m >= 0 else 1)
        tags[6] = ("rational", (round(abs(r.altitude_m) * 1000), 1000))
    return tags


def _image(claim: Claim) -> Directory:
    r = claim.reported
    tags: Directory = {
        0x0112: ("short", 1),
        0x011A: ("rational", (72, 1)),
        0x011B: ("rational", (72, 1)),
        0x0128: ("short", 2),
    }
    if r.software:
        tags[0x0131] = ("ascii", r.software)
    if claim.has("model"):
        tags[0x010F] = ("ascii", r.make)
        tags[0x0110] = ("ascii", r.model)
    if claim.has("time"):
        tags[0x0132] = ("ascii", _moment(claim).strftime("%Y:%m:%d %H:%M:%S"))
    return tags


def _exif(claim: Claim, f_number: float, exposure: Tuple[int, int], iso: int, subsec: bool = False) -> Directory:
    r, camera = claim.reported, claim.camera
    tags: Directory = {
        0x829A: ("rational", exposure),
        0x829D: ("rational", f_number),
        0x8822: ("short", 2),
        0x8827: ("short", iso),
        0x9000: ("undefined", b"0230"),
        0x9207: ("short", 2),
    }
    if claim.has("time"):
        stamp = _moment(claim).strftime("%Y:%m:%d %H:%M:%S")
        tags[0x9003] = ("ascii", stamp)
        tags[0x9004] = ("ascii", stamp)
        if subsec:
            tags[0x9290] = tags[0x9291] = ("ascii", f"{_moment(claim).microsecond:06d}")
    if claim.has("focal"):
        if r.focal_mm is not None:
            tags[0x920A] = ("rational", (round(r.focal_mm * 1000), 1000))
        if r.focal_35mm is not None and claim.has("focal35"):
            tags[0xA405] = ("short", round(r.focal_35mm))
        unit = claim.payload.focal_plane_unit
        if unit is not None and r.focal_plane_per_mm is not None and claim.has("focal-plane"):
            per_unit = r.focal_plane_per_mm * _MM_PER_UNIT[unit]
            tags[0xA20E] = tags[0xA20F] = ("rational", (round(per_unit * 10000), 10000))
            tags[0xA210] = ("short", unit)
    tags[0xA002] = ("long", camera.width)
    tags[0xA003] = ("long", camera.height)
    tags[0xA404] = ("rational", r.digital_zoom)
    if claim.has("serial") and r.serial:
        tags[0xA431] = ("ascii", r.serial)
    if r.lens:
        tags[0xA434] = ("ascii", r.lens)
    return tags


def _packet(body: str, pad: int = 800) -> str:
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>\n<x:xmpmeta xmlns:x="adobe:ns:meta/">\n'
        ' <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">\n'
        f"{body} </rdf:RDF>\n</x:xmpmeta>\n{' ' * pad}\n" + '<?xpacket end="w"?>'
    )


def _jpeg_block(claim: Claim, pixels: np.ndarray, image: Directory, exif: Directory) -> bytes:
    """The Exif block of a JPEG, with the tags that the standard asks of JPEGs and a thumbnail."""
    image[0x0213] = ("short", 1)
    exif[0x9101] = ("undefined", b"\x01\x02\x03\x00")
    exif[0xA000] = ("undefined", b"0100")
    exif[0xA001] = ("short", 1)
    return tiff_header(8) + tiff_block(image, exif, _gps(claim), thumbnail=small_jpeg(pixels))


def _dji_xmp(claim: Claim) -> str:
    """DJI's packet: one description, everything in attributes."""
    r, camera = claim.reported, claim.camera
    stamp = _moment(claim).strftime("%Y-%m-%d %H:%M:%S")
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
    return _packet(body + '   crs:HasCrop="False">\n  </rdf:Description>\n')


def dji(claim: Claim, pixels: np.ndarray) -> bytes:
    """DJI RGB: JPEG, EXIF with 35 mm focal, XMP in attributes."""
    image = _image(claim)
    image[0x010E] = ("ascii", "default")
    image[0x9C9C] = ("byte", "0.9.142".encode("utf-16-le"))
    block = _jpeg_block(claim, pixels, image, _exif(claim, 2.8, (1, 800), 100))
    xmp = _dji_xmp(claim) if claim.has("xmp") else ""
    return jpeg_file(pixels, claim.payload.jpeg_quality, block, xmp)


def dji_thermal(claim: Claim, pixels: np.ndarray) -> bytes:
    """DJI thermal: palette JPEG with the raw counts in APP3 and calibration in APP4 and APP5."""
    image = _image(claim)
    image[0x010E] = ("ascii", "WhiteHot")
    block = _jpeg_block(claim, pixels, image, _exif(claim, 1.0, (1, 60), 100))
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
    exif = _exif(claim, 4.0, (1, 1000), 100)
    exif[0xA217] = ("short", 2)
    block = _jpeg_block(claim, pixels, _image(claim), exif)
    return jpeg_file(pixels, claim.payload.jpeg_quality, block)


def _sequence(name: str, values: Iterable[object]) -> str:
    items = "".join(f"      <rdf:li>{v}</rdf:li>\n" for v in values)
    return f"    <{name}>\n     <rdf:Seq>\n{items}     </rdf:Seq>\n    </{name}>\n"


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
    xmp += _sequence(
        "MicaSense:RadiometricCalibration", ("0.00024034012984746906", "8.4484068029562534e-08", "-5.56e-06")
    )
    xmp += flat("MicaSense:FlightId", "Xr" + claim.payload.serial.ljust(18, "q")[:18])
    if r.capture_id:
        xmp += flat("MicaSense:CaptureId", r.capture_id)
    xmp += flat("MicaSense:TriggerMethod", 4)
    xmp += _sequence("MicaSense:DarkRowValue", (5032, 5035, 5015, 5033))
    xmp += "   </rdf:Description>\n" + description.format("Camera", "http://pix4d.com/1.0")
    if r.band_name:
        xmp += flat("Camera:BandName", r.band_name)
    if band.wavelength_nm:
        xmp += flat("Camera:CentralWavelength", f"{band.wavelength_nm:g}") + flat(
            "Camera:WavelengthFWHM", f"{band.fwhm_nm:g}"
        )
    xmp += _sequence("Camera:VignettingCenter", (f"{cx:.6f}", f"{cy:.6f}"))
    xmp += _sequence("Camera:VignettingPolynomial", (f"{v:.17g}" for v in _vignetting(claim.payload.vignette, camera)))
    xmp += flat("Camera:ModelType", "perspective")
    if claim.has("focal"):
        xmp += flat("Camera:PrincipalPoint", f"{cx * pixel_mm:.6f},{cy * pixel_mm:.6f}")
        if claim.payload.options.get("focal_in_pixels"):
            xmp += flat("Camera:PerspectiveFocalLength", f"{camera.focal_px:.9f}")
        else:
            xmp += flat("Camera:PerspectiveFocalLength", f"{camera.focal_px * pixel_mm:.6f}")
            xmp += flat("Camera:PerspectiveFocalLengthUnits", "mm")
        # Pix4D's order: three radial terms, then the tangential two.
        xmp += _sequence("Camera:PerspectiveDistortion", (f"{v:.12g}" for v in (k1, k2, k3, p1, p2)))
    xmp += flat("Camera:BandSensitivity", "0.15843822484782541")
    xmp += flat("Camera:RigName", claim.payload.options.get("rig_name", "RedEdge-M"))
    xmp += flat("Camera:RigCameraIndex", band.rig_index)
    xmp += flat("Camera:RigRelatives", ", ".join(f"{v:.6f}" for v in band.tilt_deg))
    xmp += flat("Camera:Irradiance", "0.41153082251548767")
    xmp += "   </rdf:Description>\n" + description.format("DLS", "http://micasense.com/DLS/1.0/")
    xmp += flat("DLS:Serial", "DL06-1912233-SC") + flat("DLS:SpectralIrradiance", "0.41153082251548767")
    xmp += "   </rdf:Description>\n"
    image = _image(claim)
    if claim.has("xmp"):
        image[0x02BC] = ("byte", _packet(xmp).encode("utf-8"))
    image[0xC619] = ("short", [2, 2])
    image[0xC61A] = ("rational", [(BLACK_LEVEL, 1)] * 4)
    exif = _exif(claim, 2.8, (1, 556), 100, subsec=True)
    for tag in (0xA002, 0xA003, 0xA404):
        exif.pop(tag)
    return tiff_file(pixels, image, exif, _gps(claim, (2, 2, 0, 0)))


WRITERS: Dict[str, Callable[[Claim, np.ndarray], bytes]] = {
    "dji": dji,
    "dji-thermal": dji_thermal,
    "generic": generic,
    "micasense": micasense,
}
