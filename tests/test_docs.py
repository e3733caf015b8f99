"""The docs say what the code does: tables, commands, links, names, values and the options with their conditions."""

from __future__ import annotations

import argparse
import ast
import dataclasses
import importlib.util
import itertools
import json
import re
import shlex
import textwrap
from pathlib import Path
from typing import Dict, Iterator, List, Set, Tuple

import pytest
from sensorgate.plugin.cli import build_parser
from sensorgate.plugin.odm.options import OptionNeeds, odm_3_6_options, options_for
from sensorgate.stages import thresholds as numbers

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted({*ROOT.glob("*.md"), *DOCS.rglob("*.md")})
LINK = re.compile(r"(?<!\\)\]\(([^)\s]+)\)")
INLINE = re.compile(r"`([^`\n]+)`")
FENCE = re.compile(r"^```")
# `stages/read.py:scan`: a name that the file defines.
SYMBOL = re.compile(r"^((?:stages|plugin|tests|docs|benchmarks)/[\w/.]+\.py):(\w+(?:\.\w+)?)$")
# What the reader of a worked example makes.
WORKED_EXAMPLE = {"docs/findings/overlap-low.md", "stages/overlap.py", "tests/stages/test_overlap.py"}
FILE = re.compile(r"^(?:stages|plugin|tests|docs|benchmarks|\.ci)/[\w/.-]*$")
# `focal_variance` (0.03): a threshold with its default.
VALUE = re.compile(r"`([a-z][a-z0-9_]+)` \((-?[\d.]+)(?: ?%)?[^)]*\)")


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


pages = pytest.mark.parametrize("page", PAGES, ids=name_of)


def blocks(text: str) -> Iterator[List[str]]:
    """Lines of every code block, fenced or indented."""
    inside, found = False, []
    for line in [*text.splitlines(), ""]:
        if FENCE.match(line):
            if inside:
                yield found
            inside, found = not inside, []
        elif inside:
            found.append(line)
        elif line.startswith("    ") and not line.lstrip().startswith(("-", "*")):
            found.append(line.strip())
        elif found:
            yield found
            found = []


def prose(text: str) -> str:
    """The text without its fenced blocks."""
    kept, inside = [], False
    for line in text.splitlines():
        if FENCE.match(line):
            inside = not inside
        elif not inside:
            kept.append(line)
    return "\n".join(kept)


def commands(text: str) -> Iterator[str]:
    """Every ``sensorgate`` command line of the code blocks, without comments and with its lines joined."""
    for block in blocks(text):
        joined = re.sub(r"\\\n\s*", " ", "\n".join(block))
        for line in joined.splitlines():
            words = re.split(r" [#|&]", line.strip().lstrip("$ "))[0].strip()
            words = re.sub(r"^(\.venv/bin/)", "", words)
            if words.startswith("sensorgate "):
                yield words


def arguments(command: str) -> List[str]:
    """The words of a command in the docs: what may be left out is given, dots stand for nothing."""
    plain = re.sub(r"[\[\]]", " ", command).replace("...", " ")
    return shlex.split(plain)[1:]


def verbs() -> Dict[str, argparse.ArgumentParser]:
    found = next(a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction))
    return dict(found.choices)


def heading_ids(page: Path) -> Set[str]:
    """Anchors as GitHub makes them."""
    found: Set[str] = set()
    for line in prose(page.read_text(encoding="utf-8")).splitlines():
        if line.startswith("#"):
            words = line.lstrip("#").strip().lower()
            found.add(re.sub(r"[^\w\- ]", "", words).replace(" ", "-"))
    return found


def test_the_tables_are_those_of_the_code():
    tables = _module(DOCS / "tables.py")
    stale = [p.name for p in DOCS.glob("*.md") if tables.written(p.read_text("utf-8")) != p.read_text("utf-8")]
    assert not stale, f"run: python docs/tables.py ({', '.join(stale)})"


def test_the_threshold_tables_leave_none_out():
    told = [n for names in _module(DOCS / "tables.py").sections().values() for n in names]
    assert sorted(told) == sorted(numbers.Thresholds.describe())


def _module(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pages
def test_links_lead_somewhere(page):
    lost = []
    for target in LINK.findall(prose(page.read_text(encoding="utf-8"))):
        if re.match(r"^[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        where = (page.parent / file).resolve() if file else page
        if not where.exists() or (anchor and where.suffix == ".md" and anchor not in heading_ids(where)):
            lost.append(target)
    assert not lost


@pages
def test_commands_are_understood(page):
    for command in commands(page.read_text(encoding="utf-8")):
        try:
            build_parser().parse_args(arguments(command))
        except SystemExit as end:
            assert end.code == 0, command


@pages
def test_commands_in_the_text_have_these_options(page):
    known = verbs()
    for said in INLINE.findall(prose(page.read_text(encoding="utf-8"))):
        words = said.split()
        if words[0] != "sensorgate" or len(words) < 2 or not re.match(r"^[a-z]+$", words[1]):
            continue
        assert words[1] in known, said
        options = {o for a in known[words[1]]._actions for o in a.option_strings}
        assert {w.split("=")[0] for w in words if w.startswith("-")} <= options, said


@pages
def test_files_and_names_that_are_mentioned_exist(page):
    for said in INLINE.findall(prose(page.read_text(encoding="utf-8"))):
        symbol = SYMBOL.match(said)
        if symbol:
            assert symbol.group(2) in defined(ROOT / symbol.group(1)), said
        elif FILE.match(said) and said not in WORKED_EXAMPLE:
            assert (ROOT / said).exists(), said


def defined(file: Path) -> Set[str]:
    """Names of a module, and of its classes' members as ``Class.member``."""
    found: Set[str] = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            for inner in node.body:
                if isinstance(inner, ast.FunctionDef):
                    found.add(f"{node.name}.{inner.name}")
                elif isinstance(inner, ast.AnnAssign) and isinstance(inner.target, ast.Name):
                    found.add(f"{node.name}.{inner.target.id}")
        targets = [node.target] if isinstance(node, ast.AnnAssign) else getattr(node, "targets", [])
        found.update(t.id for t in targets if isinstance(t, ast.Name))
    return found


@pages
def test_values_of_thresholds_are_the_defaults(page):
    text = re.sub(r"\s+", " ", prose(page.read_text(encoding="utf-8")))
    told = numbers.Thresholds.describe()
    for name, value in VALUE.findall(text):
        if name in told:
            assert float(value) == pytest.approx(float(told[name]["default"])), name


@pytest.mark.parametrize("page", ["how-the-gate-decides.md", "how-the-proof-decides.md"])
def test_pages_on_decisions_name_thresholds_that_exist(page):
    text = re.sub(r"\s+", " ", prose((DOCS / page).read_text(encoding="utf-8")))
    found = VALUE.findall(text)
    assert len(found) > 20
    assert {name for name, _ in found} <= set(numbers.Thresholds.describe())


@pages
def test_make_targets_exist(page):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    text = page.read_text(encoding="utf-8")
    said = set(re.findall(r"`make ([a-z-]+)`", text))
    for block in blocks(text):
        said |= {m.group(1) for line in block for m in [re.match(r"^make ([a-z-]+)", line)] if m}
    assert said <= targets


@pages
def test_no_page_names_a_place_of_one_machine(page):
    assert not re.search(r"/(work|root|home)/", page.read_text(encoding="utf-8"))


def test_every_page_can_be_found_from_the_index():
    linked = {
        (DOCS / target.partition("#")[0]).resolve()
        for target in LINK.findall((DOCS / "README.md").read_text(encoding="utf-8"))
    }
    own = {p.resolve() for p in DOCS.glob("*.md")} - {(DOCS / "README.md").resolve()}
    assert own <= linked
    assert (DOCS / "findings/README.md").resolve() in linked


def test_every_example_is_told_in_the_index():
    said = (DOCS / "examples/README.md").read_text(encoding="utf-8")
    assert {p.name for p in (DOCS / "examples").iterdir() if p.suffix in (".py", ".csv")} <= set(LINK.findall(said))


def option_rows() -> List[Tuple[str, str, str]]:
    """Option, value where one is told, and condition of every row of the table of emitted options."""
    text = (DOCS / "options.md").read_text(encoding="utf-8")
    table = text.split("## What a project gets", 1)[1].split("\n## ", 1)[0]
    return re.findall(r"^\| `([a-z-]+)`(?: = (\w+))? \|.*\| `([^`]+)` \|$", table, re.MULTILINE)


def needs() -> Iterator[OptionNeeds]:
    """Every combination of what a project can ask for."""
    flags = [f.name for f in dataclasses.fields(OptionNeeds) if f.type == "bool"]
    for values in itertools.product((False, True), repeat=len(flags)):
        for accuracy in (None, 0.05):
            yield OptionNeeds(**dict(zip(flags, values)), primary_band="Green", gps_accuracy_m=accuracy)


def test_the_conditions_of_the_options_are_the_code_s():
    rows = option_rows()
    stack = [*odm_3_6_options(), {"name": "force-gcp", "type": "bool", "domain": None}]
    valued = {name for name, value, _ in rows if value}
    emitted: Set[Tuple[str, str]] = set()
    for need in needs():
        given = {(o.name, str(o.value) if o.name in valued else "") for o in options_for(need, stack)}
        emitted |= given
        values = {f.name: getattr(need, f.name) for f in dataclasses.fields(OptionNeeds)}
        told = {(n, v) for n, v, condition in rows if eval(condition, {"__builtins__": {}}, values)}
        assert given == told, need
    assert emitted == {(name, value) for name, value, _ in rows}


def test_what_is_never_emitted_is_never_emitted():
    text = (DOCS / "options.md").read_text(encoding="utf-8")
    table = text.split("## What is never set", 1)[1].split("\n## ", 1)[0]
    never = set(re.findall(r"^\| `([a-z-]+)", table, re.MULTILINE))
    assert never
    assert not never & {o.name for need in needs() for o in options_for(need)}


def test_the_table_of_exit_codes_is_the_code_s():
    from sensorgate.stages import errors

    text = (ROOT / "README.md").read_text(encoding="utf-8")
    table = text.split("## Exit codes", 1)[1].split("\n## ", 1)[0]
    told = {int(n) for n in re.findall(r"^\| (\d+) \|", table, re.MULTILINE)}
    classes = [c for c in vars(errors).values() if isinstance(c, type) and issubclass(c, errors.SensorgateError)]
    assert {c.exit_code for c in classes} <= told and 0 in told


def test_the_intrinsics_sources_stand_in_their_order():
    from sensorgate.stages.intrinsics import SOURCES, TRUSTED

    text = (DOCS / "how-the-gate-decides.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \d+ \| `([a-z0-9-]+)` \|.*\| (yes|no) \|$", text, re.MULTILINE)
    assert tuple(name for name, _ in rows) == SOURCES
    assert {name for name, held in rows if held == "yes"} == set(TRUSTED)


def test_the_units_of_the_focal_plane_are_the_code_s():
    from sensorgate.stages.focals import UNIT_MM

    text = (DOCS / "how-the-gate-decides.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d) \| [a-z]+ \| ([\d.]+) \|$", text, re.MULTILINE)
    assert {int(n): float(mm) for n, mm in rows} == UNIT_MM


def test_the_columns_of_a_calibration_sheet_are_all_told():
    from sensorgate.stages.usersheet import COLUMNS

    text = (DOCS / "cameras.md").read_text(encoding="utf-8")
    table = text.split("## A sheet of your own", 1)[1].split("\n## ", 1)[0]
    told = {n for cell in re.findall(r"^\| (`[^|]+) \|", table, re.MULTILINE) for n in re.findall(r"`(\w+)`", cell)}
    assert told == set(COLUMNS)


def test_the_fields_of_a_row_of_the_built_in_sheet_are_all_told():
    from sensorgate.stages.sensors import SheetRow

    rows = json.loads((ROOT / "stages/sensors.json").read_text(encoding="utf-8"))["rows"]
    text = (DOCS / "cameras.md").read_text(encoding="utf-8")
    table = text.split("## A row for everybody", 1)[1].split("\n## ", 1)[0]
    told = {n for cell in re.findall(r"^\| (`[^|]+) \|", table, re.MULTILINE) for n in re.findall(r"`(\w+)`", cell)}
    assert {key for row in rows for key in row} <= told <= {f.name for f in dataclasses.fields(SheetRow)}


def test_the_options_of_the_field_node_are_all_told():
    from sensorgate.plugin.node.options import OPTIONS, POLICIES

    text = (DOCS / "field-node.md").read_text(encoding="utf-8")
    table = text.split("## Options of a task", 1)[1].split("\n## ", 1)[0]
    told = dict(re.findall(r"^\| `([a-z-]+)` \| (.*) \|$", table, re.MULTILINE))
    assert set(told) == {o.name for o in OPTIONS}
    assert all(f"`{policy}`" in told["mixed-sensor-policy"] for policy in POLICIES)


def test_the_number_of_sheet_rows_is_right():
    rows = json.loads((ROOT / "stages/sensors.json").read_text(encoding="utf-8"))["rows"]
    told = re.search(r"built-in sheet has (\d+) rows", (DOCS / "limits.md").read_text(encoding="utf-8"))
    assert told and int(told.group(1)) == len(rows)


@pages
def test_python_in_the_docs_can_be_imported(page):
    for block in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
        try:
            tree = ast.parse(textwrap.dedent(block))
        except SyntaxError:
            tree = ast.parse(f"[{block}]" if "=" not in block else f"class _:\n    {block}")
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sensorgate"):
                module = importlib.import_module(node.module)
                for alias in node.names:
                    named = hasattr(module, alias.name) or importlib.util.find_spec(f"{node.module}.{alias.name}")
                    assert named, f"{node.module} has no {alias.name}"


def test_a_wrong_command_is_seen():
    assert list(commands("```\nsensorgate gate X \\\n  --html y  # c\n```")) == ["sensorgate gate X  --html y"]
    assert list(commands("text\n\n    sensorgate node --odm /code --out D  # c\n")) == [
        "sensorgate node --odm /code --out D"
    ]
    with pytest.raises(SystemExit):
        build_parser().parse_args(arguments("sensorgate gate [--htm x] F --nothing"))
