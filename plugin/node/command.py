"""An ODM command line taken apart without importing ODM: which project it means, and what we have to change in it."""

from __future__ import annotations

import ast
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, FrozenSet, List, Mapping, Optional, Sequence, Tuple

from .options import take

# Where ODM's parser is read from: ODM's own name first, then that of its fork.
PARSERS = ("opendm/config.py", "modules/config.py")
_PATHS = frozenset(
    f"--{n}" for n in ("project-path", "gcp", "geo", "align", "split-image-groups", "cameras", "boundary", "copy-to")
)
_FLAG_ACTIONS = frozenset(("StoreTrue", "store_true", "store_false", "help", "version"))


@dataclass(frozen=True)
class Grammar:
    """The options that an ODM knows: name with its hyphens -> the long name, and the long names without a value."""

    names: Mapping[str, str]
    flags: FrozenSet[str]

    def long_name(self, word: str) -> Optional[str]:
        """The option that ``word`` means, unique beginnings counted as ODM counts them."""
        if word in self.names:
            return self.names[word]
        meant = {long for name, long in self.names.items() if word.startswith("--") and name.startswith(word)}
        return next(iter(meant)) if len(meant) == 1 else None


def read_grammar(odm: Path) -> Grammar:
    """ODM's options out of the text of its parser; empty where there is none to read."""
    for name in PARSERS:
        try:
            tree = ast.parse((odm / name).read_text(encoding="utf-8"))
        except (OSError, SyntaxError, ValueError):
            continue
        return _grammar_of(tree)
    return Grammar({}, frozenset())


def _grammar_of(tree: ast.AST) -> Grammar:
    names: Dict[str, str] = {"--help": "--help", "-h": "--help"}
    flags = {"--help"}
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
            continue
        if node.func.attr != "add_argument":
            continue
        spelled = [a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)]
        options = [s for s in spelled if s.startswith("-")]
        if not options:
            continue
        long = next((s for s in options if s.startswith("--")), options[0])
        names.update(dict.fromkeys(options, long))
        if any(_says_flag(k) for k in node.keywords):
            flags.add(long)
    return Grammar(names, frozenset(flags))


def _says_flag(keyword: ast.keyword) -> bool:
    value = keyword.value
    if keyword.arg == "nargs":
        return isinstance(value, ast.Constant) and value.value == 0
    if keyword.arg != "action":
        return False
    said = value.value if isinstance(value, ast.Constant) else getattr(value, "id", "")
    return said in _FLAG_ACTIONS


@dataclass(frozen=True)
class Word:
    """One option of the command line with its value, or (``name`` empty) a word that stands alone."""

    name: str
    value: Optional[str]

    def spelled(self) -> List[str]:
        """As it goes to ODM."""
        if not self.name:
            return [self.value or ""]
        return [self.name] if self.value is None else [self.name, self.value]


@dataclass(frozen=True)
class Command:
    """``ours`` are our own options (name -> value), ``words`` all that is ODM's."""

    ours: Mapping[str, str]
    words: Tuple[Word, ...]

    def value(self, name: str) -> Optional[str]:
        """The last value of ``--name``, or ``None``."""
        found = [w.value for w in self.words if w.name == f"--{name}"]
        return found[-1] if found else None

    def has(self, name: str) -> bool:
        """Whether ``--name`` was given."""
        return any(w.name == f"--{name}" for w in self.words)

    def with_value(self, name: str, value: str) -> "Command":
        """The same command line with another value of ``--name``."""
        words = tuple(Word(w.name, value) if w.name == f"--{name}" else w for w in self.words)
        return Command(self.ours, words)

    def absolute(self) -> "Command":
        """The same with whole paths: ODM runs in its own folder, a person may call from another."""
        words = tuple(
            Word(w.name, os.path.abspath(w.value)) if w.value and w.name in _PATHS and os.path.exists(w.value) else w
            for w in self.words
        )
        return Command(self.ours, words)

    @property
    def project_path(self) -> Optional[str]:
        """The folder of projects."""
        return self.value("project-path")

    @property
    def name(self) -> str:
        """The project's name in it; ODM's own default where none is given."""
        alone = [w.value for w in self.words if not w.name and w.value]
        return alone[-1] if alone else "code"

    def without(self, *names: str) -> Tuple[Word, ...]:
        """ODM's words without these options and without the project."""
        drop = {f"--{n}" for n in (*names, "project-path")}
        return tuple(w for w in self.words if w.name and w.name not in drop)


def parse(arguments: Sequence[str], grammar: Grammar) -> Command:
    """Take a command line apart. Raises ``WrongOption`` for a bad value of ours; ODM judges its own."""
    ours, rest = take(list(arguments))
    words: List[Word] = []
    at = 0
    while at < len(rest):
        word, given, value = rest[at].partition("=")
        at += 1
        if not word.startswith("-") or word == "-":
            words.append(Word("", rest[at - 1]))
            continue
        long = grammar.long_name(word)
        name = long or word
        if given:
            words.append(Word(name, value))
        elif name in grammar.flags or at >= len(rest):
            words.append(Word(name, None))
        elif long is None and (rest[at].startswith("--") or at == len(rest) - 1):
            # Unknown to this ODM: the last word is the project, and an option is no value.
            words.append(Word(name, None))
        else:
            words.append(Word(name, rest[at]))
            at += 1
    return Command(ours, tuple(words))


def spelled(words: Sequence[Word], project_path: str, name: str) -> List[str]:
    """The words of a command line for ODM on one project."""
    return [*(part for word in words for part in word.spelled()), "--project-path", project_path, name]
