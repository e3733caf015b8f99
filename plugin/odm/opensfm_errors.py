"""Reprojection errors per frame, gathered in one pass and bounded memory.

ODM's own mean leaves out whatever lies beyond 4 px, so it can never say more
than 4. Its tracks on the other hand hold mismatches that the solver had cast
off. Errors are therefore gathered in bins per frame; what counts is decided
per camera by its own median.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np
import numpy.typing as npt

from ...stages.thresholds import Thresholds

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

_EDGES = np.geomspace(0.01, 1000.0, 251)


@dataclass(frozen=True)
class ErrorFigures:
    """Errors of one camera, or of everything, in pixels of the frame as ODM read it.

    ``mean_px`` is over ``counted`` of ``observations``: mismatches are left
    out where they are few. ``odm_px`` leaves out everything beyond 4 px, as
    ODM's report does; ``all_px`` nothing (a point behind its camera counts as
    the largest error). ``beyond`` is the share beyond 4 px.
    """

    observations: int
    counted: int
    mean_px: Optional[float]
    odm_px: Optional[float]
    all_px: Optional[float]
    beyond: Optional[float]


class ErrorTable:
    """Errors by frame and bin."""

    def __init__(self, frames: int, cutoff_px: float) -> None:
        self._cutoff = cutoff_px
        self._bins = len(_EDGES) + 1
        self._count = np.zeros((frames, self._bins), dtype=np.int64)
        self._sum = np.zeros((frames, self._bins))
        self._small_sum = np.zeros(frames)
        self._small = np.zeros(frames, dtype=np.int64)

    def add(self, frame: Ints, error_px: Array) -> None:
        """Add errors (N,) of frames (N,); what is no number counts as the largest."""
        error = np.where(np.isfinite(error_px), np.minimum(error_px, 1e4), 1e4)
        at = frame * self._bins + np.searchsorted(_EDGES, error, side="left")
        size = self._count.size
        self._count += np.bincount(at, minlength=size).reshape(self._count.shape)
        self._sum += np.bincount(at, weights=error, minlength=size).reshape(self._sum.shape)
        small = error <= self._cutoff
        self._small += np.bincount(frame[small], minlength=len(self._small))
        self._small_sum += np.bincount(frame[small], weights=error[small], minlength=len(self._small))

    def _last_bin(self, rows: Ints, limits: Thresholds) -> int:
        """The last bin that counts for one camera's frames."""
        count = self._count[rows].sum(axis=0)
        total = int(count.sum())
        if not total:
            return self._bins
        middle = int(np.searchsorted(np.cumsum(count), (total + 1) // 2))
        median = float(_EDGES[min(middle, len(_EDGES) - 1)])
        cut = max(limits.outcome_outlier_px, limits.outcome_outlier_medians * median)
        last = int(np.searchsorted(_EDGES, cut, side="left"))
        left_out = int(count[last + 1 :].sum())
        return last if left_out <= limits.outcome_outlier_share * total else self._bins

    def figures(self, rows: Ints, limits: Thresholds) -> ErrorFigures:
        """Errors of the frames of one camera."""
        last = self._last_bin(rows, limits)
        count, total = self._count[rows], int(self._count[rows].sum())
        counted, small = int(count[:, : last + 1].sum()), int(self._small[rows].sum())
        return ErrorFigures(
            observations=total,
            counted=counted,
            mean_px=_mean(float(self._sum[rows, : last + 1].sum()), counted),
            odm_px=_mean(float(self._small_sum[rows].sum()), small),
            all_px=_mean(float(self._sum[rows].sum()), total),
            beyond=round(1.0 - small / total, 4) if total else None,
        )

    def per_frame(self, rows: Ints, limits: Thresholds) -> Tuple[Array, Ints]:
        """Mean error (NaN without any) and counted observations of each frame of one camera."""
        last = self._last_bin(rows, limits)
        count = self._count[rows, : last + 1].sum(axis=1)
        total = self._sum[rows, : last + 1].sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(count > 0, total / np.maximum(count, 1), np.nan), count


def _mean(total: float, count: int) -> Optional[float]:
    return round(total / count, 4) if count else None
