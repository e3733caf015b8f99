"""What administrators and users set: the hold, thresholds, calibration sheets."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import sys
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, Tuple

from ...stages.errors import UsageError
from ...stages.record import write_text
from ...stages.thresholds import DEFAULTS, Thresholds
from ...stages.usersheet import read_user_sheet
from ..inspection import Settings
from . import bounds, home, presence

OFF, REPORT, HOLD = "off", "report", "hold"
MODES = (OFF, REPORT, HOLD)
MINE, ALL = "mine", "all"
_HOLD, _THRESHOLDS, _SHEET = "hold", "thresholds", "sheet"
_MOST_SETTING = 16
# name, what it is needed for, module, requirement under Python 3.9
EXTRAS: Tuple[Tuple[str, str, str, str], ...] = (
    ("OpenCV", "harmonizing and alignment on this server", "cv2", "opencv-python-headless>=4.5,<5"),
    ("pycolmap", "alignment on this server", "pycolmap", "pycolmap>=3.13,<3.14"),
    ("Jinja2", "the report page", "jinja2", "Jinja2>=3.0"),
)


def mode() -> str:
    """``off``, ``report`` or ``hold``; what cannot be read holds."""
    told = home.global_store().get_string(_HOLD, OFF)
    return told if told in MODES else HOLD


def set_mode(value: Any) -> None:
    """Change the admin setting. Raises ``UsageError``."""
    if value not in MODES:
        raise UsageError(f"hold must be one of {', '.join(MODES)}.")
    home.global_store().set_string(_HOLD, value)


def store_for(scope: Any, user: Any) -> Any:
    """The store of one user or of all."""
    if scope not in (MINE, ALL):
        raise UsageError("scope must be mine or all.")
    return home.global_store() if scope == ALL else home.user_store(user)


def changes(store: Any) -> Dict[str, Any]:
    """Thresholds that were changed in this store."""
    value = store.get_json(_THRESHOLDS, {})
    return dict(value) if isinstance(value, dict) else {}


def thresholds_for(user: Any) -> Thresholds:
    """The defaults with everybody's changes and this user's; one that no longer fits is passed over."""
    result = DEFAULTS
    for store in (home.global_store(), home.user_store(user)):
        for name, value in sorted(changes(store).items()):
            with contextlib.suppress(UsageError):
                result = result.replaced({name: value})
    return result


def set_thresholds(store: Any, value: Any) -> None:
    """Keep all changes of a store. Raises ``UsageError``."""
    if not isinstance(value, dict):
        raise UsageError("thresholds must be an object of names and numbers.")
    DEFAULTS.replaced(value)
    store.set_json(_THRESHOLDS, {n: v for n, v in value.items() if v != getattr(DEFAULTS, n)})


def sheet(store: Any) -> Optional[Mapping[str, Any]]:
    """The calibration sheet of a store: name, text and number of rows."""
    value = store.get_json(_SHEET, None)
    return value if isinstance(value, dict) and isinstance(value.get("text"), str) else None


def set_sheet(store: Any, value: Any) -> None:
    """Keep a calibration sheet, read strictly before, or remove it. Raises ``UsageError``."""
    if value is None:
        store.del_key(_SHEET)
        return
    text, name = (value.get("text"), value.get("name")) if isinstance(value, dict) else (None, None)
    if not isinstance(text, str) or not isinstance(name, str):
        raise UsageError("A calibration sheet has a name and a text.")
    if len(text.encode("utf-8", "replace")) > bounds.SHEET_BYTES:
        raise UsageError("The file is too large for a calibration sheet.")
    suffix = ".json" if name.lower().endswith(".json") else ".csv"
    with _written(text, suffix) as file:
        try:
            rows = len(read_user_sheet(Path(file)))
        except UsageError as error:
            # The reader names the file that it was given.
            raise UsageError(str(error).replace(os.path.basename(file), _shown(name))) from None
    store.set_json(_SHEET, {"name": _shown(name), "suffix": suffix, "text": text, "rows": rows})


def _shown(name: str) -> str:
    plain = "".join(c for c in name.replace("\\", "/").rsplit("/", 1)[-1] if c.isprintable())
    return plain[:120] or "sheet.csv"


@contextlib.contextmanager
def _written(text: str, suffix: str) -> Iterator[str]:
    import tempfile

    with tempfile.TemporaryDirectory(prefix="sensorgate-", dir=str(home.temporary())) as folder:
        file = os.path.join(folder, f"sheet{suffix}")
        write_text(file, text)
        yield file


@contextlib.contextmanager
def settings_for(user: Any) -> Iterator[Settings]:
    """The settings of the gate for this user; the user's own sheet wins over everybody's."""
    found = sheet(home.user_store(user)) or sheet(home.global_store())
    limits = thresholds_for(user)
    if found is None:
        yield Settings(thresholds=limits)
        return
    with _written(str(found["text"]), str(found.get("suffix", ".csv"))) as file:
        yield Settings(thresholds=limits, calibration=file)


def missing() -> List[str]:
    """Names of the extras that harmonizing and alignment lack in this process."""
    return [name for name, _, module, _ in EXTRAS if name != "Jinja2" and not _found(module)]


def _found(module: str) -> bool:
    if importlib.util.find_spec(module) is not None:
        return True
    folder = home.packages_folder()
    if folder in sys.path or not os.path.isdir(folder):
        return False
    return any(e == module or e.startswith((f"{module}.", f"{module}-")) for e in os.listdir(folder))


def extras() -> List[Dict[str, Any]]:
    """What is there of the heavy libraries, and how an administrator adds what is not."""
    rows = []
    for name, needed_for, module, requirement in EXTRAS:
        there = _found(module)
        command = f"python -m pip install --target {home.packages_folder()} '{requirement}'"
        rows.append(
            {
                "name": name,
                "needed_for": needed_for,
                "installed": there,
                "message": ""
                if there
                else f"{name} is not installed here. It is needed for {needed_for}. "
                f"In the worker's container: {command}",
            }
        )
    return rows


def describe(user: Any) -> Dict[str, Any]:
    """What ``GET settings`` answers."""
    mine, everybody = home.user_store(user), home.global_store()
    own, common = sheet(mine), sheet(everybody)
    active = own or common
    return {
        "hold": mode(),
        "may_change": bool(user.is_superuser),
        "restart": presence.restart_needed() if user.is_superuser else "",
        "thresholds": {"mine": changes(mine), "all": changes(everybody), "known": Thresholds.describe()},
        "sheet": {
            "mine": own["name"] if own else None,
            "all": common["name"] if common else None,
            "rows": active["rows"] if active else 0,
        },
        "extras": extras(),
    }
