"""Writes the folder that NodeODM takes as its ``odm_path``, with all that it needs to run without internet."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

from ...stages.errors import MissingDependency, UsageError
from ...stages.record import write_text
from ..version import VERSION
from .command import PARSERS
from .libraries import FOLDER, LIST, Carried, Library, wanted, write_list

_FILES = Path(__file__).with_name("files")
_PACKAGE = Path(__file__).resolve().parents[2]
_OURS = frozenset(("run.sh", "start.py", "opendm", "site", FOLDER, LIST, "ODM_HOME", "VERSION", "ENGINE", "SuperBuild"))
# The C libraries of the systems that ODM's images stand on, newest first: 24.04 for 3.12, 21.04 for 3.9.
_MANYLINUX = {"3.12": ("2_39", "2_34", "2_31", "2_28", "2_27", "2_24", "2_17"), "3.9": ("2_31", "2_28", "2_24", "2_17")}
_OLD_NAMES = ("manylinux2014", "manylinux2010")
_MACHINES = {"amd64": "x86_64", "x64": "x86_64", "arm64": "aarch64"}


@dataclass(frozen=True)
class Written:
    """What the folder holds: distributions with their versions, those that were not found, and what to say."""

    folder: Path
    carried: Tuple[Carried, ...]
    missing: Tuple[Library, ...]
    notes: Tuple[str, ...]


def write_folder(
    odm: Path, out: Path, *, python: str = "3.12", wheels: Optional[Path] = None, machine: Optional[str] = None
) -> Written:
    """Write the folder ``out`` for the ODM in ``odm``, as that path will be called where the node runs.

    Nothing of ODM is copied or changed. Libraries come from ``wheels``, or
    from the package index without it. Raises ``UsageError`` where ``out``
    holds other things or ``odm`` is no ODM, ``MissingDependency`` without pip.
    """
    libraries = wanted(python)
    told = (machine or platform.machine()).lower()
    kind = _MACHINES.get(told, told)
    notes = _check(odm, out, wheels)
    out.mkdir(parents=True, exist_ok=True)
    for name in sorted(_OURS):
        _remove(out / name)
    _copy_files(out)
    _copy_package(out / "site" / "sensorgate")
    _note_odm(odm, out)
    carried, missing = _carry(out / FOLDER, libraries, python, kind, wheels)
    write_list(out, python, kind, carried)
    if any(lib.module == "pycolmap" for lib in missing):
        notes.append(
            f"There is no pycolmap for Python {python} on {kind}: this node gates, harmonizes and routes by metadata "
            "and proves nothing by an alignment."
        )
    return Written(out, carried, missing, tuple(notes))


def _check(odm: Path, out: Path, wheels: Optional[Path]) -> List[str]:
    if not odm.is_absolute():
        raise UsageError(f"--odm takes the absolute path of ODM where the node runs, not {odm}.")
    if wheels is not None and not wheels.is_dir():
        raise UsageError(f"--wheels: there is no folder {wheels}.")
    if out.exists():
        there = {p.name for p in out.iterdir()} if out.is_dir() else {"a file"}
        if not there <= _OURS:
            raise UsageError(f"{out} is not empty. Choose a new folder, or one that this command wrote.")
    if out.resolve() == odm.resolve() or odm.resolve() in out.resolve().parents:
        raise UsageError(f"{out} lies inside ODM. Choose a folder beside it: ODM stays as it is.")
    if not odm.exists():
        return [f"There is no {odm} on this machine; it has to be there where the node runs."]
    if not (odm / "run.sh").is_file() or not any((odm / name).is_file() for name in PARSERS):
        raise UsageError(f"{odm} is no ODM: run.sh and {PARSERS[0]} are not there.")
    return []


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif path.exists() or path.is_symlink():
        path.unlink()


def _copy_files(out: Path) -> None:
    for name, target, mode in (
        ("run.sh", "run.sh", 0o755),
        ("start.py", "start.py", 0o644),
        ("config.py", "opendm/config.py", 0o644),
    ):
        write_text(out / target, (_FILES / name).read_text(encoding="utf-8"))
        (out / target).chmod(mode)
    write_text(out / "opendm/__init__.py", "")


def _copy_package(target: Path) -> None:
    """Our own package as it stands, tests and caches left out."""
    kept = ("plugin", "stages")
    for name in kept:
        shutil.copytree(_PACKAGE / name, target / name, ignore=shutil.ignore_patterns("__pycache__", "*.pyc", ".*"))
    shutil.copyfile(_PACKAGE / "manifest.json", target / "manifest.json")


def _note_odm(odm: Path, out: Path) -> None:
    write_text(out / "ODM_HOME", f"{odm}\n")
    for name in ("VERSION", "ENGINE"):
        if (odm / name).is_file():
            shutil.copyfile(odm / name, out / name)
    if not odm.exists():
        (out / "VERSION").symlink_to(odm / "VERSION")
    # NodeODM's own tools look for ODM's libraries below its odm_path.
    (out / "SuperBuild").symlink_to(odm / "SuperBuild", target_is_directory=True)


def _carry(
    folder: Path, libraries: Sequence[Library], python: str, machine: str, wheels: Optional[Path]
) -> Tuple[Tuple[Carried, ...], Tuple[Library, ...]]:
    """Install each library into a folder of its own, by pip, for the other Python and machine."""
    carried: List[Carried] = []
    missing: List[Library] = []
    for library in libraries:
        if not library.always and not _has_wheel(library, wheels):
            continue
        target = folder / library.name
        if _install(library, target, python, machine, wheels):
            carried.append(Carried(library.name, library.module, library.minimum, _version_in(target)))
        else:
            _remove(target)
            missing.append(library)
    return tuple(carried), tuple(missing)


def _has_wheel(library: Library, wheels: Optional[Path]) -> bool:
    start = library.name.lower().replace("-", "_") + "-"
    return wheels is not None and any(p.name.lower().startswith(start) for p in wheels.glob("*.whl"))


def _platforms(python: str, machine: str) -> List[str]:
    names = [f"manylinux_{glibc}_{machine}" for glibc in _MANYLINUX[python]]
    return [*names, *(f"{old}_{machine}" for old in _OLD_NAMES)]


def _install(library: Library, target: Path, python: str, machine: str, wheels: Optional[Path]) -> bool:
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input"]
    command += ["--no-deps", "--no-compile", "--only-binary=:all:", "--target", str(target), "--python-version", python]
    for name in _platforms(python, machine):
        command += ["--platform", name]
    if wheels is not None:
        command += ["--no-index", "--find-links", str(wheels)]
    floor = library.specifier or f">={library.minimum}"
    done = subprocess.run(
        [*command, f"{library.name}{floor}"],
        capture_output=True,
        text=True,
        env=dict(os.environ, PIP_REQUIRE_VIRTUALENV="0"),
    )
    if "No module named pip" in done.stderr:
        raise MissingDependency("pip", "filling the folder with libraries", "python -m ensurepip")
    if done.returncode == 0:
        shutil.rmtree(target / "bin", ignore_errors=True)  # scripts that name this machine's Python
    return done.returncode == 0


def _version_in(target: Path) -> str:
    found = sorted(p.name for p in target.glob("*.dist-info"))
    return found[0][: -len(".dist-info")].rpartition("-")[2] if found else ""


def summary(written: Written) -> List[str]:
    """What to tell who called."""
    held = ", ".join(f"{c.name} {c.version}" for c in written.carried)
    told = [
        f"Written: {written.folder} (sensorgate {VERSION}{'; ' + held if held else ''})",
        *(f"Note: {note}" for note in written.notes),
    ]
    left = [lib for lib in written.missing if lib.module != "pycolmap"]
    if left:
        told.append("Not found: " + ", ".join(f"{lib.name} ({lib.purpose})" for lib in left))
    told.append(f"Start the node with: node index.js --odm_path {written.folder}")
    return told
