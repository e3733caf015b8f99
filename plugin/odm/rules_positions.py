"""What ODM would do with the frames' positions and heights."""

from __future__ import annotations

from typing import Iterator, Sequence

from ...stages.finding import ERROR, INFO, WARNING, Finding
from .folder import Folder, finding, several

_ODM_DEFAULT_DOP_M = 10.0
_RTK_FIXED = 50
_ZERO_ALTITUDE_SHARE = 0.05
_ZONE_DEGREES = 6.0
_UTM_LIMIT_DEGREES = (81.0, 99.0)


def gps_missing(folder: Folder) -> Iterator[Finding]:
    """One frame without a position makes ODM match all with all; none with one makes it match by words."""
    solver = folder.solver
    without = [f for f in solver if f.latitude is None or f.longitude is None]
    if not solver or not without:
        return
    if len(without) == len(solver):
        yield finding(
            "odm-gps-none",
            WARNING,
            without,
            "No frame has a position: ODM would match by visual words, with weaker features, and without ground "
            "control the result has neither place nor scale.",
            "Give positions in a geo.txt (--geo) or ground control (--gcp).",
            odm="No GPS information, using BOW matching by default "
            "(you can override this by setting --matcher-type explicitly)",
        )
        return
    pairs = len(solver) * (len(solver) - 1) // 2
    yield finding(
        "odm-gps-exhaustive",
        WARNING,
        without,
        f"{several(without, 'has', 'have')} no position. One is enough: ODM then matches every frame with every other, "
        f"{pairs} pairs for {len(solver)} frames.",
        "Leave these frames out, or give their positions in a geo.txt (--geo).",
        measured=float(pairs),
        threshold=float(50 * len(solver)),
        odm=f"GPS position not available for {without[0].name}",
    )


def gps_zero(folder: Folder) -> Iterator[Finding]:
    """ODM warns of a position 0,0 and uses it."""
    found = [f for f in folder.solver if f.latitude == 0.0 and f.longitude == 0.0]
    if not found:
        return
    others = [f.longitude for f in folder.solver if f.has_gps and f.longitude is not None]
    # Proj has no UTM coordinate for a point on the equator a quarter of the globe away; ODM then gives up.
    beyond = any(_UTM_LIMIT_DEGREES[0] <= abs(lon) <= _UTM_LIMIT_DEGREES[1] for lon in others)
    effect = "which costs the whole map its georeference" if beyond else "which throws the map's origin off"
    yield finding(
        "odm-gps-zero",
        WARNING,
        found,
        f"{several(found, 'has', 'have')} the position 0, 0. ODM warns and uses it, {effect}.",
        "Leave these frames out, or give their positions in a geo.txt (--geo).",
        odm="Could not generate coordinates file. The orthophoto will not be georeferenced."
        if beyond
        else f"{found[0].name} has GPS position (0,0), possibly corrupted",
    )


def gps_reference(folder: Folder) -> Iterator[Finding]:
    """Without N/S and E/W tags ODM assumes north and east."""
    found = [f for f in folder.solver if f.gps_reference_missing]
    if found:
        yield finding(
            "odm-gps-reference-missing",
            WARNING,
            found,
            f"{several(found, 'does', 'do')} not say north or south, east or west; ODM assumes north and east.",
            "Write the tags: exiftool -GPSLatitudeRef=S -GPSLongitudeRef=W FILE.",
            odm=f"GPS position for {found[0].name} might be incorrect, GPSLatitudeRef tag is missing (assuming N)",
        )


def altitude(folder: Folder) -> Iterator[Finding]:
    """One frame without a height, or more than 5 % at zero, and ODM drops the heights of all."""
    solver = folder.solver
    placed = any(f.latitude is not None for f in solver)
    without = [f for f in solver if f.altitude_m is None]
    zero = [f for f in solver if f.altitude_m == 0.0]
    if placed and without:
        yield finding(
            "odm-altitude-missing",
            WARNING,
            without,
            f"{several(without, 'has', 'have')} no height. One is enough: ODM then ignores the heights of all "
            f"{len(solver)} frames and levels the block by how the cameras stood.",
            "Leave these frames out, or give their heights in a geo.txt (--geo).",
        )
    elif placed and len(zero) > _ZERO_ALTITUDE_SHARE * len(solver):
        yield finding(
            "odm-altitude-zero",
            WARNING,
            zero,
            f"{len(zero)} of {len(solver)} frames stand at a height of exactly 0 m; ODM then ignores all heights.",
            "Give the heights in a geo.txt (--geo).",
            measured=round(len(zero) / len(solver), 4),
            threshold=_ZERO_ALTITUDE_SHARE,
            odm="More than 5% of images have zero altitude, this might be an indicator that the images have "
            "no altitude information",
        )


def rtk(folder: Folder) -> Iterator[Finding]:
    """ODM takes the RTK deviation whether the solution was fixed or not, and 10 m for every other frame."""
    told = [f for f in folder.solver if f.rtk_std_m is not None]
    loose = [f for f in told if f.rtk_flag is not None and f.rtk_flag != _RTK_FIXED]
    if loose:
        yield finding(
            "odm-rtk-not-fixed",
            WARNING,
            loose,
            f"{several(loose, 'carries', 'carry')} an RTK deviation without a fixed solution; ODM believes it "
            "all the same.",
            "Use the geo.txt that sensorgate run writes: it holds true accuracies for each frame.",
        )
    plain = [f for f in folder.solver if f.rtk_std_m is None and f.latitude is not None]
    if told and plain:
        yield finding(
            "odm-accuracy-mixed",
            INFO,
            plain,
            f"{len(told)} frames carry an RTK deviation; for the other {len(plain)} ODM takes "
            f"{_ODM_DEFAULT_DOP_M:g} m.",
            "Use the geo.txt that sensorgate run writes: it holds true accuracies for each frame.",
        )


def repeated_blocks(folder: Folder) -> Iterator[Finding]:
    """ODM doubles RTK deviations and turns the pitch once per XMP block."""
    found = [f for f in folder.solver if f.xmp_blocks > 1 and (f.rtk_std_m is not None or f.pitch_deg is not None)]
    dji = [f for f in found if f.make.lower() in ("dji", "hasselblad")]
    if dji:
        yield finding(
            "odm-xmp-blocks",
            INFO,
            dji,
            f"The XMP of {several(dji)} has several blocks. ODM corrects pitch and RTK deviation once per block, "
            "so both come out wrong.",
            "Harmless by default; do not use --sfm-algorithm triangulation with these frames.",
        )


def _longitude_span(longitudes: Sequence[float]) -> float:
    """Degrees from the westernmost to the easternmost, over the date line where that is shorter."""
    ordered = sorted(longitudes)
    gaps = [b - a for a, b in zip(ordered, ordered[1:])] + [ordered[0] + 360.0 - ordered[-1]]
    return 360.0 - max(gaps)


def far_zone(folder: Folder) -> Iterator[Finding]:
    """All coordinates go into the UTM zone of the first frame that ODM lists."""
    placed = [f for f in folder.solver if f.has_gps]
    longitudes = [f.longitude for f in placed if f.longitude is not None]
    span = _longitude_span(longitudes) if longitudes else 0.0
    if span > _ZONE_DEGREES:
        yield finding(
            "odm-positions-apart",
            ERROR,
            placed,
            f"The frames lie {span:.0f} degrees of longitude apart; ODM puts all of them into one map zone.",
            "Process the areas apart, or leave out the frames with wrong positions.",
            measured=round(span, 2),
            threshold=_ZONE_DEGREES,
        )


RULES = (gps_missing, gps_zero, gps_reference, altitude, rtk, repeated_blocks, far_zone)
