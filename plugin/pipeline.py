"""The one place that strings the stages together; command line, node and WebODM all call it."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from ..stages.align.images import undecoded
from ..stages.assemble import Group, request_of
from ..stages.calibrations import survey_digest
from ..stages.errors import BlockedError, MissingDependency, SensorgateError
from ..stages.finding import Finding, sort_key
from ..stages.gate import BLOCKED
from ..stages.harmonize.model import HarmonizedFrame
from ..stages.overruled import overruled, still_true
from ..stages.progress import Cancel, Progress, check
from ..stages.proven import apart
from ..stages.read import Found
from ..stages.record import dumps, write_text
from .harmonizing import Harmonized, harmonize
from .inspection import DEFAULT_SETTINGS, Inspection, Settings, inspect
from .placing import Placed, believed, frames_of, place, without_alignment
from .plan import Digests, input_files, output_files, plan_record
from .plan_diff import input_differences
from .plan_file import Plan
from .remembering import Memory, learned
from .replay import replay_record
from .report import build as reporting
from .workfolder import WorkFolder, disk_errors, open_folder

LOG = logging.getLogger("sensorgate.pipeline")


@dataclass(frozen=True)
class Result:
    """What a verb returns: the report in the shape of ``report.schema.json``, and the exit code."""

    report: Dict[str, Any]
    exit_code: int


def _report(
    inspection: Inspection, findings: Sequence[Finding], written: Optional[reporting.Written] = None
) -> Dict[str, Any]:
    return reporting.build(
        inspection.survey,
        inspection.verdict,
        findings,
        inspection.assessed.plan,
        inspection.settings.thresholds,
        paths=inspection.paths,
        options=inspection.settings.options(),
        odm_ids=inspection.prediction.camera_ids,
        odm_notes=inspection.prediction.notes,
        gcp_points=inspection.control.points,
        gps_sigma=inspection.control.accuracies,
        written=written,
    )


def gate(
    paths: Sequence[str],
    settings: Settings = DEFAULT_SETTINGS,
    *,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    found: Optional[Found] = None,
    inspection: Optional[Inspection] = None,
) -> Result:
    """The verdict on imagery before anything is spent on it. Exit 0 consistent, 1 fixable, 3 blocked."""
    inspection = inspection or inspect(paths, settings, progress=progress, cancel=cancel, found=found)
    code = {"consistent": 0, "inconsistent": 1}.get(inspection.verdict, 3)
    return Result(_report(inspection, inspection.findings), code)


def run(
    paths: Sequence[str],
    out: Path,
    settings: Settings = DEFAULT_SETTINGS,
    *,
    work: Optional[Path] = None,
    resume: bool = False,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    inspection: Optional[Inspection] = None,
    plan: Optional[Plan] = None,
) -> Result:
    """The main job: from mixed imagery to ODM projects in ``out``; an ``inspection`` of it is not made again.

    With a ``plan`` of an earlier run (its settings: ``replay.settings_of``) the
    report's ``replay`` says what differs from it.

    Exit 0 when all frames are placed and proceed, 1 when something is
    isolated, unproven or left out, 3 (``BlockedError``) when nothing could be
    written.
    """
    if settings.align:
        require_solver(settings.engine)
    folder = open_folder(out, work, [Path(p) for p in paths if Path(p).is_dir()], resume)
    started = False
    try:
        with disk_errors(folder.out):
            inspection = inspection or inspect(paths, settings, progress=progress, cancel=cancel)
            if inspection.verdict == BLOCKED:
                raise BlockedError(blocked_message(inspection))
            folder.begin(reporting.digest_of(inspection.survey, settings.identity()), resume)
            started = True
            report, memory = _produce(inspection, folder, progress, cancel, plan)
            folder.publish()
            memory.write()
    except BaseException:
        if not started:
            folder.abandon()
        raise
    if not report["subprojects"]:
        return Result(report, BlockedError.exit_code)
    clean = all(s["route"] == "proceed" for s in report["subprojects"])
    whole = all(f["subproject"] for f in report["frames"])
    return Result(report, 0 if clean and whole else 1)


def require_solver(engine: str) -> None:
    """Raise ``MissingDependency`` before any work when the alignment could not run."""
    import importlib.util
    import shutil

    if importlib.util.find_spec("cv2") is None:
        raise MissingDependency("OpenCV", "the alignment", "pip install 'sensorgate[sfm]' (or run with --no-align)")
    if engine == "pycolmap" and importlib.util.find_spec("pycolmap") is None:
        raise MissingDependency("pycolmap", "the alignment", "pip install 'sensorgate[sfm]' (or run with --no-align)")
    if engine == "colmap" and shutil.which("colmap") is None:
        raise MissingDependency("COLMAP", "--engine colmap", "apt-get install colmap (or use --engine pycolmap)")


def blocked_message(inspection: Inspection) -> str:
    """Why there is nothing to do, and the way out."""
    survey = inspection.survey
    where = ", ".join(inspection.paths)
    if survey.broken:
        first = survey.broken[0]
        return (
            f"None of the {len(survey.broken)} image files in {where} can be read "
            f"(first: {first.path}: {first.message}). Copy the files from the card again."
        )
    if survey.frames:
        return f"None of the {len(survey.frames)} frames in {where} is a survey frame. See sensorgate gate {where}."
    seen = sum(n for _, n in survey.ignored)
    other = f" ({seen} other files were passed over)" if seen else ""
    return f"There is no image in {where}{other}. Point to the folder that holds the drone's JPEG or TIFF files."


def _produce(
    inspection: Inspection,
    folder: WorkFolder,
    progress: Optional[Progress],
    cancel: Optional[Cancel],
    plan: Optional[Plan],
) -> Tuple[Dict[str, Any], Memory]:
    """Everything between the inspection and the finished result in the scratch."""
    digests = Digests(progress, cancel)
    inputs = digests.of(input_files(inspection))
    if plan is not None:
        for early in input_differences(plan.record, {"inputs": {"files": inputs}}):
            LOG.warning("replay: %s", early.message)
    ready = harmonize(inspection, folder, progress, cancel)
    inspection = ready.inspection
    placed: List[Placed] = []
    for group in ready.groups:
        check(cancel)
        placed.extend(_prove(group, inspection, folder, ready.copies, progress, cancel))
    placed, ready = _decodable(placed, ready)
    groups = apart([(p.group.spectrum, p.group.area, p.proven) for p in placed])
    placed = [replace(p, proven=g) for p, g in zip(placed, groups)]
    written = place(placed, inspection, ready, folder.folder("result"))
    frames = tuple(replace(f, excluded=ready.dropped.get(f.path, f.excluded)) for f in inspection.survey.frames)
    inspection = replace(inspection, survey=replace(inspection.survey, frames=frames))
    memory = learned(
        inspection.settings.calibrations,
        [p.proven.alignment for p in placed if p.proven.alignment is not None],
        inspection.survey.profiles,
        survey_digest(inspection.survey.files),
        inspection.settings.thresholds,
    )
    profiles = inspection.survey.profiles
    decisions = {d.profile: d for p in reversed(placed) for d in believed(p.proven, profiles)}
    refuted = overruled(decisions.values(), profiles, inspection.settings.thresholds)
    known = still_true(inspection.findings, refuted, {f.path: f.profile for f in inspection.survey.frames})
    said = [*known, *refuted, *ready.findings, *written.findings, *memory.findings]
    findings = tuple(sorted(said, key=sort_key))
    report = _report(inspection, findings, written.record)
    _conserve(report)
    now = plan_record(report, inspection, inputs, digests.of(output_files(folder.folder("result") / "projects")))
    if plan is not None:
        report["replay"] = replay_record(plan, now)
    _write_reports(report, now, folder, ready.copies)
    return report, memory


def _prove(
    group: Group,
    inspection: Inspection,
    folder: WorkFolder,
    copies: Mapping[str, HarmonizedFrame],
    progress: Optional[Progress],
    cancel: Optional[Cancel],
) -> List[Placed]:
    """Align one group, or take up what an interrupted run proved; without alignment every payload is unproven."""
    settings = inspection.settings
    if not settings.align:
        return without_alignment(group, inspection.survey)
    from ..stages.record import from_plain
    from ..stages.route import Proof, prove

    kept_name = f"proof-{group.name}.json"
    kept = folder.load(kept_name)
    proof: Optional[Proof] = None
    if isinstance(kept, dict):
        try:
            proof = from_plain(Proof, kept)
        except (TypeError, ValueError, KeyError):
            LOG.info("%s of the interrupted run does not fit; aligning again", kept_name)
    if proof is None:
        request = request_of(
            group,
            inspection.survey,
            copies,
            settings.thresholds,
            marks=inspection.control.marks(copies),
            accuracies=inspection.control.accuracies,
        )
        proof = prove(
            request,
            folder.folder(f"align-{group.name}"),
            thresholds=settings.thresholds,
            engine=settings.engine,
            max_dim=settings.max_dim,
            progress=progress,
            cancel=cancel,
        )
        folder.keep(kept_name, proof)
    return [Placed(group, proven) for proven in proof.groups]


def _decodable(placed: Sequence[Placed], ready: Harmonized) -> Tuple[List[Placed], Harmonized]:
    """Frames that the solver could not decode leave: one of them ends ODM's whole run."""
    lost: Dict[str, str] = {}
    kept: List[Placed] = []
    for item in placed:
        notes = item.proven.alignment.notes if item.proven.alignment is not None else ()
        damaged = set(undecoded(item.proven.frames, notes))
        whole = replace(item, proven=replace(item.proven, frames=tuple(sorted({*item.proven.frames} - damaged))))
        left = set(frames_of(whole, ready.inspection.survey)) if whole.proven.frames else set()
        for path in frames_of(item, ready.inspection.survey) if damaged else ():
            if path not in left:
                lost[path] = "pixels-broken" if path in damaged else "capture-incomplete"
        if whole.proven.frames:
            kept.append(whole if damaged else item)
    damaged_paths = tuple(p for p in sorted(lost) if lost[p] == "pixels-broken")
    if not damaged_paths:
        return list(placed), ready
    finding = Finding(
        code="pixels-broken",
        severity="error",
        subjects=damaged_paths,
        message=f"{len(damaged_paths)} frames have a good header, but their picture cannot be decoded.",
        remedy="Copy the files from the card again and run once more.",
        measured=float(len(damaged_paths)),
    )
    return kept, replace(ready, dropped={**ready.dropped, **lost}, findings=(*ready.findings, finding))


def _conserve(report: Mapping[str, Any]) -> None:
    """The law of conservation: every frame in exactly one project, or left out with its reason."""
    homes: Dict[str, int] = {}
    for project in report["subprojects"]:
        for path in project["frames"]:
            homes[path] = homes.get(path, 0) + 1
    for frame in report["frames"]:
        inside = homes.get(frame["path"], 0)
        if inside > 1 or (inside == 1) != (frame["subproject"] is not None) or (inside == 0 and not frame["reason"]):
            raise SensorgateError(f"{frame['path']} would be lost or doubled. Nothing was written; please report this.")


def _write_reports(
    report: Dict[str, Any], plan: Mapping[str, Any], folder: WorkFolder, copies: Mapping[str, HarmonizedFrame]
) -> None:
    """``report.json``, ``plan.json`` and ``report.html`` beside the projects, all in the scratch until published."""
    result = folder.folder("result")
    write_text(result / "report.json", dumps(report))
    write_text(result / "plan.json", dumps(plan))
    try:
        from .report.html import render
        from .report.previews import previews_of

        write_text(result / "report.html", render(report, previews_of(report, copies)))
    except MissingDependency as error:
        LOG.warning("%s The job itself is complete; report.html was left out.", error)


__all__ = ["Inspection", "Result", "Settings", "gate", "inspect", "run"]
