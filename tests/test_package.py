"""The package as a user gets it: wheel, import rules, version, and what the gate needs to import."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import numpy
import PIL
import pytest

from tests import simulator

ROOT = Path(__file__).resolve().parents[1]


def test_every_package_is_listed():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    block = re.search(r"^packages = \[(.*?)^\]", text, re.S | re.M)
    assert block
    listed = set(re.findall(r'"([^"]+)"', block.group(1)))
    found = {"sensorgate"}
    for folder in ("stages", "plugin"):
        for init in (ROOT / folder).rglob("__init__.py"):
            found.add("sensorgate." + ".".join(init.parent.relative_to(ROOT).parts))
    assert listed == found


def test_one_version():
    from sensorgate.plugin.version import VERSION

    assert json.loads((ROOT / "manifest.json").read_text(encoding="utf-8"))["version"] == VERSION


def test_no_python_file_stands_at_the_top():
    assert not list(ROOT.glob("*.py"))


def build(kind, source, out):
    """A wheel or an sdist of ``source``, as ``pip`` and ``python -m build`` make them, without the network."""
    command = [sys.executable, "-m", "build", f"--{kind}", "--no-isolation", "--outdir", str(out), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=out)
    assert done.returncode == 0, done.stderr[-2000:]
    (found,) = [*out.glob("sensorgate-*.whl")] if kind == "wheel" else [*out.glob("sensorgate-*.tar.gz")]
    return found


@pytest.fixture(scope="module")
def sdist(tmp_path_factory):
    pytest.importorskip("build")
    return build("sdist", ROOT, tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def wheel(sdist, tmp_path_factory):
    """Built of the unpacked sdist, not of this folder: what is missing there is missing for everybody."""
    home = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(sdist) as archive:
        archive.extractall(home)
    (source,) = home.iterdir()
    return build("wheel", source, tmp_path_factory.mktemp("wheel"))


def data_files():
    """Everything below the packages that is no module."""
    for folder in ("stages", "plugin"):
        for path in (ROOT / folder).rglob("*"):
            if path.is_file() and path.suffix not in (".py", ".pyc") and "__pycache__" not in path.parts:
                yield path.relative_to(ROOT).as_posix()


def test_the_wheel_holds_every_module_and_data_file_and_nothing_else(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    ours = {n for n in names if ".dist-info/" not in n}
    modules = {p.relative_to(ROOT).as_posix() for f in ("stages", "plugin") for p in (ROOT / f).rglob("*.py")}
    data = set(data_files())
    assert {Path(n).suffix for n in data} >= {".json", ".html", ".css", ".js"}
    assert ours == {f"sensorgate/{n}" for n in (*modules, *data, "manifest.json")}
    assert not {n.split("/")[0] for n in ours} & {"stages", "plugin", "tests"}, "would collide with ODM's own stages"


def test_the_sdist_holds_what_a_build_needs(sdist):
    with tarfile.open(sdist) as archive:
        names = {n.partition("/")[2] for n in archive.getnames()}
    assert {"pyproject.toml", "README.md", "LICENSE", "manifest.json"} <= names
    assert set(data_files()) <= names


@pytest.fixture(scope="module")
def empty(wheel, tmp_path_factory):
    """An environment that holds the wheel alone; numpy and Pillow are borrowed from here, and nothing else is."""
    home = tmp_path_factory.mktemp("empty")
    venv.create(home / "env", with_pip=False)
    python = home / "env" / ("Scripts" if os.name == "nt" else "bin") / "python"
    subprocess.run([sys.executable, "-m", "pip", "--python", str(python), "install", "-q", "--no-deps", str(wheel)],
                   check=True)  # fmt: skip
    borrowed = home / "borrowed"
    borrowed.mkdir()
    for module in (numpy, PIL):
        source = Path(module.__file__).parent
        for found in (source, *source.parent.glob(f"{source.name.lower()}.libs")):
            (borrowed / found.name).symlink_to(found)
    return python, {**os.environ, "PYTHONPATH": str(borrowed)}


def sensorgate(empty, *arguments, cwd):
    python, env = empty
    return subprocess.run(
        [python.with_name("sensorgate"), *arguments], capture_output=True, text=True, env=env, cwd=cwd
    )


def test_the_installed_command_runs_the_gate_with_numpy_and_pillow_alone(empty, tmp_path):
    python, env = empty
    lonely = "import importlib.util as u; print([m for m in ('cv2', 'jinja2', 'tqdm', 'pytest') if u.find_spec(m)])"
    assert (
        subprocess.run([python, "-c", lonely], capture_output=True, text=True, env=env, cwd=tmp_path).stdout == "[]\n"
    )
    simulator.render("clean", tmp_path / "survey", seed=0, frames_scale=0.25)
    done = sensorgate(empty, "gate", "survey/images", "--json", "report.json", cwd=tmp_path)
    assert done.returncode in (0, 1), done.stderr
    assert "Traceback" not in done.stderr
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert report["versions"]["sensorgate"] == json.loads((ROOT / "manifest.json").read_text())["version"]
    assert report["frames"] and all(f["focal_source"] for f in report["frames"]), "the sheets came along"


def test_an_empty_folder_is_blocked_and_a_missing_library_is_named(empty, tmp_path):
    (tmp_path / "bare").mkdir()
    assert sensorgate(empty, "gate", "bare", cwd=tmp_path).returncode == 3
    done = sensorgate(empty, "run", "bare", "--out", "out", cwd=tmp_path)
    assert done.returncode == 4 and "sensorgate[sfm]" in done.stderr and "Traceback" not in done.stderr


def test_the_installed_package_writes_the_webodm_archive(empty, tmp_path):
    done = sensorgate(empty, "webodm", "--out", "plugin.zip", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    names = zipfile.ZipFile(tmp_path / "plugin.zip").namelist()
    assert {n.split("/")[0] for n in names} == {"sensorgate"}
    assert {"sensorgate/plugin.py", "sensorgate/manifest.json", "sensorgate/__init__.py"} <= set(names)
