"""Which libraries a task uses: those that ODM brings where they are new enough, else those of the folder."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Dict, List, Optional, Tuple

from ...stages.errors import UsageError
from ...stages.record import dumps, from_plain, write_text

LIST = "libraries.json"
FOLDER = "libraries"
PYTHONS = ("3.12", "3.9")


@dataclass(frozen=True)
class Library:
    """A distribution, the module it is imported as, the oldest version that serves, and what it is for.

    ``always`` is set where no ODM image brings it; ``pythons`` limits that to
    some Pythons.
    """

    name: str
    module: str
    minimum: str
    purpose: str
    always: bool = False
    pythons: Tuple[str, ...] = PYTHONS
    specifier: str = ""


# What ODM's images hold (numpy, Pillow, OpenCV, pyproj) is carried only where a wheel of it is put beside.
LIBRARIES: Tuple[Library, ...] = (
    Library("pycolmap", "pycolmap", "3.13", "the alignment", always=True, pythons=("3.12",), specifier=">=4.0,<5"),
    Library("pycolmap", "pycolmap", "3.13", "the alignment", always=True, pythons=("3.9",), specifier=">=3.13,<3.14"),
    Library("Jinja2", "jinja2", "3.0", "report.html", always=True),
    Library("MarkupSafe", "markupsafe", "2.0", "report.html", always=True),
    Library("Pillow", "PIL", "9.4", "reading images", always=True, pythons=("3.9",)),
    Library("Pillow", "PIL", "9.4", "reading images", pythons=("3.12",)),
    Library("numpy", "numpy", "1.23", "everything"),
    Library("opencv-python-headless", "cv2", "4.5", "harmonizing and the alignment", specifier=">=4.5,<6"),
    Library("pyproj", "pyproj", "3.3", "ground control in other coordinate systems"),
)


def wanted(python: str) -> Tuple[Library, ...]:
    """The libraries that a folder for ``python`` may carry."""
    if python not in PYTHONS:
        raise UsageError(f"--python is one of {', '.join(PYTHONS)}, not {python}.")
    return tuple(lib for lib in LIBRARIES if python in lib.pythons)


@dataclass(frozen=True)
class Carried:
    """One distribution in the folder."""

    name: str
    module: str
    minimum: str
    version: str


def write_list(folder: Path, python: str, machine: str, carried: Tuple[Carried, ...]) -> None:
    """Note what the folder carries and for which Python and machine."""
    write_text(folder / LIST, dumps({"python": python, "machine": machine, "libraries": list(carried)}))


def _numbers(version: str) -> Tuple[int, ...]:
    return tuple(int(n) for n in re.findall(r"\d+", version)[:3])


def _version(names: Tuple[str, ...]) -> Optional[str]:
    for name in names:
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return None


def serves(library: Carried) -> bool:
    """Whether this Python has the library in a version that serves; one without a version was built for ODM."""
    if importlib.util.find_spec(library.module) is None:
        return False
    version = _version((library.name, library.name.replace("-headless", ""), library.module))
    return version is None or _numbers(version) >= _numbers(library.minimum)


def complete(folder: str, odm: str) -> List[str]:
    """Put on ``sys.path`` what this Python lacks of what the folder carries; returns the names put there."""
    running = f"{sys.version_info[0]}.{sys.version_info[1]}"
    for name in ("dist-packages", "site-packages"):
        built = os.path.join(odm, "SuperBuild", "install", "lib", f"python{running}", name)
        if os.path.isdir(built) and built not in sys.path:
            sys.path.append(built)  # the OpenCV that ODM was built with
    try:
        with open(os.path.join(folder, LIST), encoding="utf-8") as stream:
            said: Dict[str, object] = json.load(stream)
    except (OSError, ValueError):
        return []
    listed = said.get("libraries")
    if said.get("python") != running or not isinstance(listed, list):
        return []
    put: List[str] = []
    for item in listed:
        library = from_plain(Carried, item)
        if not serves(library):
            sys.path.insert(1, os.path.join(folder, FOLDER, library.name))
            put.append(library.name)
    return put
