"""The calls that scripts know by name: profile, assert, and a locked alignment of one folder."""

from __future__ import annotations

import shutil
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any, Dict, List, Optional, Union

from .align.model import AlignmentReport, AlignRequest
from .errors import BlockedError, InconsistentProfiles
from .finding import ERROR
from .gate import assess
from .harmonize.model import untouched
from .read import scan
from .sensors import load_sheet
from .survey import Survey, build
from .thresholds import DEFAULTS, Thresholds

Folder = Union[str, Path]


def survey_of(image_dir: Folder, thresholds: Thresholds = DEFAULTS) -> Survey:
    """Read a folder and place its frames. Raises ``UsageError`` where there is no such folder."""
    return build(scan([str(image_dir)]), load_sheet(thresholds=thresholds), thresholds)


def profile_images(image_dir: Folder, max_focal_variance: float = 0.03) -> Dict[str, Dict[str, Any]]:
    """Group a folder's frames by true camera.

    Returns ``{"Make_Model": {"focal": [mm per frame], "res": {(width, height)},
    "sensor_w": {mm}}}``; further cameras of one make and model are
    ``Make_Model#2`` and so on, in the order of their profile ids.
    """
    survey = survey_of(image_dir, DEFAULTS.replaced({"focal_variance": max_focal_variance}))
    files = survey.file_of()
    counted: Dict[str, int] = defaultdict(int)
    result: Dict[str, Dict[str, Any]] = {}
    for profile in survey.profiles:
        name = f"{profile.make}_{profile.model}"
        counted[name] += 1
        key = name if counted[name] == 1 else f"{name}#{counted[name]}"
        width = profile.intrinsics.sensor_width_mm
        result[key] = {
            "focal": [f for p in profile.frames if (f := files[p].focal_mm) is not None],
            "res": {(files[p].width, files[p].height) for p in profile.frames},
            "sensor_w": set() if width is None else {round(width, 4)},
        }
    return result


def assert_profiles_consistent(image_dir: Folder, max_focal_variance: float = 0.03) -> Dict[str, Dict[str, Any]]:
    """Return ``profile_images`` or raise ``InconsistentProfiles`` naming every failed rule.

    Raises ``BlockedError`` where the folder holds no usable frame.
    """
    limits = DEFAULTS.replaced({"focal_variance": max_focal_variance})
    survey = survey_of(image_dir, limits)
    if not survey.profiles:
        raise BlockedError(f"There is no readable frame in {image_dir}.")
    failed = [f for f in assess(survey, limits).findings if f.severity == ERROR]
    if failed:
        raise InconsistentProfiles("; ".join(f"{f.code}: {f.message}" for f in failed))
    return profile_images(image_dir, max_focal_variance)


def requests_for(survey: Survey, thresholds: Thresholds = DEFAULTS) -> List[AlignRequest]:
    """The solver's requests for a survey as it is, pixels untouched."""
    from .assemble import groups_of, request_of

    return [request_of(group, survey, untouched(survey.files), thresholds) for group in groups_of(survey)]


def run_locked_sfm(image_dir: Folder, workspace: Optional[Folder] = None) -> AlignmentReport:
    """Align a folder with its trusted intrinsics held, and return the report of its largest group.

    Drives the COLMAP program where it is installed, pycolmap otherwise. All
    files go to ``workspace`` (a temporary folder when none is given, removed
    afterwards); nothing is written into ``image_dir``.
    """
    from .align import align

    survey = survey_of(image_dir)
    requests = requests_for(survey)
    if not requests:
        raise BlockedError(f"There is no usable frame in {image_dir}.")
    request = max(requests, key=lambda r: len(r.frames))
    engine = "colmap" if shutil.which("colmap") else "pycolmap"
    if workspace is not None:
        return align(request, Path(workspace), engine=engine, lock=True)
    with tempfile.TemporaryDirectory(prefix="sensorgate-") as scratch:
        return align(request, Path(scratch), engine=engine, lock=True)
