"""Align a group of frames and judge what came out.

``align`` is the one public call: pairs, solve, calibrate, measure, judge.
"""

from __future__ import annotations

from pathlib import Path
from typing import Optional, Union

from ..progress import Cancel, Progress
from ..thresholds import DEFAULTS, Thresholds
from .model import AlignmentReport, AlignRequest
from .run import align_once

__all__ = ["align"]


def align(
    request: AlignRequest,
    workspace: Union[str, Path],
    *,
    thresholds: Thresholds = DEFAULTS,
    engine: str = "pycolmap",
    rung: str = "quick",
    max_dim: Optional[int] = None,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    lock: bool = False,
) -> AlignmentReport:
    """Align ``request`` inside ``workspace`` and return the report with a verdict per payload.

    ``rung`` is ``quick`` or ``mixed`` (more and weaker features), ``max_dim``
    the longer side in px that frames are shrunk to. ``lock`` holds every
    trusted calibration without trying others. Features stay in the workspace
    and are used again. Nothing is written elsewhere.

    Raises ``MissingDependency`` where the engine is not installed,
    ``SolverFailed`` where its process died, ``Cancelled``, and ``UsageError``
    for an unknown engine or rung.
    """
    return align_once(
        request,
        Path(workspace),
        thresholds=thresholds,
        engine=engine,
        rung=rung,
        max_dim=max_dim,
        progress=progress,
        cancel=cancel,
        lock=lock,
    ).report
