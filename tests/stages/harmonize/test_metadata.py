from __future__ import annotations

import io
import random
from fractions import Fraction

import exifread
import numpy as np
import piexif
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from sensorgate.stages.errors import FrameError
from sensorgate.stages.harmonize import jpeg, tiff
from sensorgate.stages.harmonize.exif import TagEdit, TiffBlock, as_rational, decimal, edit_tags
from sensorgate.stages.harmonize.metadata import retag
from sensorgate.stages.harmonize.resample import decode_jpeg, encode_jpeg, resize
from sensorgate.stages.read import frame_from_header
from sensorgate.stages.thresholds import DEFAULTS

from .samples import MAKER_NOTE, XMP, exif_block, jpeg_bytes, odm_focal_ratio, real, tag_lines, texture


def shrink(data: bytes, width: int, height: int, size: tuple) -> bytes:
    pixels = resize(decode_jpeg(data, grey=False), size)
    encoded = encode_jpeg(pixels, jpeg.sampling(data), DEFAULTS)
    return jpeg.with_header_of(data, encoded, TagEdit((width, height, *size)))


def test_resampled_jpeg_keeps_what_names_the_frame():
    data = jpeg_bytes(320, 240)
    result = shrink(data, 320, 240, (256, 192))
    assert result.count(XMP) == 1
    assert MAKER_NOTE in result
    before, after = piexif.load(data), piexif.load(result)
    assert after["GPS"] == before["GPS"]
    assert after["0th"][piexif.ImageIFD.Model] == b"Cam 1"
    changed = {t for t in before["Exif"] if before["Exif"][t] != after["Exif"][t]}
    assert changed == {
        piexif.ExifIFD.FocalPlaneXResolution,
        piexif.ExifIFD.FocalPlaneYResolution,
        piexif.ExifIFD.PixelXDimension,
        piexif.ExifIFD.PixelYDimension,
    }
    assert (after["Exif"][piexif.ExifIFD.PixelXDimension], after["Exif"][piexif.ExifIFD.PixelYDimension]) == (256, 192)
    assert after["thumbnail"] is None and before["thumbnail"][1000:1100] not in result
    with Image.open(io.BytesIO(result)) as image:
        assert image.size == (256, 192)


@pytest.mark.parametrize("with_equivalent", [True, False])
@pytest.mark.parametrize("size", [(256, 192), (160, 120), (480, 360), (321, 241)])
def test_focal_ratio_is_the_same_after_resampling(with_equivalent, size):
    changes = {} if with_equivalent else {"FocalLengthIn35mmFilm": None}
    data = jpeg_bytes(320, 240, exif=exif_block(320, 240, **changes))
    result = shrink(data, 320, 240, size)
    assert odm_focal_ratio(result) == pytest.approx(odm_focal_ratio(data), rel=1e-6)


def test_stale_focal_plane_would_double_the_ratio():
    """The guard of the test above: without the rewrite the rule does give another ratio."""
    data = jpeg_bytes(320, 240, exif=exif_block(320, 240, FocalLengthIn35mmFilm=None))
    encoded = encode_jpeg(resize(decode_jpeg(data, grey=False), (160, 120)), (2, 1), DEFAULTS)
    assert odm_focal_ratio(jpeg.with_header_of(data, encoded, TagEdit())) == pytest.approx(2 * odm_focal_ratio(data))


@pytest.mark.parametrize("subsampling, expected", [(0, (1, 1)), (1, (2, 1)), (2, (2, 2))])
def test_chroma_subsampling_is_kept(subsampling, expected):
    data = jpeg_bytes(320, 240, subsampling=subsampling)
    assert jpeg.sampling(data) == expected
    assert jpeg.sampling(shrink(data, 320, 240, (256, 192))) == expected


def test_orientation_tag_stays_and_pixels_are_not_turned():
    block = piexif.load(exif_block(320, 240))
    block["0th"][piexif.ImageIFD.Orientation] = 6
    data = jpeg_bytes(320, 240, exif=piexif.dump(block))
    result = shrink(data, 320, 240, (160, 120))
    with Image.open(io.BytesIO(result)) as image:
        assert image.size == (160, 120)
        assert image.getexif()[0x0112] == 6


def test_icc_and_comment_stay_mpf_and_adobe_marker_go():
    data = jpeg_bytes(320, 240, icc_profile=b"ICC" * 50, comment=b"field 7")
    mpf = b"MPF\x00II*\x00" + b"\x00" * 40
    adobe = b"Adobe\x00\x64\x00\x00\x00\x00\x01"
    at = jpeg.segments(data)[0][0].start - 4
    for marker, body in ((0xE2, mpf), (0xEE, adobe), (0xE7, b"DJI-DBG\x00x")):
        data = data[:at] + bytes((0xFF, marker)) + (len(body) + 2).to_bytes(2, "big") + body + data[at:]
    result = shrink(data + b"\xff\xd8second picture\xff\xd9", 320, 240, (256, 192))
    assert mpf not in result and adobe not in result and b"second picture" not in result
    assert b"DJI-DBG\x00x" in result
    with Image.open(io.BytesIO(result)) as image:
        assert image.format == "JPEG"
        assert image.info["icc_profile"] == b"ICC" * 50
        assert image.info["comment"] == b"field 7"


def test_retag_changes_only_the_bytes_of_the_tag():
    data = jpeg_bytes(320, 240)
    result = retag(data, TagEdit(focal_mm=8.9))
    different = [i for i, (a, b) in enumerate(zip(data, result)) if a != b]
    assert len(result) == len(data) and different
    assert different[-1] - different[0] < 8
    assert exifread.process_file(io.BytesIO(result))["EXIF FocalLength"].values[0] == Fraction(89, 10)
    assert retag(data, TagEdit(focal_mm=8.8, focal_35mm=24)) == data


def test_retag_adds_an_absent_tag_and_moves_nothing():
    data = jpeg_bytes(320, 240, exif=exif_block(320, 240, FocalLengthIn35mmFilm=None))
    result = retag(data, TagEdit(focal_35mm=25))
    before, after = piexif.load(data), piexif.load(result)
    assert after["Exif"].pop(piexif.ExifIFD.FocalLengthIn35mmFilm) == 25
    for block in (before, after):
        del block["0th"][piexif.ImageIFD.ExifTag]
    assert after == before
    assert data.find(MAKER_NOTE) == result.find(MAKER_NOTE)
    old, new = (next(s.start for s in jpeg.segments(d)[0] if s.marker == 0xDB) for d in (data, result))
    assert data[old:] == result[new:]


def test_retag_gives_tags_to_a_file_without_exif():
    out = io.BytesIO()
    Image.fromarray(texture(64, 48)).save(out, "JPEG")
    result = retag(out.getvalue(), TagEdit(focal_mm=4.5, focal_35mm=25))
    tags = exifread.process_file(io.BytesIO(result))
    assert tags["EXIF FocalLength"].values[0] == Fraction(9, 2)
    assert tags["EXIF FocalLengthIn35mmFilm"].values[0] == 25
    with Image.open(io.BytesIO(result)) as image:
        image.load()


def test_retagged_tiff_keeps_its_pixels():
    out = io.BytesIO()
    pixels = (texture(64, 48, 1)[:, :, 0].astype(np.uint16) << 8) + 7
    Image.fromarray(pixels).save(out, "TIFF", compression="tiff_lzw")
    result = retag(out.getvalue(), TagEdit(focal_mm=5.5))
    assert exifread.process_file(io.BytesIO(result))["EXIF FocalLength"].values[0] == Fraction(11, 2)
    assert np.array_equal(tiff.decode(result, DEFAULTS)[:, :, 0], pixels)
    assert retag(result, TagEdit(focal_mm=5.5)) == result


@given(st.floats(0.5, 400.0), st.integers(1, 0xFFFF))
@settings(max_examples=60, deadline=None)
def test_focal_tags_come_back_as_written(focal, equivalent):
    block = TiffBlock(bytearray(exif_block(320, 240)[6:]))
    edit_tags(block, TagEdit(focal_mm=focal, focal_35mm=equivalent))
    tags = piexif.load(b"Exif\x00\x00" + bytes(block.data))["Exif"]
    above, under = tags[piexif.ExifIFD.FocalLength]
    assert above / under == pytest.approx(focal, abs=1e-6)
    assert tags[piexif.ExifIFD.FocalLengthIn35mmFilm] == equivalent


@given(st.integers(1, 60000), st.integers(1, 60000), st.integers(1, 0xFFFFFFFF), st.integers(1, 0xFFFFFFFF))
@settings(max_examples=100, deadline=None)
def test_focal_plane_is_scaled_exactly(old, new, above, under):
    block = TiffBlock(bytearray(exif_block(320, 240, FocalPlaneXResolution=(above, under))[6:]))
    edit_tags(block, TagEdit((old, old, new, new)))
    result = piexif.load(b"Exif\x00\x00" + bytes(block.data))["Exif"][piexif.ExifIFD.FocalPlaneXResolution]
    wanted = Fraction(above, under) * Fraction(new, old)
    if Fraction(1, 1000) < wanted < 10**8:
        assert abs(Fraction(*result) / wanted - 1) < Fraction(1, 10**5)


@given(st.fractions(min_value=0, max_value=10**12))
def test_rationals_fit_their_field(value):
    above, under = as_rational(value)
    assert 0 <= above <= 0xFFFFFFFF and 0 < under <= 0xFFFFFFFF


def test_decimal_is_what_the_camera_wrote():
    assert decimal(4.386) == Fraction(4386, 1000)
    assert decimal(3.61) == Fraction(361, 100)


@pytest.mark.parametrize("kind", ["jpeg", "tiff"])
def test_damaged_files_end_in_a_frame_error_or_a_result(kind):
    """Random damage to the header: never another exception, never an endless loop."""
    if kind == "jpeg":
        data = jpeg_bytes(160, 120)
    else:
        out = io.BytesIO()
        Image.fromarray(texture(64, 48)).save(out, "TIFF", exif=Image.Exif())
        data = retag(out.getvalue(), TagEdit(focal_mm=5.0, focal_35mm=24))
    rng = random.Random(7)
    for _ in range(300):
        broken = bytearray(data)
        for _ in range(rng.randint(1, 6)):
            broken[rng.randrange(min(len(broken), 1200)) if rng.random() < 0.6 else -1 - rng.randrange(300)] = (
                rng.randrange(256)
            )
        broken = broken[: rng.choice([len(broken), rng.randrange(4, len(broken))])]
        try:
            if kind == "jpeg":
                jpeg.with_header_of(bytes(broken), data, TagEdit((160, 120, 80, 60), 5.1, 25))
            else:
                tiff.encode(bytes(broken), np.zeros((24, 32, 3), np.uint8), TagEdit((64, 48, 32, 24), 5.1, 25))
            retag(bytes(broken), TagEdit(focal_mm=5.2, focal_35mm=26))
        except FrameError:
            continue


@pytest.mark.parametrize(
    "name",
    [
        "brighton_p3_rgb/DJI_0018.JPG",
        "caliterra_canon_rgb/IMG_9374.jpg",
        "garfield_sequoia_rgb_ms/IMG_161122_163234_0000_RGB.JPG",
    ],
)
def test_real_jpegs_keep_their_tags(name, tmp_path):
    path = real(name)
    data = path.read_bytes()
    with Image.open(path) as image:
        width, height = image.size
    xmp = data[data.index(b"<?xpacket begin") : data.index(b"<?xpacket end") + len(b'<?xpacket end="w"?>')]
    size = (round(width * 0.4), round(height * 0.4))
    result = shrink(data, width, height, size)
    small = tmp_path / path.name
    small.write_bytes(result)
    assert result.count(xmp) == 1
    assert tag_lines(small) == tag_lines(path)
    with Image.open(small) as image:
        assert image.size == size and image.format == "JPEG"
    has_ratio = b"Canon" in data[:2000] or b"Parrot" in data[:2000]
    if has_ratio:
        assert odm_focal_ratio(result) == pytest.approx(odm_focal_ratio(data), rel=1e-4)


@pytest.mark.parametrize(
    "name", ["garfield_sequoia_rgb_ms/IMG_161122_163234_0000_GRE.TIF", "micasense_rededge_capture/IMG_0001_1.tif"]
)
@pytest.mark.parametrize("scale", [0.6, 1.3])
def test_real_tiffs_keep_their_tags(name, scale, tmp_path):
    path = real(name)
    data = path.read_bytes()
    pixels = tiff.decode(data, DEFAULTS)
    with Image.open(path) as image:
        assert np.array_equal(np.asarray(image), pixels[:, :, 0])
    xmp = data[data.index(b"<?xpacket begin") : data.index(b"<?xpacket end") + len(b'<?xpacket end="w"?>')]
    size = (round(pixels.shape[1] * scale), round(pixels.shape[0] * scale))
    other = resize(pixels[:, :, 0], size)[:, :, None]
    result = tiff.encode(data, other, TagEdit((pixels.shape[1], pixels.shape[0], *size)))
    small = tmp_path / path.name
    small.write_bytes(result)
    assert result.count(xmp) == 1
    assert tag_lines(small) == tag_lines(path)
    assert odm_focal_ratio(result) == pytest.approx(odm_focal_ratio(data), rel=1e-4)
    with Image.open(small) as image:
        assert image.size == size and np.array_equal(np.asarray(image), other[:, :, 0])
    assert np.array_equal(tiff.decode(result, DEFAULTS), other)


@given(st.binary(max_size=400))
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_bytes_as_exif(data):
    for head in (b"II*\x00", b"MM\x00*"):
        try:
            edit_tags(TiffBlock(bytearray(head + data)), TagEdit((10, 10, 20, 20), 5.0, 25))
        except FrameError:
            continue


@pytest.mark.parametrize("written", [(4547420, 1000), (0, 0)], ids=["stale", "0/0"])
def test_stale_and_empty_focal_plane_tags_are_set_right(written):
    """A frame shrunk by its owner, or 0/0 of a camera that knows no better: the copy says the true width."""
    import io

    import piexif
    from PIL import Image
    from sensorgate.stages.harmonize.exif import TagEdit
    from sensorgate.stages.harmonize.metadata import retag

    exif = piexif.dump(
        {
            "0th": {},
            "Exif": {
                piexif.ExifIFD.FocalLength: (52, 10),
                piexif.ExifIFD.FocalPlaneXResolution: written,
                piexif.ExifIFD.FocalPlaneYResolution: written,
                piexif.ExifIFD.FocalPlaneResolutionUnit: 2,
                piexif.ExifIFD.PixelXDimension: 1332,
                piexif.ExifIFD.PixelYDimension: 1000,
            },
            "GPS": {},
            "1st": {},
        }
    )
    stream = io.BytesIO()
    Image.new("RGB", (666, 500), (10, 90, 10)).save(stream, "JPEG", exif=exif)
    tags = piexif.load(retag(stream.getvalue(), TagEdit(focal_plane=(666, 500, 7.44))))["Exif"]
    density = tags[piexif.ExifIFD.FocalPlaneXResolution]
    assert 666 * 25.4 / (density[0] / density[1]) == pytest.approx(7.44, abs=1e-4)
    assert (tags[piexif.ExifIFD.PixelXDimension], tags[piexif.ExifIFD.PixelYDimension]) == (666, 500)


def _with_dji_calibration(data: bytes, tags: bytes) -> bytes:
    body = b"http://ns.adobe.com/xap/1.0/\x00" + XMP.replace(b"drone-dji:CaptureUUID", tags + b" drone-dji:CaptureUUID")
    old = next(s for s in jpeg.segments(data)[0] if data.startswith(b"http://ns.adobe.com/xap", s.start))
    return data[: old.start - 4] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + data[old.end :]


@pytest.mark.parametrize("size", [(256, 192), (295, 221), (480, 360), (117, 88)])
@pytest.mark.parametrize(
    "tags",
    [
        b'drone-dji:CalibratedFocalLength="280.5"',
        b'drone-dji:DewarpData="2022-01-01;280.5,280.7,3.1,-2.2,0.01,-0.02,0.001,0.002,0.03"',
        b'drone-dji:CalibratedFocalLength="280.5" drone-dji:CalibratedOpticalCenterX="160.2" '
        b'drone-dji:CalibratedOpticalCenterY="120.1"',
        b'xmlns:Camera="http://pix4d.com/camera/1.0/" Camera:PerspectiveFocalLength="280.5" '
        b'Camera:PerspectiveFocalLengthUnits="pixels" Camera:PrincipalPoint="6.6,4.4"',
    ],
)
def test_calibrations_that_count_pixels_are_read_right_from_a_resampled_frame(tags, size):
    """The packet stays as it is, so its pixels are those of the original: the file says which size that had."""
    data = _with_dji_calibration(jpeg_bytes(320, 240), tags)
    before = frame_from_header("a.jpg", {0: data}, len(data))
    result = shrink(data, 320, 240, size)
    after = frame_from_header("a.jpg", {0: result}, len(result))
    assert before.calibration is not None and after.calibration is not None
    assert (after.original_width, after.original_height) == (320, 240)
    assert after.calibration.focal_px / size[0] == pytest.approx(before.calibration.focal_px / 320, rel=1e-6)
    assert after.calibration.distortion == before.calibration.distortion
    if before.calibration.center_px is not None:
        wanted = [c * s / o for c, s, o in zip(before.calibration.center_px, size, (320, 240))]
        assert after.calibration.center_px == pytest.approx(wanted, rel=5e-3)
    again = shrink(result, *size, (200, 150))
    twice = frame_from_header("a.jpg", {0: again}, len(again))
    assert (twice.original_width, twice.original_height) == (320, 240)
    assert twice.calibration.focal_px / 200 == pytest.approx(before.calibration.focal_px / 320, rel=1e-6)


def test_a_frame_shrunk_by_its_owner_is_told_by_the_size_in_exif():
    data = _with_dji_calibration(jpeg_bytes(320, 240), b'drone-dji:CalibratedFocalLength="280.5"')
    shrunk = jpeg.with_header_of(data, encode_jpeg(texture(160, 120), (2, 1), DEFAULTS), TagEdit())
    before = frame_from_header("a.jpg", {0: shrunk}, len(shrunk))
    assert before.calibration.focal_px == pytest.approx(140.25) and before.original_width is None
    for result in (
        shrink(shrunk, 160, 120, (128, 96)),
        retag(shrunk, TagEdit(focal_plane=(160, 120, 13.2))),
    ):
        after = frame_from_header("a.jpg", {0: result}, len(result))
        assert (after.original_width, after.original_height) == (320, 240)
        assert after.calibration.focal_px / after.width == pytest.approx(280.5 / 320)


def test_a_full_exif_block_goes_without_the_original_size():
    others = len(exif_block(320, 240, thumbnail=False, MakerNote=b""))
    note = b"N" * (0xFFFD - 20 - others)
    data = jpeg_bytes(320, 240, exif=exif_block(320, 240, thumbnail=False, MakerNote=note))
    result = shrink(data, 320, 240, (256, 192))
    with Image.open(io.BytesIO(result)) as image:
        assert image.size == (256, 192) and 0xC791 not in image.getexif()


def test_a_frame_without_exif_still_tells_its_original_size_beside_an_xmp_packet():
    out = io.BytesIO()
    Image.fromarray(texture(320, 240)).save(out, "JPEG", xmp=XMP)
    result = shrink(out.getvalue(), 320, 240, (256, 192))
    after = frame_from_header("a.jpg", {0: result}, len(result))
    assert (after.original_width, after.original_height) == (320, 240) and result.count(XMP) == 1
