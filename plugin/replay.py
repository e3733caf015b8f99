"""A plan done again elsewhere: its settings taken over, and told what came out otherwise.

A plan names no place: its small files are looked for by name and content beside
the plan and the imagery. Whatever it sets is checked as an argument would be.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
import textwrap
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from ..stages.calibrations import Entry, entry_of
from ..stages.errors import UsageError
from ..stages.thresholds import DEFAULTS, Thresholds
from .inspection import Settings, argument
from .plan import FILES
from .plan_diff import Record, differences
from .plan_file import Plan
from .report.view import clean_text, listing, plural

_MAX_FILE_BYTES = 64 * 1024 * 1024
_MAX_STORED = 1000
_MOST_LINES = 12
# What protects this machine from its input: a plan may tighten it, only the person at the machine may loosen it.
_GUARDS = re.compile(r"_bytes$|^max_(xmp|ifd|text|input)_|^dem_block_mb$|^outcome_max_|^submit_asset_")
_DIGEST = re.compile(r"[0-9a-f]{64}\Z")


def _number(low: float, high: float) -> Callable[[Any], bool]:
    return lambda v: not isinstance(v, bool) and isinstance(v, (int, float)) and low <= v <= high


_OPTIONS: Dict[str, Callable[[Any], bool]] = {
    "ground_m": _number(DEFAULTS.ground_min_m, DEFAULTS.ground_max_m),
    "gsd_target": lambda v: v in ("finest", "coarsest") if isinstance(v, str) else _number(1e-6, 1e4)(v),
    "force_gcp": lambda v: isinstance(v, bool),
    "check_points": lambda v: isinstance(v, str) and len(v) <= 10_000,
    "engine": lambda v: v in ("pycolmap", "colmap"),
    "max_dim": lambda v: isinstance(v, int) and _number(200, 20000)(v),
    "align": lambda v: isinstance(v, bool),
    "look": lambda v: isinstance(v, bool),
}


def settings_of(plan: Plan, given: Settings, folders: Sequence[Path] = ()) -> Settings:
    """The plan's settings; what the command gives besides must agree, or say where the plan's files lie now.

    ``folders`` are searched for the plan's small files beside the plan's own.
    ``UsageError`` for an unknown name, a value out of its range, a
    contradiction, or a file that is not found.
    """
    record = plan.record["settings"]
    values = dict(record["options"])
    for name, value in values.items():
        if name not in _OPTIONS or not _OPTIONS[name](value):
            raise UsageError(f"--plan: it sets {clean_text(name)[:40]!r} to {clean_text(repr(value))[:60]}: not known.")
    for name in record["files"]:
        if name not in FILES:
            raise UsageError(f"--plan: it names a file for {clean_text(name)[:40]!r}, which is not known.")
    wanted = Settings(thresholds=_thresholds(plan, given.thresholds), **values)
    for field in dataclasses.fields(Settings):
        name = field.name
        asked = getattr(given, name)
        if name in (*FILES, "thresholds", "stored", "calibrations") or asked in (field.default, getattr(wanted, name)):
            continue
        raise UsageError(
            f"{argument(name)}: the plan has {getattr(wanted, name)!r}, the command {asked!r}. "
            "With --plan the plan decides: leave the option out, or run without --plan."
        )
    places = {name: _place(plan, name, getattr(given, name), folders) for name in FILES}
    stored = _stored(record["stored"])
    if given.calibrations is not None and stored is None:
        raise UsageError("--calibrations: the plan had no calibration store. Leave the option out.")
    return dataclasses.replace(wanted, **places, calibrations=given.calibrations, stored=stored)


def _thresholds(plan: Plan, given: Thresholds) -> Thresholds:
    told = plan.record["thresholds"]["all"]
    unknown = sorted(set(told) - {f.name for f in dataclasses.fields(Thresholds)})
    if unknown:
        raise UsageError(
            f"--plan: it sets {listing([repr(clean_text(n)[:40]) for n in unknown])}, which this version does not "
            "know. Replay it with the version of sensorgate that wrote it."
        )
    limits = DEFAULTS.replaced(told)
    for field in dataclasses.fields(Thresholds):
        name = field.name
        default, asked, wanted = field.default, getattr(given, name), getattr(limits, name)
        if asked not in (default, wanted):
            raise UsageError(
                f"The threshold {name} is {wanted} in the plan and {asked} in the command. "
                "With --plan the plan decides: leave it out, or run without --plan."
            )
        if _GUARDS.search(name) and wanted > max(default, asked):
            raise UsageError(
                f"--plan: it raises {name} to {wanted}, a limit that protects this machine. If you trust the plan, "
                f'allow it with --thresholds and a file that says {{"{name}": {wanted}}}.'
            )
    return limits


def _place(plan: Plan, name: str, given: Optional[str], folders: Sequence[Path]) -> Optional[str]:
    """Where a file of the plan lies now: as given, else one of its name and content in a folder that we know."""
    entry = plan.record["settings"]["files"].get(name)
    if entry is None:
        if given is not None:
            raise UsageError(f"{argument(name)}: the plan had none. Leave the option out, or run without --plan.")
        return None
    if given is not None:
        return given
    file, digest = entry["name"], entry["sha256"]
    if file in ("", ".", "..") or len(file) > 255 or re.search(r"[/\\\0:]", file) or not _DIGEST.match(digest):
        raise UsageError(f"--plan: {clean_text(file)[:60]!r} is no file name, or its digest is none.")
    # An elevation model opens in GDAL, which follows what it names: only the person at the machine says which.
    for folder in (plan.folder, *folders) if name != "dem" else ():
        found = folder / file
        if found.is_file() and _same(found, digest):
            return str(found)
    sought = "" if name == "dem" else ", and no such file with the same content lies beside the plan or the imagery"
    raise UsageError(
        f"The plan used {clean_text(file)} ({argument(name)}){sought}. Give it with {argument(name)} FILE."
    )


def _same(file: Path, digest: str) -> bool:
    try:
        if file.stat().st_size > _MAX_FILE_BYTES:
            return False
        return hashlib.sha256(file.read_bytes()).hexdigest() == digest
    except OSError:
        return False


def _stored(told: Optional[List[Any]]) -> Optional[Tuple[Entry, ...]]:
    if told is None:
        return None
    if len(told) > _MAX_STORED:
        raise UsageError("--plan: it holds more stored calibrations than a survey has cameras.")
    entries = [entry_of(value) for value in told]
    whole = tuple(e for e in entries if e is not None)
    if len(whole) != len(entries):
        raise UsageError("--plan: one of its stored calibrations is damaged. Copy the plan again from the first run.")
    return whole


def replay_record(plan: Plan, now: Record) -> Dict[str, Any]:
    """The report's ``replay``: which plan, and what differs from it."""
    found = differences(plan.record, now)
    return {
        "plan_sha256": plan.sha256,
        "same": not found,
        "differences": [dataclasses.asdict(d) for d in found],
    }


def told(record: Mapping[str, Any], width: int = 100) -> List[str]:
    """The report's ``replay`` for a terminal."""
    found = record["differences"]
    if not found:
        return ["Replay: nothing differs from the plan, to the last byte of the projects."]
    lines = [f"Replay: {plural(len(found), 'thing')} {'differs' if len(found) == 1 else 'differ'} from the plan"]
    for each in found[:_MOST_LINES]:
        body = textwrap.wrap(clean_text(each["message"]), width - 12, break_on_hyphens=False) or [""]
        lines.append(f"  {each['about']:<10}{body[0]}")
        lines.extend(" " * 12 + part for part in body[1:3])
    if len(found) > _MOST_LINES:
        lines.append(f"  and {len(found) - _MOST_LINES} more in report.json (replay)")
    return lines
