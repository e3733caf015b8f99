"""The sub-projects' orthophotos in one file, and how well they lie on each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

from ..stages.errors import UsageError
from ..stages.progress import Cancel, Progress
from ..stages.rasters import Fusion, fuse_rasters
from ..stages.record import to_plain
from ..stages.thresholds import DEFAULTS, Thresholds
from .odm.layout import ORTHOPHOTO

SCHEMA_VERSION = 1


def find_orthophotos(folder: Path) -> Tuple[Tuple[str, Path], ...]:
    """Name and orthophoto of every sub-project below ``folder``/projects (or ``folder``), by name."""
    for base in (folder / "projects", folder):
        if base.is_dir():
            found = [(p.name, p.joinpath(*ORTHOPHOTO)) for p in sorted(base.iterdir()) if p.is_dir()]
            present = tuple((name, path) for name, path in found if path.is_file())
            if present:
                return present
    return ()


def named(files: Sequence[Path]) -> Tuple[Tuple[str, Path], ...]:
    """Names for files that were given one by one: the project's folder, else the file's own name, made unique."""
    result: List[Tuple[str, Path]] = []
    taken = set()
    for path in files:
        inside = path.parts[-2:] == ORTHOPHOTO and len(path.resolve().parts) > 3
        base = path.resolve().parts[-3] if inside else path.stem
        name, number = base, 2
        while name in taken:
            name, number = f"{base}-{number}", number + 1
        taken.add(name)
        result.append((name, path))
    return tuple(result)


def fuse(
    paths: Sequence[Path],
    out: Path,
    *,
    thresholds: Thresholds = DEFAULTS,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Fusion:
    """Fuse the orthophotos below the folders of ``paths``, or the files that it names, into ``out``.

    Raises ``UsageError`` where there is none, ``MissingDependency`` without
    GDAL, ``BlockedError`` where none can be used.
    """
    sources: List[Tuple[str, Path]] = []
    files = [p for p in paths if not p.is_dir()]
    absent = [p for p in files if not p.is_file()]
    if absent:
        raise UsageError(f"{absent[0]} does not exist.")
    for folder in (p for p in paths if p.is_dir()):
        found = find_orthophotos(folder)
        if not found:
            raise UsageError(
                f"There is no orthophoto below {folder} (projects/NAME/{'/'.join(ORTHOPHOTO)}). "
                "Process the sub-projects first (sensorgate submit, or each project's sensorgate/odm.sh)."
            )
        sources.extend(found)
    sources.extend(named(files))
    names = [name for name, _ in sources]
    if len(set(names)) < len(names):
        sources = list(named([path for _, path in sources]))
    return fuse_rasters(sources, out, thresholds, progress=progress, cancel=cancel)


def record(fusion: Fusion) -> Dict[str, Any]:
    """What ``--json`` writes."""
    return {"schema_version": SCHEMA_VERSION, **to_plain(fusion)}


def lines(fusion: Fusion) -> List[str]:
    """What is printed: the file, its bands, the distances, what to know."""
    told = [
        f"{fusion.file}: {fusion.width} x {fusion.height} pixels of {fusion.pixel:.4g} map units, "
        f"{len(fusion.bands)} bands, {fusion.kind}, no data = {fusion.nodata:g}"
    ]
    told += [f"  band {band.index:<3} {band.name}  ({band.source})" for band in fusion.bands]
    for shift in fusion.shifts:
        if shift.points:
            told.append(
                f"  {shift.raster} on {shift.reference}: {shift.median:.3g} map units apart in the median, "
                f"{shift.p95:.3g} at the 95th percentile ({shift.median_px:.2g} px of the coarser raster)"
            )
    told += [f"{f.severity.upper()} {f.code}: {f.message} {f.remedy}" for f in fusion.findings]
    return told
