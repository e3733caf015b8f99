"""The gate: what is wrong with this survey, and what follows from it.

``assess`` runs every rule over a survey. A rule is a pure generator of
findings; it reads the survey and the thresholds and nothing else.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import Callable, Dict, Iterator, List, Optional, Sequence, Set, Tuple, Union

from .captures import seconds
from .finding import ERROR, INFO, WARNING, Finding, sort_key
from .geo import distance_m
from .harmonize.model import HarmonizePlan
from .harmonize.plan import plan as plan_harmonizing
from .profile import MULTISPECTRAL, CameraProfile, Payload, SurveyFrame
from .survey import Survey
from .thresholds import Thresholds

CONSISTENT, INCONSISTENT, BLOCKED = "consistent", "inconsistent", "blocked"
_SPECTRUM_WORD = {"rgb": "colour", "multispectral": "multispectral", "thermal": "thermal"}


@dataclass(frozen=True)
class GateReport:
    """The verdict of the gate with its findings, worst first, and the harmonizing that would follow."""

    verdict: str
    findings: Tuple[Finding, ...]
    plan: HarmonizePlan


Rule = Callable[[Survey, Thresholds], Iterator[Finding]]


def listed(items: Sequence[str], most: int = 3) -> str:
    """``a, b, c and 5 more``."""
    names = list(items)
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"


def plural(count: int, noun: str = "frame") -> str:
    """``1 frame``, ``2 frames``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _names(paths: Sequence[str]) -> str:
    return listed([p.rsplit("/", 1)[-1] for p in paths])


def _survey_frames(survey: Survey) -> List[SurveyFrame]:
    return [f for f in survey.frames if f.excluded is None]


def _broken(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    by_code: Dict[Tuple[str, str], List[str]] = defaultdict(list)
    for item in survey.broken:
        by_code[(item.code, item.message)].append(item.path)
    for (code, message), paths in sorted(by_code.items()):
        yield Finding(
            code=code,
            severity=ERROR,
            subjects=tuple(paths),
            message=f"{_names(paths)}: {message}",
            remedy="Copy the file from the card again, or leave it out. sensorgate run leaves it out.",
            measured=float(len(paths)),
        )


def _excluded(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    texts = {
        "duplicate-file": (
            ERROR,
            "{n} the same, byte for byte, as another file of this folder: {names}. Two equal frames have no base line.",
            "Delete the copies. sensorgate run leaves them out.",
        ),
        "panel-frame": (
            WARNING,
            "{n} of the calibration panel: {names}.",
            "Keep them out of the reconstruction; sensorgate run puts them beside the project.",
        ),
        "transit-frame": (
            WARNING,
            "{n} taken while climbing or landing, below half the flight's height: {names}.",
            "Keep them out of the reconstruction. sensorgate run leaves them out.",
        ),
        "horizon-frame": (
            WARNING,
            "{n} looking at the horizon: {names}.",
            "Keep them out of the reconstruction. sensorgate run leaves them out.",
        ),
    }
    by_code: Dict[str, List[str]] = defaultdict(list)
    for frame in survey.frames:
        if frame.excluded in texts:
            by_code[str(frame.excluded)].append(frame.path)
    for code, paths in sorted(by_code.items()):
        severity, text, remedy = texts[code]
        count = plural(len(paths)) + (" is" if len(paths) == 1 else " are")
        if code != "duplicate-file":
            count = plural(len(paths))
        message = text.format(n=count, names=_names(paths))
        yield Finding(code, severity, tuple(paths), message, remedy, measured=float(len(paths)))


def _mixed_spectra(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    groups: Dict[str, List[Payload]] = defaultdict(list)
    for payload in survey.payloads:
        groups[payload.spectrum].append(payload)
    if len(groups) < 2:
        return
    counts = Counter(f.payload for f in _survey_frames(survey))
    parts = [
        f"{plural(sum(counts[p.id] for p in groups[s]), _SPECTRUM_WORD[s] + ' frame')}" for s in sorted(groups)
    ]
    yield Finding(
        code="mixed-spectra",
        severity=ERROR,
        subjects=tuple(sorted(p.id for members in groups.values() for p in members)),
        message=f"The folder mixes {' and '.join(parts)}. A solver cannot match features across spectra.",
        remedy="One project per spectrum: sensorgate run writes them.",
        measured=float(len(groups)),
        threshold=1.0,
    )


def _mixed_rigs(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    rigs = [p for p in survey.payloads if p.spectrum == MULTISPECTRAL]
    kinds = {rig_kind(p, survey) for p in rigs}
    if len(kinds) > 1:
        yield Finding(
            code="mixed-rigs",
            severity=ERROR,
            subjects=tuple(p.id for p in rigs),
            message=f"{len(kinds)} kinds of multispectral camera are in the folder: {listed([p.id for p in rigs])}. "
            "ODM sorts bands by name over the whole folder and would mix them.",
            remedy="One project per camera: sensorgate run writes them.",
            measured=float(len(kinds)),
            threshold=1.0,
        )


def rig_kind(payload: Payload, survey: Survey) -> Tuple[str, str, Tuple[str, ...]]:
    """Make, model and band set: only rigs of one kind may share a project."""
    profile = survey.profile_of()[payload.primary]
    return (profile.make, profile.model, payload.bands)


def _focal(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    for profile in survey.profiles:
        variance = profile.focal_variance
        low, high = profile.focal_mm_min, profile.focal_mm_max
        if low is None or high is None or low == high:
            continue
        span = f"{low:g} to {high:g} mm"
        if variance > limits.focal_variance:
            yield Finding(
                code="focal-variance",
                severity=ERROR,
                subjects=(profile.id,),
                message=f"{profile.id} reports focal lengths from {span}, {100 * variance:.1f} % apart, "
                "though lens, zoom and size are the same: the tag drifts, not the lens.",
                remedy="Treat it as one camera with one focal. sensorgate run gives its copies one focal tag and "
                "locks the intrinsics where a calibration is known.",
                measured=variance,
                threshold=limits.focal_variance,
            )
        else:
            yield Finding(
                code="focal-jitter",
                severity=WARNING,
                subjects=(profile.id,),
                message=f"{profile.id} reports focal lengths from {span}: autofocus jitter. "
                "ODM would make a camera of each value.",
                remedy="sensorgate run gives the copies one focal tag.",
                measured=variance,
                threshold=limits.focal_variance,
            )


def _two_lenses(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    families: Dict[Tuple[str, str, int, int, str], List[CameraProfile]] = defaultdict(list)
    for profile in survey.profiles:
        families[(profile.family, profile.serial, profile.width, profile.height, profile.mode)].append(profile)
    for _, members in sorted(families.items()):
        if len(members) < 2:
            continue
        ids = tuple(p.id for p in members)
        yield Finding(
            code="two-lenses",
            severity=WARNING,
            subjects=ids,
            message=f"{members[0].family} was used with {len(members)} focal lengths: {listed(ids)}. "
            "They are kept apart as different cameras.",
            remedy="Nothing to do if the lens was changed or zoomed on purpose.",
            measured=members[0].family_focal_variance,
            threshold=limits.focal_split,
        )


def _bodies(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    families: Dict[str, Set[str]] = defaultdict(set)
    ids: Dict[str, List[str]] = defaultdict(list)
    for profile in survey.profiles:
        if profile.serial:
            families[profile.family].add(profile.serial)
            ids[profile.family].append(profile.id)
    for family, serials in sorted(families.items()):
        if len(serials) > 1:
            yield Finding(
                code="several-bodies",
                severity=WARNING,
                subjects=tuple(ids[family]),
                message=f"{len(serials)} bodies of {family} made these frames. Each is a camera of its own.",
                remedy="Nothing to do: sensorgate keeps them apart and says where ODM cannot.",
                measured=float(len(serials)),
                threshold=1.0,
            )


def _sizes(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    families: Dict[Tuple[str, str], List[CameraProfile]] = defaultdict(list)
    for profile in survey.profiles:
        families[(profile.family, profile.serial)].append(profile)
    for (family, _), members in sorted(families.items()):
        sizes = sorted({(p.width, p.height) for p in members})
        if len(sizes) < 2:
            continue
        aspects = [w / h for w, h in sizes]
        same = max(aspects) / min(aspects) - 1.0 <= limits.aspect_tolerance
        shown = listed([f"{w}x{h}" for w, h in sizes])
        why = "the same picture scaled" if same else "cut differently, so with different principal points"
        yield Finding(
            code="mixed-resolutions",
            severity=WARNING,
            subjects=tuple(p.id for p in members),
            message=f"{family} wrote frames of {len(sizes)} sizes ({shown}): {why}.",
            remedy="They are kept apart as different cameras; sensorgate run brings them to one ground resolution.",
            measured=max(aspects) / min(aspects) - 1.0,
            threshold=limits.aspect_tolerance,
        )


def _sensor_width(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    families: Dict[Tuple[str, str], List[CameraProfile]] = defaultdict(list)
    for profile in survey.profiles:
        if profile.intrinsics.sensor_width_mm is not None:
            families[(profile.family, profile.mode)].append(profile)
    for (family, _), members in sorted(families.items()):
        widths = sorted(p.intrinsics.sensor_width_mm or 0.0 for p in members)
        if widths[-1] - widths[0] > limits.sensor_width_mm and len({p.width / p.height for p in members}) == 1:
            yield Finding(
                code="sensor-width-differs",
                severity=WARNING,
                subjects=tuple(p.id for p in members),
                message=f"{family} claims sensors {widths[0]:.2f} to {widths[-1]:.2f} mm wide. One of them is wrong.",
                remedy="Give the right width with --calibration, or set right the focal-plane tags.",
                measured=widths[-1] - widths[0],
                threshold=limits.sensor_width_mm,
            )


def _intrinsics(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    by_path = {f.path: f for f in survey.frames}
    for profile in survey.profiles:
        stale = [p for p in profile.frames if any(n.startswith("stale-focal-plane") for n in by_path[p].intrinsics.notes)]
        if stale:
            yield Finding(
                code="stale-focal-plane",
                severity=ERROR,
                subjects=tuple(stale),
                message=f"{plural(len(stale))} of {profile.id} carry focal-plane tags of another picture size "
                "(they were resized after the flight). Software that believes them gets a wrong focal.",
                remedy="sensorgate run sets the tags right in the project's copies.",
                measured=float(len(stale)),
            )
        source = profile.intrinsics.focal_source
        if source == "unknown":
            yield Finding(
                code="focal-unknown",
                severity=WARNING,
                subjects=(profile.id,),
                message=f"Nothing tells the focal length of {profile.id}: no tag, no calibration, not in the sheet. "
                "ODM would start from its guess of 0.85.",
                remedy="Add the camera with --calibration FILE (sensor width and focal length in mm).",
            )
        elif source == "generic-width":
            yield Finding(
                code="focal-guessed",
                severity=WARNING,
                subjects=(profile.id,),
                message=f"The focal of {profile.id} rests on a general table of sensor widths.",
                remedy="Add the camera with --calibration FILE if you know its sensor.",
            )


def _captures_complete(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    for payload in survey.payloads:
        if len(payload.profiles) < 2:
            continue
        dropped = incomplete_captures(survey, payload)
        lost_bands = sorted(set(payload.bands) - set(kept_bands(survey, payload)))
        if lost_bands:
            yield Finding(
                code="band-mostly-missing",
                severity=ERROR,
                subjects=(payload.id,),
                message=f"Most captures of {payload.id} have no {listed(lost_bands)} frame.",
                remedy="Copy the missing band from the card. sensorgate run goes on without that band.",
            )
        if dropped:
            yield Finding(
                code="capture-incomplete",
                severity=ERROR,
                subjects=tuple(dropped),
                message=f"{plural(len(dropped))} of {payload.id} belong to captures that lack a band: "
                f"{_names(dropped)}. ODM leaves such captures out, or stops.",
                remedy="Copy the missing band files from the card. sensorgate run leaves these captures out.",
                measured=float(len(dropped)),
                threshold=0.0,
            )


def kept_bands(survey: Survey, payload: Payload) -> Tuple[str, ...]:
    """Bands that at least half of a rig's captures have; a band below that is given up, not the captures."""
    members = [f for f in _survey_frames(survey) if f.payload == payload.id]
    captures: Dict[str, Set[str]] = defaultdict(set)
    for frame in members:
        captures[frame.capture].add(frame.band)
    have = Counter(b for bands in captures.values() for b in bands)
    multi = sum(1 for bands in captures.values() if len(bands) > 1) or len(captures)
    kept = tuple(sorted(b for b in payload.bands if 2 * have[b] >= multi))
    return kept or payload.bands


def incomplete_captures(survey: Survey, payload: Payload) -> Tuple[str, ...]:
    """Frames of a rig that cannot enter its project: a band of their capture is missing or doubled, or given up."""
    kept = set(kept_bands(survey, payload))
    captures: Dict[str, List[SurveyFrame]] = defaultdict(list)
    for frame in _survey_frames(survey):
        if frame.payload == payload.id:
            captures[frame.capture].append(frame)
    out: List[str] = []
    for members in captures.values():
        bands = Counter(f.band for f in members)
        whole = all(bands[b] == 1 for b in kept)
        out.extend(f.path for f in members if not whole or f.band not in kept)
    return tuple(sorted(out))


def _areas(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    area = survey.area_of()
    for spectrum in sorted({p.spectrum for p in survey.payloads}):
        members = [f for f in _survey_frames(survey) if f.spectrum == spectrum and f.flight in area]
        counts = Counter(area[f.flight] for f in members)
        if len(counts) > 1:
            shown = ", ".join(f"area {a}: {plural(n)}" for a, n in sorted(counts.items()))
            yield Finding(
                code="separate-areas",
                severity=ERROR,
                subjects=tuple(sorted({f.flight for f in members})),
                message=f"The {_SPECTRUM_WORD[spectrum]} frames were taken over {len(counts)} places that cannot "
                f"overlap ({shown}). ODM would merge the pieces without a word.",
                remedy="One project per place: sensorgate run writes them.",
                measured=float(len(counts)),
                threshold=1.0,
            )


def _positions(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    files = survey.file_of()
    paths = [f.path for f in _survey_frames(survey)]
    zero = [p for p in paths if files[p].latitude is not None and files[p].longitude is not None and not files[p].has_gps]
    if zero:
        yield Finding(
            code="gps-zero",
            severity=WARNING,
            subjects=tuple(zero),
            message=f"{plural(len(zero))} carry the position 0,0 that cameras write before they have a fix: {_names(zero)}.",
            remedy="Give positions with --geo FILE, or go on: they are treated as without GPS.",
            measured=float(len(zero)),
        )
    missing = [p for p in paths if not files[p].has_gps]
    if missing and len(missing) == len(paths):
        yield Finding(
            code="gps-none",
            severity=WARNING,
            subjects=(),
            message="No frame has a GPS position. Nothing can be proven by position, and the map will have no place.",
            remedy="Give positions with --geo FILE or ground control with --gcp FILE.",
            measured=float(len(missing)),
        )
    elif missing:
        yield Finding(
            code="gps-missing",
            severity=WARNING,
            subjects=tuple(missing),
            message=f"{len(missing)} of {plural(len(paths))} have no GPS position: {_names(missing)}. "
            "One such frame makes ODM match every frame with every other.",
            remedy="Give positions with --geo FILE, or keep these frames apart.",
            measured=float(len(missing)),
            threshold=0.0,
        )
    outliers = gps_outliers(survey, limits)
    if outliers:
        yield Finding(
            code="gps-outlier",
            severity=WARNING,
            subjects=outliers,
            message=f"{plural(len(outliers))} stand far from the rest of their flight: {_names(outliers)}.",
            remedy="Set their position right with --geo FILE; it is not used for the proof.",
            measured=float(len(outliers)),
            threshold=limits.gps_outlier_m,
        )


def gps_outliers(survey: Survey, limits: Thresholds) -> Tuple[str, ...]:
    """Frames farther than ``gps_outlier_m`` from the median position of their flight."""
    files = survey.file_of()
    out: List[str] = []
    for flight in survey.flights:
        fixes = {p: files[p] for p in flight.frames if files[p].has_gps}
        if len(fixes) < 3:
            continue
        lats = sorted(f.latitude or 0.0 for f in fixes.values())
        lons = sorted(f.longitude or 0.0 for f in fixes.values())
        middle = (lats[len(lats) // 2], lons[len(lons) // 2])
        out.extend(
            p
            for p, f in fixes.items()
            if distance_m(middle, (f.latitude or 0.0, f.longitude or 0.0)) > limits.gps_outlier_m
        )
    return tuple(sorted(out))


def _rtk(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    files = survey.file_of()
    flagged = [f.path for f in _survey_frames(survey) if files[f.path].rtk_flag is not None]
    fixed = [p for p in flagged if is_rtk_fixed(files[p].rtk_flag)]
    total = len(_survey_frames(survey))
    if fixed and len(fixed) < total:
        plain = [f.path for f in _survey_frames(survey) if f.path not in set(fixed)]
        yield Finding(
            code="rtk-mixed",
            severity=WARNING,
            subjects=tuple(plain),
            message=f"{len(fixed)} of {plural(total)} have a fixed RTK position, the others do not. "
            "One accuracy for all would trust the wrong ones.",
            remedy="sensorgate run writes geo.txt with an accuracy per frame.",
            measured=float(len(fixed)),
            threshold=float(total),
        )


def is_rtk_fixed(flag: Optional[int]) -> bool:
    """DJI's RtkFlag 50 is a fixed solution; 16 single, 34 float."""
    return flag == 50


def _few(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    counts: Dict[str, int] = Counter()
    captures: Dict[str, Set[str]] = defaultdict(set)
    for frame in _survey_frames(survey):
        counts[frame.payload] += 1
        captures[frame.payload].add(frame.capture)
    for payload in survey.payloads:
        views = len(captures[payload.id])
        if 0 < views < limits.min_proof_frames:
            yield Finding(
                code="too-few-frames",
                severity=WARNING,
                subjects=(payload.id,),
                message=f"{payload.id} has {plural(views, 'capture')}. Fewer than {limits.min_proof_frames} cannot "
                "prove that a reconstruction is right.",
                remedy="Fly more frames, or take the result as unproven.",
                measured=float(views),
                threshold=float(limits.min_proof_frames),
            )


def _clock(survey: Survey, limits: Thresholds) -> Iterator[Finding]:
    files = survey.file_of()
    missing = [f.path for f in _survey_frames(survey) if seconds(files[f.path]) is None]
    if missing and len(missing) < len(_survey_frames(survey)):
        yield Finding(
            code="time-missing",
            severity=INFO,
            subjects=tuple(missing),
            message=f"{plural(len(missing))} have no capture time: {_names(missing)}.",
            remedy="Nothing to do unless bands or rolling shutter depend on it.",
            measured=float(len(missing)),
        )


RULES: Tuple[Rule, ...] = (
    _broken,
    _excluded,
    _mixed_spectra,
    _mixed_rigs,
    _focal,
    _two_lenses,
    _bodies,
    _sizes,
    _sensor_width,
    _intrinsics,
    _captures_complete,
    _areas,
    _positions,
    _rtk,
    _few,
    _clock,
)


def verdict_of(findings: Sequence[Finding], usable: int) -> str:
    """Blocked without a usable frame, inconsistent with any error, else consistent."""
    if usable == 0:
        return BLOCKED
    return INCONSISTENT if any(f.severity == ERROR for f in findings) else CONSISTENT


def assess(
    survey: Survey, limits: Thresholds, *, gsd_target: Union[str, float] = "finest"
) -> GateReport:
    """Run every rule and plan the harmonizing; pure."""
    findings = [finding for rule in RULES for finding in rule(survey, limits)]
    plan, planned = plan_harmonizing(
        _survey_frames(survey), survey.file_of(), survey.profiles, survey.flights, limits, gsd_target=gsd_target
    )
    findings.extend(planned)
    if not _survey_frames(survey):
        findings.append(
            Finding(
                code="no-usable-frame",
                severity=ERROR,
                subjects=(),
                message="There is no frame in this folder that a reconstruction could use.",
                remedy="Point to the folder that holds the drone's images.",
                measured=0.0,
                threshold=1.0,
            )
        )
    return GateReport(
        verdict=verdict_of(findings, len(_survey_frames(survey))),
        findings=tuple(sorted(findings, key=sort_key)),
        plan=plan,
    )
