"""GDAL by its Python bindings, or by its programs where those are missing.

Both take the same option lists, so a caller does not know which it has.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any, Dict, List, Sequence

from .errors import FrameError, MissingDependency

_PROGRAMS = ("gdalinfo", "gdalwarp", "gdal_translate")
_HEADS = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")
_SETTINGS = {"GDAL_PAM_ENABLED": "NO", "PROJ_NETWORK": "OFF", "GDAL_NUM_THREADS": "1", "GDAL_CACHEMAX": "256"}


class Gdal:
    """The three operations that fusing needs; ``FrameError`` ``raster-unusable`` where GDAL refuses a file."""

    def info(self, path: Path) -> Dict[str, Any]:
        """Return gdalinfo's JSON of a raster."""
        raise NotImplementedError

    def warp(self, options: Sequence[str], source: Path, target: Path) -> None:
        """Run gdalwarp."""
        raise NotImplementedError

    def translate(self, options: Sequence[str], source: Path, target: Path) -> None:
        """Run gdal_translate."""
        raise NotImplementedError


class _Bindings(Gdal):
    def __init__(self, module: Any) -> None:
        self._gdal = module
        module.UseExceptions()
        for name, value in _SETTINGS.items():
            module.SetConfigOption(name, value)

    def info(self, path: Path) -> Dict[str, Any]:
        found = self._try(path, lambda: self._gdal.Info(str(path), format="json"))
        return dict(found)

    def warp(self, options: Sequence[str], source: Path, target: Path) -> None:
        given = self._gdal.WarpOptions(options=list(options))
        self._try(source, lambda: self._gdal.Warp(str(target), str(source), options=given))

    def translate(self, options: Sequence[str], source: Path, target: Path) -> None:
        given = self._gdal.TranslateOptions(options=list(options))
        self._try(source, lambda: self._gdal.Translate(str(target), str(source), options=given))

    @staticmethod
    def _try(path: Path, work: Any) -> Any:
        try:
            result = work()
        except RuntimeError as error:
            raise _unusable(path, str(error)) from None
        if result is None:
            raise _unusable(path, "")
        return result


class _Programs(Gdal):
    def info(self, path: Path) -> Dict[str, Any]:
        try:
            return dict(json.loads(self._run(path, ["gdalinfo", "-json", str(path)])))
        except ValueError:
            raise _unusable(path, "gdalinfo gave no JSON") from None

    def warp(self, options: Sequence[str], source: Path, target: Path) -> None:
        self._run(source, ["gdalwarp", "-q", "-overwrite", *options, str(source), str(target)])

    def translate(self, options: Sequence[str], source: Path, target: Path) -> None:
        self._run(source, ["gdal_translate", "-q", *options, str(source), str(target)])

    @staticmethod
    def _run(path: Path, command: List[str]) -> str:
        done = subprocess.run(command, capture_output=True, check=False, env={**os.environ, **_SETTINGS})
        if done.returncode != 0:
            raise _unusable(path, done.stderr.decode("utf-8", "replace"))
        return done.stdout.decode("utf-8", "replace")


def _unusable(path: Path, detail: str) -> FrameError:
    last = [line for line in detail.strip().splitlines() if line.strip()][-1:] or ["no reason given"]
    return FrameError("raster-unusable", f"GDAL cannot work with {path.name}: {last[0]}")


def find_gdal() -> Gdal:
    """The bindings, else the programs. Raises ``MissingDependency``."""
    try:
        from osgeo import gdal

        return _Bindings(gdal)
    except ImportError:
        pass
    if all(shutil.which(p) for p in _PROGRAMS):
        return _Programs()
    raise MissingDependency(
        "GDAL", "fusing orthophotos", "apt-get install gdal-bin (or: pip install 'sensorgate[geo]')"
    )


def looks_like_tiff(path: Path) -> bool:
    """Whether a file begins like a TIFF: other formats may point to files of their own and are not opened."""
    try:
        with open(path, "rb") as stream:
            return stream.read(4) in _HEADS
    except OSError:
        return False
