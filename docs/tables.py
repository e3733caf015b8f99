"""Writes the tables of the docs that come from the code: thresholds, command line, fields of report.json.

    python docs/tables.py           write them
    python docs/tables.py --check   say which are out of date, and end with 1 where any is

A table stands in its page between ``<!-- table: NAME -->`` and ``<!-- end of table -->``.
The test suite holds every page against this.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Mapping

from sensorgate.plugin.cli import build_parser
from sensorgate.stages.thresholds import Thresholds

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
_BLOCK = re.compile(r"(<!-- table: (\w+) -->).*?(<!-- end of table -->)", re.DOTALL)
_SECTION = re.compile(r"^    # --- (.+?) -+$")
_FIELD = re.compile(r"^    (\w+): \w+ = _number\(")


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def _rows(header: List[str], rows: List[List[str]]) -> List[str]:
    lines = ["| " + " | ".join(header) + " |", "| " + " | ".join("---" for _ in header) + " |"]
    return lines + ["| " + " | ".join(_cell(c) for c in row) + " |" for row in rows]


def sections() -> Dict[str, List[str]]:
    """Heading -> names of its thresholds, in the order of the source."""
    found: Dict[str, List[str]] = {}
    heading = ""
    for line in (ROOT / "stages/thresholds.py").read_text(encoding="utf-8").splitlines():
        section, field = _SECTION.match(line), _FIELD.match(line)
        if section:
            heading = section.group(1)
            found[heading] = []
        elif field and heading:
            found[heading].append(field.group(1))
    return found


def thresholds() -> List[str]:
    """One table per section of ``stages/thresholds.py``."""
    told = Thresholds.describe()
    lines: List[str] = []
    for heading, names in sections().items():
        rows = [[f"`{n}`", f"{told[n]['default']}", told[n]["unit"], told[n]["why"]] for n in names]
        lines += ["", f"## {heading[0].upper()}{heading[1:]}", "", *_rows(["name", "default", "unit", "reason"], rows)]
    return lines[1:]


def _argument(action: argparse.Action) -> List[str]:
    name = ", ".join(f"`{o}`" for o in action.option_strings) or f"`{action.metavar or action.dest}`"
    value = ""
    if action.choices is not None:
        value = " or ".join(f"`{c}`" for c in action.choices)
    elif action.option_strings and action.nargs != 0:
        value = f"`{action.metavar}`"
    needed = " (needed)" if action.required else ""
    default = action.default
    if isinstance(default, str) and default not in (action.help or ""):
        needed += f" (default: {default})"
    return [name, value, (action.help or "").replace("%%", "%") + needed]


def command_line() -> List[str]:
    """One table per verb, from the argument parser itself."""
    parser = build_parser()
    verbs = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    lines: List[str] = []
    for choice in verbs._choices_actions:
        verb = verbs.choices[choice.dest]
        arguments = [a for a in verb._actions if not isinstance(a, argparse._HelpAction)]
        arguments.sort(key=lambda a: bool(a.option_strings))
        told = " ".join((verb.description or "").replace("%%", "%").split())
        rows = [_argument(a) for a in arguments]
        said = choice.help or ""
        lines += ["", f"## {choice.dest}", "", f"{said[:1].upper()}{said[1:]}. {told}", ""]
        lines += _rows(["argument", "value", "meaning"], rows)
    return lines[1:]


def _kind(schema: Mapping[str, Any]) -> str:
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return ", ".join("null" if v is None else f"`{v}`" for v in schema["enum"])
    if "$ref" in schema:
        return _link(schema["$ref"])
    if "anyOf" in schema:
        return " or ".join(_kind(s) for s in schema["anyOf"])
    kinds = schema.get("type", "any")
    kinds = [kinds] if isinstance(kinds, str) else kinds
    names = []
    for kind in kinds:
        if kind == "array" and "items" in schema:
            names.append(f"list of {_kind(schema['items'])}")
        elif kind == "object" and isinstance(schema.get("additionalProperties"), dict):
            names.append(f"object of {_kind(schema['additionalProperties'])}")
        else:
            names.append(kind)
    return " or ".join(names)


def _link(reference: str) -> str:
    name = reference.rsplit("/", 1)[-1]
    return "count" if name == "count" else f"[{name}](#{name.lower()})"


def _objects(schema: Mapping[str, Any], name: str) -> Iterator[List[str]]:
    """Rows of an object's fields; the fields of lists of objects without a name of their own stand with them."""
    needed = set(schema.get("required", ()))
    for field, told in schema.get("properties", {}).items():
        said = str(told.get("description", ""))
        may = "" if field in needed or "optional" in said else " Optional."
        yield [f"`{name}{field}`", _kind(told), f"{said}{may}".strip()]
        inner = told.get("items", told)
        if "properties" in inner:
            yield from _objects(inner, f"{name}{field}[]." if "items" in told else f"{name}{field}.")


def report() -> List[str]:
    """Every field of ``report.json``, from its schema."""
    schema = json.loads((ROOT / "plugin/report/report.schema.json").read_text(encoding="utf-8"))
    header = ["field", "type", "meaning"]
    lines = ["## The whole", "", *_rows(header, list(_objects(schema, "")))]
    for name in sorted(schema["$defs"]):
        told = schema["$defs"][name]
        if "properties" in told:
            text = [str(told["description"]), ""] if "description" in told else []
            lines += ["", f"## {name}", "", *text, *_rows(header, list(_objects(told, "")))]
    return lines


TABLES: Dict[str, Callable[[], List[str]]] = {
    "thresholds": thresholds,
    "command_line": command_line,
    "report": report,
}


def written(page: str) -> str:
    """The text of a page with its tables as the code has them."""

    def fill(block: "re.Match[str]") -> str:
        return "\n\n".join((block.group(1), "\n".join(TABLES[block.group(2)]()), block.group(3)))

    return _BLOCK.sub(fill, page)


def main() -> int:
    """Write or check the pages; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--check", action="store_true", help="write nothing")
    check = parser.parse_args().check
    stale = []
    for page in sorted(DOCS.glob("*.md")):
        before = page.read_text(encoding="utf-8")
        after = written(before)
        if after != before:
            stale.append(page.name)
            if not check:
                page.write_text(after, encoding="utf-8")
    for name in stale:
        print(f"{name} {'is out of date' if check else 'written'}")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
