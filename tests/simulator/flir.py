"""FLIR's files: the Vue Pro R's linear 16-bit TIFF, and a JPEG with its raw counts in FFF segments."""

from __future__ import annotations

import struct

import numpy as np

from .claim import Claim, exif_tags, gps_tags, image_tags, jpeg_block, packet, sequence
from .exif import Directory, jpeg_file, tiff_file

KELVIN_PER_COUNT = 0.04
_CHUNK = 64_000


def _xmp(claim: Claim, linear: bool) -> str:
    """Pix4D's band tags and the autopilot's place and attitude; here a pitch of -90 looks straight down."""
    r = claim.reported
    element = "    <{0}>{1}</{0}>\n".format
    body = '  <rdf:Description rdf:about=""\n    xmlns:Camera="http://pix4d.com/camera/1.0/"\n'
    body += '    xmlns:FLIR="http://ns.flir.com/xmp/1.0/">\n'
    body += sequence("Camera:BandName", ("LWIR",)) + sequence("Camera:CentralWavelength", (10000,))
    body += sequence("Camera:WavelengthFWHM", (4500,))
    body += element("Camera:TlinearGain", f"{KELVIN_PER_COUNT if linear else 0.0:.2f}")
    angles = (("Yaw", r.yaw_deg % 360.0), ("Pitch", r.pitch_deg), ("Roll", r.roll_deg))
    for name, degrees in angles:
        body += element(f"Camera:{name}", f"{round(degrees * 100)}/100")
    body += element("Camera:GPSXYAccuracy", "1.20") + element("Camera:GPSZAccuracy", "2.10")
    body += element("Camera:GyroRate", "0.00") + element("Camera:DetectorBitDepth", "16")
    body += element("Camera:IsNormalized", "1")
    if r.relative_altitude_m is not None and claim.has("relative-altitude"):
        body += element("FLIR:MAVRelativeAltitude", f"{round(r.relative_altitude_m * 1000)}/1000")
    return packet(body + "  </rdf:Description>\n")


def _exif(claim: Claim) -> Directory:
    exif = exif_tags(claim, 1.25, (1, 60), 100)
    for tag in (0x829A, 0x8827, 0xA404):
        exif.pop(tag)
    return exif


def tlinear_tiff(claim: Claim, pixels: np.ndarray) -> bytes:
    """Vue Pro R: temperature in steps of 0.04 K, 16 bits, in an uncompressed TIFF."""
    if claim.celsius is None:
        raise ValueError(f"{claim.name}: this dialect writes temperatures and was given none")
    counts = np.clip((claim.celsius + 273.15) / KELVIN_PER_COUNT, 0, 65535).astype(np.uint16)
    image = image_tags(claim)
    if claim.has("xmp"):
        image[0x02BC] = ("byte", _xmp(claim, True).encode("utf-8"))
    return tiff_file(counts, image, _exif(claim), gps_tags(claim), directories_first=True)


def _fff(counts: np.ndarray) -> bytes:
    """A file of FLIR's with one record: the raw counts behind a 32-byte head that says their order and size."""
    height, width = counts.shape
    raw = struct.pack("<HHH", 2, width, height).ljust(32, b"\0") + counts.astype("<u2").tobytes()
    start = 64 + 32
    head = b"FFF\0" + b"ATAU_RBFO".ljust(16, b"\0") + struct.pack(">LLLL", 100, 64, 1, 2)
    record = struct.pack(">HHLLLLLLL", 1, 2, 100, 1, start, len(raw), 0, 0, 0)
    return head.ljust(64, b"\0") + record[:32].ljust(32, b"\0") + raw


def radiometric_jpeg(claim: Claim, pixels: np.ndarray) -> bytes:
    """A palette picture with the raw counts in numbered FLIR segments."""
    block = jpeg_block(claim, pixels, image_tags(claim), _exif(claim))
    segments = []
    if claim.has("raw") and claim.celsius is not None:
        data = _fff(np.clip(claim.celsius * 64.0 + 12000.0, 0, 65535))
        parts = [data[i : i + _CHUNK] for i in range(0, len(data), _CHUNK)]
        segments = [(0xE1, b"FLIR\0\x01" + bytes([i, len(parts) - 1]) + part) for i, part in enumerate(parts)]
    xmp = _xmp(claim, False) if claim.has("xmp") else ""
    return jpeg_file(pixels, claim.payload.jpeg_quality, block, xmp, segments)
