"""Which calibration of a profile the evidence supports (pure decisions; the adjustments are the engine's).

Reprojection error does not choose: on nadir blocks the lowest belongs to
bowed models. Bowing chooses the distortion, independent geometry the focal,
relative altitude and GPS may only veto, and where nothing can be called the
source rank decides. A self-calibration that the block cannot support is a
guess like any other.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Dict, List, Optional, Sequence, Tuple

from ..thresholds import Thresholds
from .fit import called
from .model import AlignCamera, Bowing, Candidate, LockDecision
from .prepare import known_distortion
from .trials import HEIGHTS, NONE, SOLVED, Geometry, Outcome
from .vertical import MODEL


def vetoes(outcomes: Sequence[Outcome], flown_height_m: Optional[float], limits: Thresholds) -> Tuple[str, ...]:
    """Return a reason per outcome that rules it out, ``""`` where none does."""
    errors = [o.error_px for o in outcomes if o.error_px is not None and math.isfinite(o.error_px)]
    best = min(errors, default=math.nan)
    return tuple(_veto(o, best, flown_height_m, limits) for o in outcomes)


def _veto(o: Outcome, best_px: float, flown_m: Optional[float], limits: Thresholds) -> str:
    if o.error_px is None or not math.isfinite(o.error_px):
        return "its adjustment gave no figures"
    assumed = o.trial.focal is not None or o.trial.distortion is not None
    cost = round(o.error_px / best_px - 1.0, 4) if best_px > 0 else 0.0
    if assumed and cost > limits.held_reproj_cost:
        return f"costs {cost:.0%} reprojection error, {limits.held_reproj_cost:.0%} is the limit"
    if o.misfit is not None and o.misfit > 1.0:
        return f"lies {o.misfit:.1f} times the allowed distance off its GPS"
    if o.scale is not None and abs(o.scale.ratio - 1.0) > limits.solved_focal_sigma * o.scale.sigma:
        return (
            f"its differences of height are {1.0 / o.scale.ratio - 1.0:+.1%} off the measured ones, known to "
            f"{o.scale.sigma:.1%} by {o.scale.by}"
        )
    if o.height_m is not None and flown_m is not None:
        allowed = max(limits.height_veto_m, limits.height_veto_ratio * flown_m) + (o.relief_m or 0.0)
        if abs(o.height_m - flown_m) > allowed:
            return (
                f"stands {o.height_m:.1f} m above ground, flown were {flown_m:.1f} m, {allowed:.1f} m may be explained"
            )
    return ""


def choose(
    outcomes: Sequence[Outcome],
    surfaces: Dict[Tuple[int, int], Bowing],
    camera: AlignCamera,
    geometry: Geometry,
    flown_height_m: Optional[float],
    limits: Thresholds,
) -> Tuple[int, LockDecision, Tuple[str, ...]]:
    """Return the index of the chosen outcome, what to do with the camera, and each outcome's veto.

    ``surfaces`` has the bow of outcome i minus outcome j, i < j, over the
    points that both have.
    """
    veto = vetoes(outcomes, flown_height_m, limits)
    open_ = [i for i, v in enumerate(veto) if not v]
    if not open_:
        chosen = next(i for i, o in enumerate(outcomes) if o.trial.focal is None and o.trial.distortion is None)
        return (
            chosen,
            _decision(outcomes[chosen], camera, False, "every candidate is ruled out: left to be solved"),
            veto,
        )
    strong = geometry.strong(limits) and _certain(outcomes, open_, limits)
    bend, why_bend = _choose_distortion(outcomes, open_, surfaces, camera, strong, limits)
    focal, why_focal = _choose_focal(outcomes, open_, bend, strong, camera, geometry, limits)
    by_heights = focal == HEIGHTS
    by_model = by_heights and geometry.height_by == MODEL
    chosen = next(
        i for i in open_ if outcomes[i].trial.distortion_source == bend and outcomes[i].trial.focal_source == focal
    )
    fixed = outcomes[chosen].trial.focal is not None and outcomes[chosen].trial.distortion is not None
    proven = bend != NONE or _known_straight(camera) or why_bend.startswith("bowing")
    free = [o for o in outcomes if o.trial.focal is None and o.trial.distortion is None]
    hold, why_hold = False, "left to be solved"
    if fixed and proven and (by_model or (camera.intrinsics.focal_trusted and not by_heights)):
        hold, why_hold = True, "held"
        if free and _costs_gps(outcomes[chosen], free[0], limits):
            hold, why_hold = False, "not held: it costs GPS fit against the solved camera"
    elif strong and focal in (SOLVED, HEIGHTS) and _drifts(camera, limits):
        hold, why_hold = True, f"held at it: its frames claim focals {camera.focal_variance:.1%} apart"
    decision = _decision(outcomes[chosen], camera, hold, f"{why_bend}; {why_focal}; {why_hold}")
    return chosen, replace(decision, supported=by_heights or (strong and focal == SOLVED)), veto


def _certain(outcomes: Sequence[Outcome], open_: Sequence[int], limits: Thresholds) -> bool:
    """The solved focal is known to better than what tells two cameras apart."""
    free = [outcomes[i] for i in open_ if outcomes[i].trial.focal is None]
    if not free:
        return False
    sigma = free[-1].focal_sigma
    return sigma is None or limits.solved_focal_sigma * sigma <= limits.focal_source_gap * free[-1].solved_focal


def _drifts(camera: AlignCamera, limits: Thresholds) -> bool:
    """The focal tags of one camera vary beyond the rule."""
    return camera.focal_variance > limits.focal_variance


def _known_straight(camera: AlignCamera) -> bool:
    known = known_distortion(camera)
    return known is not None and not any(known)


def _choose_distortion(
    outcomes: Sequence[Outcome],
    open_: Sequence[int],
    surfaces: Dict[Tuple[int, int], Bowing],
    camera: AlignCamera,
    strong: bool,
    limits: Thresholds,
) -> Tuple[str, str]:
    """Bowing first, where it can be called; then what is known of the lens; then what was solved."""
    bends: List[str] = []
    for i in open_:
        if outcomes[i].trial.distortion_source not in bends:
            bends.append(outcomes[i].trial.distortion_source)
    speaks = {b: next(i for i in open_ if outcomes[i].trial.distortion_source == b) for b in bends}
    out = {
        b
        for b in bends
        for other in bends
        if b != other and _bows_more(outcomes, surfaces, speaks[b], speaks[other], limits)
    }
    left = [b for b in bends if b not in out] or bends
    known = known_distortion(camera)
    rank = [NONE] if _known_straight(camera) else []
    if known is not None and any(known):
        rank.append(camera.intrinsics.distortion_source)
    if strong and SOLVED in left:
        return (
            SOLVED,
            "bowing leaves the solved distortion, and the geometry supports it"
            if out
            else "the geometry supports a solved distortion",
        )
    for name in (*rank, SOLVED, NONE):
        if name in left:
            if out and len(left) == 1:
                return name, f"bowing chose distortion {name}"
            words = {NONE: "lens corrected in the camera" if rank else "nothing better than no distortion"}
            return name, words.get(name, f"distortion {name}")
    return left[0], f"distortion {left[0]}"


def _bows_more(
    outcomes: Sequence[Outcome], surfaces: Dict[Tuple[int, int], Bowing], a: int, b: int, limits: Thresholds
) -> bool:
    """Whether ``a`` surely bows and ``b`` bows surely less: by cameras, and the two surfaces really differ."""
    bow_a, bow_b = outcomes[a].bowing, outcomes[b].bowing
    if not called(bow_a, limits.bowing_sigma) or bow_a.bowing_m is None or bow_b.bowing_m is None:
        return False
    between = surfaces.get((min(a, b), max(a, b)))
    if between is None or not called(between, limits.bowing_sigma):
        return False
    if not called(bow_b, limits.bowing_sigma):
        return abs(bow_b.bowing_m) < abs(bow_a.bowing_m)
    spread = math.hypot(bow_a.se_m or 0.0, bow_b.se_m or 0.0)
    return abs(bow_a.bowing_m) - abs(bow_b.bowing_m) > limits.bowing_sigma * spread


def _choose_focal(
    outcomes: Sequence[Outcome],
    open_: Sequence[int],
    bend: str,
    strong: bool,
    camera: AlignCamera,
    geometry: Geometry,
    limits: Thresholds,
) -> Tuple[str, str]:
    """What fixes the focal, else its best source.

    An elevation model refutes, and puts right what it refuted or what was
    guessed; a trusted focal that it does not contradict stays.
    """
    at = {outcomes[i].trial.focal_source: i for i in open_ if outcomes[i].trial.distortion_source == bend}
    first = next(iter(at))
    trusted = first != SOLVED and first != HEIGHTS and camera.intrinsics.focal_trusted
    if HEIGHTS in at and trusted and geometry.height_by == MODEL:
        scale = outcomes[at[first]].scale
        off = f" within {abs(1.0 / scale.ratio - 1.0):.1%}" if scale is not None else ""
        return first, f"focal from {first}, which {MODEL} confirms{off}"
    if HEIGHTS in at:
        known = f"{geometry.height_by}, to {geometry.height_sigma or 0.0:.1%}"
        return HEIGHTS, f"measured heights ({known}): the geometry fixes the focal"
    if strong and SOLVED in at:
        return SOLVED, "the geometry fixes the focal"
    why = f"focal from {first}"
    if not trusted and SOLVED in at and _drifts(camera, limits):
        first = SOLVED
        why = (
            f"its frames claim focals {camera.focal_variance:.1%} apart and no trusted source says which: solved once "
            "as one camera"
        )
    elif first == SOLVED:
        why = "focal solved"
    if first == SOLVED:
        one = outcomes[at[SOLVED]]
        why += f" to {one.focal_sigma / one.solved_focal:.1%}" if one.focal_sigma is not None else ""
    return first, why + _undecided(geometry, limits)


def _undecided(geometry: Geometry, limits: Thresholds) -> str:
    """Why the block itself does not choose the focal, where nothing does."""
    if geometry.strong(limits):
        return " (its geometry leaves the focal uncertain)"
    if geometry.by_heights(limits):
        return ""
    if geometry.height_sigma is None and geometry.height_by == MODEL:
        return f" ({MODEL} cannot choose it: it has too little ground under the block)"
    if geometry.height_sigma is None:
        return " (weak geometry: straight down from one height no focal shows)"
    known = f"to {geometry.height_sigma:.1%}" if geometry.height_sigma < 1.0 else "not at all"
    need = limits.focal_source_gap / limits.solved_focal_sigma
    return f" ({geometry.height_by} cannot choose it: they tell the vertical scale {known}, {need:.1%} is needed)"


def _costs_gps(held: Outcome, free: Outcome, limits: Thresholds) -> bool:
    """Whether holding moved the model off its GPS: more than a tenth worse, and more than a tenth of the allowed."""
    for mine, other, sigma in (
        (held.gps_horizontal_m, free.gps_horizontal_m, limits.gps_sigma_horizontal_m),
        (held.gps_vertical_m, free.gps_vertical_m, limits.gps_sigma_vertical_m),
    ):
        if mine is None or other is None:
            continue
        if mine > other * (1 + limits.held_reproj_cost) and mine - other > limits.held_reproj_cost * sigma:
            return True
    return False


def _decision(outcome: Outcome, camera: AlignCamera, hold: bool, reason: str) -> LockDecision:
    trial = outcome.trial
    return LockDecision(
        profile=camera.profile,
        hold=hold,
        focal_ratio=round(outcome.solved_focal, 6),
        center_ratio=(round(outcome.solved_center[0], 6), round(outcome.solved_center[1], 6)),
        distortion=tuple(round(v, 6) for v in outcome.solved_distortion),
        source=f"focal {trial.focal_source}, distortion {trial.distortion_source}",
        reason=reason,
        aspect_ratio=round(outcome.solved_aspect, 6),
    )


def as_candidates(
    outcomes: Sequence[Outcome], chosen: int, decision: LockDecision, veto: Sequence[str]
) -> Tuple[Candidate, ...]:
    """The outcomes as the report lists them."""
    return tuple(
        Candidate(
            profile=decision.profile,
            name=o.trial.name,
            focal_source=o.trial.focal_source,
            distortion_source=o.trial.distortion_source,
            focal_ratio=round(o.solved_focal, 6),
            distortion=tuple(round(v, 6) for v in o.solved_distortion),
            held=o.trial.focal is not None and o.trial.distortion is not None,
            mean_reproj_error_px=o.error_px,
            gps_horizontal_m=o.gps_horizontal_m,
            gps_vertical_m=o.gps_vertical_m,
            height_m=o.height_m,
            bowing=o.bowing,
            vetoed=veto[i],
            chosen=i == chosen,
            center_ratio=(round(o.solved_center[0], 6), round(o.solved_center[1], 6)),
            height_scale=o.scale.ratio if o.scale else None,
            height_scale_sigma=o.scale.sigma if o.scale else None,
            height_scale_by=o.scale.by if o.scale else "",
            aspect_ratio=round(o.solved_aspect, 6),
        )
        for i, o in enumerate(outcomes)
    )
