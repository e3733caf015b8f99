"""The payloads that stories fly: real models at a fraction of their pixels, and invented ones.

A frame at a quarter of a model's pixels keeps sensor width, focal length and
35 mm focal, so every tag stays true of what was rendered.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Tuple

from .camera import Camera
from .survey import MULTISPECTRAL, RGB, THERMAL, Band, Payload


def _rgb(
    name: str, make: str, model: str, size: Tuple[int, int], sensor_mm: float, focal_mm: float, **more: Any
) -> Payload:
    center = more.pop("center_px", (0.0, 0.0))
    distortion = more.pop("distortion", (0.0, 0.0, 0.0, 0.0, 0.0))
    camera = Camera(*size, focal_mm / sensor_mm, center, distortion)
    values = {"dialect": "dji", "spectrum": RGB, "folder": name, **more}
    return Payload(
        id=name,
        make=make,
        model=model,
        bands=(Band("RGB", camera),),
        sensor_width_mm=sensor_mm,
        focal_mm=focal_mm,
        **values,
    )


def phantom4pro(name: str = "p4p", **more: Any) -> Payload:
    """DJI FC6310 at a quarter: 13.2 mm wide, 8.8 mm, corrected in camera to a small rest."""
    values = {
        "focal_35mm": 24,
        "serial": "0K9CE5R0A50012",
        "corrected_in_camera": True,
        "center_px": (2.6, -1.9),
        "software": "v01.08.1719",
        "vignette": 0.2,
        **more,
    }
    return _rgb(name, "DJI", "FC6310", (1368, 912), 13.2, 8.8, **values)


def phantom4(name: str = "p4", **more: Any) -> Payload:
    """DJI FC330 at a third: 6.17 mm wide, 3.61 mm, 20 mm equivalent, corrected in camera."""
    values = {
        "focal_35mm": 20,
        "corrected_in_camera": True,
        "center_px": (-1.4, 1.1),
        "gain": 0.86,
        "offset_dn": 4.0,
        "software": "v01.25.0820",
        **more,
    }
    return _rgb(name, "DJI", "FC330", (1332, 1000), 6.17, 3.61, **values)


def kestrel(name: str = "kestrel", **more: Any) -> Payload:
    """An invented DJI-like camera with a strongly distorting lens and no sheet anywhere."""
    values = {
        "focal_35mm": 26,
        "serial": "KX0017",
        "distortion": (-0.085, 0.061, 0.0006, -0.0004, -0.012),
        "center_px": (5.5, -4.0),
        "software": "2.1.7",
        **more,
    }
    return _rgb(name, "Aerovista", "Kestrel K1", (1280, 960), 8.8, 6.4, **values)


def compact(name: str = "compact", **more: Any) -> Payload:
    """A Canon compact at a third: focal-plane tags in inches, GPS, no XMP."""
    values = {
        "dialect": "generic",
        "focal_plane_unit": 2,
        "name_pattern": "IMG_{number:04d}.JPG",
        "distortion": (-0.021, 0.014, 0.0, 0.0, 0.0),
        "center_px": (-3.0, 2.0),
        "software": "",
        **more,
    }
    return _rgb(name, "Canon", "Canon PowerShot S110", (1332, 1000), 7.44, 5.2, **values)


def micasense(name: str = "rededge", **more: Any) -> Payload:
    """MicaSense RedEdge-M at its native 1280x960: 4.8 mm wide, 5.4 mm, five lenses."""
    table = (
        ("Blue", "ms-blue", 475, 20, (0.0, 0.0), (-0.35, 0.22, 0.11), (2.1, -3.2), 1.004),
        ("Green", "ms-green", 560, 20, (0.03, 0.0), (0.0, 0.0, 0.0), (-4.6, 1.8), 1.000),
        ("Red", "ms-red", 668, 10, (0.06, 0.0), (0.28, -0.31, 0.05), (6.3, 4.1), 0.997),
        ("NIR", "ms-nir", 840, 40, (0.06, 0.028), (0.17, 0.40, -0.14), (-1.2, -6.0), 1.009),
        ("Red edge", "ms-rededge", 717, 10, (0.0, 0.028), (-0.21, -0.18, 0.09), (3.7, 2.5), 1.001),
    )
    bands = tuple(
        Band(
            label,
            Camera(1280, 960, 5.4 * stretch / 4.8, center, (-0.098 - 0.002 * i, 0.13 - 0.003 * i, 1e-4, -2e-4, 0.012)),
            (channel,),
            float(nm),
            float(wide),
            (*lever, 0.0),
            tilt,
            i,
        )
        for i, (label, channel, nm, wide, lever, tilt, center, stretch) in enumerate(table)
    )
    values = {
        "dialect": "micasense",
        "spectrum": MULTISPECTRAL,
        "focal_plane_unit": 4,
        "serial": "RM01-1822061-SC",
        "folder": name,
        "name_pattern": "IMG_{number:04d}_{band}.tif",
        "software": "v5.1.7",
        "noise_dn": 90.0,
        "blur_px": 0.3,
        "vignette": 0.3,
        "gain": 0.85,
        **more,
    }
    return Payload(
        id=name, make="MicaSense", model="RedEdge-M", bands=bands, sensor_width_mm=4.8, focal_mm=5.4, **values
    )


def thermal(name: str = "thermal", **more: Any) -> Payload:
    """DJI Mavic 2 Enterprise Advanced, thermal: 640x512 at 12 um, 9 mm, and no focal tag of any kind."""
    camera = Camera(640, 512, 9.0 / 7.68, (1.5, -0.8), (-0.012, 0.004, 0.0, 0.0, 0.0))
    values = {
        "dialect": "dji-thermal",
        "spectrum": THERMAL,
        "serial": "1TCLHAA03B",
        "folder": name,
        "name_pattern": "DJI_{number:04d}_R.JPG",
        "software": "10.00.01.10",
        "noise_dn": 0.06,
        "blur_px": 0.6,
        "vignette": 0.0,
        "jpeg_quality": 96,
        "options": {"palette": "white-hot", "range_c": (14.0, 54.0), "no_focal": True},
        **more,
    }
    return Payload(
        id=name,
        make="DJI",
        model="MAVIC2-ENTERPRISE-ADVANCED",
        bands=(Band("LWIR", camera, ("thermal",)),),
        sensor_width_mm=7.68,
        focal_mm=9.0,
        **values,
    )


def sequoia(name: str = "sequoia", **more: Any) -> Payload:
    """Parrot Sequoia, the four narrow bands: 1280x960 at 3.75 um behind fisheye lenses of 3.98 mm."""
    table = (
        ("Green", "ms-green", 550, "GRE", (0.0, 0.0), (0.0, 0.0, 0.0), (23.0, -11.5), 1.000),
        ("Red", "ms-red", 660, "RED", (0.013, 0.0), (0.21, -0.16, 0.07), (-6.5, 8.0), 1.003),
        ("Red edge", "ms-rededge", 735, "REG", (0.0, 0.013), (-0.14, 0.24, -0.05), (9.0, 4.5), 0.998),
        ("NIR", "ms-nir", 790, "NIR", (0.013, 0.013), (0.09, 0.11, 0.13), (-3.0, -14.0), 1.006),
    )
    bands = tuple(
        Band(
            label,
            Camera(1280, 960, 4.003 * stretch / 4.8, center, fisheye=(0.0059 - 0.0007 * i, -0.137 + 0.002 * i)),
            (channel,),
            float(nm),
            10.0 if nm == 735 else 40.0,
            (*lever, 0.0),
            tilt,
            i,
            suffix,
            0.002 * i,
        )
        for i, (label, channel, nm, suffix, lever, tilt, center, stretch) in enumerate(table)
    )
    values = {
        "dialect": "parrot-sequoia",
        "spectrum": MULTISPECTRAL,
        "focal_35mm": 30,
        "focal_plane_unit": 4,
        "serial": "PI040378AA6C000032",
        "folder": name,
        "name_pattern": "IMG_240618_100000_{number:04d}_{name}.TIF",
        "software": "v1.2.0",
        "noise_dn": 90.0,
        "vignette": 0.35,
        "gain": 0.85,
        **more,
    }
    return Payload(id=name, make="Parrot", model="Sequoia", bands=bands, sensor_width_mm=4.8, focal_mm=3.98, **values)


def sequoia_rgb(name: str = "sequoia-rgb", **more: Any) -> Payload:
    """The Sequoia's RGB camera at a quarter: 4608x3456 at 1.34 um, 4.88 mm, rolling shutter, a little late."""
    values = {
        "dialect": "parrot-sequoia-rgb",
        "focal_35mm": 28,
        "focal_plane_unit": 4,
        "serial": "PI040378AA6C000032",
        "folder": "sequoia",
        "name_pattern": "IMG_240618_100000_{number:04d}_RGB.JPG",
        "software": "v1.2.0",
        "distortion": (0.178, -0.4746, -0.0009, -0.00065, 0.402),
        "center_px": (-9.0, -6.5),
        **more,
    }
    payload = _rgb(name, "Parrot", "Sequoia", (1152, 864), 6.175, 4.88, **values)
    band = replace(payload.bands[0], lever_m=(0.02, 0.03, 0.0), delay_s=0.058, readout_s=0.047, suffix="RGB")
    return replace(payload, bands=(band,))


def anafi(name: str = "anafi", **more: Any) -> Payload:
    """Parrot ANAFI at a quarter: 5344x4016 at 1.12 um, 4 mm, rolling shutter of a thirtieth of a second."""
    values = {
        "dialect": "parrot",
        "focal_35mm": 23,
        "serial": "PI040416BA8H012345",
        "name_pattern": "P{number:03d}0{number:03d}.JPG",
        "distortion": (-0.015, 0.009, 0.0, 0.0, 0.0),
        "center_px": (3.0, -2.5),
        "software": "Anafi-1.8.2",
        **more,
    }
    payload = _rgb(name, "Parrot", "Anafi", (1336, 1004), 5.985, 4.0, **values)
    return replace(payload, bands=(replace(payload.bands[0], readout_s=0.033),))


def vue_pro(name: str = "vue", **more: Any) -> Payload:
    """FLIR Vue Pro R 640 with 13 mm: linear 16-bit TIFFs, 17 um pixels."""
    camera = Camera(640, 512, 13.0 / 10.88, (2.0, -1.2), (-0.02, 0.006, 0.0, 0.0, 0.0))
    values = {
        "dialect": "flir",
        "spectrum": THERMAL,
        "folder": name,
        "name_pattern": "20240618_100000_{number:03d}.TIFF",
        "serial": "0281773",
        "software": "02.04.00",
        "noise_dn": 0.06,
        "blur_px": 0.6,
        "vignette": 0.0,
        "options": {"palette": "white-hot", "range_c": (14.0, 54.0)},
        **more,
    }
    return Payload(
        id=name,
        make="FLIR",
        model="Vue Pro R 640 13mm",
        bands=(Band("LWIR", camera, ("thermal",)),),
        sensor_width_mm=10.88,
        focal_mm=13.0,
        **values,
    )


def with_band_size(payload: Payload, factor: float) -> Payload:
    """The same payload with smaller frames."""
    return replace(payload, bands=tuple(replace(b, camera=b.camera.scaled(factor)) for b in payload.bands))
