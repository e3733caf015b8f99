"""The plugin from its archive in a little WebODM: Python 3.9, Django and DRF of WebODM's versions."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Dict, List

import piexif
import pytest
from PIL import Image
from sensorgate.plugin.webodm.archive import write_archive

ROOT = Path(__file__).resolve().parents[3]
INSIDE = Path(__file__).with_name("inside")
# What WebODM 3.2.4 installs.
PACKAGES = (
    *("Django==2.2.27", "djangorestframework==3.13.1", "pytz==2020.1", "numpy==1.26.2", "pillow==11.3.0"),
    *("Jinja2>=3.0", "pytest>=7.4"),
)


@pytest.fixture(scope="module")
def python() -> Path:
    """Python 3.9 with WebODM's packages, made once and kept in ``build``."""
    found = subprocess.run([str(ROOT / ".ci/python39")], capture_output=True, text=True, check=False)
    if found.returncode:
        pytest.skip("no Python 3.9 on this machine")
    home = ROOT / "build/venv-webodm"
    stamp, own = home / "stamp", hashlib.sha256(repr(PACKAGES).encode()).hexdigest()
    interpreter = home / "bin/python"
    if not stamp.is_file() or stamp.read_text() != own:
        subprocess.run([found.stdout.strip(), "-m", "venv", "--clear", str(home)], check=True)
        done = subprocess.run(
            [str(interpreter), "-m", "pip", "install", "-q", *PACKAGES], capture_output=True, text=True, check=False
        )
        if done.returncode:
            pytest.skip(f"WebODM's packages cannot be installed: {done.stderr.strip()[-200:]}")
        stamp.write_text(own)
    return interpreter


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("archive") / "sensorgate.zip"
    write_archive(file, ROOT)
    return file


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Dict[str, List[str]]:
    """Two cameras over two places, with equal file names."""
    root = tmp_path_factory.mktemp("frames")
    return {
        "one": [_frame(root / "one", n, "DJI", "FC6310", 46.00, (8800, 1000)) for n in range(8)],
        "two": [_frame(root / "two", n, "Canon", "PowerShot S110", 46.20, (5200, 1000)) for n in range(8)],
    }


def _frame(folder: Path, number: int, make: str, model: str, latitude: float, focal: "tuple[int, int]") -> str:
    folder.mkdir(exist_ok=True)

    def degrees(value: float) -> "tuple[tuple[int, int], ...]":
        whole = int(value)
        return ((whole, 1), (0, 1), (round((value - whole) * 3600 * 10000), 10000))

    exif = piexif.dump(
        {
            "0th": {piexif.ImageIFD.Make: make, piexif.ImageIFD.Model: model},
            "Exif": {
                piexif.ExifIFD.FocalLength: focal,
                piexif.ExifIFD.DateTimeOriginal: f"2024:05:01 10:00:{5 * number:02d}",
            },
            "GPS": {
                piexif.GPSIFD.GPSLatitudeRef: "N",
                piexif.GPSIFD.GPSLatitude: degrees(latitude + 0.0002 * (number % 4)),
                piexif.GPSIFD.GPSLongitudeRef: "E",
                piexif.GPSIFD.GPSLongitude: degrees(8.0 + 0.0002 * (number // 4)),
                piexif.GPSIFD.GPSAltitudeRef: 0,
                piexif.GPSIFD.GPSAltitude: (500, 1),
            },
        }
    )
    file = folder / f"DJI_{number:04d}.JPG"
    Image.new("RGB", (800, 600), (number, 90, 60)).save(file, exif=exif)
    return str(file)


@pytest.mark.parametrize("subject", ["api", "hold"])
def test_inside_a_little_webodm(
    subject: str, python: Path, archive: Path, frames: Dict[str, List[str]], tmp_path: Path
) -> None:
    environment = {
        **{k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")},
        "INSIDE_MEDIA": str(tmp_path),
        "INSIDE_ARCHIVE": str(archive),
        "INSIDE_FRAMES": json.dumps(frames),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    # A rootdir of its own: the settings of this repository's tests are not for it.
    command = [str(python), "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, f"--rootdir={INSIDE}"]
    command.append(f"--confcutdir={INSIDE}")
    done = subprocess.run(
        [*command, str(INSIDE / f"inside_{subject}.py")],
        cwd=str(INSIDE),
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]


def test_the_archive_is_what_the_admin_page_takes(archive: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(archive) as opened:
        opened.extractall(tmp_path)
        names = opened.namelist()
    folders = os.listdir(tmp_path)
    assert len(folders) == 1 and "." not in folders[0] and not folders[0].endswith("test")
    root = tmp_path / folders[0]
    assert all((root / name).is_file() for name in ("__init__.py", "plugin.py", "manifest.json"))
    manifest = json.loads((root / "manifest.json").read_text(encoding="utf-8"))
    assert tuple(int(n) for n in manifest["webodmMinVersion"].split(".")) <= (3, 2, 4)
    assert not any("requirements.txt" in n or "__pycache__" in n or n.endswith(".pyc") for n in names)
    assert not any("/tests/" in n for n in names)
    for needed in ("public/main.js", "templates/menu.html", "templates/report.html"):
        assert (root / "plugin/webodm" / needed).is_file()
    assert (root / "stages/sensors.json").is_file() and (root / "plugin/report/report.html").is_file()


def test_the_same_tree_gives_the_same_archive(archive: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.zip"
    write_archive(again, ROOT)
    assert again.read_bytes() == archive.read_bytes()


def test_outside_of_webodm_the_plugin_is_a_plain_package(archive: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(archive) as opened:
        opened.extractall(tmp_path)
    code = (
        "import sensorgate, sensorgate.plugin.webodm.proposal, sensorgate.plugin.webodm.verdict, sys\n"
        "assert not hasattr(sensorgate, 'Plugin')\n"
        "heavy = {'django', 'cv2', 'pycolmap', 'jinja2', 'osgeo'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)
