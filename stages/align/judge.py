"""The verdict on each payload of an alignment (pure).

Registered count and reprojection error pass wrong models, so they are
necessary only. What decides is whether the solved centres fit the measured
ones, together with the anchor and alone; what cannot be contradicted is
unproven, and a missing figure is never a pass.
"""

from __future__ import annotations

import math
from typing import List, Optional, Sequence, Tuple

from ..thresholds import Thresholds
from .measure import Measured, PayloadFigures
from .model import GpsFit, PayloadAlignment

PASS = "pass"
FAIL = "fail"
UNPROVEN = "unproven"

_CLOSE = 0.1
_CLOSE_WORD = " (close)"
_NO_POSITION = "frames with a position: {}, nothing independent proves the model"
_ON_A_LINE = "its positions lie on one line: GPS cannot contradict the model"


def judge(measured: Measured, limits: Thresholds, tied: Sequence[str] = ()) -> Tuple[PayloadAlignment, ...]:
    """Return one verdict per payload, with every reason in words.

    Ties to others are asked of every payload but the anchor: where two have
    none, it is the other that leaves. ``tied`` are payloads that ground
    control ties instead.
    """
    several = len(measured.payloads) > 1
    return tuple(_judge_one(p, measured, several and p.payload not in tied, limits) for p in measured.payloads)


def _judge_one(p: PayloadFigures, measured: Measured, several: bool, limits: Thresholds) -> PayloadAlignment:
    bad: List[str] = []
    open_: List[str] = []
    said: List[str] = []
    _registration(p, limits, bad, said)
    if several and p.payload != measured.anchor:
        _ties(p, limits, bad, said)
    else:
        _own_pairs(p, limits, bad, said)
    _reprojection(p, limits, bad, said)
    _gps(p, measured.anchor, limits, bad, open_, said)
    for flight, up in p.flight_offsets_m:
        said.append(
            f"the GPS altitudes of {flight} lie {_side(up, 'above', 'below')} those of its other flights: its shape "
            "holds, it was judged without the difference"
        )
    _control(p, bad, open_, said)
    _gap(p, bad, said)
    if p.looks_down is not None and p.looks_down < limits.min_registered_share:
        bad.append("its cameras look at the sky: the model is turned over")
    if p.frames < limits.min_proof_frames:
        few = f"{p.frames} frames" if p.frames != 1 else "1 frame"
        open_.append(f"{few}: fewer than {limits.min_proof_frames} cannot contradict a wrong model")
    verdict = UNPROVEN if _nothing_to_judge(p, limits) else FAIL if bad else UNPROVEN if open_ else PASS
    reasons = {PASS: said, UNPROVEN: [*open_, *bad, *said], FAIL: [*bad, *open_, *said]}[verdict]
    return PayloadAlignment(
        payload=p.payload,
        frames=p.frames,
        registered=p.registered,
        in_main_component=p.in_main,
        mean_reproj_error_px=p.mean_reproj_error_px,
        together=p.together,
        alone=p.alone,
        height_m=p.height_m,
        flown_height_m=p.flown_height_m,
        bowing=p.bowing,
        cross_pairs=p.cross_pairs,
        cross_inliers=p.cross_inliers,
        capture_gap_m=p.capture_gap_m,
        verdict=verdict,
        reasons=tuple(reasons),
        strong_cross_pairs=p.strong_cross,
        flight_offsets_m=p.flight_offsets_m,
        gps_offset_m=p.offset_m if any("GPS offset" in r for r in said) else None,
        control=p.control,
        close=_is_close(verdict, bad, said),
    )


def _is_close(verdict: str, bad: Sequence[str], said: Sequence[str]) -> bool:
    """Passed with a figure close to its limit, or failed by such figures alone."""
    if verdict == PASS:
        return any(r.endswith(_CLOSE_WORD) for r in said)
    return verdict == FAIL and all(r.endswith(_CLOSE_WORD) for r in bad)


def _nothing_to_judge(p: PayloadFigures, limits: Thresholds) -> bool:
    """So few frames that neither success nor failure says anything."""
    return p.frames < limits.min_proof_frames


def _registration(p: PayloadFigures, limits: Thresholds, bad: List[str], said: List[str]) -> None:
    share = p.in_main / p.frames if p.frames else 0.0
    text = f"{p.in_main} of {p.frames} frames are in the main model"
    if round(share, 6) < limits.min_registered_share:
        apart = f", {p.registered - p.in_main} in another" if p.registered > p.in_main else ""
        bad.append(text + apart + _near(share, limits.min_registered_share))
    else:
        said.append(text + _near(share, limits.min_registered_share))


def _own_pairs(p: PayloadFigures, limits: Thresholds, bad: List[str], said: List[str]) -> None:
    text = f"its pairs hold {_say(p.own_inliers)} verified matches, {limits.min_inliers} are needed"
    if p.own_inliers is None:
        bad.append(text)
    elif p.own_inliers < limits.min_inliers:
        bad.append(text + _near(p.own_inliers, limits.min_inliers))
    elif _near(p.own_inliers, limits.min_inliers):
        said.append(text + _CLOSE_WORD)


def _ties(p: PayloadFigures, limits: Thresholds, bad: List[str], said: List[str]) -> None:
    text = f"{p.strong_cross} pairs with other payloads hold {limits.min_inliers} verified matches or more"
    if p.strong_cross < limits.min_strong_pairs:
        close = _CLOSE_WORD if p.strong_cross == limits.min_strong_pairs - 1 else ""
        bad.append(f"{text}, {limits.min_strong_pairs} are needed{close}")
    elif not p.shares_model:
        bad.append("no such pair lies inside one model with another payload")
    else:
        close = _CLOSE_WORD if p.strong_cross == limits.min_strong_pairs else ""
        said.append(text + close)


def _reprojection(p: PayloadFigures, limits: Thresholds, bad: List[str], said: List[str]) -> None:
    worst = p.worst_profile_px
    if worst is None or not math.isfinite(worst):
        bad.append("no reprojection error could be measured")
    elif round(worst, 3) > limits.max_reproj_error_px:
        close = _near(worst, limits.max_reproj_error_px)
        bad.append(f"mean reprojection error {worst:.2f} px, {limits.max_reproj_error_px:g} px is the limit{close}")
    else:
        said.append(f"mean reprojection error {worst:.2f} px{_near(worst, limits.max_reproj_error_px)}")


def _gps(
    p: PayloadFigures,
    anchor: Optional[str],
    limits: Thresholds,
    bad: List[str],
    open_: List[str],
    said: List[str],
) -> None:
    if p.positions < limits.min_proof_frames:
        open_.append(_NO_POSITION.format(p.positions))
        return
    if p.alone.frames and p.alone.collinear and p.self_fitted:
        open_.append(_ON_A_LINE)
        return
    together = _misfit(p.together, limits)
    # On one line a fit of its own proves nothing; the anchor's similarity still can contradict it.
    alone = together if p.alone.collinear else _misfit(p.alone, limits)
    if alone is None:
        if not any("main model" in b for b in bad):
            open_.append("too few of its frames with a position are in the model")
        return
    if together is None:
        bad.append("its place against the anchor could not be measured")
        return
    if alone > 1.0:
        bad.append(
            f"alone it lies {_words(p.alone)} off its GPS, {_limit(p.alone, limits)} is the limit{_near(alone, 1.0)}"
        )
    elif together > 1.0:
        scatter = _misfit(p.scatter, limits)
        if scatter is not None and scatter <= 1.0 and p.offset_m is not None:
            east, north, up = p.offset_m
            said.append(
                f"GPS offset: its positions lie {_side(east, 'east', 'west')}, {_side(north, 'north', 'south')} and "
                f"{_side(up, 'above', 'below')} where {anchor} puts its cameras; its shape holds"
            )
        else:
            bad.append(
                f"joined to {anchor} it lies {_words(p.together)} off its GPS, "
                f"alone {_words(p.alone)}: wrongly attached"
            )
    else:
        close = _near(max(alone, together), 1.0)
        said.append(f"GPS fit {_words(p.together)}, limit {_limit(p.together, limits)}{close}")


def _control(p: PayloadFigures, bad: List[str], open_: List[str], said: List[str]) -> None:
    """Ground control proves what GPS cannot, and contradicts what GPS does not vouch for.

    Where GPS itself proves the payload, points that do not fit are the points'
    fault, and only said.
    """
    control = p.control
    if control is None:
        return
    blind = any(o in (_NO_POSITION.format(p.positions), _ON_A_LINE) for o in open_)
    if control.verdict == PASS:
        said.append(control.text)
        open_[:] = [o for o in open_ if not blind or o not in (_NO_POSITION.format(p.positions), _ON_A_LINE)]
    elif control.verdict == FAIL and blind:
        bad.append(control.text)
    else:
        (open_ if blind else said).append(control.text)


def _misfit(fit: GpsFit, limits: Thresholds) -> Optional[float]:
    """The larger of residual over allowed, horizontal and vertical; ``None`` where the horizontal is missing."""
    if fit.horizontal_m is None or fit.sigma_horizontal_m is None or not math.isfinite(fit.horizontal_m):
        return None
    worst = fit.horizontal_m / (limits.gps_sigma_factor * fit.sigma_horizontal_m)
    if fit.vertical_m is not None and fit.sigma_vertical_m is not None:
        if not math.isfinite(fit.vertical_m):
            return None
        worst = max(worst, fit.vertical_m / (limits.gps_sigma_factor * fit.sigma_vertical_m))
    return round(worst, 3)


def _words(fit: GpsFit) -> str:
    text = f"{fit.horizontal_m:.2f} m"
    return text + (f" horizontally, {fit.vertical_m:.2f} m vertically" if fit.vertical_m is not None else "")


def _limit(fit: GpsFit, limits: Thresholds) -> str:
    factor = limits.gps_sigma_factor
    return f"{factor * (fit.sigma_horizontal_m or 0.0):.2f} / {factor * (fit.sigma_vertical_m or 0.0):.2f} m"


def _gap(p: PayloadFigures, bad: List[str], said: List[str]) -> None:
    if p.capture_gap_m is None or p.capture_gap_limit_m is None:
        return
    (flat, up), (flat_limit, up_limit) = p.capture_gap_m, p.capture_gap_limit_m
    text = f"centres of one capture lie {flat:.1f} m and {up:.1f} m in height apart"
    if flat > flat_limit or up > up_limit:
        bad.append(f"{text}, {flat_limit:.1f} m and {up_limit:.1f} m can be explained")
    else:
        said.append(text)


def _near(value: float, limit: float) -> str:
    """``close`` within a tenth of the limit, on either side."""
    return _CLOSE_WORD if limit and abs(value / limit - 1.0) < _CLOSE else ""


def _side(value: float, positive: str, negative: str) -> str:
    return f"{abs(value):.1f} m {positive if value >= 0 else negative}"


def _say(value: Optional[int]) -> str:
    return "no" if value is None else str(value)


def untied(payload: PayloadAlignment, limits: Thresholds) -> bool:
    """Whether a payload has too few ties to others, or too few frames in the main model, to pass with any camera."""
    share = payload.in_main_component / payload.frames if payload.frames else 0.0
    return payload.strong_cross_pairs < limits.min_strong_pairs or round(share, 6) < limits.min_registered_share


def overall(payloads: Sequence[PayloadAlignment]) -> str:
    """``pass`` when every payload passes, ``fail`` when one fails, else ``unproven``."""
    verdicts = {p.verdict for p in payloads}
    if FAIL in verdicts or not verdicts:
        return FAIL
    return PASS if verdicts == {PASS} else UNPROVEN
