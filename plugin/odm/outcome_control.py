"""The ground control that an ODM run had, as marks of the alignment: what it proves of the reconstruction.

ODM's own residuals are those of points that it pulled the model towards. Here
the marks are intersected in its cameras and laid on their coordinates by the
rules that prove an alignment: points enough, in frames enough, over ground
enough.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import List, Mapping, Optional, Sequence, Tuple

from ...stages.align.control import NO_CONTROL, Controlled
from ...stages.align.held import hold_control
from ...stages.align.model import AlignRequest, GcpMark
from ...stages.align.solution import Job, Solution
from ...stages.align.world import Ground
from ...stages.errors import UsageError
from ...stages.gcp import marks_from_file
from ...stages.thresholds import Thresholds

# The project's own list, else the copy that ODM handed to OpenSfM.
_LISTS = ("gcp_list.txt", "opensfm/gcp_list.txt")


def marks_of_project(
    folder: Path, request: AlignRequest, name_of: Mapping[str, str], notes: List[str]
) -> Tuple[GcpMark, ...]:
    """The marks of the project's ground control list on its frames; a list that cannot be read is noted."""
    file: Optional[Path] = next((folder / n for n in _LISTS if (folder / n).is_file()), None)
    if file is None:
        return ()
    path_of = {name_of[f.path]: f.path for f in request.frames}
    try:
        found = marks_from_file(file, [replace(f, path=name_of[f.path]) for f in request.frames])
    except UsageError as error:
        notes.append(str(error))
        return ()
    # Every line of the list went into ODM's adjustment: none is a check point any more.
    return tuple(replace(m, path=path_of[m.path], check=False) for m in found)


def control_of(
    request: AlignRequest,
    job: Job,
    solution: Solution,
    ground: Ground,
    no_formula: Sequence[str],
    used: bool,
    limits: Thresholds,
) -> Controlled:
    """What ground control says of ODM's model; ``used`` says whether ODM had adjusted the model to it.

    Marks on frames ``no_formula`` (paths) are left out: the rays of their
    cameras are none of Brown's.
    """
    blind = set(no_formula)
    marks = tuple(m for m in request.gcps if m.path not in blind)
    if not marks:
        return NO_CONTROL
    asked = replace(request, gcps=marks)
    _, control = hold_control(asked, job, solution, solution.cameras, ground, "odm", Path(), limits)
    return replace(control, fit=replace(control.fit, held=used)) if control.fit is not None else control
