"""Which options a project gets, and whether a stack knows them.

An option is emitted only where something measured asks for it. ODM ends on a
name it does not know and NodeODM drops it without a word, so everything is
held against the stack's own list first.
"""

from __future__ import annotations

import difflib
import functools
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union

OptionValue = Union[bool, int, float, str]
OptionList = Sequence[Mapping[str, Any]]

_NO_SIGNS = re.compile(r"[^A-Za-z0-9]+")
_LIST = Path(__file__).with_name("options_3_6_0.json")


@dataclass(frozen=True)
class Option:
    """One option with its value and the reason in one sentence."""

    name: str
    value: OptionValue
    reason: str


@dataclass(frozen=True)
class OptionProblem:
    """What is wrong with one option; ``nearest`` is the known name that it may have meant."""

    name: str
    message: str
    nearest: Optional[str] = None


@dataclass(frozen=True)
class OptionNeeds:
    """What a project's verdict asks of ODM.

    ``lock`` wants the intrinsics held and ``cameras_cover_all`` says that the
    cameras file has an entry for every camera id that enters ODM's solver.
    ``bands_aligned`` is set where the band files were warped onto the primary
    band, named ``primary_band``; ``radiometry_applied`` where black level,
    vignette and row gradient went into the warped pixels, which ODM then has
    to apply to the primary band too. ``radiometry_changed`` is set where pixel
    values were altered. ``gps_accuracy_m`` is one accuracy for all frames;
    ``geo_has_accuracies`` that ``geo.txt`` gives one per frame.
    ``keep_gps`` keeps GPS beside ground control (all frames RTK fixed).
    """

    lock: bool = False
    cameras_cover_all: bool = False
    lock_reason: str = ""
    bands_aligned: bool = False
    primary_band: Optional[str] = None
    radiometry_applied: bool = False
    radiometry_changed: bool = False
    has_gcp: bool = False
    force_gcp: bool = False
    keep_gps: bool = False
    gps_accuracy_m: Optional[float] = None
    geo_has_accuracies: bool = False


@functools.lru_cache(maxsize=1)
def odm_3_6_options() -> Tuple[Mapping[str, Any], ...]:
    """Every option of ODM 3.6.0: name, type, default, domain, whether NodeODM shows it."""
    loaded: Dict[str, Any] = json.loads(_LIST.read_text(encoding="utf-8"))
    return tuple(loaded["options"])


def option_names(option_list: OptionList) -> Tuple[str, ...]:
    """The names in a stack's list, sorted."""
    return tuple(sorted(str(o["name"]) for o in option_list if "name" in o))


def _wanted(needs: OptionNeeds) -> List[Option]:
    wanted: List[Option] = []
    if needs.lock and needs.cameras_cover_all:
        why = needs.lock_reason or "every camera of the project is in the cameras file and is to be held"
        wanted.append(Option("use-fixed-camera-params", True, why))
    if needs.bands_aligned:
        primary = _NO_SIGNS.sub("", needs.primary_band or "")  # ODM compares with a name cut to letters and digits
        if primary:
            wanted.append(Option("primary-band", primary, "the other bands were warped onto this one, keep it primary"))
        wanted.append(Option("skip-band-alignment", True, "the bands are aligned already"))
    if needs.radiometry_changed:
        wanted.append(
            Option("radiometric-calibration", "none", "pixel values were changed, so they are no raw sensor numbers")
        )
    elif needs.radiometry_applied:
        why = "black level and vignette are applied in the aligned bands already; the primary band needs them too"
        wanted.append(Option("radiometric-calibration", "camera", why))
    if needs.has_gcp and needs.force_gcp:
        wanted.append(Option("force-gcp", True, "asked for, and this stack has the option"))
    if needs.has_gcp and needs.keep_gps and not needs.force_gcp:
        wanted.append(Option("force-gps", True, "all frames are RTK fixed, so GPS helps beside the ground control"))
    accuracy = needs.gps_accuracy_m
    if accuracy is not None and not needs.geo_has_accuracies and math.isfinite(accuracy) and accuracy > 0:
        wanted.append(Option("gps-accuracy", float(accuracy), "all frames have this accuracy and ODM would take 10 m"))
    return wanted


def options_for(needs: OptionNeeds, option_list: Optional[OptionList] = None) -> Tuple[Option, ...]:
    """The options of a project, by name; only such as ``option_list`` (default: ODM 3.6.0) has and would take.

    Never ``use-exif`` (it throws the ground control away), never
    ``sfm-algorithm planar`` (it takes one camera for all frames), never
    ``cameras`` (the file goes beside the project), and the lock only with a
    cameras file that covers every camera: ODM would hold the rest at zero
    distortion.
    """
    wanted = _wanted(needs)
    refused = {p.name for p in validate(wanted, odm_3_6_options() if option_list is None else option_list)}
    return tuple(sorted((o for o in wanted if o.name not in refused), key=lambda o: o.name))


def as_node_options(options: Sequence[Option]) -> List[Dict[str, OptionValue]]:
    """As NodeODM and WebODM take them; a flag that is false is left out, for it cannot be said on a command line."""
    return [{"name": o.name, "value": o.value} for o in options if o.value is not False]


def _as_bool(value: Any) -> bool:
    return isinstance(value, bool) or (isinstance(value, str) and value.lower() in ("true", "false"))


def number_of(value: Any) -> Optional[float]:
    """A value as a finite number, also out of text; ``None`` where it is none (a truth value is none)."""
    if isinstance(value, bool):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


def _range_problem(number: float, domain: str) -> Optional[str]:
    text = domain.lower()
    bounds = re.search(r"(-?[\d.]+)\s*<=\s*\w+\s*<=\s*(-?[\d.]+)", text)
    if bounds and not float(bounds.group(1)) <= number <= float(bounds.group(2)):
        return f"must lie between {bounds.group(1)} and {bounds.group(2)}"
    above = re.search(r">\s*(-?[\d.]+)", text)
    if above and not bounds and not number > float(above.group(1)):
        return f"must be above {above.group(1)}"
    if text.startswith("positive") and number < 0:
        return "must not be negative"
    return None


def _json_problem(value: Any) -> Optional[str]:
    if value == "":
        return None
    try:
        json.loads(value)
    except (TypeError, ValueError):
        return "must be JSON text"
    return None


def _value_problem(value: Any, option: Mapping[str, Any]) -> Optional[str]:
    kind = option.get("type")
    domain = option.get("domain")
    if kind == "bool":
        return None if _as_bool(value) else "must be true or false"
    if isinstance(domain, (list, tuple)):
        choices = [str(c) for c in domain]
        return None if str(value) in choices else f"must be one of {', '.join(choices)}"
    if kind in ("int", "float"):
        number = number_of(value)
        if number is None:
            return "must be a number"
        if kind == "int" and number != int(number):
            return "must be a whole number"
        return _range_problem(number, domain) if isinstance(domain, str) else None
    if domain == "json":
        return _json_problem(value)
    return None if isinstance(value, str) else "must be text"


def validate(
    options: Union[Sequence[Option], Sequence[Mapping[str, Any]]], option_list: OptionList
) -> Tuple[OptionProblem, ...]:
    """What a stack would not take of ``options``: unknown names (with the nearest known), wrong types and values.

    ``options`` are ``Option`` or ``{"name", "value"}``; ``option_list`` is
    what a node answers on ``/options`` or ``odm_3_6_options()``.
    """
    known = {str(o["name"]): o for o in option_list if "name" in o}
    problems: List[OptionProblem] = []
    seen = set()
    for option in options:
        name = option.name if isinstance(option, Option) else str(option.get("name", ""))
        value = option.value if isinstance(option, Option) else option.get("value")
        if name in seen:
            problems.append(OptionProblem(name, f"{name} is given twice."))
            continue
        seen.add(name)
        if name not in known:
            spelled = name.lstrip("-").replace("_", "-").lower()
            near = difflib.get_close_matches(spelled, sorted(known), n=1, cutoff=0.6)
            hint = f" Did you mean {near[0]}?" if near else ""
            problems.append(
                OptionProblem(name, f"This stack has no option named {name}.{hint}", near[0] if near else None)
            )
            continue
        wrong = _value_problem(value, known[name])
        if wrong:
            problems.append(OptionProblem(name, f"{name} {wrong}, not {value!r}."))
    return tuple(problems)
