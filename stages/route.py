"""From frames that may share a project to groups that provably do: the ladder, and the document's router.

quick → mixed-block settings with pairs found by likeness → each refused
payload pairwise onto the proven ones, tied by ground control where there is
any → its own group. Every payload ends in exactly one group; what nothing can
prove is a group of its own, never dropped.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple, Union

from .align.blocks import blocks, likeness, subset
from .align.control import checked
from .align.judge import FAIL, PASS, UNPROVEN
from .align.model import AlignmentReport, AlignRequest, GcpMark, LockDecision, PayloadAlignment
from .align.prepare import sorted_request
from .align.run import Aligned, align_once
from .align.solution import Retrieval
from .align.tie import ControlTie, joined_by_control, tie_by_control
from .align.worker import SolverFailed
from .errors import UsageError
from .gcp import marks_from_file
from .progress import Cancel, Progress, check
from .thresholds import DEFAULTS, Thresholds

PROCEED = "proceed"
PAIRWISE = "pairwise"
ISOLATE = "isolate"
ROUTES = (PROCEED, PAIRWISE, ISOLATE, UNPROVEN)

PROCEED_STRATEGY = "proceed_bundle_adjustment"
FALLBACK_STRATEGY = "fallback_pairwise"


@dataclass(frozen=True)
class ProvenGroup:
    """Payloads that share one project, with the alignment that says so.

    ``frames`` are the paths of the request's frames, sorted. ``alignment`` is
    ``None`` where no solver could be run on them. ``locked`` has one decision
    per profile that was solved.
    """

    name: str
    payloads: Tuple[str, ...]
    frames: Tuple[str, ...]
    route: str
    reasons: Tuple[str, ...]
    alignment: Optional[AlignmentReport] = None
    locked: Tuple[LockDecision, ...] = ()


@dataclass(frozen=True)
class Proof:
    """Where every payload of a request ended, and every alignment that was tried on the way."""

    groups: Tuple[ProvenGroup, ...]
    attempts: Tuple[AlignmentReport, ...]


def prove(
    request: AlignRequest,
    workspace: Union[str, Path],
    *,
    thresholds: Thresholds = DEFAULTS,
    engine: str = "pycolmap",
    max_dim: Optional[int] = None,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> Proof:
    """Climb the ladder for one request of one spectrum.

    Raises ``MissingDependency``, ``Cancelled`` and ``UsageError`` as ``align``
    does. A solver that dies on a group makes the group unproven, with its
    last words as the reason.
    """
    ladder = _Ladder(Path(workspace), thresholds, engine, max_dim, progress, cancel)
    request = sorted_request(request)
    found: List[ProvenGroup] = []
    for number, block in enumerate(blocks(request, thresholds)):
        groups = ladder.climb(block, PROCEED)
        if number:
            groups = [
                replace(g, reasons=("it lies over other ground than the rest of its request", *g.reasons))
                for g in groups
            ]
        found.extend(groups)
    return Proof(tuple(_named(request.name, found)), tuple(ladder.attempts))


def _named(name: str, groups: Sequence[ProvenGroup]) -> List[ProvenGroup]:
    order = sorted(groups, key=lambda g: (ROUTES.index(g.route), -len(g.frames), g.payloads))
    return [replace(g, name=name if i == 0 else f"{name}-{i + 1}") for i, g in enumerate(order)]


class _Ladder:
    """One climb's settings and its record of attempts."""

    def __init__(
        self,
        workspace: Path,
        limits: Thresholds,
        engine: str,
        max_dim: Optional[int],
        progress: Optional[Progress],
        cancel: Optional[Cancel],
    ) -> None:
        self.workspace = workspace
        self.limits = limits
        self.engine = engine
        self.max_dim = max_dim
        self.progress = progress
        self.cancel = cancel
        self.attempts: List[AlignmentReport] = []

    def run(
        self,
        request: AlignRequest,
        rung: str,
        extra: Sequence[Retrieval] = (),
        start: Optional[Aligned] = None,
    ) -> Aligned:
        check(self.cancel)
        side = self.max_dim
        done = align_once(
            request,
            self.workspace,
            thresholds=self.limits,
            engine=self.engine,
            rung=rung,
            max_dim=side,
            progress=self.progress,
            cancel=self.cancel,
            extra=extra,
            start=start,
        )
        self.attempts.append(done.report)
        return done

    def climb(self, request: AlignRequest, route: str) -> List[ProvenGroup]:
        """Prove a block; ``route`` is what its accepted groups are called."""
        try:
            return self._climb(request, route)
        except SolverFailed as error:
            payloads = {f.payload for f in request.frames}
            if len(payloads) == 1:
                return [_group(request, UNPROVEN, (str(error),), None)]
            said = f"the solver ended on the payloads together ({error})"
            found: List[ProvenGroup] = []
            for payload in sorted(payloads):
                for group in self.climb(subset(request, {payload}), ISOLATE):
                    found.append(replace(group, reasons=(said, *group.reasons)))
            return found

    def _climb(self, request: AlignRequest, route: str) -> List[ProvenGroup]:
        quick = self.run(request, "quick" if route != ISOLATE else "alone")
        verdicts = _verdicts(quick.report)
        if not verdicts[FAIL]:
            return self._accept(quick, route)
        several = len(quick.report.payloads) > 1
        extra = [likeness(request, p, self.limits) for p in sorted(verdicts[FAIL])] if several else []
        mixed = self.run(request, "mixed", extra)
        if not _verdicts(mixed.report)[FAIL]:
            return self._accept(mixed, route, "accepted with the settings for mixed blocks")
        best = min((quick, mixed), key=lambda a: (len(_verdicts(a.report)[FAIL]), a is mixed))
        kept, guilty = self._separate(best)
        if kept is None:
            return self._each_alone(request, best)
        return self._rejoin(request, kept, guilty, mixed, route)

    def _accept(self, done: Aligned, route: str, note: str = "") -> List[ProvenGroup]:
        """Turn an alignment without a failed payload into groups; the unproven leave the proven."""
        verdicts = _verdicts(done.report)
        notes = (note,) if note else ()
        if not verdicts[UNPROVEN]:
            return [_group(done.request, route, (*notes, *_reasons(done.report)), done.report)]
        if not verdicts[PASS]:
            names = {p.payload for p in done.report.payloads}
            if len(names) == 1 or all(
                p.strong_cross_pairs >= self.limits.min_strong_pairs for p in done.report.payloads
            ):
                return [_group(done.request, UNPROVEN, (*notes, *_reasons(done.report)), done.report)]
            return self._each_alone(done.request, done)
        found = self.climb(subset(done.request, set(verdicts[PASS])), route)
        for payload in sorted(verdicts[UNPROVEN]):
            found.extend(self.climb(subset(done.request, {payload}), ISOLATE))
        return found

    def _separate(self, done: Aligned) -> Tuple[Optional[Aligned], List[str]]:
        """Take refused payloads away until the rest stands; return the rest's alignment and who left.

        Where somebody passed, all that failed leave at once; where nobody did,
        the worst leaves alone, because one bad payload can spoil all others.
        """
        left: Set[str] = {p.payload for p in done.report.payloads}
        guilty: List[str] = []
        current = done
        while len(left) > 1:
            verdicts = _verdicts(current.report)
            if not verdicts[FAIL]:
                break
            leave = sorted(verdicts[FAIL]) if verdicts[PASS] else [_worst(current.report)]
            guilty.extend(leave)
            left -= set(leave)
            if not left:
                return None, guilty
            current = self.run(subset(done.request, left), "quick" if done.report.rung == "quick" else "mixed")
        verdicts = _verdicts(current.report)
        return (current, guilty) if not verdicts[FAIL] and verdicts[PASS] else (None, guilty)

    def _each_alone(self, request: AlignRequest, tried: Aligned) -> List[ProvenGroup]:
        """Nothing stands together: every payload by itself."""
        payloads = sorted({f.payload for f in request.frames})
        if len(payloads) == 1:
            report = tried.report
            return [_group(request, UNPROVEN, _reasons(report), report)]
        why = {p.payload: p.reasons for p in tried.report.payloads}
        found: List[ProvenGroup] = []
        for payload in payloads:
            for group in self.climb(subset(request, {payload}), ISOLATE):
                said = tuple(f"together: {r}" for r in why.get(payload, ())[:1])
                found.append(replace(group, reasons=(*said, *group.reasons)))
        return found

    def _rejoin(
        self, request: AlignRequest, kept: Aligned, guilty: Sequence[str], tried: Aligned, route: str
    ) -> List[ProvenGroup]:
        """Try each refused payload pairwise on what stands, then let the rest go by themselves."""
        why = {p.payload: p.reasons[:1] for p in tried.report.payloads}
        strength = {p.payload: p.strong_cross_pairs for p in tried.report.payloads}
        stands, joined, refused = kept, [], {}
        for payload in sorted(guilty, key=lambda p: (-strength[p], p)):
            result, notes = self._pairwise(request, stands, payload, tried)
            if result is None:
                refused[payload] = notes
            else:
                stands = result
                joined.append(f"{payload}: {notes[0]}")
        name = PAIRWISE if joined else route
        found = self._accept(stands, name, "; ".join(joined))
        if refused:
            for group in self.climb(subset(request, set(refused)), ISOLATE):
                said = [r for p in group.payloads for r in (*why.get(p, ()), *refused.get(p, ()))]
                label = ISOLATE if group.route in (PROCEED, PAIRWISE) else group.route
                found.append(replace(group, route=label, reasons=(*said, *group.reasons)))
        return found

    def _pairwise(
        self, request: AlignRequest, base: Aligned, payload: str, tried: Aligned
    ) -> Tuple[Optional[Aligned], Tuple[str, ...]]:
        """Register one payload onto a standing model; ``None`` with what is missing where that is refused.

        ``tried`` has looked for pairs with the same features and by likeness:
        where it verified none, there is nothing to register by, and only
        ground control can tie.
        """
        linked = next((p.cross_pairs for p in tried.report.payloads if p.payload == payload), 0)
        if not linked:
            early = tie_by_control(tried, payload, self.limits)
            if not early.holds:
                return None, ("no verified pair with any other payload, so pairwise has nothing to hold on", early.text)
        names = {f.payload for f in base.request.frames} | {payload}
        both = subset(request, names)
        wish = likeness(both, payload, self.limits)
        solid = self.run(base.request, "pairwise")
        whole = solid.solution.models == 1 and not _verdicts(solid.report)[FAIL]
        result = self.run(both, "pairwise", (wish,), solid if whole else None)
        if _stands(result.report, payload):
            return result, ("joined pairwise onto the proven payloads",)
        tie: ControlTie = tie_by_control(result, payload, self.limits)
        if tie.holds:
            joined = joined_by_control(result, payload, self.limits)
            if not _verdicts(joined.report)[FAIL]:
                return joined, (tie.text,)
            return None, ("refused pairwise", f"{tie.text}, but {_said(joined.report, payload)}")
        return None, ("refused pairwise", tie.text)


def _verdicts(report: AlignmentReport) -> Dict[str, List[str]]:
    found: Dict[str, List[str]] = {PASS: [], FAIL: [], UNPROVEN: []}
    for payload in report.payloads:
        found[payload.verdict].append(payload.payload)
    return found


def _stands(report: AlignmentReport, payload: str) -> bool:
    """The payload passes and takes nobody down with it."""
    verdicts = _verdicts(report)
    return payload in verdicts[PASS] and not verdicts[FAIL]


def _said(report: AlignmentReport, payload: str) -> str:
    """The first reason of a payload, or of the first failed one."""
    failed = sorted((p for p in report.payloads if p.verdict == FAIL), key=lambda p: (p.payload != payload, p.payload))
    return "; ".join(r for p in failed[:1] for r in p.reasons[:1]) or "another payload fails with it"


def _worst(report: AlignmentReport) -> str:
    """The failed payload to take away first: worst fit alone, then fewest frames, then name."""

    def rank(p: PayloadAlignment) -> Tuple[float, int, str]:
        fit = p.alone
        off = math.inf
        if fit.horizontal_m is not None and fit.sigma_horizontal_m:
            off = round(fit.horizontal_m / fit.sigma_horizontal_m, 3)
        return (-off, p.frames, p.payload)

    return min((p for p in report.payloads if p.verdict == FAIL), key=rank).payload


def _reasons(report: AlignmentReport) -> Tuple[str, ...]:
    said = () if report.control is None else checked(report.control)
    if len(report.payloads) == 1:
        return (*report.payloads[0].reasons, *said)
    return (*(f"{p.payload}: {reason}" for p in report.payloads for reason in p.reasons), *said)


def _group(request: AlignRequest, route: str, reasons: Sequence[str], report: Optional[AlignmentReport]) -> ProvenGroup:
    return ProvenGroup(
        name=request.name,
        payloads=tuple(sorted({f.payload for f in request.frames})),
        frames=tuple(sorted(f.path for f in request.frames)),
        route=route,
        reasons=tuple(dict.fromkeys(reasons)),
        alignment=report,
        locked=report.decisions if report else (),
    )


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
        ladder = _Ladder(workspace, self.thresholds, engine, max_dim, None, None)
        if strategy == PROCEED_STRATEGY:
            return ladder.run(request, "quick").report
        return one_by_one(ladder, sorted_request(request)).report


def one_by_one(ladder: _Ladder, request: AlignRequest) -> Aligned:
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
