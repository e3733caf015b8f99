"""Which spectrum and band a frame shows, and how that is known.

Evidence is taken in the order in which it can be trusted: the band that the
file names, DJI's name of the camera, raw thermal data, the calibration sheet's
cameras of that name and size, the pixel format, and at the very last the file
name. A camera converted to near infrared keeps clean RGB metadata and cannot
be told from it: it stays ``rgb``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Optional, Tuple

from .frame import Frame
from .profile import MULTISPECTRAL, RGB, THERMAL
from .sensors import Sheet, SheetRow, plain_name
from .thresholds import DEFAULTS, Thresholds

LWIR = "lwir"
MONO = "mono"
STACK = "stack"

_BANDS = {
    "blue": "blue",
    "b": "blue",
    "blu": "blue",
    "coastalblue": "coastalblue",
    "coastal": "coastalblue",
    "green": "green",
    "g": "green",
    "gre": "green",
    "red": "red",
    "r": "red",
    "yellow": "yellow",
    "rededge": "rededge",
    "edge": "rededge",
    "re": "rededge",
    "reg": "rededge",
    "nir": "nir",
    "n": "nir",
    "nearir": "nir",
    "nearinfrared": "nir",
    "infrared": "nir",
    "pan": "pan",
    "panchro": "pan",
    "panchromatic": "pan",
    "lwir": LWIR,
    "longwaveinfrared": LWIR,
    "thermal": LWIR,
    "thermalir": LWIR,
    "tir": LWIR,
}
_RGB_NAMES = {"rgb", "redgreenblue", "visible", "color", "colour", "truecolor"}

# Centres that an unnumbered band name stands for; a numbered name within the
# tolerance of them is that plain band (MicaSense's ten-band numbering).
_STANDARD_NM = {"blue": 475.0, "green": 560.0, "red": 668.0, "rededge": 717.0, "nir": 842.0}

# Where the visible and near-infrared bands of mapping cameras lie, in nm (upper ends).
_RANGES_NM = (
    (455.0, "coastalblue"),
    (505.0, "blue"),
    (600.0, "green"),
    (695.0, "red"),
    (760.0, "rededge"),
    (1100.0, "nir"),
)
_LWIR_NM = (7000.0, 15000.0)

# Pixel counts of the microbolometers that fly (and of their 2x modes).
_BOLOMETER_SIZES = frozenset(
    {(80, 60), (160, 120), (160, 128), (206, 156), (320, 240), (320, 256), (336, 256), (382, 288), (384, 288)}
    | {(464, 348), (640, 480), (640, 512), (768, 576), (1024, 768), (1280, 1024)}
)

_THERMAL_SOURCES = ("infrared", "thermal", "ircamera")
_RGB_SOURCES = ("wide", "zoom", "visible", "rgb", "tele", "nightvision", "mediumtele", "default")
_MS_SOURCES = ("ms", "multispectral", "nir", "ndvi")
_MS_SOURCE = re.compile(r"^ms(g|r|re|nir|b)(?:camera)?$")

_BAND_SUFFIX = re.compile(r"[_-](?:MS[_-])?(BLUE|BLU|GREEN|GRE|RED|REDEDGE|REG|RE|NIR|B|G|R|N|PAN)$", re.IGNORECASE)
_THERMAL_NAME = re.compile(r"(?:[_-](?:T|R|IR|THRM|THERMAL|TIR|LWIR)$)|thermal|lwir", re.IGNORECASE)
_RIG_SUFFIX = re.compile(r"_(\d{1,2})$")


@dataclass(frozen=True)
class Spectrum:
    """``spectrum`` is rgb, multispectral or thermal; ``band`` its normalised name; ``evidence`` what told so."""

    spectrum: str
    band: str
    evidence: str


def classify(frame: Frame, sheet: Sheet, thresholds: Thresholds = DEFAULTS) -> Spectrum:
    """Tell a frame's spectrum and band from the best evidence that there is."""
    rows = _rows(frame, sheet)
    return (
        _by_band_names(frame, sheet, thresholds)
        or _by_image_source(frame, rows)
        or _by_payload(frame, thresholds)
        or _by_sheet(frame, rows)
        or _by_maker(frame, sheet)
        or _by_pixels(frame)
        or _by_file_name(frame)
        or Spectrum(RGB, RGB, "nothing in the file speaks of another spectrum")
    )


def normalise_band(name: str, wavelength_nm: Optional[float] = None, thresholds: Thresholds = DEFAULTS) -> str:
    """``Red edge-705`` -> ``rededge-705``, ``NIR`` -> ``nir``, ``""`` with 842 nm -> ``nir``.

    A number in the name keeps the band distinct unless it is the standard
    centre of that name within ``band_wavelength_nm``. Unknown names come back
    as plain letters and digits.
    """
    numbered = re.match(r"^\s*([A-Za-z][A-Za-z _]*?)[\s_-]*(\d{3,5})\s*(?:nm)?\s*$", name)
    base_text, number = (numbered.group(1), int(numbered.group(2))) if numbered else (name, 0)
    plain = plain_name(base_text)
    if plain in _RGB_NAMES:
        return RGB
    base = _BANDS.get(plain)
    if base is None:
        if plain:
            return f"{plain}-{number}" if number else plain
        return _by_wavelength(wavelength_nm) if wavelength_nm else ""
    if not number or base == LWIR:
        return base
    standard = _STANDARD_NM.get(base)
    if standard is not None and abs(number - standard) <= thresholds.band_wavelength_nm:
        return base
    return f"{base}-{number}"


def _by_wavelength(wavelength_nm: float) -> str:
    if _LWIR_NM[0] <= wavelength_nm <= _LWIR_NM[1]:
        return LWIR
    for end, band in _RANGES_NM:
        if wavelength_nm < end:
            return "blue" if band == "coastalblue" else band
    return ""


def _rows(frame: Frame, sheet: Sheet) -> Tuple[SheetRow, ...]:
    make, model = frame.make or frame.xmp_make, frame.model or frame.xmp_model
    rows = sheet.candidates(
        make, model, *frame.camera_size, frame.lens, "", frame.image_source, frame.focal_mm, "", frame.serial
    )
    return tuple(r for r in rows if r.spectrum)


def _split_names(bands: Tuple[str, ...]) -> Tuple[str, ...]:
    return tuple(part.strip() for name in bands for part in name.replace("|", ",").split(",") if part.strip())


def _by_band_names(frame: Frame, sheet: Sheet, thresholds: Thresholds) -> Optional[Spectrum]:
    names = _split_names(frame.bands)
    bands = [normalise_band(n, frame.wavelength_nm if len(names) == 1 else None, thresholds) for n in names]
    said = f"the file names its band {', '.join(names)}"
    if bands and (bands == [RGB] or {b.split("-")[0] for b in bands} == {"red", "green", "blue"}):
        return Spectrum(RGB, RGB, said)
    if not bands and frame.wavelength_nm:
        band = _by_wavelength(frame.wavelength_nm)
        bands, said = ([band] if band else []), f"the file gives the wavelength {frame.wavelength_nm:g} nm"
    if not bands:
        return None
    if bands == [LWIR]:
        return Spectrum(THERMAL, LWIR, said)
    if frame.thermal_payload and frame.channels == 3:
        return None
    if len(bands) == 1:
        return Spectrum(MULTISPECTRAL, _distinct(bands[0], frame, sheet, thresholds), said)
    return Spectrum(MULTISPECTRAL, "+".join(bands), said)


def _distinct(band: str, frame: Frame, sheet: Sheet, thresholds: Thresholds) -> str:
    """A rig with two bands of one name: the sheet's wavelengths say which of them this is."""
    if frame.wavelength_nm is None or "-" in band:
        return band
    same = [
        r
        for r in sheet.rows_for(frame.make or frame.xmp_make, frame.model or frame.xmp_model)
        if r.wavelength_nm is not None and r.band.split("-")[0] == band
    ]
    near = sorted((abs((r.wavelength_nm or 0.0) - frame.wavelength_nm), r.band) for r in same)
    return near[0][1] if near and near[0][0] <= thresholds.band_wavelength_nm else band


def _by_image_source(frame: Frame, rows: Tuple[SheetRow, ...]) -> Optional[Spectrum]:
    source = plain_name(frame.image_source)
    if not source:
        return None
    said = f"the camera names its source {frame.image_source}"
    if any(word in source for word in _THERMAL_SOURCES):
        return Spectrum(THERMAL, LWIR, said)
    if any(source.startswith(word) for word in _MS_SOURCES) and frame.channels <= 2:
        hit = _MS_SOURCE.match(source)
        band = _BANDS[hit.group(1)] if hit else _suffix_band(frame) or _one_band(rows) or MONO
        return Spectrum(MULTISPECTRAL, band, said)
    if any(source.startswith(word) for word in _RGB_SOURCES) and frame.channels >= 3:
        return Spectrum(RGB, RGB, said)
    return None


def _by_payload(frame: Frame, thresholds: Thresholds) -> Optional[Spectrum]:
    small = frame.width * frame.height <= thresholds.thermal_max_megapixels * 1e6
    if frame.thermal_payload and small:
        return Spectrum(THERMAL, LWIR, f"raw thermal data in the file ({frame.thermal_payload})")
    return None


def _by_sheet(frame: Frame, rows: Tuple[SheetRow, ...]) -> Optional[Spectrum]:
    single = frame.channels <= 2
    colour = frame.channels >= 3
    fitting = [r for r in rows if not (single and r.spectrum == RGB) and not (colour and r.spectrum == MULTISPECTRAL)]
    if len({r.spectrum for r in fitting}) != 1:
        return None
    row = fitting[0]
    said = f"the calibration sheet knows this size of {row.makes[0]} {row.models[0]} as {row.spectrum}"
    if row.spectrum == MULTISPECTRAL:
        named = _suffix_band(frame)
        if not _one_band(tuple(fitting)) and (named or _rig_band(frame, fitting)):
            return Spectrum(MULTISPECTRAL, named or _rig_band(frame, fitting), f"{said}; the band is the file name's")
        return Spectrum(MULTISPECTRAL, _one_band(tuple(fitting)) or MONO, said)
    return Spectrum(row.spectrum, row.band or (LWIR if row.spectrum == THERMAL else RGB), said)


def _by_maker(frame: Frame, sheet: Sheet) -> Optional[Spectrum]:
    """A model that the sheet does not have, in a size that its maker gives to thermal cameras alone."""
    make, model = frame.make or frame.xmp_make, frame.model or frame.xmp_model
    if sheet.rows_for(make, model) or not _is_bolometer(frame):
        return None
    if sheet.spectra_of_size(make, *frame.camera_size) != (THERMAL,):
        return None
    size = "{}x{}".format(*frame.camera_size)
    return Spectrum(THERMAL, LWIR, f"every camera of {make} in the calibration sheet that writes {size} is thermal")


def _by_pixels(frame: Frame) -> Optional[Spectrum]:
    if frame.channels > 4:
        return Spectrum(MULTISPECTRAL, STACK, f"{frame.channels} channels in one file")
    if frame.channels > 2:
        return None
    bolometer = _is_bolometer(frame)
    if frame.sample_format == "float":
        named = _suffix_band(frame)
        if named and not bolometer:
            return Spectrum(MULTISPECTRAL, named, f"one floating-point channel; the file name {frame.name} hints at it")
        return Spectrum(THERMAL, LWIR, "one floating-point channel without a band: temperatures")
    if bolometer and (not _suffix_band(frame) or _thermal_name(frame)):
        return Spectrum(THERMAL, LWIR, "one channel in the size of a thermal sensor")
    named = _suffix_band(frame)
    if named:
        return Spectrum(MULTISPECTRAL, named, f"one channel; the file name {frame.name} hints at the band")
    return Spectrum(MULTISPECTRAL, MONO, f"one channel of {frame.bits} bits without a band name")


def _by_file_name(frame: Frame) -> Optional[Spectrum]:
    if _is_bolometer(frame) and _thermal_name(frame):
        return Spectrum(THERMAL, LWIR, f"only the file name {frame.name} and the size of a thermal sensor say so")
    return None


def _is_bolometer(frame: Frame) -> bool:
    return (max(frame.camera_size), min(frame.camera_size)) in _BOLOMETER_SIZES


def _stem(frame: Frame) -> str:
    return frame.name.rsplit(".", 1)[0]


def _thermal_name(frame: Frame) -> bool:
    return _THERMAL_NAME.search(_stem(frame)) is not None


def _suffix_band(frame: Frame) -> str:
    hit = _BAND_SUFFIX.search(_stem(frame))
    return _BANDS[hit.group(1).lower()] if hit else ""


def _one_band(rows: Tuple[SheetRow, ...]) -> str:
    bands = {r.band for r in rows if r.spectrum == MULTISPECTRAL}
    return bands.pop() if len(bands) == 1 else ""


def _rig_band(frame: Frame, rows: "list[SheetRow]") -> str:
    """The band by its place in the rig: from XMP, or from the number at the end of the name."""
    index = frame.rig_index
    if index is None:
        hit = _RIG_SUFFIX.search(_stem(frame))
        index = int(hit.group(1)) - 1 if hit else None
    found = sorted({r.band for r in rows if index is not None and r.rig_index == index})
    return found[0] if len(found) == 1 else ""
