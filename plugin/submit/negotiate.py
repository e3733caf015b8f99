"""What a project asks of a node, held against what the node says it can do. All pure.

NodeODM drops an option that it does not know without a word, takes ``80zz``
for 80 and 8000.7 for 8000, and counts images only after the upload; so all of
this is decided before anything is sent, and looked at again afterwards.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ..odm.options import OptionList, number_of, validate
from ..odm.wire import POLICY_FOR_HARMONIZED, POLICY_OPTION
from .views import NodeView

LOCK = "use-fixed-camera-params"
# What nodes add by themselves: NodeODM's products for viewers, its cap on cores, a cluster's address for split tasks.
ADDED_BY_NODES = frozenset(("pc-ept", "cog", "gltf", "max-concurrency", "sm-cluster"))
# The domains that NodeODM can check; it refuses every value of an option with another one.
_DOMAINS = re.compile(
    r"^((positive |negative )?(integer|float)|percent|json|string|path"
    r"|(float|integer): [-+.\d]+ <= x <= [-+.\d]+|(float|integer) (>=|>|<|<=) [-+.\d]+)$"
)

# Above this a JSON number is no whole number for the node any more.
_EXACT = 2**53

ADAPTER, PLAIN, CLUSTER = "adapter", "plain", "cluster"


@dataclass(frozen=True)
class Terms:
    """What is sent, in the node's own types, and what is said about it.

    ``calibration_file`` puts the calibration (or ``{}``) among the images for
    the node's adapter, ``calibration_seed`` where a plain ODM finds it by itself.
    """

    options: Tuple[Mapping[str, Any], ...]
    calibration_file: bool
    calibration_seed: bool
    notes: Tuple[str, ...] = ()


@dataclass(frozen=True)
class Negotiated:
    """The terms, or the reasons why the project cannot go to this node."""

    terms: Optional[Terms]
    problems: Tuple[str, ...]


def kind_of(node: NodeView, option_list: OptionList) -> str:
    """``cluster`` (any of its nodes may take a task), ``adapter`` (lists our option) or ``plain``."""
    if node.cluster:
        return CLUSTER
    return ADAPTER if any(o.get("name") == POLICY_OPTION for o in option_list) else PLAIN


def negotiate(
    options: Sequence[Mapping[str, Any]],
    option_list: OptionList,
    node: NodeView,
    *,
    files: int,
    has_calibration: bool,
    leave_out: Mapping[str, str] = {},
    seeds: bool = True,
) -> Negotiated:
    """Hold a project against a node.

    ``options`` are ``{"name", "value"}``, ``files`` is how many would lie in
    the node's image folder. ``leave_out`` maps options that are not to be sent
    to the reason; ``seeds`` is false where the node was seen to refuse them.
    """
    problems: List[str] = []
    notes: List[str] = []
    kind = kind_of(node, option_list)
    known = {str(o["name"]): o for o in option_list if "name" in o}
    wanted = [dict(o) for o in options]
    if POLICY_OPTION in known and not any(o.get("name") == POLICY_OPTION for o in wanted):
        wanted.append({"name": POLICY_OPTION, "value": POLICY_FOR_HARMONIZED})
    for name, why in sorted(leave_out.items()):
        if any(o["name"] == name for o in wanted):
            wanted = [o for o in wanted if o["name"] != name]
            notes.append(f"{name} is left out: {why}")
    reach = has_calibration and (seeds or kind == ADAPTER)
    if has_calibration and not reach:
        wanted = [o for o in wanted if o["name"] != LOCK]
        notes.append("This node takes no calibration, so ODM solves the cameras itself and nothing is locked.")
    problems += [p.message for p in validate(wanted, option_list)]
    typed: List[Mapping[str, Any]] = []
    for option in wanted:
        described = known.get(str(option.get("name")))
        if described is None:
            continue
        value = typed_value(option.get("value"), described)
        problem = _domain_problem(option, described)
        if problem:
            problems.append(problem)
        typed.append({"name": option["name"], "value": value})
    if node.max_images is not None and files + (kind != PLAIN) > node.max_images:
        problems.append(
            f"{files} files are more than this node takes ({node.max_images}). Split the project, or use a larger node."
        )
    if files < 1:
        problems.append("The project has no image.")
    if problems:
        return Negotiated(None, tuple(dict.fromkeys(problems)))
    if reach and kind == PLAIN:
        notes.append("This node has no sensorgate adapter: the calibration goes where ODM keeps its own overrides.")
    return Negotiated(
        Terms(
            options=tuple(sorted(typed, key=lambda o: str(o["name"]))),
            calibration_file=kind != PLAIN,
            calibration_seed=reach and kind != ADAPTER and seeds,
            notes=tuple(notes),
        ),
        (),
    )


def typed_value(value: Any, described: Mapping[str, Any]) -> Any:
    """The value in the type that the node will make of it, so that sending and reading back compare equal."""
    kind = described.get("type")
    if kind == "bool" and isinstance(value, str):
        return value.lower() == "true"
    if kind in ("int", "float"):
        number = number_of(value)
        if number is not None:
            return int(number) if kind == "int" else number
    return value


def _domain_problem(option: Mapping[str, Any], described: Mapping[str, Any]) -> Optional[str]:
    domain = described.get("domain")
    if isinstance(domain, str) and domain and not _DOMAINS.match(domain):
        return f"The node itself cannot check {option['name']} (its domain is {domain!r}) and would refuse the task."
    bounds = re.match(r"^(?:float|integer) (>=|>|<=|<) ([-+.\d]+)$", domain) if isinstance(domain, str) else None
    number = number_of(option.get("value"))
    if bounds and number is not None:
        limit = float(bounds.group(2))
        fine = {">=": number >= limit, ">": number > limit, "<=": number <= limit, "<": number < limit}
        if not fine[bounds.group(1)]:
            return f"{option['name']} must be {bounds.group(1)} {bounds.group(2)}, not {option['value']!r}."
    if described.get("type") == "int" and number is not None and abs(number) > _EXACT:
        return f"{option['name']} {option['value']!r} is too large for the node to keep exactly."
    if domain == "json" and option.get("value") == "":
        return f"{option['name']} must be JSON text; leave it out instead of giving nothing."
    if domain == "percent" and number is not None and not 0 <= number <= 100:
        return f"{option['name']} must lie between 0 and 100, not {option['value']!r}."
    return None


def same(sent: Any, took: Any) -> bool:
    """Whether two option values are one: nodes turn numbers into texts and back."""
    if isinstance(sent, bool) or isinstance(took, bool):
        return str(sent).lower() == str(took).lower()
    a, b = number_of(sent), number_of(took)
    if a is not None and b is not None:
        return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12)
    return str(sent) == str(took)


def differences(sent: Sequence[Mapping[str, Any]], took: Sequence[Tuple[str, Any]]) -> Dict[str, str]:
    """Option name -> how what the task has differs from what was sent. Empty when the node took it all."""
    asked = {str(o["name"]): o["value"] for o in sent if o["value"] is not False}
    has = {name: value for name, value in took if value is not False}
    found: Dict[str, str] = {}
    for name in sorted(asked):
        if name not in has:
            found[name] = f"the node dropped {name}"
        elif not same(asked[name], has[name]):
            found[name] = f"the node made {has[name]!r} of {name} {asked[name]!r}"
    for name in sorted(set(has) - set(asked) - ADDED_BY_NODES):
        found[name] = f"the node added {name} {has[name]!r}"
    return found


def numeric_options(options: Sequence[Mapping[str, Any]]) -> Tuple[str, ...]:
    """Options with a number for a value: one NodeODM release ends on the first of them (NodeODM issue 269)."""
    return tuple(
        sorted(
            str(o["name"]) for o in options if isinstance(o["value"], (int, float)) and not isinstance(o["value"], bool)
        )
    )
