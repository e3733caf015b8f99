"""The folder itself: what it holds, the option list as a node asks for it, and libraries without internet."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from sensorgate.plugin.cli import main
from sensorgate.plugin.node.folder import write_folder
from sensorgate.plugin.node.libraries import Carried, serves, wanted
from sensorgate.stages.errors import UsageError

from .fake import make_odm, no_wheels

# Asks for the options as NodeODM was seen to: modules loaded from files under names of their own, and a parser that
# notes every call in words.
_ASK = """\
import argparse, importlib.machinery, json, sys, types

folder = sys.argv[2]
sys.path.append(folder)


def load(name, file):
    loader = importlib.machinery.SourceFileLoader(name, file)
    module = types.ModuleType(name)
    module.__file__ = file
    loader.exec_module(module)
    return module


for name in ("opendm/__init__", "opendm/context"):
    try:
        load(name, folder + "/" + name + ".py")
    except Exception:
        pass
config = load("config", folder + "/opendm/config.py")
noted = {}


class Noting(argparse.ArgumentParser):
    def add_argument(self, *args, **kwargs):
        super().add_argument(*args, **kwargs)
        noted[args[0]] = {k: str(v) for k, v in kwargs.items()}

    def add_mutually_exclusive_group(self):
        return Noting()


assert not hasattr(config, "parser")
config.config(parser=Noting())
print(json.dumps(noted))
"""


@pytest.fixture(scope="module")
def odm(tmp_path_factory):
    return make_odm(tmp_path_factory.mktemp("odm"))


@pytest.fixture(scope="module")
def front(odm, tmp_path_factory):
    folder = tmp_path_factory.mktemp("front")
    out = folder / "node"
    write_folder(odm, out, wheels=no_wheels(folder))
    return out


def ask(front, **env):
    done = subprocess.run(
        [sys.executable, "-I", "-c", _ASK, "--project-path", str(front), "bogusname"],
        capture_output=True,
        text=True,
        env={**os.environ, **env},
        cwd="/",
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_option_list_is_odms_with_ours(front):
    options = ask(front)
    assert {"--dsm", "--cameras", "--end-with", "--rerun-from", "--project-path"} <= set(options)
    policy = options["--mixed-sensor-policy"]
    # NodeODM makes a list of the text by turning apostrophes into quotation marks.
    assert json.loads(policy["choices"].replace("'", '"')) == ["off", "report", "auto", "strict"]
    assert policy["default"] == "auto"
    assert options["--force-gcp"]["default"] == "False"
    ours = [o for name, o in options.items() if name.startswith(("--mixed", "--force-gcp"))]
    assert len(ours) == 5
    assert all("'" not in o["help"] and "%(" not in o["help"] for o in ours)
    assert all(o.get("metavar", "<string>") == "<string>" for o in ours), "a node refuses other domains"


def test_the_folder_has_what_a_node_reads(front, odm):
    assert os.access(front / "run.sh", os.X_OK)
    assert (front / "run.sh").read_text().startswith("#!")
    assert (front / "VERSION").read_text() == "3.6.0\n"
    assert (front / "site/sensorgate/manifest.json").is_file()
    assert not list((front / "site").rglob("__pycache__")) and not (front / "site/sensorgate/tests").exists()
    assert not list(odm.rglob("sensorgate*"))
    texts = [
        p for p in front.rglob("*") if p.is_file() and p.suffix in (".sh", ".py", ".json") and "site" not in p.parts
    ]
    assert all(str(Path(__file__).resolve().parents[3]) not in p.read_text() for p in texts)


def test_writing_again_replaces_what_was_written(front, odm, tmp_path):
    (front / "site/sensorgate/stages/stale.py").write_text("")
    write_folder(odm, front, wheels=no_wheels(tmp_path))
    assert not (front / "site/sensorgate/stages/stale.py").exists()


def test_wrong_uses_are_told(odm, tmp_path, capsys):
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.txt").write_text("keep")
    with pytest.raises(UsageError, match="not empty"):
        write_folder(odm, full, wheels=no_wheels(tmp_path))
    with pytest.raises(UsageError, match="no ODM"):
        write_folder(full, tmp_path / "o", wheels=no_wheels(tmp_path))
    with pytest.raises(UsageError, match="absolute"):
        write_folder(Path("ODM"), tmp_path / "o", wheels=no_wheels(tmp_path))
    with pytest.raises(UsageError, match="inside ODM"):
        write_folder(odm, odm / "front", wheels=no_wheels(tmp_path))
    with pytest.raises(UsageError, match="wheels"):
        write_folder(odm, tmp_path / "o", wheels=tmp_path / "nowhere")
    assert main(["node", "--odm", str(odm), "--out", str(full)]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert (full / "mine.txt").read_text() == "keep"


def test_an_odm_that_is_not_here_yet_is_noted(tmp_path, capsys):
    out = tmp_path / "node"
    wheels = no_wheels(tmp_path)
    assert main(["node", "--odm", "/no/such/odm", "--out", str(out), "--wheels", str(wheels), "--python", "3.9"]) == 0
    said = capsys.readouterr().out
    assert "no /no/such/odm on this machine" in said
    assert "no pycolmap for Python 3.9" in said and "routes by metadata" in said
    assert (out / "ODM_HOME").read_text() == "/no/such/odm\n"


def wheel(folder: Path, name: str, version: str, module: str, tag: str) -> None:
    """A wheel with one module that says its version."""
    stem = f"{name.replace('-', '_')}-{version}"
    files = {
        f"{module}/__init__.py": f'__version__ = "{version}"\n',
        f"{stem}.dist-info/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n",
        f"{stem}.dist-info/WHEEL": f"Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: false\nTag: {tag}\n",
    }
    lines = []
    with zipfile.ZipFile(folder / f"{stem}-{tag}.whl", "w") as archive:
        for path, text in files.items():
            digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b"=").decode()
            lines.append(f"{path},sha256={digest},{len(text)}\n")
            archive.writestr(path, text)
        lines.append(f"{stem}.dist-info/RECORD,,\n")
        archive.writestr(f"{stem}.dist-info/RECORD", "".join(lines))


def test_libraries_come_from_the_wheels_that_fit_the_node(odm, tmp_path):
    wheels = tmp_path / "w"
    wheels.mkdir()
    wheel(wheels, "pycolmap", "4.2.1", "pycolmap", "cp312-cp312-manylinux_2_28_x86_64")
    wheel(wheels, "pycolmap", "3.13.0", "pycolmap", "cp39-cp39-manylinux_2_28_x86_64")
    wheel(wheels, "Jinja2", "3.1.4", "jinja2", "py3-none-any")
    new = write_folder(odm, tmp_path / "new", wheels=wheels, machine="amd64")
    assert [(c.name, c.version) for c in new.carried] == [("pycolmap", "4.2.1"), ("Jinja2", "3.1.4")]
    assert [m.name for m in new.missing] == ["MarkupSafe"]
    assert (tmp_path / "new/libraries/pycolmap/pycolmap/__init__.py").is_file()
    old = write_folder(odm, tmp_path / "old", python="3.9", wheels=wheels, machine="x86_64")
    assert ("pycolmap", "3.13.0") in [(c.name, c.version) for c in old.carried]
    assert {m.name for m in old.missing} == {"MarkupSafe", "Pillow"}
    arm = write_folder(odm, tmp_path / "arm", wheels=wheels, machine="arm64")
    assert [c.name for c in arm.carried] == ["Jinja2"]
    assert any("no pycolmap for Python 3.12 on aarch64" in note for note in arm.notes)


def test_a_library_that_odm_brings_is_taken_from_odm():
    assert serves(Carried("numpy", "numpy", "1.23", "9.9"))
    assert not serves(Carried("numpy", "numpy", "99.0", "99.1")), "too old for us"
    assert not serves(Carried("no-such", "no_such_module", "1.0", "1.0"))


def test_every_python_has_one_solver():
    for python in ("3.12", "3.9"):
        assert [lib.module for lib in wanted(python)].count("pycolmap") == 1
    with pytest.raises(UsageError):
        wanted("3.7")


def test_the_launcher_takes_the_carried_library_where_this_python_has_none(odm, tmp_path):
    """Only for the Python that the folder was made for; others run without it."""
    here = f"{sys.version_info[0]}.{sys.version_info[1]}"
    wheels = tmp_path / "w"
    wheels.mkdir()
    wheel(wheels, "pycolmap", "4.2.1", "pycolmap", "cp312-cp312-manylinux_2_28_x86_64")
    out = write_folder(odm, tmp_path / "new", wheels=wheels, machine="x86_64").folder
    code = (
        "import importlib, sys; sys.path.insert(0, sys.argv[1] + '/site');"
        "print(importlib.import_module('sensorgate.plugin.node.libraries').complete(sys.argv[1], sys.argv[2]))"
    )
    listed = json.loads((out / "libraries.json").read_text())
    listed["libraries"][0]["module"] = "module_that_is_nowhere"
    for python, expected in ((here, "['pycolmap']"), ("2.7", "[]")):
        listed["python"] = python
        (out / "libraries.json").write_text(json.dumps(listed))
        done = subprocess.run([sys.executable, "-S", "-c", code, str(out), str(odm)], capture_output=True, text=True)
        assert done.stdout.strip() == expected, done.stderr
