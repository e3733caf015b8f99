"""Every finding has its page in docs/findings, and every page its finding."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Dict, Iterable, Iterator, Set

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs/findings"
CODE = re.compile(r"^[a-z0-9]+(-[a-z0-9]+)+$")
# Classes that take a code, and where; functions with a parameter of that name are found.
TAKING = {"Finding": 0, "FrameError": 0, "BrokenFrame": 2}
# Roles become codes with "-frame" behind them; a role that is never left out has none.
ROLES = {"panel-frame", "transit-frame", "horizon-frame"}
SECTIONS = ("## Cause", "## Example", "## What ODM would do", "## Remedy")


def _name(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _constants(node: ast.AST) -> Iterator[str]:
    """Texts that an expression can be: itself, or either side of a condition."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.IfExp):
        yield from _constants(node.body)
        yield from _constants(node.orelse)


def _codes_of(tree: ast.AST, defined: Dict[str, int]) -> Iterator[str]:
    """Codes of a module; ``defined`` maps functions with a parameter ``code`` to its place."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple) and len(node.value.elts) == 3:
            # (code, message, remedy) that a caller makes a finding of
            yield from (t for t in _constants(node.value.elts[0]) if CODE.match(t))
        if not isinstance(node, ast.Call):
            continue
        for keyword in node.keywords:
            if keyword.arg in ("code", "excluded"):
                yield from _constants(keyword.value)
        place = defined.get(_name(node))
        if place is not None and place < len(node.args):
            yield from _constants(node.args[place])


def _defined(trees: Iterable[ast.AST]) -> Dict[str, int]:
    """Functions and classes that take a code, with the place of that argument."""
    found = dict(TAKING)
    for tree in trees:
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and node.name != "__init__":
                names = [a.arg for a in node.args.args if a.arg != "self"]
                if "code" in names:
                    found[node.name] = names.index("code")
    return found


def codes() -> Dict[str, Set[str]]:
    """Code -> the modules that can say it."""
    found: Dict[str, Set[str]] = {code: {"stages/flights.py"} for code in ROLES}
    files = sorted(f for part in ("stages", "plugin") for f in (ROOT / part).rglob("*.py"))
    trees = {f: ast.parse(f.read_text(encoding="utf-8")) for f in files}
    defined = _defined(trees.values())
    for file, tree in trees.items():
        for code in _codes_of(tree, defined):
            if CODE.match(code):
                found.setdefault(code, set()).add(file.relative_to(ROOT).as_posix())
    return found


def pages() -> Set[str]:
    return {p.stem for p in PAGES.glob("*.md")} - {"README"}


def test_every_code_has_a_page():
    missing = {code: sorted(where) for code, where in codes().items() if code not in pages()}
    assert not missing, f"docs/findings/<code>.md is missing for {missing}"


def test_every_page_has_a_code():
    assert pages() - set(codes()) == set()


@pytest.mark.parametrize("page", sorted(PAGES.glob("*.md")), ids=lambda p: p.stem)
def test_a_page_says_cause_example_odm_and_remedy(page: Path):
    text = page.read_text(encoding="utf-8")
    if page.stem == "README":
        linked = set(re.findall(r"\]\(([a-z0-9-]+)\.md\)", text))
        assert linked == pages()
        return
    assert text.startswith(f"# {page.stem}\n")
    places = [text.find(section) for section in SECTIONS]
    assert -1 not in places and places == sorted(places), page.stem
    for section, after in zip(places, [*places[1:], len(text)]):
        assert len(text[section:after].split("\n", 1)[1].strip()) > 10, page.stem
    assert "/work" not in text and "/root" not in text


def test_the_collector_sees_all_ways_a_code_is_given():
    source = (
        "def told(why, code): pass\nFinding(code='a-b', severity=1)\ntold('text-like', 'c-d')\n"
        "x.BrokenFrame(p, n, 'e-f', 'text-like')\nFinding(code='g-h' if x else 'i-j')\nother('no-code')\n"
        "replace(f, excluded='k-l')\ndef g():\n    return 'm-n', 'message', 'remedy'\n"
    )
    tree = ast.parse(source)
    assert set(_codes_of(tree, _defined([tree]))) == {"a-b", "c-d", "e-f", "g-h", "i-j", "k-l", "m-n"}
