"""What the report says in sentences: the verdict, ODM alone against this, the alignment in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from .view import SPECTRUM_WORDS, View, figure, listing, plural, share

GOOD = "good"
BAD = "bad"
NOTE = "note"
ODM_DEFAULT_FOCAL = "0.85"
HEIGHT_WORDS = {
    "relative-altitude": "above take-off",
    "relative-altitude+dem": "relief taken out",
    "dem": "GPS minus model",
    "ground-option": "GPS minus ground",
}


@dataclass(frozen=True)
class Comparison:
    """One topic: what ODM alone would have done, and what was done instead."""

    topic: str
    alone: str
    instead: str


@dataclass(frozen=True)
class Check:
    """One figure of an alignment in words. ``state`` is ``good``, ``bad`` or ``note``."""

    name: str
    value: str
    limit: str
    state: str
    words: str


def verdict(view: View) -> Tuple[str, str]:
    """The verdict in one plain sentence, and a second one that says where things stand."""
    report = view.report
    frames = plural(len(report["frames"]), "frame")
    spectra = [SPECTRUM_WORDS[s] for s in view.spectra()]
    if report["verdict"] == "blocked":
        errors = [f["message"] for f in report["findings"] if f["severity"] == "error"]
        return "Blocked: nothing here can be reconstructed yet.", (errors or ["No usable frame was found."])[0]
    if report["verdict"] == "consistent":
        headline = f"Consistent: {'this' if len(report['frames']) == 1 else 'these'} {frames} can be queued."
    elif len(report["subprojects"]) > 1:
        headline = f"Do not queue this folder as one project: it holds {len(report['subprojects'])} projects."
    elif len(spectra) > 1:
        headline = f"Do not queue this folder as one project: it mixes {listing(spectra)} frames."
    else:
        headline = "Do not queue this folder as it is."
    mixed = f" in {len(spectra)} spectra ({listing(spectra)})" if len(spectra) > 1 else ""
    return headline, f"{frames} from {plural(len(report['profiles']), 'camera')}{mixed}. {standing(view)}".strip()


def standing(view: View) -> str:
    """How many sub-projects are proven, or what to do when there are none yet."""
    projects = view.report["subprojects"]
    if not projects:
        mended = view.report["verdict"] == "inconsistent"
        return "sensorgate run sorts it into projects that fit; the originals stay as they are." if mended else ""
    said = f"{plural(len(projects), 'project')} {'written' if view.written else 'proposed'}"
    words = {
        "proceed": "proven to reconstruct",
        "pairwise": "joined pairwise",
        "isolate": "set apart",
        "unproven": "unproven",
    }
    counts = {route: sum(1 for p in projects if p["route"] == route) for route in words}
    return f"{said}: {', '.join(f'{counts[r]} {words[r]}' for r in words if counts[r])}."


def comparisons(view: View) -> List[Comparison]:
    """Topic by topic, only where the two differ."""
    if not view.report["frames"]:
        return []
    parts = (_projects(view), _cameras(view), _focal(view), _resolution(view), _brightness(view), _left_out(view))
    return [row for row in parts if row]


def _projects(view: View) -> Optional[Comparison]:
    projects = view.report["subprojects"]
    spectra = [SPECTRUM_WORDS[s] for s in view.spectra()]
    usable = sum(1 for f in view.report["frames"] if f["role"] != "broken")
    if len(projects) < 2 and (projects or len(spectra) < 2):
        return None
    mixed = f": {listing(spectra)} frames matched against each other" if len(spectra) > 1 else ""
    if not projects:
        promised = "One project per spectrum, and per group of payloads that a trial alignment proves to fit."
        return Comparison("Projects", f"One project with all {usable:,} frames{mixed}.", promised)
    names = listing([f"{p['name']} ({plural(len(p['frames']), 'frame')})" for p in projects])
    return Comparison(
        "Projects", f"One project with all {usable:,} frames{mixed}.", f"{len(projects)} projects: {names}."
    )


def _cameras(view: View) -> Optional[Comparison]:
    owners: Dict[str, Set[str]] = {}
    ids: Dict[str, Set[str]] = {}
    for frame in view.report["frames"]:
        if frame["odm_camera_id"] and frame["profile"]:
            owners.setdefault(frame["odm_camera_id"], set()).add(frame["profile"])
            ids.setdefault(frame["profile"], set()).add(frame["odm_camera_id"])
    merged = sorted({p for profiles in owners.values() if len(profiles) > 1 for p in profiles})
    split = sorted(p for p, found in ids.items() if len(found) > 1)
    if not merged and not split:
        return None
    faults = []
    if merged:
        faults.append(f"{listing(merged, 3)} would be taken for one camera with shared intrinsics")
    for name in split[:2]:
        faults.append(f"{name} would be solved as {len(ids[name])} separate cameras, because its focal tag jitters")
    alone = f"{plural(len(owners), 'camera model')} for {plural(len(ids), 'true camera')}: {'; '.join(faults)}."
    cured = "; their copies carry one focal tag per camera" if split else ""
    return Comparison(
        "Cameras", alone, f"{plural(len(ids), 'true camera')}, told apart by serial, lens, band and size{cured}."
    )


def _focal(view: View) -> Optional[Comparison]:
    gap = view.threshold.get("focal_source_gap", 0.03)
    wrong: Dict[str, int] = {}
    for frame in view.report["frames"]:
        profile = view.profiles.get(frame["profile"] or "")
        ratio = profile["intrinsics"]["focal_ratio"] if profile else None
        defaulted = (frame["odm_camera_id"] or "").rsplit(" ", 1)[-1] == ODM_DEFAULT_FOCAL
        if profile and defaulted and (ratio is None or abs(ratio / float(ODM_DEFAULT_FOCAL) - 1.0) > gap):
            wrong[profile["id"]] = wrong.get(profile["id"], 0) + 1
    calibrated = [c for p in view.report["subprojects"] for c in p["calibration"]]
    if not wrong and not calibrated:
        return None
    alone = (
        f"Its silent default of {ODM_DEFAULT_FOCAL} × width for {plural(sum(wrong.values()), 'frame')} "
        f"of {listing(sorted(wrong), 3)}."
        if wrong
        else "Every camera solved anew from its tags, free to bow the ground."
    )
    held = sum(1 for c in calibrated if c["held"])
    instead = (
        f"A cameras file for {plural(len(calibrated), 'camera')}, {held} of them held fixed, each with its source."
        if calibrated
        else "The better source, given to ODM in a cameras file."
        if not view.written
        else "No better source was found; see the findings."
    )
    return Comparison("Focal length", alone, instead)


def _resolution(view: View) -> Optional[Comparison]:
    scaled = [a for a in view.report["actions"] if a["scale"] != 1.0]
    if not scaled:
        return None
    before = [a["gsd_before_cm"] for a in view.report["actions"] if a["gsd_before_cm"]]
    span = f"{min(before):.2f} to {max(before):.2f} cm per pixel" if before else "Mixed ground resolution"
    count = sum(a["frames"] for a in scaled)
    scales = sorted({a["scale"] for a in scaled})
    factor = f"{scales[0]:.2f}" if len(scales) == 1 else f"{scales[0]:.2f} to {scales[-1]:.2f}"
    verb = "resampled" if view.written else "to be resampled"
    alone = f"{span} matched as they are; the coarse frames find few partners."
    return Comparison("Ground resolution", alone, f"{plural(count, 'frame')} {verb} × {factor}, originals untouched.")


def gain_words(action: Optional[Mapping[str, Any]]) -> str:
    """What resampling a flight brings and costs, or would; nothing where it is within the trigger."""
    gain = (action or {}).get("gain")
    if not gain or not (gain["chosen"] or gain["ratio"] - 1.0 > gain["trigger"]):
        return ""
    now, then = gain["native"], gain["resampled"]
    coarser = f"{gain['ratio']:.2f} × coarser than the finest, " if gain["ratio"] > 1.005 else ""
    verb = "resampled" if gain["chosen"] else "kept; resampled"
    pixels = f"{then['megapixels'] / now['megapixels']:.2g} × pixels, " if now["megapixels"] else ""
    return (
        f"{coarser}{verb} × {then['scale']:.2f}: expected matches {_shares(now['inliers'], then['inliers'])}, "
        f"inside ODM {_shares(now['odm_inliers'], then['odm_inliers'])}; {pixels}"
        f"{size_words(now['size_bytes'])} → about {size_words(then['size_bytes'])}; "
        f"ODM features at {_changed(now['odm_feature_px'], then['odm_feature_px'])} px, "
        f"undistorted {_changed(now['odm_undistorted_px'], then['odm_undistorted_px'])} px"
    )


def _shares(before: float, after: float) -> str:
    return f"{_changed(round(100 * before), round(100 * after))} %"


def _changed(before: int, after: int) -> str:
    return f"{before}" if before == after else f"{before} → {after}"


def size_words(count: int) -> str:
    """Bytes as a pilot reads them: ``820 MB``, ``1.4 GB``."""
    for unit, size in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{count / size:.1f} {unit}" if count < 10 * size else f"{count / size:.0f} {unit}"
    return f"{count / 1e3:.0f} kB"


def _brightness(view: View) -> Optional[Comparison]:
    matched = [a for a in view.report["actions"] if a["lut"]]
    if not matched:
        return None
    largest = max((abs(v) for a in matched for v in a["lut"]["offset_dn"]), default=0.0)
    kept = any(a["lut"]["written"] for a in matched)
    return Comparison(
        "Brightness",
        f"Flights up to {largest:.0f} of 255 apart in mean brightness: seams in the orthophoto, weaker matches.",
        f"{plural(len(matched), 'flight')} matched with one table per flight and channel"
        f"{'' if kept else ', for the alignment only'}.",
    )


def _left_out(view: View) -> Optional[Comparison]:
    left = view.excluded()
    if not left:
        return None
    broken = sum(1 for f in left if f["role"] == "broken")
    panels = sum(1 for f in left if f["role"] == "panel")
    alone = f"{plural(len(left) - broken, 'frame')} left out here would go into the solver"
    if broken:
        alone += f"; {plural(broken, 'unreadable file')} might end the run"
    kept = "; panel captures are copied beside the project" if panels else ""
    instead = f"{plural(len(left), 'file')} left out and listed below{kept}."
    return Comparison("Not survey", alone + ".", instead)


def alignment_checks(view: View, project: Mapping[str, Any]) -> List[Check]:
    """The figures of one sub-project's alignment, each with its limit and what it means."""
    found = project["alignment"]
    if found is None:
        return []
    limit = view.threshold
    checks = [_registered(found, limit), _reprojection(found, limit)]
    checks.extend(_gps(found))
    checks.extend(c for c in (_height(found), _bowing(found, limit), _inliers(found, limit)) if c)
    return checks


def _registered(found: Mapping[str, Any], limit: Mapping[str, float]) -> Check:
    total, placed, models = found["frames"], found["registered"], found["components"]
    enough = total > 0 and placed / total >= limit.get("min_registered_share", 0.5) and models == 1
    words = (
        "All frames hang together in one model."
        if models == 1 and placed == total
        else f"{plural(total - placed, 'frame')} found no place; the rest hang together in one model."
        if models == 1
        else "No model could be built."
        if models == 0
        else f"The frames fall apart into {models} models; ODM would keep only the largest."
    )
    return Check("Frames placed", f"{placed:,} of {total:,}", "one model", GOOD if enough else BAD, words)


def _reprojection(found: Mapping[str, Any], limit: Mapping[str, float]) -> Check:
    error, most = found["mean_reproj_error_px"], limit.get("max_reproj_error_px", 2.0)
    words = (
        "How far points land from where the model puts them. A wrong model can pass this, so it is never enough alone."
    )
    state = BAD if error is None or error > most else GOOD
    return Check("Reprojection error", figure(error, 2, "px"), f"≤ {most:.1f} px", state, words)


def _gps(found: Mapping[str, Any]) -> List[Check]:
    checks = []
    for key, name in (("horizontal", "GPS fit, level"), ("vertical", "GPS fit, height")):
        value, most = found.get(f"gps_{key}_m"), found.get(f"gps_limit_{key}_m")
        if value is None:
            continue
        words = (
            "How far the solved camera positions lie from their GPS. This is what tells a right model from a wrong one."
        )
        if key == "vertical":
            words = "The same in height."
        state = NOTE if most is None else GOOD if value <= most else BAD
        checks.append(Check(name, figure(value, 2, "m"), f"≤ {most:.1f} m" if most is not None else "", state, words))
    if not checks:
        value = found["gps_rmse_m"]
        words = (
            "How far the solved camera positions lie from their GPS."
            if value is not None
            else "There is no GPS to hold the model against."
        )
        checks.append(Check("GPS fit", figure(value, 2, "m"), "", NOTE, words))
    return checks


def _height(found: Mapping[str, Any]) -> Optional[Check]:
    if found["height_m"] is None:
        return None
    flown = [p["flown_height_m"] for p in found.get("payloads", []) if p.get("flown_height_m") is not None]
    solved = [p["height_m"] for p in found.get("payloads", []) if p.get("height_m") is not None]
    if len(flown) == 1 and len(solved) == 1:
        return Check(
            "Flying height",
            figure(solved[0], 1, "m"),
            f"flown {flown[0]:.1f} m",
            NOTE,
            "Solved height above the solved ground.",
        )
    return Check(
        "Flying height", figure(found["height_m"], 1, "m"), "", NOTE, "Solved height above the solved ground, median."
    )


def _bowing(found: Mapping[str, Any], limit: Mapping[str, float]) -> Optional[Check]:
    bow, error = found["bowing_m"], found["bowing_se_m"]
    if bow is None:
        return None
    value = f"{bow:+.2f} m" + (f" ± {error:.2f}" if error is not None else "")
    needed = limit.get("bowing_sigma", 3.0)
    called = error is not None and abs(bow) > needed * error
    words = (
        f"The block bends: its middle lies {abs(bow):.2f} m {'low' if bow > 0 else 'high'} against its edge. "
        "Cross strips, obliques or ground control points cure it."
        if called
        else f"Flat: less than {needed:g} standard errors, so no bending can be called."
    )
    return Check(
        "Bowing", value, f"± {needed * error:.2f} m" if error is not None else "", NOTE if called else GOOD, words
    )


def _inliers(found: Mapping[str, Any], limit: Mapping[str, float]) -> Optional[Check]:
    value, least = found.get("median_inliers"), limit.get("min_inliers", 30)
    if value is None:
        return None
    words = "Median of verified matches per pair of frames."
    return Check("Matches per pair", figure(value, 0), f"≥ {least:g}", GOOD if value >= least else BAD, words)


def cross_words(found: Mapping[str, Any], least: float, told: Sequence[str] = ()) -> List[str]:
    """One sentence per pair of payloads that were matched, and what was said of each payload and not yet told."""
    lines = []
    for pair in found.get("pairs", []):
        if pair["a"] == pair["b"]:
            continue
        inliers = pair["inliers_median"]
        enough = inliers is not None and inliers >= least
        judged = "enough to join them" if enough else f"too few to join them ({least:g} needed)"
        tried = plural(pair["pairs"], "pair")
        lines.append(f"{pair['a']} and {pair['b']}: {figure(inliers, 0)} matches per pair over {tried}, {judged}.")
    for payload in found.get("payloads", []):
        for reason in payload.get("reasons", []):
            named = f"{payload['payload']}: {reason}"
            if reason not in told and named not in told:
                lines.append(named)
        offset = payload.get("gps_offset_m")
        if offset:
            shift = ", ".join(f"{v:+.1f} m {way}" for v, way in zip(offset, ("east", "north", "up")) if v is not None)
            lines.append(f"{payload['payload']}: its geometry fits, but its GPS is shifted by {shift}.")
    return lines


def excluded_groups(view: View) -> List[Tuple[str, List[str]]]:
    """Reason code to paths of the frames left out, most frequent reason first."""
    groups: Dict[str, List[str]] = {}
    for frame in view.excluded():
        groups.setdefault(frame["reason"], []).append(frame["path"])
    return sorted(groups.items(), key=lambda item: (-len(item[1]), item[0]))


def option_words(options: Sequence[Mapping[str, Any]]) -> List[str]:
    """The options as they are typed behind ODM's own command."""
    words = []
    for option in options:
        value = option["value"]
        if value is True:
            words.append(f"--{option['name']}")
        elif value is not False:
            words.append(f"--{option['name']} {quoted(str(value))}")
    return words


def quoted(text: str) -> str:
    """As a POSIX shell takes it."""
    plain = text and all(c.isalnum() or c in "-_./:,+=@%" for c in text)
    return text if plain else "'" + text.replace("'", "'\"'\"'") + "'"


def spread_words(minimum: Optional[float], maximum: Optional[float], variance: float) -> str:
    """The focal tags of a profile: one value, or from-to with the spread of its family."""
    if minimum is None or maximum is None:
        return "no focal tag"
    if abs(maximum - minimum) < 0.005:
        return f"{minimum:.2f} mm"
    return f"{minimum:.2f} to {maximum:.2f} mm ({share(variance)} apart in its family)"
