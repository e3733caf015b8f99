"""What a person can do about how the projects came out: advice that no option can carry out (pure)."""

from __future__ import annotations

from typing import Iterator, List, Sequence, Tuple

from ..stages.align.fit import called
from ..stages.align.judge import UNPROVEN
from ..stages.finding import INFO, WARNING, Finding
from ..stages.proven import ISOLATE, PAIRWISE, PROCEED, ProvenGroup
from ..stages.thresholds import Thresholds


def advice(
    projects: Sequence[Tuple[str, str, int, ProvenGroup]], has_gcp: bool, limits: Thresholds
) -> Tuple[Finding, ...]:
    """Advice on written projects: each is its name, spectrum, piece of ground and what was proven of it."""
    return (
        *_bowed(projects, limits),
        *_joined_pairwise(projects, has_gcp),
        *_alone_beside_the_anchor(projects),
        *_shifted(projects, has_gcp),
        *_unplaced(projects, limits),
    )


def _bowed(projects: Sequence[Tuple[str, str, int, ProvenGroup]], limits: Thresholds) -> Iterator[Finding]:
    """A bow that no candidate calibration removed, although the profiles are consistent."""
    for name, _, _, group in projects:
        bow = group.alignment.bowing if group.alignment is not None else None
        if bow is None or bow.bowing_m is None or not called(bow, limits.bowing_sigma):
            continue
        yield Finding(
            code="block-bows",
            severity=WARNING,
            subjects=(name,),
            message=f"The block of {name} bows by {bow.bowing_m:+.2f} m (standard error {bow.se_m or 0.0:.2f} m), and "
            "no calibration that was tried removes it.",
            remedy="Give ground control (--gcp) or a calibration of this camera (--calibration); next time fly cross "
            "strips at another height or some oblique frames.",
            measured=round(abs(bow.bowing_m), 3),
            threshold=round(limits.bowing_sigma * (bow.se_m or 0.0), 3),
        )


def _joined_pairwise(projects: Sequence[Tuple[str, str, int, ProvenGroup]], has_gcp: bool) -> Iterator[Finding]:
    """Pairwise joining is a rescue; where it is chosen again and again the flights want changing."""
    joined = tuple(name for name, _, _, group in projects if group.route == PAIRWISE)
    control = "." if has_gcp else " and give ground control (--gcp)."
    if len(joined) > 1:
        yield Finding(
            code="joined-pairwise",
            severity=WARNING,
            subjects=joined,
            message=f"The payloads of {len(joined)} projects held together only after they were joined one by one.",
            remedy="That is the flights' doing, not one bad frame's: fly the payloads over common targets, with more "
            f"overlap and at closer heights{control}",
            measured=float(len(joined)),
        )
    elif joined:
        yield Finding(
            code="joined-pairwise",
            severity=INFO,
            subjects=joined,
            message=f"The payloads of {joined[0]} held together only after they were joined one by one.",
            remedy="Where this happens again and again, fly the payloads over common targets with more overlap"
            + control,
        )


def _alone_beside_the_anchor(projects: Sequence[Tuple[str, str, int, ProvenGroup]]) -> Iterator[Finding]:
    """Payloads that reconstruct alone over the ground of a proven project, but do not share its model."""
    for name, spectrum, area, group in projects:
        if group.route != ISOLATE or group.alignment is None:
            continue
        anchors: List[Tuple[str, int]] = [
            (n, len(g.frames))
            for n, s, a, g in projects
            if (s, a) == (spectrum, area) and n != name and g.route in (PROCEED, PAIRWISE)
        ]
        if anchors:
            anchor = min(anchors, key=lambda x: (-x[1], x[0]))[0]
            yield Finding(
                code="align-to-anchor",
                severity=INFO,
                subjects=(name,),
                message=f"{name} reconstructs by itself over the ground of {anchor}, but does not fit its model.",
                remedy=f"Run {anchor} first and give its surface model or point cloud to {name} with ODM's align "
                "option, so that both lie in one frame of reference.",
            )


def _shifted(projects: Sequence[Tuple[str, str, int, ProvenGroup]], has_gcp: bool) -> Iterator[Finding]:
    """Payloads whose shape fits their project's model and whose positions do not: they would not lie together alone."""
    for name, _, _, group in projects:
        report = group.alignment
        for payload in report.payloads if report is not None else ():
            offset = payload.gps_offset_m
            if report is None or offset is None or group.route not in (PROCEED, PAIRWISE):
                continue
            ways = zip(offset, ("east", "north", "up"))
            control = "" if has_gcp else "give ground control (--gcp), "
            yield Finding(
                code="positions-shifted",
                severity=WARNING,
                subjects=(payload.payload, name),
                message=f"The frames of {payload.payload} fit the model of {name}, but their positions lie "
                f"{', '.join(f'{v:+.1f} m {way}' for v, way in ways)} of where {report.anchor} puts them. ODM believes "
                "both and lays the block between them.",
                remedy=f"Give right positions (--geo), {control}or run {payload.payload} by itself and lay it on the "
                f"result of {report.anchor} with ODM's align option.",
                measured=round(max(abs(v) for v in offset), 2),
            )


def _unplaced(projects: Sequence[Tuple[str, str, int, ProvenGroup]], limits: Thresholds) -> Iterator[Finding]:
    """Frames of a proven project that found no place in its model: holes in what ODM will make of it."""
    for name, _, _, group in projects:
        report = group.alignment
        if report is None or group.route == UNPROVEN:
            continue
        frames, mains = report.frames, max(1, report.areas)
        lost = tuple(f.path for f in frames if not f.registered or (f.component or 0) >= mains)
        if not lost:
            continue
        share = len(lost) / len(frames)
        yield Finding(
            code="frames-unplaced",
            severity=WARNING if share > limits.unplaced_share else INFO,
            subjects=lost,
            message=f"{len(lost)} of {len(frames)} aligned frames of {name} found no place in its model. They stay in "
            "the project, but ODM will probably leave them out, with a hole where nothing else covers their ground.",
            remedy="Look where they lie on the report's map. Over forest, water or snow fly with 80 % overlap or more, "
            "and higher; blurred or dark frames can be taken out.",
            measured=round(share, 3),
            threshold=limits.unplaced_share,
        )
