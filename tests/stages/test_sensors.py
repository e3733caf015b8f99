"""The calibration sheet: what its rows hold, how they are found, and the user's own sheet."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensorgate.stages import record, sensors
from sensorgate.stages.errors import UsageError
from sensorgate.stages.focals import equivalent_ratio
from sensorgate.stages.profile import SPECTRA
from sensorgate.stages.sensors import CROPPED, EXACT, MODEL_ONLY, SCALED, SheetRow, built_in_rows, load_sheet
from sensorgate.stages.thresholds import DEFAULTS

ROWS = built_in_rows()
SHEET = load_sheet()
FILE = Path(sensors.__file__).with_name("sensors.json")
KEYS = {f.name for f in dataclasses.fields(SheetRow)} - {"origin", "match", "serial", "center_px", "focal_px"}


def ids(rows: Any) -> List[str]:
    return [r.id for r in rows]


def test_the_file_has_only_known_keys_and_every_row_its_source() -> None:
    raw: List[Dict[str, Any]] = json.loads(FILE.read_text(encoding="utf-8"))["rows"]
    assert len(raw) >= 200
    for row in raw:
        assert set(row) <= KEYS, row["id"]
        assert row["source"] and row["makes"] and row["models"], row["id"]
    assert len({r["id"] for r in raw}) == len(raw)


@pytest.mark.parametrize("row", ROWS, ids=ids(ROWS))
def test_a_row_is_physical(row: SheetRow) -> None:
    assert row.spectrum in SPECTRA
    assert row.projection in ("brown", "fisheye")
    assert row.shutter in ("", "rolling", "global")
    assert row.spectrum == "multispectral" or row.band == ("lwir" if row.spectrum == "thermal" else "")
    assert all(w > 0 and h > 0 for w, h in row.sizes)
    if row.sensor_width_mm is not None:
        assert DEFAULTS.sensor_width_min_mm <= row.sensor_width_mm <= 60.0
    if row.zoom:
        assert row.focal_mm is None
    if row.focal_mm is not None and row.sensor_width_mm is not None:
        assert 0.3 <= row.focal_mm / row.sensor_width_mm <= 6.0


@pytest.mark.parametrize("row", [r for r in ROWS if r.pixel_um and r.sizes], ids=lambda r: r.id)
def test_pitch_times_pixels_is_the_width(row: SheetRow) -> None:
    across = row.pitch_px or max(w for w, _ in row.sizes)
    assert row.pixel_um is not None
    assert row.sensor_width_mm == pytest.approx(row.pixel_um * across / 1000.0, rel=0.03)
    for width, _, width_mm in row.modes:
        assert width_mm == pytest.approx(row.pixel_um * width / 1000.0, rel=0.03)


@pytest.mark.parametrize(
    "row", [r for r in ROWS if r.focal_mm and r.focal_35mm and r.sensor_width_mm], ids=lambda r: r.id
)
def test_focal_and_width_agree_with_the_published_equivalent(row: SheetRow) -> None:
    assert row.focal_mm and row.sensor_width_mm
    ratio = equivalent_ratio(row.focal_35mm, *row.sizes[0])
    assert row.focal_mm / row.sensor_width_mm == pytest.approx(ratio, rel=0.12)


def test_no_two_rows_answer_to_the_same_key() -> None:
    seen: Dict[Tuple[Any, ...], str] = {}
    for row in ROWS:
        for make, model in itertools.product(row.makes, row.models):
            for size in [*row.sizes, *((w, h) for w, h, _ in row.modes)] or [(0, 0)]:
                for source in row.image_sources or ("",):
                    key = (
                        sensors._plain_make(make),
                        sensors._plain_model(make, model),
                        size,
                        row.spectrum,
                        row.band,
                        source,
                        row.focal_mm,
                    )
                    assert seen.setdefault(key, row.id) == row.id, f"{row.id} and {seen[key]} on {key}"


def test_the_sheet_finds_each_row_by_its_own_key() -> None:
    for row in ROWS:
        for size in row.sizes:
            found = SHEET.candidates(
                row.makes[0],
                row.models[0],
                *size,
                spectrum=row.spectrum,
                image_source=row.image_sources[0] if row.image_sources else "",
                focal_mm=row.focal_mm,
                band=row.band,
            )
            assert row.id in ids(found), (row.id, size, ids(found))
            assert all(f.match == EXACT for f in found)


@given(
    st.sampled_from(ROWS),
    st.sampled_from([str.lower, str.upper, lambda t: f"  {t} ", lambda t: t.replace(" ", "  ")]),
)
def test_spelling_of_names_does_not_matter(row: SheetRow, spelled: Any) -> None:
    plain = SHEET.rows_for(row.makes[0], row.models[0])
    assert SHEET.rows_for(spelled(row.makes[0]), spelled(row.models[0])) == plain
    assert row in plain


@pytest.mark.parametrize(
    "asked, width, match",
    [
        (("DJI", "FC300S", 4000, 3000), 6.17, EXACT),
        (("DJI", "FC300S", 4000, 2250), 6.17, EXACT),
        (("DJI", "FC300S", 2000, 1500), 6.17, SCALED),
        (("DJI", "FC300S", 4000, 2400), 6.17, CROPPED),
        (("DJI", "FC6310", 4864, 3648), 11.67, EXACT),
        (("DJI", "FC6310", 5472, 3078), 13.13, EXACT),
        (("DJI", "FC6310", 3648, 5472), 13.13 * 3648 / 5472, EXACT),
        (("DJI", "PHANTOM VISION FC200", 4384, 3288), 6.17, MODEL_ONLY),
    ],
)
def test_width_per_size(asked: Tuple[str, str, int, int], width: float, match: str) -> None:
    row = SHEET.find(*asked)
    assert row is not None
    assert row.sensor_width_mm == pytest.approx(width, rel=1e-3)
    assert row.match == match
    assert row.width_source == ("sheet" if match == EXACT else "generic-width")


def test_a_size_of_another_shape_is_not_guessed() -> None:
    assert SHEET.find("DJI", "FC300S", 3000, 3000) is None
    assert SHEET.find("DJI", "NO-SUCH-CAMERA", 4000, 3000) is None
    assert SHEET.find("", "", 4000, 3000) is None


def test_cameras_of_one_name_are_told_apart() -> None:
    wide = SHEET.find("DJI", "M3T", 4000, 3000, image_source="WideCamera")
    tele = SHEET.find("DJI", "M3T", 4000, 3000, image_source="ZoomCamera")
    by_focal = SHEET.find("DJI", "M3T", 4000, 3000, focal_mm=29.8)
    thermal = SHEET.find("DJI", "M3T", 640, 512)
    assert wide and tele and by_focal and thermal
    assert (wide.focal_mm, tele.focal_mm, thermal.focal_mm) == (4.4, 29.9, 9.1)
    assert by_focal.id == tele.id
    assert thermal.spectrum == "thermal"
    m4t = [SHEET.find("DJI", "M4T", 8064, 6048, focal_mm=f) for f in (6.7, 19.4)]
    assert [r.id for r in m4t if r] == ["dji-m4t-wide", "dji-m4t-medium-tele"]
    m30t = [SHEET.find("DJI", "M30T", w, h, spectrum="thermal") for w, h in ((640, 512), (1280, 1024))]
    assert [r.sensor_width_mm for r in m30t if r] == [7.68, 7.68]
    assert ids([r for r in [SHEET.find("Parrot", "Sequoia", 1280, 960, band="nir")] if r]) == ["parrot-sequoia-nir"]


def test_equal_lenses_of_one_name_without_anything_to_tell_them_are_not_guessed() -> None:
    assert SHEET.find("DJI", "M3T", 4000, 3000) is None
    assert SHEET.find("DJI", "ZH20N", 640, 512) is None


def test_rows_go_to_json_and_back() -> None:
    for row in ROWS:
        assert record.from_plain(SheetRow, json.loads(record.dumps(row))) == row


def test_general_table_is_optional_and_near_where_it_is_installed() -> None:
    width = sensors.general_width_mm("NIKON CORPORATION", "NIKON D3400", 6000, 4000)
    if width is None:
        pytest.skip("lensfunpy is not installed")
    assert width == pytest.approx(23.5, rel=0.03)
    assert sensors.general_width_mm("Nobody", "Nothing", 6000, 4000) is None


# --- the user's own sheet -----------------------------------------------------


def write(folder: Path, name: str, text: str) -> Path:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


FULL = (
    "make,model,width,height,serial,sensor_width_mm,focal_mm,k1,k2,p1,p2,k3,cx,cy\n"
    "DJI,FC6310,5472,3648,ABC1,13.2,8.75,-0.01,0.02,0.001,-0.002,0.003,2740,1820\n"
)


def test_a_users_row_wins_and_carries_its_calibration(tmp_path: Path) -> None:
    sheet = load_sheet(write(tmp_path, "own.csv", FULL))
    row = sheet.find("dji", "fc6310", 5472, 3648, serial="ABC1")
    assert row is not None
    assert (row.width_source, row.sensor_width_mm, row.focal_mm) == ("user-sheet", 13.2, 8.75)
    assert row.distortion == (-0.01, 0.02, 0.001, -0.002, 0.003)
    assert row.center_px == (2740.0, 1820.0)
    other = sheet.find("DJI", "FC6310", 5472, 3648, serial="OTHER")
    assert other is not None and other.width_source == "sheet"
    assert sheet.find("DJI", "FC220", 4000, 3000) == SHEET.find("DJI", "FC220", 4000, 3000)


def test_json_and_csv_say_the_same(tmp_path: Path) -> None:
    header, values = (line.split(",") for line in FULL.strip().split("\n"))
    numbers = {k: (v if k in ("make", "model", "serial") else float(v)) for k, v in zip(header, values)}
    by_csv = load_sheet(write(tmp_path, "own.csv", FULL)).rows[0]
    assert load_sheet(write(tmp_path, "own.json", json.dumps([numbers]))).rows[0] == by_csv
    assert load_sheet(write(tmp_path, "rows.json", json.dumps({"rows": [numbers]}))).rows[0] == by_csv
    semicolons = write(tmp_path, "semi.csv", "\ufeff# ours\n" * 0 + FULL.replace(",", ";"))
    assert load_sheet(semicolons).rows[0] == by_csv


def test_a_focal_in_pixels_needs_no_sensor_width(tmp_path: Path) -> None:
    sheet = load_sheet(write(tmp_path, "own.csv", "make,model,width,height,focal_px\nA,B,4000,3000,2800\n"))
    row = sheet.find("A", "B", 4000, 3000)
    assert row is not None and row.focal_px == 2800.0 and row.sensor_width_mm is None
    assert sheet.find("A", "B", 4000, 2000) is None


@pytest.mark.parametrize(
    "name, text, said",
    [
        ("a.csv", "", "empty"),
        ("a.csv", "make,model,width_mm\nA,B,3\n", "line 1, column 'width_mm'"),
        ("a.csv", "make,model,sensor_width_mm\nA,B,wide\n", "line 2, column 'sensor_width_mm'"),
        ("a.csv", "make,model,sensor_width_mm\n\nA,B,-3\n", "line 3, column 'sensor_width_mm'"),
        ("a.csv", "make,model,sensor_width_mm\nA,B,nan\n", "line 2, column 'sensor_width_mm'"),
        ("a.csv", "make,model,sensor_width_mm\nA,,3\n", "line 2, column 'model'"),
        ("a.csv", "make,model,sensor_width_mm\nA,B,\n", "line 2, column 'sensor_width_mm'"),
        ("a.csv", "make,model,sensor_width_mm\nA,B,3,4\n", "line 2, column 4"),
        ("a.csv", "make,model,focal_px\nA,B,3000\n", "line 2, column 'width'"),
        ("a.csv", "make,model,width,sensor_width_mm\nA,B,10,3\n", "line 2, column 'height'"),
        ("a.csv", "make,model,spectrum,sensor_width_mm\nA,B,pink,3\n", "line 2, column 'spectrum'"),
        ("a.csv", "make,model,width,height,sensor_width_mm,cx,cy\nA,B,10,10,3,5,11\n", "line 2, column 'cy'"),
        ("a.json", "[{", "line 1, column"),
        ("a.json", '{"a": 1}', "list of rows"),
        ("a.json", "[3]", "row 1"),
        ("a.json", '[{"make": "A", "model": "B", "sensor_width_mm": true}]', "row 1, column 'sensor_width_mm'"),
        ("a.json", '[{"make": ["A"], "model": "B", "sensor_width_mm": 3}]', "row 1, column 'make'"),
        ("a.json", "[" * 100000, "a.json"),
    ],
)
def test_a_bad_sheet_is_refused_by_line_and_column(tmp_path: Path, name: str, text: str, said: str) -> None:
    with pytest.raises(UsageError) as caught:
        load_sheet(write(tmp_path, name, text))
    assert said in str(caught.value)
    assert name in str(caught.value)


def test_a_missing_or_binary_sheet_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        load_sheet(tmp_path / "none.csv")
    binary = tmp_path / "b.csv"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(UsageError, match="UTF-8"):
        load_sheet(binary)


@given(st.text(max_size=200))
def test_no_text_breaks_the_reader_otherwise(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    file = tmp_path_factory.mktemp("sheet") / "any.csv"
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        rows = load_sheet(file).rows
    except UsageError:
        return
    assert all(math.isfinite(r.sensor_width_mm or 1.0) for r in rows)
