"""Named surveys. A story is a function of the seed; lies are added on top (see ``lies``)."""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Dict, Tuple

from . import catalogue, lies
from .flight import RTK, Plan, Receiver, fly
from .geo import Origin
from .survey import ControlPoint, Payload, Scene, Shot, Survey, rng

HOME = Origin(47.21840, 8.73150, 441.0)
FAR = Origin(47.24480, 8.75320, 436.0)
GROUND = Scene("ground", HOME)


def _survey(name: str, *flights: Tuple[Payload, Tuple[Shot, ...]], scenes: Tuple[Scene, ...] = (GROUND,)) -> Survey:
    payloads: Dict[str, Payload] = {}
    shots: Tuple[Shot, ...] = ()
    for payload, flown in flights:
        payloads[payload.id] = payload
        shots += flown
    return Survey(name, scenes, tuple(payloads.values()), shots)


def _targets(seed: int, half_m: Tuple[float, float], count: int, checks: int) -> Tuple[ControlPoint, ...]:
    """Targets spread over a block: the corners and the middle first, jittered."""
    gen = rng(seed, "targets")
    grid = [(-1, -1), (1, 1), (-1, 1), (1, -1), (0, 0), (0, 1), (0, -1), (-1, 0), (1, 0)]
    spots = [(x + gen.uniform(-0.12, 0.12), y + gen.uniform(-0.12, 0.12)) for x, y in grid[:count]]
    spots += [(gen.uniform(-0.7, 0.7), gen.uniform(-0.7, 0.7)) for _ in range(checks)]
    return tuple(
        ControlPoint(
            f"gcp{i + 1:02d}" if i < count else f"check{i + 1 - count:02d}",
            GROUND.id,
            float(x * half_m[0]),
            float(y * half_m[1]),
            "gcp" if i < count else "check",
        )
        for i, (x, y) in enumerate(spots)
    )


def tiny(seed: int) -> Survey:
    """One RGB payload, two strips of four small frames."""
    camera = catalogue.with_band_size(catalogue.phantom4pro(), 0.5)
    plan = Plan(height_m=45.0, strips=2, per_strip=4, side=0.6)
    survey = _survey("tiny", (camera, fly(camera, plan, GROUND, seed)))
    return replace(survey, points=_targets(seed, (18.0, 14.0), 2, 0))


def clean(seed: int) -> Survey:
    """One drone, 24 frames, nothing wrong, five targets and three held out."""
    camera = catalogue.phantom4pro()
    survey = _survey("clean", (camera, fly(camera, Plan(height_m=60.0, strips=4, per_strip=6), GROUND, seed)))
    return replace(survey, points=_targets(seed, (45.0, 35.0), 5, 3))


def _mixed(seed: int, stranger: Origin) -> Survey:
    p4p = catalogue.phantom4pro(project="rgb")
    p4 = catalogue.phantom4(project="rgb")
    rig = catalogue.micasense(project="multispectral")
    heat = catalogue.thermal(project="thermal")
    other = catalogue.compact(folder="p4", route="isolate", project="stranger")
    elsewhere = Scene("elsewhere", stranger, key="elsewhere")
    survey = _survey(
        "demo",
        (p4p, fly(p4p, Plan(height_m=60.0, strips=3, per_strip=6), GROUND, seed)),
        (p4, fly(p4, Plan(72.0, 3, 4, heading_deg=90.0, start_s=39600.0, first_number=101), GROUND, seed)),
        (rig, fly(rig, Plan(90.0, 2, 5, forward=0.75, side=0.6, start_s=43200.0), GROUND, seed)),
        (heat, fly(heat, Plan(75.0, 2, 7, forward=0.78, side=0.62, start_s=46800.0, first_number=401), GROUND, seed)),
        (other, fly(other, Plan(55.0, 2, 4, start_s=50400.0, first_number=731), elsewhere, seed)),
        scenes=(GROUND, elsewhere),
    )
    return replace(survey, points=_targets(seed, (42.0, 36.0), 6, 3))


def demo(seed: int) -> Survey:
    """Two RGB drones that belong together, a five-band rig, thermal without focal tags, eight strangers 3 km off."""
    return _mixed(seed, FAR)


def demo_nasty(seed: int) -> Survey:
    """The demo whose strangers claim to have been taken here."""
    return replace(_mixed(seed, HOME), name="demo-nasty")


def two_lenses(seed: int) -> Survey:
    """One model name, two lenses of 24 and 35 mm equivalent on one body."""
    wide = catalogue.kestrel("wide", lens="K 6.4 mm", folder="", project="rgb")
    long = catalogue.kestrel("long", lens="K 9.4 mm", folder="", project="rgb", focal_35mm=38)
    band = long.bands[0]
    optics = replace(band.camera, focal_ratio=9.4 / 8.8, distortion=(-0.03, 0.02, 0.0, 0.0, 0.0))
    long = replace(long, focal_mm=9.4, bands=(replace(band, camera=optics),))
    return _survey(
        "two-lenses",
        (wide, fly(wide, Plan(60.0, 3, 4, heading_deg=90.0), GROUND, seed)),
        (long, fly(long, Plan(80.0, 3, 4, start_s=37800.0, first_number=201), GROUND, seed)),
    )


def firmware_drift(seed: int) -> Survey:
    """An update changes the reported focal by 5 % in mid-survey; the lens is one and the same."""
    return replace(lies.drift_focal(clean(seed), "p4p", 0.05), name="firmware-drift")


def gps_shift(seed: int) -> Survey:
    """The second drone's GPS lies 14 m off as a whole; its geometry is good."""
    p4p, p4 = catalogue.phantom4pro(project="rgb"), catalogue.phantom4(project="rgb")
    shifted = Receiver(bias_m=(12.0, -7.0, 0.0), altitude_bias_m=-21.0)
    return _survey(
        "gps-shift",
        (p4p, fly(p4p, Plan(60.0, 3, 6), GROUND, seed, RTK)),
        (p4, fly(p4, Plan(72.0, 3, 4, heading_deg=90.0, start_s=39600.0, first_number=101), GROUND, seed, shifted)),
    )


def no_gps(seed: int) -> Survey:
    """A clean survey without any position."""
    survey = lies.drop_tags(clean(seed), "p4p", ("gps", "relative-altitude"))
    unproven = tuple(replace(p, route="unproven") for p in survey.payloads)
    return replace(survey, name="no-gps", payloads=unproven)


def altitudes_1_3(seed: int) -> Survey:
    """One camera at heights of 1 : 3, so the footprints differ threefold."""
    low = catalogue.phantom4pro(project="rgb")
    return _survey(
        "altitudes-1-3",
        (low, fly(low, Plan(30.0, 4, 5, side=0.6), GROUND, seed)),
        (low, fly(low, Plan(90.0, 2, 4, start_s=39600.0, first_number=101), GROUND, seed)),
    )


def broken_files(seed: int) -> Survey:
    """A clean survey with one of each kind of bad file, and things that are no survey frames."""
    survey = clean(seed)
    paths = [s.path for s in survey.shots]
    for index, kind in ((2, "truncate"), (5, "empty"), (8, "text"), (11, "garble"), (14, "strip")):
        survey = lies.spoil(survey, paths[index], kind)
    survey = lies.duplicate(survey, paths[3], paths[3].replace("DJI_", "COPY_"))
    extra = {"p4p/readme.txt": b"flown on a sunny day\n", "p4p/.hidden.JPG": b"x", "Thumbs.db": b"\0" * 64}
    return replace(survey, name="broken-files", extra_files=extra)


def rig_trouble(seed: int) -> Survey:
    """A rig whose third capture lost its red band and whose fifth has a band file misnumbered."""
    rig = catalogue.micasense()
    survey = _survey("rig-trouble", (rig, fly(rig, Plan(90.0, 2, 4), GROUND, seed)))
    survey = lies.lose(survey, "rededge/IMG_0003_3.tif")
    return lies.rename(survey, "rededge/IMG_0005_4.tif", "rededge/IMG_0055_4.tif")


def panels(seed: int) -> Survey:
    """A rig's flight between two panel captures, with three transit captures on the climb."""
    rig = catalogue.micasense()
    survey = _survey("panels", (rig, fly(rig, Plan(90.0, 2, 4, transit=3), GROUND, seed)))
    return lies.panels(survey, "rededge", (0, -1))


def stale_tags(seed: int) -> Survey:
    """A compact camera's owner shrank the second half of the frames and kept every tag, focal plane included."""
    camera = catalogue.compact()
    survey = _survey("stale-tags", (camera, fly(camera, Plan(55.0, 3, 4), GROUND, seed)))
    for shot in survey.shots[6:]:
        survey = lies.spoil(survey, shot.path, "resize", factor=0.5)
    return survey


def one_other_size(seed: int) -> Survey:
    """A clean survey in which one frame was taken in a smaller mode."""
    survey = clean(seed)
    return replace(lies.resize_one(survey, survey.shots[9].path, 0.5), name="one-other-size")


def obliques(seed: int) -> Survey:
    """Nadir strips, cross strips at another height and a tilted pass: geometry that fixes a focal length."""
    camera = catalogue.kestrel()
    return _survey(
        "obliques",
        (camera, fly(camera, Plan(60.0, 3, 5), GROUND, seed)),
        (camera, fly(camera, Plan(78.0, 2, 4, heading_deg=90.0, start_s=37200.0, first_number=51), GROUND, seed)),
        (camera, fly(camera, Plan(60.0, 2, 4, oblique_deg=30.0, start_s=38400.0, first_number=81), GROUND, seed)),
    )


STORIES: Dict[str, Callable[[int], Survey]] = {
    "tiny": tiny,
    "clean": clean,
    "demo": demo,
    "demo-nasty": demo_nasty,
    "two-lenses": two_lenses,
    "firmware-drift": firmware_drift,
    "gps-shift": gps_shift,
    "no-gps": no_gps,
    "altitudes-1-3": altitudes_1_3,
    "broken-files": broken_files,
    "rig-trouble": rig_trouble,
    "panels": panels,
    "stale-tags": stale_tags,
    "one-other-size": one_other_size,
    "obliques": obliques,
}


def build(name: str, seed: int = 0) -> Survey:
    """The survey of a named story."""
    if name not in STORIES:
        raise ValueError(f"There is no story named {name!r}. Stories: {', '.join(STORIES)}.")
    return STORIES[name](seed)
