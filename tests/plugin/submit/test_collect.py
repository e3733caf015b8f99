"""What comes back from a node is not trusted."""

from __future__ import annotations

import io
import stat
import zipfile

import pytest
from sensorgate.plugin.odm.layout import EVIDENCE
from sensorgate.plugin.submit.collect import outputs_for, set_aside, unpack
from sensorgate.plugin.submit.errors import Refused
from sensorgate.stages.errors import UsageError
from sensorgate.stages.thresholds import DEFAULTS

from .making import files_of, project
from .node_parts import products


def archive(tmp_path, entries, compression=zipfile.ZIP_STORED):
    path = tmp_path / "all.zip"
    with zipfile.ZipFile(path, "w", compression) as made:
        for name, data in entries:
            made.writestr(name, data)
    return path


def test_products_stand_in_the_project(tmp_path):
    folder = project(tmp_path, "rgb")
    before = files_of(folder)
    path = tmp_path / "all.zip"
    path.write_bytes(products(**{"odm_dem/dsm.tif": b"1"}))
    assert unpack(path, folder) == ("odm_dem", "odm_georeferencing", "odm_orthophoto", "odm_report")
    assert (folder / "odm_orthophoto/odm_orthophoto.tif").read_bytes() == b"orthophoto"
    assert files_of(folder) == before and not (folder / ".part-assets").exists()
    assert unpack(path, folder)  # once more over what is there


def link(target: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo("odm_report/link")
    entry.external_attr = (stat.S_IFLNK | 0o777) << 16
    return entry


@pytest.mark.parametrize(
    "name",
    ["../out.txt", "a/../../out.txt", "/etc/out.txt", "C:/out.txt", "..\\out.txt", "a\\..\\..\\out.txt", "c:out.txt"],
)
def test_no_path_leaves_the_project(tmp_path, name):
    folder = project(tmp_path, "rgb")
    there = sorted(p.name for p in tmp_path.rglob("*"))
    with pytest.raises(Refused, match="must not be unpacked"):
        unpack(archive(tmp_path, [("odm_report/a", b"1"), (name, b"x")]), folder)
    (tmp_path / "all.zip").unlink()
    assert sorted(p.name for p in tmp_path.rglob("*")) == there


def test_no_links(tmp_path):
    folder = project(tmp_path, "rgb")
    with pytest.raises(Refused, match="must not be unpacked"):
        unpack(archive(tmp_path, [(link("/etc"), "/etc/passwd")]), folder)


@pytest.mark.parametrize("name", ["images/A.JPG", "Images/A.JPG", "sensorgate/options.json", "gcp_list.txt"])
def test_the_projects_own_input_stays(tmp_path, name):
    folder = project(tmp_path, "rgb")
    with pytest.raises(Refused, match="own"):
        unpack(archive(tmp_path, [(name, b"x")]), folder)


def test_a_bomb_is_stopped_by_bytes_not_by_its_header(tmp_path):
    folder = project(tmp_path, "rgb")
    path = archive(tmp_path, [("odm_report/zeros", bytes(10**7))], zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < 10**5
    with pytest.raises(Refused, match="room"):
        unpack(path, folder, max_bytes=10**6)
    assert not (folder / "odm_report").exists()


def test_too_many_files(tmp_path):
    folder = project(tmp_path, "rgb")
    path = archive(tmp_path, [(f"t/{i}", b"") for i in range(20)])
    with pytest.raises(Refused, match="20 files"):
        unpack(path, folder, DEFAULTS.replaced({"submit_asset_files": 10}))


@pytest.mark.parametrize("data", [b"", b"no zip", products()[:-30], products()[:60]])
def test_damaged_archives(tmp_path, data):
    folder = project(tmp_path, "rgb")
    (tmp_path / "all.zip").write_bytes(data)
    with pytest.raises(Refused, match="damaged"):
        unpack(tmp_path / "all.zip", folder)


def test_damaged_inside(tmp_path):
    folder = project(tmp_path, "rgb")
    data = io.BytesIO(products())
    data.getbuffer()[60] ^= 0xFF
    (tmp_path / "all.zip").write_bytes(data.getvalue())
    with pytest.raises(Refused, match="damaged"):
        unpack(tmp_path / "all.zip", folder)
    assert not (folder / "odm_report").exists()


def test_what_is_asked_of_the_node():
    assert outputs_for(("all.zip",)) == ()
    assert outputs_for(("odm_orthophoto", "log.json"))[0] == "odm_orthophoto"
    # With nothing of the list there, a node was seen to pack the whole task, images and all.
    assert set(EVIDENCE) <= set(outputs_for(("odm_dem",)))
    for name in ("../x", "/etc", "a;b"):
        with pytest.raises(UsageError):
            outputs_for((name,))


def test_a_rejected_result_is_out_of_the_way(tmp_path):
    folder = project(tmp_path, "rgb", gcp="x\n")
    (tmp_path / "all.zip").write_bytes(products())
    unpack(tmp_path / "all.zip", folder)
    set_aside(folder, 1)
    assert sorted(p.name for p in folder.iterdir()) == ["gcp_list.txt", "images", "sensorgate"]
    assert (folder / "sensorgate/rejected-1/odm_orthophoto/odm_orthophoto.tif").is_file()
