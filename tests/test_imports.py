"""Who may import whom, and who knows what: the rules of the house."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# Beside plugin/odm only what stands before or after a whole ODM knows names of ODM's; each says why.
KNOWS_ODM = {
    "plugin/node": "stands in the place of ODM's folder: its command line, its progress and its products are ODM's",
    "plugin/webodm": "WebODM's tasks carry ODM's option names and files",
    "plugin/cli/submit.py": "its help names products to ask a node for",
    "plugin/cli/node.py": "its help names NodeODM's own setting",
    "plugin/submit/negotiate.py": "options that a node adds by itself, and the lock that it may refuse",
    "plugin/submit/collect.py": "its message names a product to ask a node for",
    "plugin/submit/journey.py": "words of a node's refusal",
    "plugin/submit/parcel.py": "our own options.json below sensorgate/",
    "plugin/submit/reroute.py": "the one option that a second try raises",
}
# ODM's folders, inner files and products. gcp_list.txt and geo.txt are the field's formats, not ODM's secret;
# odm_ names with an underscore behind are fields of our own report.
INNER = re.compile(
    r"\bopensfm\b|\bodm_(orthophoto|georeferenc|dem|texturing|meshing|filterpoints|report|postprocess|path)"
    r"|\b(cameras|images|options|log)\.json\b|\bimage_groups\.txt\b|\bsplit-merge\b"
)


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


def _strings(path):
    """Every text in the code, docstrings apart."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    said = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                said.add(id(first.value))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in said:
            yield node.value


def _option_names():
    listed = json.loads((ROOT / "plugin/odm/options_3_6_0.json").read_text(encoding="utf-8"))["options"]
    # Names of one word are words of the language as well.
    return {o["name"] for o in listed if "-" in o["name"]}


def test_only_plugin_odm_knows_odm():
    """The names of ODM's options, folders and inner files stand in one place; the adapters around ODM are listed."""
    options = _option_names()
    assert len(options) > 50
    found = {}
    for folder in ("stages", "plugin"):
        for path in modules(folder):
            name = path.relative_to(ROOT).as_posix()
            if not name.startswith("plugin/odm/"):
                known = [s for s in _strings(path) if s in options or INNER.search(s)]
                if known:
                    found[name] = known[:3]
    allowed = tuple(f"{n}/" if not n.endswith(".py") else n for n in KNOWS_ODM)
    assert {n: s for n, s in found.items() if not n.startswith(allowed)} == {}
    idle = [n for n in KNOWS_ODM if not any(f.startswith(n) for f in found)]
    assert idle == [], "no longer needed in the list"


@pytest.mark.parametrize("name", ["stages", "plugin/report"])
def test_what_does_not_run_odm_never_imports_its_reader(name):
    """Stages and the report take what ``plugin.odm`` found; they read no project of ODM's themselves."""
    for path in modules(name):
        for _, module in imports(path):
            assert not re.search(r"\b(opensfm_|outcome_)", module), f"{path}: {module}"
