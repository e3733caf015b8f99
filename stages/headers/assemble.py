"""One Frame out of the parts of a header."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Tuple

from ..errors import FrameError
from ..frame import Frame
from ..thresholds import DEFAULTS, Thresholds
from . import calibration, exif, jpeg, position, tiff, xmp
from .source import BeyondEnd, ByteSource
from .values import Numbers, iso_time

_MAX_PACKETS = 8
_OTHER_FORMATS = (
    (b"\x89PNG", "a PNG picture"),
    (b"GIF8", "a GIF picture"),
    (b"RIFF", "a WebP picture or a film"),
    (b"BM", "a BMP picture"),
    (b"%PDF", "a PDF document"),
    (b"PK\x03\x04", "a ZIP archive"),
)
_PANEL_TAGS = tuple(
    f"{prefix}:{name}"
    for prefix in ("Camera", "MicaSense")
    for name in ("PanelSerial", "PanelAlbedo", "Albedo", "ReflectArea")
)
_SERIAL_TAGS = ("drone-dji:CameraSerialNumber", "DJI:CameraSerialNumber", "MicaSense:SerialNumber",
                "Camera:SerialNumber", "Camera:CameraSerialNumber", "exifEX:BodySerialNumber", "aux:SerialNumber",
                "drone-dji:DroneSerialNumber", "DJI:DroneSerialNumber")  # fmt: skip
_BAND_TAGS = ("Camera:BandName", "FLIR:BandName", "DJI:BandName", "drone-dji:BandName", "MicaSense:BandName")
_WAVELENGTH_TAGS = tuple(t.replace("BandName", "CentralWavelength") for t in _BAND_TAGS)
_CAPTURE_TAGS = ("drone-dji:CaptureUUID", "MicaSense:CaptureId", "Camera:CaptureUUID", "Camera:ImageUniqueID")
_RADIOMETRY_TAGS = (
    ("black-level", ("Camera:BlackCurrent", "Camera:BlackLevel", "drone-dji:BlackLevel", "MicaSense:DarkRowValue")),
    ("row-gradient", ("MicaSense:RadiometricCalibration", "Camera:RowGradient", "MicaSense:RowGradient")),
    ("vignette", ("Camera:VignettingPolynomial", "Camera:VignettingPolynomial2D", "Camera:VignettingCenter",
                  "drone-dji:VignettingData", "drone-dji:VignettingPolynomial")),
)  # fmt: skip


@dataclass(frozen=True)
class _Picture:
    """What the container itself says of the picture; the fields are those of ``Frame``."""

    path: str
    size_bytes: int
    format: str
    width: int
    height: int
    bits: int
    channels: int
    sample_format: str = "uint"
    pages: int = 1
    thermal_payload: str = ""


def frame_from(source: ByteSource, path: str, limits: Thresholds = DEFAULTS) -> Frame:
    """Read the metadata of one image.

    ``FrameError`` ``not-an-image``, ``damaged-header`` or ``truncated-image``;
    ``header-incomplete`` when header bytes alone were given and more is needed.
    """
    start = source.peek(0, min(16, source.size))
    try:
        if start.startswith(b"\xff\xd8\xff"):
            return _jpeg_frame(source, path, limits)
        if start[:4] in (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+"):
            return _tiff_frame(source, path, limits)
    except BeyondEnd:
        raise FrameError("truncated-image", "The file ends inside its header: it was not copied whole.") from None
    if not any(start):
        raise FrameError("not-an-image", "The file begins with zeros: the copy from the card failed.")
    raise FrameError("not-an-image", f"The file holds {_what(start)}, not a JPEG, TIFF or DNG picture.")


def _what(start: bytes) -> str:
    if start[4:8] == b"ftyp":
        return "a HEIF picture or a film"
    for magic, name in _OTHER_FORMATS:
        if start.startswith(magic):
            return name
    return "something else"


def _jpeg_frame(source: ByteSource, path: str, limits: Thresholds) -> Frame:
    layout = jpeg.walk(source)
    jpeg.check_end(source, layout)
    problems = list(layout.problems)
    stream: Optional[tiff.Stream] = None
    if layout.exif is not None:
        try:
            stream = tiff.open_stream(source, *layout.exif, limits.max_ifd_entries)
        except tiff.Damaged as damage:
            problems.append(f"exif-damaged:IFD0, {damage}")
    block = exif.read_block(stream, None, problems)
    packets = [source.read(offset, length) for offset, length in layout.xmp[:_MAX_PACKETS] if length > 0]
    packets = packets or _packet_of(block.image, limits, problems)
    properties = xmp.parse(packets, limits)
    _add_extended(source, layout, properties, limits)
    picture = _Picture(
        path=path,
        size_bytes=source.size,
        format="jpeg",
        width=layout.width,
        height=layout.height,
        bits=layout.bits,
        channels=layout.channels,
        thermal_payload=_thermal_payload(layout, problems),
    )
    return _frame(picture, block, properties, limits, problems)


def _add_extended(source: ByteSource, layout: jpeg.JpegLayout, properties: xmp.Xmp, limits: Thresholds) -> None:
    guid = properties.text("xmpNote:HasExtendedXMP")
    if not guid or not layout.extended:
        return
    data = jpeg.extended_xmp(source, layout, guid.encode("ascii", "replace"), limits.max_xmp_bytes)
    if data is None:
        properties.problems.append("xmp-extended-incomplete:not all parts are there")
    else:
        properties.extend(xmp.parse([data], limits))


def _tiff_frame(source: ByteSource, path: str, limits: Thresholds) -> Frame:
    problems: List[str] = []
    try:
        stream = tiff.open_stream(source, 0, source.size, limits.max_ifd_entries)
    except tiff.Damaged as damage:
        raise FrameError("damaged-header", f"The TIFF header is damaged: {damage}.") from None
    pages, first = tiff.pages(stream, exif.IMAGE_TAGS)
    page = tiff.full_resolution(pages)
    tiff.check_data(stream, page)
    fields = dict(page.fields)
    fields.update(first)
    block = exif.read_block(stream, fields, problems)
    properties = xmp.parse(_packet_of(block.image, limits, problems), limits)
    picture = _Picture(
        path=path,
        size_bytes=source.size,
        format="dng" if exif.DNG_VERSION in first or path.lower().endswith(".dng") else "tiff",
        width=page.width,
        height=page.height,
        bits=page.bits,
        channels=page.channels,
        sample_format=page.sample_format,
        pages=max(1, sum(not p.reduced for p in pages)),
    )
    return _frame(picture, block, properties, limits, problems)


def _packet_of(image: exif.Tags, limits: Thresholds, problems: List[str]) -> List[bytes]:
    value = image.fields.get(exif.XMP_PACKET)
    if value is None or image.stream is None:
        return []
    try:
        return [tiff.raw_bytes(image.stream, value, limits.max_xmp_bytes)]
    except tiff.Damaged as damage:
        problems.append(f"xmp-malformed:{damage}")
        return []


def _thermal_payload(layout: jpeg.JpegLayout, problems: List[str]) -> str:
    """Raw thermal data beside the picture: FLIR's in APP1, DJI's in one of APP3 to APP9.

    DJI's raw has 2 bytes a pixel and may be half as wide and high as the
    picture that was scaled up from it.
    """
    if layout.flir_segments:
        if layout.flir_segments < layout.flir_expected:
            problems.append(f"thermal-payload-incomplete:{layout.flir_segments} of {layout.flir_expected} segments")
        return f"FLIR FFF in APP1 x{layout.flir_segments}"
    if not layout.raw_bytes:
        return ""
    marker = max(sorted(layout.raw_bytes), key=lambda m: layout.raw_bytes[m])
    if 2 * layout.raw_bytes[marker] < layout.width * layout.height:
        return ""
    return f"DJI raw in APP{marker - 0xE0} x{layout.raw_segments[marker]}"


def _time(block: exif.ExifBlock, properties: xmp.Xmp) -> Optional[str]:
    tags = block.exif
    original = tags.text(exif.TIME_ORIGINAL)
    if original:
        subsec = tags.text(exif.SUBSEC_ORIGINAL)
        if not subsec and block.image.text(exif.DATE_TIME) in ("", original):
            subsec = tags.text(exif.SUBSEC)
        moment = iso_time(original, subsec)
        if moment is not None:
            return moment
    moment = iso_time(tags.text(exif.TIME_DIGITIZED), tags.text(exif.SUBSEC_DIGITIZED))
    return moment or iso_time(properties.text("exif:DateTimeOriginal", "xmp:CreateDate"))


def _serial(block: exif.ExifBlock, properties: xmp.Xmp) -> str:
    """The camera's own number first; the drone's only where the camera has none. ``0`` is a placeholder."""
    candidates = [block.exif.text(exif.BODY_SERIAL), block.image.text(exif.CAMERA_SERIAL)]
    candidates += [exif.clean_text(properties.text(tag)) for tag in _SERIAL_TAGS]
    told = [c for c in candidates if c]
    return next((c for c in told if c.strip("0")), told[0] if told else "")


def _triple(values: Tuple[float, ...]) -> Optional[Tuple[float, float, float]]:
    return (values[0], values[1], values[2]) if len(values) == 3 else None


def _original_size(picture: _Picture, image: exif.Tags) -> Optional[Tuple[int, int]]:
    """Size of the frame that this one was resampled from as a whole, where the file tells one of this shape."""
    told = [v for v in image.numbers(exif.ORIGINAL_SIZE) if v is not None and v >= 1] if image.stream else []
    if len(told) != 2:
        return None
    # The height of a resampled frame is rounded.
    if abs(told[1] * picture.width / told[0] - picture.height) > 1.0:
        return None
    return int(told[0]), int(told[1])


def _frame(
    picture: _Picture, block: exif.ExifBlock, properties: xmp.Xmp, limits: Thresholds, problems: List[str]
) -> Frame:
    image, tags = block.image, block.exif
    numbers = Numbers(properties, problems)
    text = properties.text
    where = position.read(block.gps, properties, problems)
    xmp_make, xmp_model = exif.clean_text(text("tiff:Make")), exif.clean_text(text("tiff:Model"))
    focal_mm = tags.positive(exif.FOCAL_LENGTH)
    x_res, y_res = (tags.positive(t, zero_is_unknown=False) for t in (exif.PLANE_X_RES, exif.PLANE_Y_RES))
    unit = tags.integer(exif.PLANE_UNIT)
    exif_width, exif_height = tags.integer(exif.PIXEL_X), tags.integer(exif.PIXEL_Y)
    unit_mm = calibration.UNIT_MM.get(2 if unit is None else unit)
    per_mm = None if x_res is None or unit_mm is None else (x_res / unit_mm, (y_res or x_res) / unit_mm)
    deviations = [numbers.one(f"drone-dji:RtkStd{axis}") for axis in ("Lon", "Lat", "Hgt")]
    told = [d for d in deviations if d is not None]
    wavelengths = numbers.several(*_WAVELENGTH_TAGS)
    radiometry = [name for name, names in _RADIOMETRY_TAGS if properties.items(*names)]
    if exif.BLACK_LEVEL in image and "black-level" not in radiometry:
        radiometry.append("black-level")
    panel = (numbers.one("Camera:CalibrationPicture", "MicaSense:CalibrationPicture") or 0.0) > 0
    whole = _triple(numbers.several("Camera:RigRelatives"))
    original = _original_size(picture, image)
    sizes = calibration.Sizes((picture.width, picture.height), (exif_width, exif_height), original)
    calibrated = calibration.from_xmp(properties, sizes, focal_mm, per_mm, limits, problems)
    return Frame(
        path=picture.path,
        size_bytes=picture.size_bytes,
        format=picture.format,
        width=picture.width,
        height=picture.height,
        bits=picture.bits,
        channels=picture.channels,
        sample_format=picture.sample_format,
        pages=picture.pages,
        orientation=image.integer(exif.ORIENTATION),
        make=image.text(exif.MAKE) or xmp_make,
        model=image.text(exif.MODEL) or image.text(exif.UNIQUE_MODEL) or xmp_model,
        serial=_serial(block, properties),
        lens=tags.text(exif.LENS_MODEL),
        software=image.text(exif.SOFTWARE),
        xmp_make=xmp_make,
        xmp_model=xmp_model,
        xmp_lens=exif.clean_text(text("aux:Lens", "exifEX:LensModel")),
        focal_mm=focal_mm,
        focal_35mm=tags.positive(exif.FOCAL_35MM),
        digital_zoom=tags.positive(exif.DIGITAL_ZOOM),
        focal_plane_x_res=x_res,
        focal_plane_y_res=y_res,
        focal_plane_unit=unit,
        exif_width=exif_width,
        exif_height=exif_height,
        f_number=tags.positive(exif.F_NUMBER),
        exposure_s=tags.positive(exif.EXPOSURE_TIME),
        iso=tags.positive(exif.ISO) or tags.positive(exif.SENSITIVITY) or tags.positive(exif.ISO_SPEED),
        time=_time(block, properties),
        latitude=where.latitude,
        longitude=where.longitude,
        gps_reference_missing=where.reference_missing,
        altitude_m=where.altitude_m,
        relative_altitude_m=where.relative_altitude_m,
        altitude_type=exif.clean_text(text("drone-dji:AltitudeType")),
        rtk_flag=numbers.whole("drone-dji:RtkFlag", "DJI:RtkFlag"),
        rtk_std_m=(told[0], told[1], told[2]) if len(told) == 3 else None,
        speed_mps=where.speed_mps,
        yaw_deg=where.yaw_deg,
        pitch_deg=where.pitch_deg,
        roll_deg=where.roll_deg,
        bands=_bands(properties),
        wavelength_nm=wavelengths[0] if len(wavelengths) == 1 else None,
        capture_id=exif.clean_text(text(*_CAPTURE_TAGS)),
        sequence=tags.integer(exif.IMAGE_NUMBER),
        image_source=exif.clean_text(text("drone-dji:ImageSource")),
        projection=exif.clean_text(text("Camera:ModelType")).lower(),
        calibration=calibrated,
        dewarp_flag=numbers.whole("drone-dji:DewarpFlag"),
        rig_name=exif.clean_text(text("Camera:RigName")),
        original_width=original[0] if original else None,
        original_height=original[1] if original else None,
        rig_index=numbers.whole("Camera:RigCameraIndex", "drone-dji:SensorIndex"),
        rotation_deg=whole,
        thermal_payload=picture.thermal_payload,
        radiometry=tuple(sorted(radiometry)),
        panel=panel or any(text(tag) for tag in _PANEL_TAGS),
        has_makernote=exif.MAKER_NOTE in tags,
        xmp_namespaces=properties.namespaces,
        xmp_blocks=properties.blocks,
        problems=tuple(dict.fromkeys(problems + properties.problems)),
    )


def _bands(properties: xmp.Xmp) -> Tuple[str, ...]:
    """Band names as spelt; ``Red, Green, Blue`` in one text is three."""
    names = [exif.clean_text(n) for item in properties.items(*_BAND_TAGS) for n in item.split(",")]
    return tuple(n for n in names if n)
