"""Calibration sheets: what is known of a camera from its name, size, lens and spectrum.

Focal-plane tags are missing from most drone cameras, so the true sensor width
and focal length come from a sheet: one row per camera, each with the source of
its facts. ``sensors.json`` is the built-in sheet; a user's own sheet (JSON or
CSV) wins over it and may carry a full calibration.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Set, Tuple, Union

from . import record
from .thresholds import DEFAULTS, Thresholds

BUILT_IN = "sheet"
USER = "user-sheet"
GENERIC = "generic-width"

# How a row's sizes fit a frame's size, best first.
EXACT = "exact"
SCALED = "scaled"
CROPPED = "height-crop"
MODEL_ONLY = "model-only"
_MATCHES = (EXACT, SCALED, CROPPED, MODEL_ONLY)

Size = Tuple[int, int]


@dataclass(frozen=True)
class SheetRow:
    """One camera of the sheet; ``sensor_width_mm`` spans the full width of every size in ``sizes``.

    ``modes`` are sizes that show another part of the sensor: width and height
    in px with the width in mm that they span. ``pixel_um`` is the pitch of one
    photosite and ``pitch_px`` how many of them lie side by side where the
    image is binned (0: as many as the widest size has). ``focal_mm`` is the
    physical focal length of a fixed lens, ``None`` where lenses or zoom change
    it. ``corrected_jpeg`` and ``corrected_raw`` say whether the camera has
    already removed the lens distortion from that format, ``None`` where this
    is not established. ``image_sources`` are DJI's names for the camera.
    ``sensor_height_mm`` is used for frames stored upright. ``match`` says how
    the row fitted the frame that it was found for, ``origin`` which sheet it
    stands in. ``center_px`` and ``distortion`` (k1, k2, p1, p2, k3, OpenCV
    order) are only in rows of the user's own calibrations.
    """

    id: str
    makes: Tuple[str, ...]
    models: Tuple[str, ...]
    source: str
    spectrum: str = "rgb"
    band: str = ""
    name: str = ""
    sizes: Tuple[Size, ...] = ()
    modes: Tuple[Tuple[int, int, float], ...] = ()
    sensor_width_mm: Optional[float] = None
    sensor_height_mm: Optional[float] = None
    focal_mm: Optional[float] = None
    focal_35mm: Optional[float] = None
    pixel_um: Optional[float] = None
    pitch_px: int = 0
    zoom: bool = False
    lenses: Tuple[str, ...] = ()
    image_sources: Tuple[str, ...] = ()
    projection: str = "brown"
    shutter: str = ""
    corrected_jpeg: Optional[bool] = None
    corrected_raw: Optional[bool] = None
    rig_index: Optional[int] = None
    wavelength_nm: Optional[float] = None
    thermal_raw: str = ""
    serial: str = ""
    focal_px: Optional[float] = None
    center_px: Optional[Tuple[float, float]] = None
    distortion: Optional[Tuple[float, ...]] = None
    origin: str = BUILT_IN
    match: str = EXACT

    @property
    def width_source(self) -> str:
        """The source name for what is taken from this row: a guess unless the size is known."""
        if self.origin == USER:
            return USER
        return BUILT_IN if self.match == EXACT else GENERIC


def plain_name(text: str) -> str:
    """Lower case letters, digits and ``+`` alone: cameras spell their names in many ways."""
    return re.sub(r"[^a-z0-9+]", "", text.casefold())


def _plain_make(make: str) -> str:
    words = re.sub(r"[^a-z0-9 ]", " ", make.casefold()).split()
    dropped = {"corporation", "corp", "inc", "co", "ltd", "systems", "ab", "imaging", "company", "robotics"}
    return "".join(w for w in words if w not in dropped) or plain_name(make)


def _plain_model(make: str, model: str) -> str:
    name, maker = plain_name(model), _plain_make(make)
    return name[len(maker) :] if maker and name.startswith(maker) and len(name) > len(maker) else name


def _same_aspect(a: Size, b: Size, tolerance: float) -> bool:
    return abs(a[0] * b[1] / (a[1] * b[0]) - 1.0) <= tolerance


@dataclass(frozen=True)
class Sheet:
    """The rows to look up, the user's before the built-in ones."""

    rows: Tuple[SheetRow, ...]
    thresholds: Thresholds = DEFAULTS

    @functools.cached_property
    def _index(self) -> Dict[Tuple[str, str], List[SheetRow]]:
        index: Dict[Tuple[str, str], List[SheetRow]] = {}
        for row in self.rows:
            for make in row.makes:
                for model in row.models:
                    rows = index.setdefault((_plain_make(make), _plain_model(make, model)), [])
                    if row not in rows:
                        rows.append(row)
        return index

    @functools.cached_property
    def _sizes(self) -> Dict[Tuple[str, Size], Set[str]]:
        sizes: Dict[Tuple[str, Size], Set[str]] = {}
        for row in self.rows:
            for make in row.makes:
                for size in row.sizes if row.spectrum else ():
                    sizes.setdefault((_plain_make(make), size), set()).add(row.spectrum)
        return sizes

    def rows_for(self, make: str, model: str) -> Tuple[SheetRow, ...]:
        """All rows of a make and model, whatever their spectrum and size."""
        return tuple(self._index.get((_plain_make(make), _plain_model(make, model)), ()))

    def spectra_of_size(self, make: str, width: int, height: int) -> Tuple[str, ...]:
        """The spectra of all cameras of a make that write frames of this size: a hint for a model not in the sheet."""
        maker = _plain_make(make)
        return tuple(sorted(self._sizes.get((maker, (width, height)), ()))) if maker else ()

    def candidates(
        self,
        make: str,
        model: str,
        width: int,
        height: int,
        lens: str = "",
        spectrum: str = "",
        image_source: str = "",
        focal_mm: Optional[float] = None,
        band: str = "",
        serial: str = "",
    ) -> Tuple[SheetRow, ...]:
        """The rows that fit best and equally well, each with the width and match for this size.

        A row is out where it names a spectrum, band, image source, lens or
        serial that contradicts a given one (a band that no row names is not
        asked for). Of the rest the best kind of size
        match stays; then, where a fixed focal length is known, the rows that
        agree with ``focal_mm`` within ``focal_split``; then the most specific.
        """
        fitting: List[SheetRow] = []
        for row in self.rows_for(make, model):
            if not _agrees(row, lens, spectrum, image_source, band, serial):
                continue
            fitted = self._fit(row, (width, height))
            if fitted is not None:
                fitting.append(fitted)
        if any(r.origin == USER for r in fitting):
            fitting = [r for r in fitting if r.origin == USER]
        if not fitting and band:
            return self.candidates(make, model, width, height, lens, spectrum, image_source, focal_mm, "", serial)
        if not fitting:
            return ()
        best = min(_MATCHES.index(r.match) for r in fitting)
        fitting = [r for r in fitting if _MATCHES.index(r.match) == best]
        fitting = self._by_focal(fitting, focal_mm)
        specific = max(_specificity(r) for r in fitting)
        return tuple(r for r in fitting if _specificity(r) == specific)

    def find(
        self,
        make: str,
        model: str,
        width: int,
        height: int,
        lens: str = "",
        spectrum: str = "",
        image_source: str = "",
        focal_mm: Optional[float] = None,
        band: str = "",
        serial: str = "",
    ) -> Optional[SheetRow]:
        """The one row that fits, its width set for this size; ``None`` where none or no single one does.

        Rows that fit equally well count as one where their geometry is equal
        (the bands of a rig): the first is returned.
        """
        rows = self.candidates(make, model, width, height, lens, spectrum, image_source, focal_mm, band, serial)
        if not rows:
            return None
        geometry = {(r.sensor_width_mm, r.focal_mm, r.focal_px, r.zoom, r.distortion, r.center_px) for r in rows}
        return rows[0] if len(geometry) == 1 else None

    def _by_focal(self, rows: List[SheetRow], focal_mm: Optional[float]) -> List[SheetRow]:
        if focal_mm is None or len(rows) < 2:
            return rows
        gaps = [abs(r.focal_mm / focal_mm - 1.0) if r.focal_mm else None for r in rows]
        near = [g for g in gaps if g is not None and g <= self.thresholds.focal_split]
        if near:
            return [r for r, g in zip(rows, gaps) if g == min(near)]
        open_lens = [r for r, g in zip(rows, gaps) if g is None]
        return open_lens or rows

    def _fit(self, row: SheetRow, size: Size) -> Optional[SheetRow]:
        """The row with its width for ``size``; upright frames are compared turned."""
        upright = size[1] > size[0] and not any(s[1] > s[0] for s in row.sizes)
        turned = (size[1], size[0]) if upright else size
        for width, height, width_mm in row.modes:
            if (width, height) == turned:
                shown = width_mm * height / width if upright else width_mm
                return dataclasses.replace(row, sensor_width_mm=shown, match=EXACT)
        match = self._match(row, turned)
        if match is None:
            return None
        width_mm_full = row.sensor_width_mm
        if upright and width_mm_full is not None:
            width_mm_full = width_mm_full * turned[1] / turned[0]
        return dataclasses.replace(row, sensor_width_mm=width_mm_full, match=match)

    def _match(self, row: SheetRow, size: Size) -> Optional[str]:
        if not row.sizes and not row.modes:
            return EXACT if row.origin == USER else MODEL_ONLY
        if size in row.sizes:
            return EXACT
        if row.origin == USER:
            return SCALED if any(_same_aspect(size, s, self.thresholds.aspect_tolerance) for s in row.sizes) else None
        if any(_same_aspect(size, s, self.thresholds.aspect_tolerance) for s in row.sizes):
            return SCALED
        if any(size[0] == s[0] and size[1] < s[1] for s in row.sizes):
            return CROPPED
        return None


def _agrees(row: SheetRow, lens: str, spectrum: str, image_source: str, band: str, serial: str) -> bool:
    if row.serial and row.serial != serial.strip():
        return False
    if spectrum and row.spectrum and row.spectrum != spectrum:
        return False
    if band and row.band and row.band != band:
        return False
    if image_source and row.image_sources and plain_name(image_source) not in map(plain_name, row.image_sources):
        return False
    return not row.lenses or not lens or any(plain_name(known) in plain_name(lens) for known in row.lenses)


def _specificity(row: SheetRow) -> int:
    return 4 * bool(row.serial) + 2 * bool(row.lenses) + bool(row.band)


@functools.lru_cache(maxsize=256)
def general_width_mm(make: str, model: str, width: int, height: int) -> Optional[float]:
    """Sensor width of a camera that the sheet does not have, by lensfun's database where lensfunpy is installed.

    The database gives the crop factor (full-frame diagonal over sensor
    diagonal, two decimals), so the width follows from the frame's aspect:
    right within about 2 %, and only for frames that show the whole sensor.
    ``None`` without lensfunpy or for an unknown camera.
    """
    try:
        import lensfunpy
    except ImportError:
        return None
    if not make or not model or width <= 0 or height <= 0:
        return None
    cameras = lensfunpy.Database().find_cameras(make, model)
    factors = {round(float(c.crop_factor), 3) for c in cameras if c.crop_factor > 0}
    if len(factors) != 1:
        return None
    return math.hypot(36.0, 24.0) / factors.pop() * width / math.hypot(width, height)


@functools.lru_cache(maxsize=1)
def built_in_rows() -> Tuple[SheetRow, ...]:
    """The rows of ``sensors.json``, in file order."""
    text = Path(__file__).with_name("sensors.json").read_text(encoding="utf-8")
    rows: Sequence[Any] = json.loads(text)["rows"]
    return tuple(record.from_plain(SheetRow, row) for row in rows)


def load_sheet(user_file: Union[str, Path, None] = None, thresholds: Thresholds = DEFAULTS) -> Sheet:
    """The built-in sheet, with the rows of ``user_file`` (JSON or CSV) before it.

    Raises ``UsageError`` naming line and column where the user's file is bad.
    """
    own: Tuple[SheetRow, ...] = ()
    if user_file is not None:
        from .usersheet import read_user_sheet

        own = read_user_sheet(Path(user_file))
    return Sheet(own + built_in_rows(), thresholds)
