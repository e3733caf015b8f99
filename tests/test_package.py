"""The package as a user gets it: wheel, import rules, version, and what the gate needs to import."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def modules(folder):
    return sorted(p for p in (ROOT / folder).rglob("*.py"))


def imports(path):
    """(level, module) of every import statement, at any depth."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            yield node.level, node.module or ""
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield 0, alias.name


def top_level_imports(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module or ""


def test_stages_never_import_the_plugin():
    for path in modules("stages"):
        depth = len(path.relative_to(ROOT / "stages").parts)
        for level, module in imports(path):
            assert not module.startswith(("sensorgate", "plugin")), path
            assert level <= depth, f"{path} reaches above stages"


def test_imports_inside_the_package_are_relative():
    for folder in ("stages", "plugin"):
        for path in modules(folder):
            for level, module in imports(path):
                if level == 0:
                    assert module.split(".")[0] not in ("sensorgate", "stages", "plugin"), f"{path}: {module}"


def test_heavy_libraries_are_imported_where_they_are_needed():
    heavy = {"cv2", "pycolmap", "osgeo", "pyodm", "pyodx", "jinja2", "pyproj", "tqdm", "django"}
    for folder in ("stages", "plugin"):
        for path in modules(folder):
            found = {name.split(".")[0] for name in top_level_imports(path)} & heavy
            assert not found, f"{path} imports {found} when it is loaded"


def test_the_gate_imports_numpy_and_pillow_alone():
    code = (
        "import sys\n"
        "from sensorgate.stages import gate, read, survey\n"
        "heavy = {'cv2', 'pycolmap', 'osgeo', 'pyodm', 'jinja2', 'pyproj', 'tqdm', 'scipy'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT.parent)


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


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(out), str(ROOT)],
        check=True,
        cwd=out,
    )
    (found,) = out.glob("sensorgate-*.whl")
    return found


def test_the_wheel_works_in_an_empty_environment(wheel, tmp_path):
    """numpy and Pillow are borrowed from here by path; everything of ours must come from the wheel."""
    home = tmp_path / "env"
    venv.create(home, with_pip=False)
    python = home / "bin" / "python"
    site = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", site, str(wheel)], check=True
    )
    names = set(os.listdir(site))
    assert "sensorgate" in names
    assert not names & {"stages", "plugin", "tests"}, "a top-level stages would collide with ODM's own"
    import numpy
    import PIL

    env = {**os.environ, "PYTHONPATH": os.pathsep.join({str(Path(m.__file__).parents[1]) for m in (numpy, PIL)})}
    # -I would drop PYTHONPATH; an editable finder of the borrowed site must not answer for the wheel.
    code = (
        "import sys; sys.meta_path[:] = [f for f in sys.meta_path if 'editable' not in repr(f)]\n"
        "import sensorgate.plugin.cli as cli, sensorgate.stages.gate as gate\n"
        f"assert gate.__file__.startswith({str(site)!r}), gate.__file__\n"
        "sys.exit(cli.main(['gate', sys.argv[1]]))"
    )
    empty = tmp_path / "empty"
    empty.mkdir()
    done = subprocess.run([python, "-c", code, str(empty)], capture_output=True, text=True, env=env, cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    assert "Traceback" not in done.stderr
