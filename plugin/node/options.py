"""The options that the node adds to ODM's own. Standard library alone: NodeODM's Python reads them too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

OFF, REPORT, AUTO, STRICT = "off", "report", "auto", "strict"
POLICIES = (OFF, REPORT, AUTO, STRICT)
POLICY = "mixed-sensor-policy"
GSD = "mixed-sensor-gsd-target"
NO_ALIGN = "mixed-sensor-skip-alignment"
MAIN_ONLY = "mixed-sensor-main-only"
FORCE_GCP = "force-gcp"


@dataclass(frozen=True)
class NodeOption:
    """One option: a flag has no ``metavar`` and no choices."""

    name: str
    help: str
    default: str = ""
    choices: Tuple[str, ...] = ()
    metavar: str = ""

    @property
    def is_flag(self) -> bool:
        """Whether it stands without a value."""
        return not self.choices and not self.metavar

    def arguments(self) -> Dict[str, Any]:
        """Keywords for ``add_argument``, in the spelling from which NodeODM tells types (choices as a list)."""
        if self.is_flag:
            return {"action": "store_true", "default": False, "help": self.help}
        if self.choices:
            return {"metavar": "<string>", "default": self.default, "choices": list(self.choices), "help": self.help}
        return {"metavar": self.metavar, "default": self.default, "type": str, "help": self.help}


# NodeODM turns apostrophes into quotation marks and shows %(default)s as it stands: the texts have neither.
OPTIONS: Tuple[NodeOption, ...] = (
    NodeOption(
        POLICY,
        "What to do with frames of several cameras. off: nothing. report: look and say, change nothing. "
        "auto: split and harmonize what ODM could not take together, and process every part. "
        "strict: refuse the task unless its frames are proven to belong together. Default: auto",
        default=AUTO,
        choices=POLICIES,
    ),
    NodeOption(
        GSD,
        "Ground resolution that frames of several cameras are brought to: finest, coarsest or a number of "
        "centimetres per pixel. Default: finest",
        default="finest",
        metavar="<string>",
    ),
    NodeOption(
        NO_ALIGN,
        "Group mixed frames by their metadata alone, without the proving alignment. Quicker, and nothing is proven.",
    ),
    NodeOption(
        MAIN_ONLY,
        "Of a mixed task process the main part only. The other parts are named in the report.",
    ),
    NodeOption(
        FORCE_GCP,
        "Let the ground control points replace GPS where there are enough of them and they lie well.",
    ),
)


def add_to(parser: Any) -> None:
    """Add the options to an argument parser, or to what NodeODM puts in its place."""
    for option in OPTIONS:
        parser.add_argument(f"--{option.name}", **option.arguments())


class WrongOption(ValueError):
    """One of our options has a value that it cannot have."""


def take(words: List[str]) -> Tuple[Dict[str, str], List[str]]:
    """Our options out of a command line: name -> value (flags: empty), and the other words in their order.

    Names count in full only, so that ODM's own abbreviations stay ODM's.
    Raises ``WrongOption`` where a value is missing or is none of the choices.
    """
    known = {f"--{o.name}": o for o in OPTIONS}
    found: Dict[str, str] = {}
    rest: List[str] = []
    at = 0
    while at < len(words):
        name, given, value = words[at].partition("=")
        option = known.get(name)
        at += 1
        if option is None:
            rest.append(words[at - 1])
            continue
        if option.is_flag:
            if not given or value.lower() in ("true", "1"):
                found[option.name] = ""
            continue
        if not given:
            if at >= len(words):
                raise WrongOption(f"--{option.name} needs a value.")
            value = words[at]
            at += 1
        problem = _problem(option, value)
        if problem is not None:
            raise WrongOption(problem)
        found[option.name] = value
    return found, rest


def _problem(option: NodeOption, value: str) -> Optional[str]:
    if option.choices and value not in option.choices:
        return f"--{option.name} is one of {', '.join(option.choices)}, not {value!r}."
    if option.name == GSD and value not in ("finest", "coarsest"):
        try:
            fits = 0.0 < float(value) < 1e4
        except ValueError:
            fits = False
        if not fits:
            return f"--{GSD} is finest, coarsest or a number of centimetres, not {value!r}."
    return None
