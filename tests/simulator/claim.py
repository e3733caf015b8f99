"""What every dialect needs of a header: the claims to write, and the directories most makers share.

``Reported.drop`` takes groups away: ``focal`` (37386,
41989, focal-plane tags, calibration), ``focal35``, ``focal-plane``, ``gps``,
``xmp``, ``time``, ``serial``, ``model``, ``relative-altitude``, ``raw``.
``Reported.undefined`` writes 0/0 in groups of rationals: ``focal-plane``,
``zoom``, ``exposure``, ``focal``.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import Any, Iterable, Optional, Tuple

import numpy as np

from .camera import Camera
from .exif import Directory, small_jpeg, tiff_block, tiff_header
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

    def rational(self, group: str, value: Any) -> Tuple[str, Any]:
        return "rational", (0, 0) if group in self.reported.undefined else value


def moment(claim: Claim) -> datetime.datetime:
    return DAY + datetime.timedelta(seconds=claim.reported.time_s)


def _dms(degrees: float) -> list:
    value = abs(degrees)
    whole = int(value)
    minutes = int((value - whole) * 60)
    seconds = (value - whole - minutes / 60.0) * 3600.0
    return [(whole, 1), (minutes, 1), (round(seconds * 100000), 100000)]


def gps_tags(claim: Claim, version: Tuple[int, ...] = (2, 3, 0, 0)) -> Directory:
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


def image_tags(claim: Claim) -> Directory:
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
        tags[0x0132] = ("ascii", moment(claim).strftime("%Y:%m:%d %H:%M:%S"))
    return tags


def exif_tags(claim: Claim, f_number: float, exposure: Tuple[int, int], iso: int, subsec: bool = False) -> Directory:
    r, camera = claim.reported, claim.camera
    tags: Directory = {
        0x829A: claim.rational("exposure", exposure),
        0x829D: claim.rational("exposure", f_number),
        0x8822: ("short", 2),
        0x8827: ("short", iso),
        0x9000: ("undefined", b"0230"),
        0x9207: ("short", 2),
    }
    if claim.has("time"):
        stamp = moment(claim).strftime("%Y:%m:%d %H:%M:%S")
        tags[0x9003] = ("ascii", stamp)
        tags[0x9004] = ("ascii", stamp)
        if subsec:
            tags[0x9290] = tags[0x9291] = ("ascii", f"{moment(claim).microsecond:06d}")
    if claim.has("focal"):
        if r.focal_mm is not None:
            tags[0x920A] = claim.rational("focal", (round(r.focal_mm * 1000), 1000))
        if r.focal_35mm is not None and claim.has("focal35"):
            tags[0xA405] = ("short", round(r.focal_35mm))
        unit = claim.payload.focal_plane_unit
        if unit is not None and r.focal_plane_per_mm is not None and claim.has("focal-plane"):
            per_unit = r.focal_plane_per_mm * _MM_PER_UNIT[unit]
            tags[0xA20E] = tags[0xA20F] = claim.rational("focal-plane", (round(per_unit * 10000), 10000))
            tags[0xA210] = ("short", unit)
    tags[0xA002] = ("long", camera.width)
    tags[0xA003] = ("long", camera.height)
    tags[0xA404] = claim.rational("zoom", r.digital_zoom)
    if claim.has("serial") and r.serial:
        tags[0xA431] = ("ascii", r.serial)
    if r.lens:
        tags[0xA434] = ("ascii", r.lens)
    return tags


def packet(body: str, pad: int = 800) -> str:
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>\n<x:xmpmeta xmlns:x="adobe:ns:meta/">\n'
        ' <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">\n'
        f"{body} </rdf:RDF>\n</x:xmpmeta>\n{' ' * pad}\n" + '<?xpacket end="w"?>'
    )


def jpeg_block(claim: Claim, pixels: np.ndarray, image: Directory, exif: Directory) -> bytes:
    """The Exif block of a JPEG, with the tags that the standard asks of JPEGs and a thumbnail."""
    image[0x0213] = ("short", 1)
    exif[0x9101] = ("undefined", b"\x01\x02\x03\x00")
    exif[0xA000] = ("undefined", b"0100")
    exif[0xA001] = ("short", 1)
    return tiff_header(8) + tiff_block(image, exif, gps_tags(claim), thumbnail=small_jpeg(pixels))


def sequence(name: str, values: Iterable[object]) -> str:
    items = "".join(f"      <rdf:li>{v}</rdf:li>\n" for v in values)
    return f"    <{name}>\n     <rdf:Seq>\n{items}     </rdf:Seq>\n    </{name}>\n"
