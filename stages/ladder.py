"""The rungs: quick, mixed-block settings, pairwise with ground control, each payload alone.

quick (what passes close to a limit once more, with COLMAP's own settings) →
mixed-block settings with pairs found by likeness → each refused payload
pairwise onto the proven ones, tied by ground control where there is any → its
own group. Every payload ends in exactly one group; what nothing can prove is a
group of its own, never dropped.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Dict, List, Mapping, Optional, Sequence, Set, Tuple

from .align.blocks import likeness, of_frames, subset
from .align.control import checked
from .align.judge import FAIL, PASS, UNPROVEN
from .align.model import AlignmentReport, AlignRequest, PayloadAlignment
from .align.prepare import engine_settings, rung_max_dim
from .align.run import Aligned, align_once, with_report
from .align.solution import Retrieval
from .align.tie import ControlTie, joined_by_control, tie_by_control
from .align.ties import ties_of
from .align.worker import SolverFailed
from .partition import lock_sides, stray_models, why_apart
from .progress import Cancel, Progress, check
from .proven import ISOLATE, PAIRWISE, PROCEED, ProvenGroup, group_of
from .thresholds import Thresholds


class Ladder:
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
        self._known: Dict[Tuple[object, ...], Aligned] = {}

    def run(
        self,
        request: AlignRequest,
        rung: str,
        extra: Sequence[Retrieval] = (),
        start: Optional[Aligned] = None,
    ) -> Aligned:
        """One alignment on a rung, kept among the attempts; what was aligned with the same numbers is not again."""
        check(self.cancel)
        side = self.max_dim
        numbers = engine_settings(rung, side or rung_max_dim(rung, self.limits), 1, self.limits)
        whole = tuple(f.path for f in request.frames)
        key = (whole, numbers, tuple(extra), start.solution.stored if start else "")
        if key in self._known:
            known = self._known[key]
            return with_report(known, replace(known.report, rung=rung))
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
        self._known[key] = done
        return done

    def climb(self, request: AlignRequest, route: str) -> List[ProvenGroup]:
        """Prove a block; ``route`` is what its accepted groups are called."""
        try:
            return self._climb(request, route)
        except SolverFailed as error:
            payloads = {f.payload for f in request.frames}
            if len(payloads) == 1:
                return [group_of(request, UNPROVEN, (str(error),), None)]
            said = f"the solver ended on the payloads together ({error})"
            found: List[ProvenGroup] = []
            for payload in sorted(payloads):
                for group in self.climb(subset(request, {payload}), ISOLATE):
                    found.append(replace(group, reasons=(said, *group.reasons)))
            return found

    def _climb(self, request: AlignRequest, route: str) -> List[ProvenGroup]:
        quick = self._quick(request, "quick" if route != ISOLATE else "alone")
        verdicts = _verdicts(quick.report)
        if not verdicts[FAIL]:
            done, note = self._in_one(request, quick)
            return self._accept(done, route, note)
        several = len(quick.report.payloads) > 1
        loose = self._loose(request, quick) if several else {}
        if loose:
            kept, guilty = self._separate(quick)
            if set(guilty) <= set(loose):
                if kept is None:
                    return self._each_alone(request, quick, route)
                return self._rejoin(request, kept, guilty, quick, route, loose)
        extra = [likeness(request, p, self.limits) for p in sorted(verdicts[FAIL])] if several else []
        mixed = self.run(request, "mixed", extra)
        if not _verdicts(mixed.report)[FAIL]:
            return self._accept(mixed, route, "accepted with the settings for mixed blocks")
        best = min((quick, mixed), key=lambda a: (len(_verdicts(a.report)[FAIL]), a is mixed))
        kept, guilty = self._separate(best)
        if kept is None:
            return self._each_alone(request, best, route)
        return self._rejoin(request, kept, guilty, mixed, route)

    def _quick(self, request: AlignRequest, rung: str) -> Aligned:
        """The cheap alignment; what it passes or fails close to a limit is decided by the reference settings."""
        done = self.run(request, rung)
        failed = [p for p in done.report.payloads if p.verdict == FAIL]
        if not all(p.close for p in failed) or not any(p.close for p in done.report.payloads):
            return done
        return self.run(request, "reference")

    def _in_one(self, request: AlignRequest, done: Aligned) -> Tuple[Aligned, str]:
        """What fell into pieces over one ground is aligned once more, with pairs between the pieces by likeness.

        Returns the alignment that left fewer frames outside of its main model, and a note on it.
        """
        strays = {path for paths in _strays(done) for path in paths}
        if not strays:
            return done, ""
        left = tuple(i for i, f in enumerate(done.request.frames) if f.path in strays)
        right = tuple(i for i, f in enumerate(done.request.frames) if f.path not in strays)
        mixed = self.run(request, "mixed", [Retrieval(left, right, self.limits.retrieval_pairs)])
        if _verdicts(mixed.report)[FAIL] or _outside(mixed.report) >= _outside(done.report):
            return done, ""
        return mixed, "accepted with the settings for mixed blocks: with the quick ones it fell into pieces"

    def _loose(self, request: AlignRequest, quick: Aligned) -> Dict[str, str]:
        """Payload -> why no further rung can tie it, where that holds for all that failed.

        Before a mixed or pairwise run is spent on payloads without ties, the
        pairs that these runs would try for them are matched with their settings.
        """
        failed = [p for p in quick.report.payloads if p.verdict == FAIL]
        least = self.limits.min_strong_pairs
        if any(p.strong_cross_pairs >= least for p in failed):
            return {}
        names = sorted(p.payload for p in failed)
        found = ties_of(
            request,
            names,
            self.workspace,
            [likeness(request, p, self.limits) for p in names],
            rung="mixed",
            thresholds=self.limits,
            engine=self.engine,
            max_dim=self.max_dim,
            progress=self.progress,
            cancel=self.cancel,
        )
        if found is None or any(t.strong >= least for t in found.values()):
            return {}
        return {
            name: f"with the settings for mixed blocks {t.strong} of {t.tried} pairs with other payloads hold "
            f"{self.limits.min_inliers} verified matches, {least} are needed: no pairwise run can join it"
            for name, t in found.items()
        }

    def _accept(self, done: Aligned, route: str, note: str = "") -> List[ProvenGroup]:
        """Turn an alignment without a failed payload into groups; the unproven leave the proven."""
        verdicts = _verdicts(done.report)
        notes = (note,) if note else ()
        if not verdicts[UNPROVEN]:
            return self._as_one(done, route, notes)
        if not verdicts[PASS]:
            names = {p.payload for p in done.report.payloads}
            if len(names) == 1 or all(
                p.strong_cross_pairs >= self.limits.min_strong_pairs for p in done.report.payloads
            ):
                split = self._by_models(done, route, notes)
                return split or [group_of(done.request, UNPROVEN, (*notes, *_reasons(done.report)), done.report)]
            return self._each_alone(done.request, done, route)
        found = self.climb(subset(done.request, set(verdicts[PASS])), route)
        why = {p.payload: p.reasons for p in done.report.payloads}
        for payload in sorted(verdicts[UNPROVEN]):
            for group in self.climb(subset(done.request, {payload}), ISOLATE):
                said = tuple(f"together: {r}" for r in why[payload] if r not in group.reasons)
                found.append(replace(group, reasons=(*group.reasons, *said)))
        return found

    def _as_one(self, done: Aligned, route: str, notes: Tuple[str, ...]) -> List[ProvenGroup]:
        """A proven alignment as one group, unless models of their own or a lock that not all can bear part it."""
        split = self._by_models(done, route, notes) or self._by_lock(done, route, notes)
        if split:
            return split
        loose = sum(len(paths) for paths in _strays(done))
        if loose > self.limits.unplaced_share * len(done.request.frames):
            apart = f"{loose} of {len(done.request.frames)} frames make models of their own: it is not one piece"
            route, notes = UNPROVEN, (apart, *notes)
        return [group_of(done.request, route, (*notes, *_reasons(done.report)), done.report)]

    def _by_models(self, done: Aligned, route: str, notes: Tuple[str, ...]) -> List[ProvenGroup]:
        """Frames that make a model of their own over the same ground leave: two surveys under one name."""
        strays = _strays(done, self.limits.min_proof_frames)
        if not strays:
            return []
        gone = {p for paths in strays for p in paths}
        rest = {f.path for f in done.request.frames} - gone
        found = [replace(g, reasons=(*notes, *g.reasons)) for g in self.climb(of_frames(done.request, rest), route)]
        for paths in strays:
            why = f"{len(paths)} frames that no match ties to the rest of their payload make a model of their own"
            for group in self.climb(of_frames(done.request, set(paths)), ISOLATE):
                found.append(replace(group, reasons=(why, *group.reasons)))
        return found

    def _by_lock(self, done: Aligned, route: str, notes: Tuple[str, ...]) -> List[ProvenGroup]:
        """Payloads that must be held part from those that cannot be, where both sides stand alone as well."""
        decisions = done.report.decisions
        sides = lock_sides(done.request, decisions)
        if sides is None:
            return []
        found: List[ProvenGroup] = []
        size = {p.payload: p.frames for p in done.report.payloads}
        larger = max(sides, key=lambda side: (sum(size[p] for p in side), side is sides[0]))
        for side in sides:
            label = route if side is larger else ISOLATE
            why = why_apart(decisions, side is sides[0])
            for group in self.climb(subset(done.request, side), label):
                found.append(replace(group, reasons=(*notes, why, *group.reasons)))
        # Alone a side may be too weak to be proven: then the joint block is worth more than the lock.
        return found if all(g.route != UNPROVEN for g in found) else []

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
            cheap = done.report.rung in ("quick", "reference")
            current = self.run(subset(done.request, left), "quick" if cheap else "mixed")
        verdicts = _verdicts(current.report)
        return (current, guilty) if not verdicts[FAIL] and verdicts[PASS] else (None, guilty)

    def _each_alone(self, request: AlignRequest, tried: Aligned, route: str) -> List[ProvenGroup]:
        """Nothing stands together: every payload by itself."""
        payloads = sorted({f.payload for f in request.frames})
        if len(payloads) == 1:
            report = tried.report
            strays = self._by_models(tried, route, ())
            if strays:
                return strays
            return [group_of(request, UNPROVEN, _reasons(report), report)]
        why = {p.payload: p.reasons for p in tried.report.payloads}
        found: List[ProvenGroup] = []
        for payload in payloads:
            for group in self.climb(subset(request, {payload}), ISOLATE):
                said = tuple(f"together: {r}" for r in why.get(payload, ())[:1])
                found.append(replace(group, reasons=(*said, *group.reasons)))
        return found

    def _rejoin(
        self,
        request: AlignRequest,
        kept: Aligned,
        guilty: Sequence[str],
        tried: Aligned,
        route: str,
        loose: Mapping[str, str] = MappingProxyType({}),
    ) -> List[ProvenGroup]:
        """Try each refused payload pairwise on what stands, then let the rest go by themselves."""
        why = {p.payload: p.reasons[:1] for p in tried.report.payloads}
        strength = {p.payload: p.strong_cross_pairs for p in tried.report.payloads}
        stands, joined, refused = kept, [], {}
        for payload in sorted(guilty, key=lambda p: (-strength[p], p)):
            result, notes = self._pairwise(request, stands, payload, tried, loose.get(payload, ""))
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
        self, request: AlignRequest, base: Aligned, payload: str, tried: Aligned, loose: str = ""
    ) -> Tuple[Optional[Aligned], Tuple[str, ...]]:
        """Register one payload onto a standing model; ``None`` with what is missing where that is refused.

        ``tried`` has looked for pairs with the same features and by likeness:
        where it verified none, or ``loose`` says that there are too few, there
        is nothing to register by, and only ground control can tie.
        """
        linked = next((p.cross_pairs for p in tried.report.payloads if p.payload == payload), 0)
        if loose or not linked:
            early = tie_by_control(tried, payload, self.limits)
            if not early.holds:
                nothing = "no verified pair with any other payload, so pairwise has nothing to hold on"
                return None, (loose or nothing, early.text)
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


def _strays(done: Aligned, least: int = 1) -> Tuple[Tuple[str, ...], ...]:
    return stray_models(done.request, done.solution.model, done.plan.areas, least)


def _outside(report: AlignmentReport) -> int:
    """Frames that are not in the main model of their ground."""
    return sum(p.frames - p.in_main_component for p in report.payloads)


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
