"""Small images with real headers, written by Pillow and piexif, and the referees that read them back."""

from __future__ import annotations

import io
import shutil
import subprocess
from pathlib import Path
from typing import Any, Dict, List, Optional

import exifread
import numpy as np
import piexif
import pytest
from PIL import Image

REAL = Path(__file__).resolve().parents[3].parent / "shared/data/real_frames"
XMP = (
    b'<?xpacket begin="\xef\xbb\xbf" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
    b'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="DJI Meta Data" '
    b'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:RelativeAltitude="+80.10"\n'
    b' drone-dji:CaptureUUID="abc"/></rdf:RDF></x:xmpmeta>    <?xpacket end="w"?>'
)
MAKER_NOTE = b"NOTE\x00" + bytes(range(200))


def real(name: str) -> Path:
    path = REAL / name
    if not path.exists():
        pytest.skip(f"real frame {name} is not here")
    return path


def texture(width: int, height: int, channels: int = 3, seed: int = 1) -> np.ndarray:
    """Ground-like: smooth noise of several sizes, full range, uint8."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width, channels), np.float64)
    for cells, weight in ((8, 1.0), (40, 0.6), (200, 0.4)):
        coarse = rng.normal(size=(cells, cells, channels))
        for c in range(channels):
            layer = Image.fromarray(coarse[:, :, c].astype(np.float32)).resize(
                (width, height), Image.Resampling.BICUBIC
            )
            total[:, :, c] += weight * np.asarray(layer)
    low, high = np.percentile(total, (0.5, 99.5))
    return np.clip((total - low) / (high - low) * 255, 0, 255).astype(np.uint8)


def exif_block(width: int, height: int, *, thumbnail: bool = True, **changes: Any) -> bytes:
    """A camera's Exif with focal plane, maker note, GPS, Interop and a thumbnail."""
    exif: Dict[int, Any] = {
        piexif.ExifIFD.FocalLength: (8800, 1000),
        piexif.ExifIFD.FocalLengthIn35mmFilm: 24,
        piexif.ExifIFD.FocalPlaneXResolution: (width * 1000, 13200),
        piexif.ExifIFD.FocalPlaneYResolution: (height * 1000, 8800),
        piexif.ExifIFD.FocalPlaneResolutionUnit: 4,
        piexif.ExifIFD.PixelXDimension: width,
        piexif.ExifIFD.PixelYDimension: height,
        piexif.ExifIFD.MakerNote: MAKER_NOTE,
        piexif.ExifIFD.DateTimeOriginal: b"2024:05:01 10:00:00",
        piexif.ExifIFD.BodySerialNumber: b"SN123",
    }
    for name, value in changes.items():
        tag = getattr(piexif.ExifIFD, name)
        if value is None:
            del exif[tag]
        else:
            exif[tag] = value
    block: Dict[str, Any] = {
        "0th": {piexif.ImageIFD.Make: b"ACME", piexif.ImageIFD.Model: b"Cam 1", piexif.ImageIFD.Orientation: 1},
        "Exif": exif,
        "GPS": {
            piexif.GPSIFD.GPSLatitudeRef: b"N",
            piexif.GPSIFD.GPSLatitude: ((46, 1), (30, 1), (12345, 1000)),
            piexif.GPSIFD.GPSLongitudeRef: b"E",
            piexif.GPSIFD.GPSLongitude: ((7, 1), (15, 1), (54321, 1000)),
        },
        "Interop": {piexif.InteropIFD.InteroperabilityIndex: b"R98"},
    }
    if thumbnail:
        small = io.BytesIO()
        Image.fromarray(texture(64, 48)).save(small, "JPEG")
        block["1st"] = {piexif.ImageIFD.Compression: 6}
        block["thumbnail"] = small.getvalue()
    return bytes(piexif.dump(block))


def jpeg_bytes(
    width: int = 320,
    height: int = 240,
    *,
    exif: Optional[bytes] = None,
    subsampling: int = 1,
    grey: bool = False,
    **more: Any,
) -> bytes:
    pixels = texture(width, height)
    image = Image.fromarray(pixels[:, :, 0] if grey else pixels)
    out = io.BytesIO()
    options: Dict[str, Any] = {} if grey else {"subsampling": subsampling}
    image.save(out, "JPEG", quality=95, exif=exif_block(width, height) if exif is None else exif, **options, **more)
    data = out.getvalue()
    at = data.index(b"Exif\x00\x00") - 4
    at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    body = b"http://ns.adobe.com/xap/1.0/\x00" + XMP
    return data[:at] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + data[at:]


def odm_focal_ratio(data: bytes) -> float:
    """The focal ratio that the reconstruction software derives from tags alone.

    The 35 mm equivalent over 36 where it is above zero; else focal length over
    sensor width, the width being current pixels over focal-plane resolution.
    """
    tags = exifread.process_file(io.BytesIO(data), details=False)

    def number(name: str) -> float:
        value = tags[name].values[0]
        return float(value.num) / float(value.den) if hasattr(value, "num") else float(value)

    if "EXIF FocalLengthIn35mmFilm" in tags and number("EXIF FocalLengthIn35mmFilm") > 0:
        return number("EXIF FocalLengthIn35mmFilm") / 36.0
    unit_mm = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}[int(number("EXIF FocalPlaneResolutionUnit"))]
    with Image.open(io.BytesIO(data)) as image:
        width_mm = image.width / number("EXIF FocalPlaneXResolution") * unit_mm
    return number("EXIF FocalLength") / width_mm


def exiftool(path: Path, *options: str) -> str:
    if shutil.which("exiftool") is None:
        pytest.skip("exiftool is not installed")
    done = subprocess.run(["exiftool", *options, str(path)], capture_output=True, check=False)
    return done.stdout.decode("utf-8", "replace")


def psnr(a: np.ndarray, b: np.ndarray, peak: float = 255.0) -> float:
    error = float(np.mean((np.asarray(a, np.float64) - np.asarray(b, np.float64)) ** 2))
    return 10.0 * float(np.log10(peak * peak / max(error, 1e-12)))


def tag_lines(path: Path) -> List[str]:
    """exiftool's view of everything that must survive, as lines."""
    return exiftool(
        path, "-a", "-G1", "-s", "-n", "-GPS:all", "-XMP:all", "-MakerNotes:all", "-IFD0:Make", "-IFD0:Model"
    ).splitlines()
