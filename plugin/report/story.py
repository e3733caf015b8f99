"""What the report says in sentences: the verdict, ODM alone against this, the alignment in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from .view import SPECTRUM_WORDS, View, listing, plural, share

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
        headline = f"Do not queue this folder as one project: {_instead(view)}."
    elif view.written:
        headline = f"Do not queue this folder as it is: {_instead(view)}."
    elif len(spectra) > 1:
        headline = f"Do not queue this folder as one project: it mixes {listing(spectra)} frames."
    else:
        headline = "Do not queue this folder as it is."
    mixed = f" in {len(spectra)} spectra ({listing(spectra)})" if len(spectra) > 1 else ""
    return headline, f"{frames} from {plural(len(report['profiles']), 'camera')}{mixed}. {standing(view)}".strip()


def _instead(view: View) -> str:
    """What to queue in place of the folder."""
    projects = view.report["subprojects"]
    count, ready = len(projects), sum(1 for p in projects if p["route"] != "unproven")
    if not view.written:
        return f"it holds {plural(count, 'project')}"
    if count == 1:
        return "queue the project made from it" if ready else "the project made from it is unproven"
    if ready == count:
        return f"queue the {count} projects made from it"
    if ready == 0:
        return f"the {count} projects made from it are unproven"
    return f"of the {count} projects made from it, {ready} {'is' if ready == 1 else 'are'} ready to queue"


def standing(view: View) -> str:
    """How many sub-projects are proven, or what to do when there are none yet."""
    projects = view.report["subprojects"]
    if not projects:
        mended = view.report["verdict"] == "inconsistent"
        return "sensorgate run sorts them into projects that fit; the originals stay as they are." if mended else ""
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
    parts = (_outcome, _projects, _cameras, _focal, _resolution, _brightness, _left_out)
    return [row for row in (part(view) for part in parts) if row]


def _outcome(view: View) -> Optional[Comparison]:
    """Whether ODM would come to an end at all."""
    stops = [f for f in view.report["findings"] if f["code"].startswith("odm-crash") and f["severity"] == "error"]
    if not stops:
        return None
    projects = view.report["subprojects"]
    proven = sum(1 for p in projects if p["route"] != "unproven")
    made = f"{plural(len(projects), 'project')} that ODM can load"
    if not view.written:
        instead = "Projects that ODM can load, each reconstructed on trial before it is handed over."
    elif proven == len(projects):
        instead = f"{made}, {'all ' if proven > 1 else ''}reconstructed on trial."
    else:
        instead = f"{made}, {proven or 'none'} of them reconstructed on trial."
    return Comparison("Does it run?", f"No. {stops[0]['message']}", instead)


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
