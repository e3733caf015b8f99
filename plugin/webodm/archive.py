"""The archive that WebODM takes: the tree, and the two files at its root by which WebODM knows a plugin."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import Dict, Iterator, Tuple

from ...stages.errors import SensorgateError, UsageError
from ..version import VERSION

FOLDER = "sensorgate"
# WebODM resolves plugin.py to the package beside it; the file has to be there and is never imported.
_STUB = '"""WebODM wants a file of this name; the plugin is the package ``plugin``."""\n\nraise ImportError(__doc__)\n'
_INIT = '''"""sensorgate {version} as a plugin of WebODM."""

from importlib.util import find_spec

if find_spec("app") is not None and find_spec("app.plugins") is not None:
    from .plugin.webodm.plugin import Plugin  # noqa: F401
'''
_PACKAGES = ("plugin", "stages")
_SINGLE = ("manifest.json", "LICENSE")
_LEFT_OUT = ("__pycache__",)
_MOMENT = (1980, 1, 1, 0, 0, 0)  # the same tree gives the same bytes


def files_of(root: Path) -> Iterator[Tuple[str, bytes]]:
    """(name in the archive, content) of everything that goes in, by name."""
    found: Dict[str, bytes] = {
        "__init__.py": _INIT.format(version=VERSION).encode("utf-8"),
        "plugin.py": _STUB.encode("utf-8"),
    }
    for name in _SINGLE:
        if (root / name).is_file():
            found[name] = (root / name).read_bytes()
    for package in _PACKAGES:
        for folder, folders, names in os.walk(root / package):
            folders[:] = sorted(f for f in folders if f not in _LEFT_OUT and not f.startswith("."))
            for name in sorted(names):
                if name.endswith((".pyc", ".pyo")) or name.startswith("."):
                    continue
                file = Path(folder) / name
                found[file.relative_to(root).as_posix()] = file.read_bytes()
    for name in sorted(found):
        yield name, found[name]


def write_archive(target: Path, root: Path, folder: str = FOLDER) -> int:
    """Write the archive beside and rename it; returns its size. Raises ``UsageError``."""
    if not (root / "manifest.json").is_file():
        raise SensorgateError("The plugin's manifest is not there; install sensorgate again.")
    beside = target.with_name(f".part-{target.name}")
    try:
        with zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in files_of(root):
                entry = zipfile.ZipInfo(f"{folder}/{name}", _MOMENT)
                entry.external_attr = 0o644 << 16
                entry.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(entry, content)
        os.replace(beside, target)
    except OSError as error:
        raise UsageError(f"Cannot write {target}: {error.strerror or error}.") from error
    finally:
        if beside.exists():
            beside.unlink()
    return target.stat().st_size
