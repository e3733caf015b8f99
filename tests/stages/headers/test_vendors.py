"""What DJI, MicaSense, Parrot and FLIR write: calibration, position, rigs, bands."""

from __future__ import annotations

import math

import pytest

from .build import RATIONAL, SHORT, exif_stream, packet, read, tiff_file, with_xmp

P4RTK = (
    'drone-dji:DewarpData="2018-09-04;3678.87,3671.84,10.1,27.29,-0.267998,0.114,0.000427,-0.0001,-0.035" '
    'drone-dji:CalibratedOpticalCenterX="{x}" drone-dji:CalibratedOpticalCenterY="{y}" '
)


def lens(focal_mm=8.8, written=None, resolution=None, unit=3):
    rows = [(0x920A, RATIONAL, (round(focal_mm * 100), 100))]
    if written:
        rows += [(0xA002, SHORT, written[0]), (0xA003, SHORT, written[1])]
    if resolution:
        rows += [(0xA20E, RATIONAL, (round(resolution * 1000), 1000)), (0xA210, SHORT, unit)]
    return exif_stream(exif=rows)


def test_dewarp_data_is_pixels_of_the_full_sensor_with_the_centre_as_an_offset():
    dewarp = "date;64.0,66.0,1.0,-2.0,-0.26,0.11,0.0004,-0.0001,-0.03"
    frame = with_xmp(f'drone-dji:DewarpData="{dewarp}" drone-dji:DewarpFlag="0"', size=(80, 60))
    assert frame.dewarp_flag == 0
    assert frame.calibration.source == "xmp-dewarp"
    assert (frame.calibration.focal_px, frame.calibration.center_px) == (65.0, (41.0, 28.0))
    assert frame.calibration.aspect_ratio == 66.0 / 64.0
    assert frame.calibration.distortion == (-0.26, 0.11, 0.0004, -0.0001, -0.03)


@pytest.mark.parametrize(
    ("size", "scale"),
    [((5472, 3648), 1.0), ((4864, 3648), 1.0), ((5472, 3078), 1.0), ((2736, 1824), 0.5)],
    ids=["full", "4:3 crop", "16:9 crop", "half"],
)
def test_dewarp_data_follows_a_reduced_frame_and_not_a_crop(size, scale):
    xmp = packet(attributes=P4RTK.format(x="2736.0", y="1824.0"))
    frame = read(tiff_file([(700, 1, list(xmp))], size=size, bits=8), "a.tif")
    assert frame.calibration.focal_px == pytest.approx((3678.87 + 3671.84) / 2 * scale)
    assert frame.calibration.aspect_ratio == pytest.approx(3671.84 / 3678.87)
    assert frame.calibration.center_px == pytest.approx((size[0] / 2 + 10.1 * scale, size[1] / 2 + 27.29 * scale))


@pytest.mark.parametrize(
    "text", ["", "date;1,2,3", "date;a,b,c,d,e,f,g,h,i", "0", "date;0,0,0,0,0,0,0,0,0", "x;5,5,0,0,0,0,0,0,0"]
)
def test_dewarp_data_that_is_none(text):
    frame = with_xmp(f'drone-dji:DewarpData="{text}"', size=(80, 60))
    assert frame.calibration is None


def test_focals_that_no_lens_has_together_are_no_calibration():
    frame = with_xmp('drone-dji:DewarpData="date;64,90,0,0,0,0,0,0,0"', size=(80, 60))
    assert frame.calibration is None and "calibration-focal-impossible:DewarpData" in frame.problems


def test_calibrated_focal_length_is_pixels():
    attributes = (
        'drone-dji:CalibratedFocalLength="3666.666504" drone-dji:CalibratedOpticalCenterX="2736.0" '
        'drone-dji:CalibratedOpticalCenterY="1824.0"'
    )
    frame = read(tiff_file([(700, 1, list(packet(attributes=attributes)))], size=(5472, 3648), bits=8), "a.tif")
    assert frame.calibration.source == "xmp-calibrated" and frame.calibration.distortion is None
    assert frame.calibration.focal_px == pytest.approx(3666.666504)


@pytest.mark.parametrize(
    ("focal", "unit", "exif_focal", "in_pixels"),
    [
        ("5.43", "", 5.5, False),
        ("1450.2", "", 5.5, True),
        ("5.43", "mm", None, False),
        ("1450.2", "pixel", None, True),
        ("25", "", 25, False),
        ("100", "", None, True),
        ("1.8", "", None, False),
    ],
)
def test_the_unit_of_a_perspective_focal(focal, unit, exif_focal, in_pixels):
    attributes = f'Camera:PerspectiveFocalLength="{focal}"'
    attributes += f' Camera:PerspectiveFocalLengthUnits="{unit}"' if unit else ""
    calibration = with_xmp(attributes, exif=lens(exif_focal) if exif_focal else b"", size=(160, 120)).calibration
    assert (calibration.focal_px, calibration.focal_mm) == ((float(focal), None) if in_pixels else (None, float(focal)))


@pytest.mark.parametrize(("unit", "per_mm"), [(2, 1 / 25.4), (3, 1 / 10), (4, 1.0), (5, 1000.0)])
def test_principal_point_is_millimetres_from_the_top_left_corner(unit, per_mm):
    exif = lens(5.5, resolution=20.0 / per_mm, unit=unit)
    attributes = 'Camera:PerspectiveFocalLength="5.4" Camera:PrincipalPoint="2.1,1.4"'
    frame = with_xmp(attributes, exif=exif, size=(80, 60))
    assert frame.calibration.center_px == pytest.approx((42.0, 28.0), rel=1e-3)
    assert with_xmp(attributes, exif=lens(5.5), size=(80, 60)).calibration.center_px is None


def test_a_resized_frame_scales_its_calibration():
    attributes = 'Camera:PerspectiveFocalLength="1400" Camera:PrincipalPoint="2.4,1.8"'
    small = with_xmp(attributes, exif=lens(5.5, (1280, 960), 266.6667, 4), size=(640, 480))
    assert small.calibration.focal_px == 700.0
    assert small.calibration.center_px == pytest.approx((320, 240), rel=1e-4)
    cropped = with_xmp(attributes, exif=lens(5.5, (1280, 960), 266.6667, 4), size=(640, 600))
    assert cropped.calibration.focal_px == 1400.0


def test_a_principal_point_of_another_size_is_dropped():
    attributes = 'Camera:PerspectiveFocalLength="5.4" Camera:PrincipalPoint="2.4,1.8"'
    frame = with_xmp(attributes, exif=lens(5.5, resolution=266.7, unit=4), size=(320, 240))
    assert frame.calibration.center_px is None
    assert frame.problems == ("calibration-center-outside:principal point",)


def test_perspective_distortion_is_put_in_opencv_order():
    attributes = 'Camera:PerspectiveFocalLength="5.4" Camera:PerspectiveDistortion="1,2,3,4,5"'
    assert with_xmp(attributes).calibration.distortion == (1.0, 2.0, 4.0, 5.0, 3.0)


def test_a_fisheye_has_its_focal_from_the_affine_matrix():
    attributes = (
        'Camera:ModelType="Fisheye" Camera:FisheyeAffineMatrix="1600,0,0,1600" '
        'Camera:FisheyePolynomial="0,1,0.006,-0.137" Camera:PerspectiveFocalLength="4.0"'
    )
    frame = with_xmp(attributes)
    assert frame.projection == "fisheye" and frame.calibration.projection == "fisheye"
    assert frame.calibration.focal_px == pytest.approx(1600 * 2 / math.pi)
    assert frame.calibration.distortion == (0.0, 1.0, 0.006, -0.137)
    assert frame.calibration.fisheye_affine == (1600.0, 0.0, 0.0, 1600.0)


def test_rtk_altitudes_and_gimbal():
    frame = with_xmp(
        'drone-dji:RtkFlag="50" drone-dji:RtkStdLon="0.011" drone-dji:RtkStdLat="0.012" drone-dji:RtkStdHgt="0.03" '
        'drone-dji:AbsoluteAltitude="+512.25" drone-dji:RelativeAltitude="-3.5" drone-dji:AltitudeType="RtkAlt" '
        'drone-dji:GimbalPitchDegree="-89.9" drone-dji:GimbalYawDegree="+170.1" drone-dji:GimbalRollDegree="+180.0" '
        'drone-dji:FlightXSpeed="3.0" drone-dji:FlightYSpeed="-4.0" drone-dji:ImageSource="WideCamera" '
        'drone-dji:CaptureUUID="u-1" drone-dji:SensorIndex="2"'
    )
    assert (frame.rtk_flag, frame.rtk_std_m) == (50, (0.011, 0.012, 0.03))
    assert (frame.altitude_m, frame.relative_altitude_m, frame.altitude_type) == (512.25, -3.5, "RtkAlt")
    assert (frame.yaw_deg, frame.pitch_deg, frame.roll_deg, frame.speed_mps) == (170.1, -89.9, 180.0, 5.0)
    assert (frame.image_source, frame.capture_id, frame.rig_index) == ("WideCamera", "u-1", 2)
    assert with_xmp('drone-dji:RtkStdLon="0.01" drone-dji:RtkStdLat="0.01"').rtk_std_m is None


@pytest.mark.parametrize(
    "attributes",
    [
        'drone-dji:GpsLatitude="+46.5" drone-dji:GpsLongitude="-7.25"',
        'drone-dji:GpsLatitude="46.5" drone-dji:GpsLongtitude="-7.25"',
        'exif:GPSLatitude="46,30.0N" exif:GPSLongitude="7,15.0W"',
        'exif:GPSLatitude="46,30,0N" exif:GPSLongitude="7,15,0W"',
    ],
)
def test_position_only_in_xmp(attributes):
    frame = with_xmp(attributes)
    assert (frame.latitude, frame.longitude, frame.gps_reference_missing) == (46.5, -7.25, False)


@pytest.mark.parametrize(
    "attributes",
    ['drone-dji:GpsLatitude="+91" drone-dji:GpsLongitude="0"', 'drone-dji:GpsLatitude="n/a" drone-dji:GpsLongitude="7"',
     'drone-dji:GpsLatitude="0.0" drone-dji:GpsLongitude="0.0"', 'drone-dji:GpsLatitude="46.5"'],
)  # fmt: skip
def test_no_position_in_xmp(attributes):
    assert with_xmp(attributes).latitude is None


def test_numbers_that_are_none_are_told_once():
    frame = with_xmp('drone-dji:RelativeAltitude="nan" drone-dji:RtkFlag="fixed" drone-dji:GimbalPitchDegree="1e999"')
    assert (frame.relative_altitude_m, frame.rtk_flag, frame.pitch_deg) == (None, None, None)
    assert set(frame.problems) == {
        "xmp-not-a-number:RelativeAltitude", "xmp-not-a-number:RtkFlag", "xmp-not-a-number:GimbalPitchDegree",
    }  # fmt: skip


def test_make_and_model_from_xmp_where_exif_has_none():
    frame = with_xmp('tiff:Make="DJI" tiff:Model="FC6310" aux:Lens="24mm"')
    assert (frame.make, frame.model, frame.xmp_make, frame.xmp_model, frame.xmp_lens) == (
        "DJI", "FC6310", "DJI", "FC6310", "24mm",
    )  # fmt: skip
    frame = with_xmp('tiff:Make="DJI" tiff:Model="FC6310"', exif=exif_stream([(0x010F, 2, "Acme"), (0x0110, 2, "X")]))
    assert (frame.make, frame.model, frame.xmp_make, frame.xmp_model) == ("Acme", "X", "DJI", "FC6310")


@pytest.mark.parametrize(
    ("attributes", "bands", "wavelength"),
    [
        ('Camera:BandName="NIR" Camera:CentralWavelength="840"', ("NIR",), 840.0),
        ('Camera:BandName="Red, Green, Blue" Camera:CentralWavelength="660,560,475"', ("Red", "Green", "Blue"), None),
        ('FLIR:BandName="LWIR" FLIR:CentralWavelength="10000"', ("LWIR",), 10000.0),
        ("", (), None),
    ],
)
def test_bands(attributes, bands, wavelength):
    frame = with_xmp(attributes)
    assert (frame.bands, frame.wavelength_nm) == (bands, wavelength)


@pytest.mark.parametrize(
    ("attributes", "panel"),
    [('Camera:CalibrationPicture="0"', False), ('Camera:CalibrationPicture="1"', True),
     ('Camera:CalibrationPicture="2"', True), ('MicaSense:PanelSerial="RP04"', True), ("", False)],
)  # fmt: skip
def test_panel_captures(attributes, panel):
    assert with_xmp(attributes).panel is panel


@pytest.mark.parametrize(
    ("attributes", "pitch", "height"),
    [
        ('Camera:Pitch="5.2" Camera:Yaw="-16.8"', -84.8, None),
        ('Camera:Pitch="-8759/100" FLIR:MAVRelativeAltitude="61500/1000"', -87.59, 61.5),
        ('drone-parrot:CameraPitchDegree="-90.2" Camera:AboveGroundAltitude="40130/1000"', -90.2, 40.13),
    ],
    ids=["Pix4D counts from nadir", "FLIR from the horizon", "ANAFI"],
)
def test_every_maker_counts_its_pitch_and_height_in_its_own_way(attributes, pitch, height):
    space = 'xmlns:drone-parrot="http://www.parrot.com/drone-parrot/1.0/" '
    frame = with_xmp(space + attributes, size=(80, 60))
    assert frame.pitch_deg == pytest.approx(pitch)
    assert frame.relative_altitude_m == height
