"""The document's router: a decision from an alignment's figures, and the alignment that follows from it."""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Mapping, Optional, Sequence, Tuple, Union

from .align.blocks import likeness, subset
from .align.judge import PASS
from .align.model import AlignmentReport, AlignRequest, GcpMark
from .align.prepare import sorted_request
from .align.run import Aligned
from .errors import UsageError
from .gcp import marks_from_file
from .ladder import Ladder
from .proven import PAIRWISE
from .thresholds import DEFAULTS, Thresholds

PROCEED_STRATEGY = "proceed_bundle_adjustment"
FALLBACK_STRATEGY = "fallback_pairwise"


class PipelineRouter:
    """Decides from an alignment's figures, and does what it decided.

    ``min_inliers`` is the number of verified matches and ``max_reproj_error``
    the mean reprojection error in px of an accepted alignment.
    """

    def __init__(
        self,
        min_inliers: int = DEFAULTS.min_inliers,
        max_reproj_error: float = DEFAULTS.max_reproj_error_px,
        thresholds: Thresholds = DEFAULTS,
    ) -> None:
        self.thresholds = thresholds.replaced(
            {"min_inliers": min_inliers, "max_reproj_error_px": float(max_reproj_error)}
        )
        self.min_inliers = min_inliers
        self.max_reproj_error = max_reproj_error

    def evaluate_alignment(self, match_report: Union[AlignmentReport, Mapping[str, Any]]) -> str:
        """Return ``proceed_bundle_adjustment`` or ``fallback_pairwise``.

        A mapping needs ``inliers`` and ``mean_reproj_error`` (also under the
        names that ``report.json`` uses); a figure that is missing or not a
        number is a fallback, never a pass. ``components`` is held to one where
        the mapping says it: matches of a pair have none. A report proceeds only
        where its own verdict agrees.
        """
        if isinstance(match_report, AlignmentReport):
            if match_report.verdict != PASS:
                return FALLBACK_STRATEGY
            figures: Dict[str, Any] = {
                "inliers": match_report.median_inliers,
                "mean_reproj_error": match_report.mean_reproj_error_px,
                "components": 1 + max(0, match_report.components - match_report.areas),
            }
        else:
            figures = {name: _first(match_report, names) for name, names in _FIGURES.items()}
            if not any(name in match_report for name in _FIGURES["components"]):
                figures["components"] = 1
        inliers, error, components = (_finite(figures[name]) for name in _FIGURES)
        if inliers is None or error is None or components is None:
            return FALLBACK_STRATEGY
        good = inliers >= self.min_inliers and 0.0 <= error <= self.max_reproj_error and components == 1
        return PROCEED_STRATEGY if good else FALLBACK_STRATEGY

    def execute_fallback(
        self,
        strategy: str,
        image_subset: Union[AlignRequest, Sequence[Union[str, Path]]],
        *,
        gcp: Optional[Union[str, Path, Sequence[GcpMark]]] = None,
        workspace: Optional[Union[str, Path]] = None,
        engine: str = "pycolmap",
        max_dim: Optional[int] = None,
    ) -> AlignmentReport:
        """Align the frames pairwise, payload after payload, and return the last report.

        ``image_subset`` is a request or paths of frames; of paths that cannot
        share one alignment, the largest set is taken. ``strategy`` is
        ``fallback_pairwise`` or ``proceed_bundle_adjustment`` (one joint
        alignment). ``gcp`` is a ground control list (``gcp_list.txt``) in pixels
        of these frames, or its marks. Files go to ``workspace`` alone, a
        temporary folder that is removed when none is given.
        """
        if strategy not in (FALLBACK_STRATEGY, PAIRWISE, PROCEED_STRATEGY):
            raise UsageError(f"There is no strategy {strategy!r}; known: {FALLBACK_STRATEGY}, {PROCEED_STRATEGY}.")
        request = image_subset if isinstance(image_subset, AlignRequest) else _request_of_paths(image_subset)
        if isinstance(gcp, (str, Path)):
            request = replace(request, gcps=marks_from_file(gcp, request.frames))
        elif gcp:
            paths = {f.path for f in request.frames}
            request = replace(request, gcps=tuple(m for m in gcp if m.path in paths))
        if workspace is None:
            with tempfile.TemporaryDirectory(prefix="sensorgate-") as scratch:
                return self._fall_back(strategy, request, Path(scratch), engine, max_dim)
        return self._fall_back(strategy, request, Path(workspace), engine, max_dim)

    def _fall_back(
        self, strategy: str, request: AlignRequest, workspace: Path, engine: str, max_dim: Optional[int]
    ) -> AlignmentReport:
        ladder = Ladder(workspace, self.thresholds, engine, max_dim, None, None)
        if strategy == PROCEED_STRATEGY:
            return ladder.run(request, "quick").report
        return _one_by_one(ladder, sorted_request(request)).report


_FIGURES: Mapping[str, Tuple[str, ...]] = {
    "inliers": ("inliers", "num_inliers", "min_inliers", "median_inliers", "inlier_count"),
    "mean_reproj_error": (
        "mean_reproj_error",
        "mean_reproj_error_px",
        "mean_reprojection_error",
        "reproj_error",
        "reprojection_error",
    ),
    "components": ("components", "num_components", "connected_components"),
}


def _first(figures: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((figures[n] for n in names if n in figures), None)


def _finite(value: Any) -> Optional[float]:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        value = value.item() if hasattr(value, "item") and getattr(value, "shape", None) == () else None
    if value is None or not math.isfinite(value):
        return None
    return float(value)


def _request_of_paths(paths: Sequence[Union[str, Path]]) -> AlignRequest:
    from .document import requests_for
    from .errors import BlockedError
    from .read import scan
    from .sensors import load_sheet
    from .survey import build

    survey = build(scan([str(p) for p in paths]), load_sheet(), DEFAULTS)
    requests = requests_for(survey)
    if not requests:
        raise BlockedError("None of these frames can be used.")
    return max(requests, key=lambda r: (len(r.frames), r.name))


def _one_by_one(ladder: Ladder, request: AlignRequest) -> Aligned:
    """Align the largest payload, then register each further one onto the model, nearest in size first."""
    count: Dict[str, int] = {}
    for frame in request.frames:
        count[frame.payload] = count.get(frame.payload, 0) + 1
    order = sorted(count, key=lambda p: (-count[p], p))
    current = ladder.run(subset(request, {order[0]}), "pairwise")
    for place, payload in enumerate(order[1:], start=2):
        both = subset(request, set(order[:place]))
        whole = current.solution.models == 1
        wish = likeness(both, payload, ladder.limits)
        current = ladder.run(both, "pairwise", (wish,), current if whole else None)
    return current
