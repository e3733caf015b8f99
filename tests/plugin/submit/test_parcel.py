"""What is sent of a project, and which names would not arrive."""

from __future__ import annotations

import json
import os

import pytest
from sensorgate.plugin.submit.parcel import read_parcels
from sensorgate.stages.errors import UsageError

from .making import CALIBRATION, project, report


def test_a_parcel_counts_what_the_node_counts(tmp_path):
    project(tmp_path, "rgb", ("A.JPG", "B.TIF", "A_mask.png"), gcp="x\n", geo="y\n", calibration=CALIBRATION)
    (tmp_path / "projects/rgb/images/notes.txt").write_text("no image")
    (tmp_path / "projects/rgb/images/.hidden.JPG").write_text("x")
    (parcel,) = read_parcels(tmp_path)
    assert [i.name for i in parcel.items] == ["A.JPG", "A_mask.png", "B.TIF", "gcp_list.txt", "geo.txt"]
    assert parcel.images == 3 and parcel.calibration == CALIBRATION


def test_report_gives_route_and_payloads(tmp_path):
    project(tmp_path, "rgb")
    report(tmp_path, [{"name": "rgb", "route": "unproven", "reasons": ["why"], "payloads": ["p", "q"]}])
    (parcel,) = read_parcels(tmp_path)
    assert (parcel.route, parcel.reasons, parcel.payloads) == ("unproven", ("why",), ("p", "q"))


def test_uuid_follows_the_content(tmp_path):
    folder = project(tmp_path, "rgb")
    (first,) = read_parcels(tmp_path)
    assert first.uuid(1) == read_parcels(tmp_path)[0].uuid(1) != first.uuid(2)
    os.utime(folder / "images/A.JPG", (1, 1))
    assert read_parcels(tmp_path)[0].uuid(1) == first.uuid(1)
    (folder / "images/A.JPG").write_bytes(b"other")
    assert read_parcels(tmp_path)[0].uuid(1) != first.uuid(1)
    (folder / "images/A.JPG").write_bytes(b"")
    with pytest.raises(UsageError, match="empty"):
        read_parcels(tmp_path)


@pytest.mark.parametrize("name", ["align.tif", "-x.JPG", "a b.JPG", "a;b.JPG", "Ü.JPG"])
def test_names_that_would_not_arrive(tmp_path, name):
    project(tmp_path, "rgb", ("A.JPG", name))
    with pytest.raises(UsageError, match="Rename"):
        read_parcels(tmp_path)


def test_names_that_differ_by_case(tmp_path):
    project(tmp_path, "rgb", ("DJI_1.JPG", "DJI_1.jpg"))
    with pytest.raises(UsageError, match="case alone"):
        read_parcels(tmp_path)


@pytest.mark.parametrize("text", ["{}", "[1]", "[{}]", "nonsense", "[" * 100000])
def test_damaged_options(tmp_path, text):
    folder = project(tmp_path, "rgb")
    (folder / "sensorgate/options.json").write_text(text)
    with pytest.raises(UsageError):
        read_parcels(tmp_path)


def test_nothing_to_send(tmp_path):
    with pytest.raises(UsageError, match="sensorgate run"):
        read_parcels(tmp_path)


def test_one_project_folder_alone(tmp_path):
    folder = project(tmp_path, "rgb", options=[{"name": "dsm", "value": True}])
    (parcel,) = read_parcels(folder)
    assert parcel.name == "rgb" and json.dumps(list(parcel.options)) == '[{"name": "dsm", "value": true}]'
