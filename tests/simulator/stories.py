"""Named surveys. A story is a function of the seed; lies are added on top (see ``lies``)."""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Dict

from . import catalogue, lies, mixes
from .flight import RTK, Plan, Receiver, beside, fly
from .geo import Origin
from .places import FAR, GROUND, HILLS, HOME, small, survey_of, targets
from .survey import Scene, Survey


def tiny(seed: int) -> Survey:
    """One RGB payload, two strips of four small frames."""
    camera = catalogue.with_band_size(catalogue.phantom4pro(), 0.5)
    plan = Plan(height_m=45.0, strips=2, per_strip=4, side=0.6)
    survey = survey_of("tiny", (camera, fly(camera, plan, GROUND, seed)))
    return replace(survey, points=targets(seed, (18.0, 14.0), 2, 0))


def clean(seed: int) -> Survey:
    """One drone, 24 frames, nothing wrong, five targets and three held out."""
    camera = catalogue.phantom4pro()
    survey = survey_of("clean", (camera, fly(camera, Plan(height_m=60.0, strips=4, per_strip=6), GROUND, seed)))
    return replace(survey, points=targets(seed, (45.0, 35.0), 5, 3))


def _mixed(seed: int, stranger: Origin) -> Survey:
    p4p = catalogue.phantom4pro(project="rgb")
    p4 = catalogue.phantom4(project="rgb")
    rig = catalogue.micasense(project="multispectral")
    heat = catalogue.thermal(project="thermal")
    other = catalogue.compact(folder="p4", route="isolate", project="stranger")
    elsewhere = Scene("elsewhere", stranger, key="elsewhere")
    survey = survey_of(
        "demo",
        (p4p, fly(p4p, Plan(height_m=60.0, strips=3, per_strip=6), GROUND, seed)),
        (p4, fly(p4, Plan(72.0, 3, 4, heading_deg=90.0, start_s=39600.0, first_number=101), GROUND, seed)),
        (rig, fly(rig, Plan(90.0, 2, 5, forward=0.75, side=0.6, start_s=43200.0), GROUND, seed)),
        (heat, fly(heat, Plan(75.0, 2, 7, forward=0.78, side=0.62, start_s=46800.0, first_number=401), GROUND, seed)),
        (other, fly(other, Plan(55.0, 2, 4, start_s=50400.0, first_number=731), elsewhere, seed)),
        scenes=(GROUND, elsewhere),
    )
    return replace(survey, points=targets(seed, (42.0, 36.0), 6, 3))


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
    return survey_of(
        "two-lenses",
        (wide, fly(wide, Plan(60.0, 3, 4, heading_deg=90.0), GROUND, seed)),
        (long, fly(long, Plan(80.0, 3, 4, start_s=37800.0, first_number=201), GROUND, seed)),
    )


def firmware_drift(seed: int) -> Survey:
    """An update changes the reported focal by 4 % in mid-survey; the lens is one and the same."""
    return replace(lies.drift_focal(clean(seed), "p4p", 0.04), name="firmware-drift")


def gps_shift(seed: int) -> Survey:
    """The second drone's GPS lies 30 m off as a whole, and 21 m in height; its geometry is good."""
    p4p, p4 = catalogue.phantom4pro(project="rgb"), catalogue.phantom4(project="rgb")
    shifted = Receiver(bias_m=(26.0, -15.0, 0.0), altitude_bias_m=-21.0)
    return survey_of(
        "gps-shift",
        (p4p, fly(p4p, Plan(60.0, 3, 6), GROUND, seed, RTK)),
        (p4, fly(p4, Plan(72.0, 3, 4, heading_deg=90.0, start_s=39600.0, first_number=101), GROUND, seed, shifted)),
    )


def no_gps(seed: int) -> Survey:
    """A clean survey without any position and without ground control: nothing can prove it."""
    unproven = tuple(replace(p, route="unproven") for p in control_alone(seed).payloads)
    return replace(control_alone(seed), name="no-gps", payloads=unproven, points=())


def control_alone(seed: int) -> Survey:
    """A clean survey without any position, which its ground control proves."""
    return replace(lies.drop_tags(clean(seed), "p4p", ("gps", "relative-altitude")), name="control-alone")


def altitudes_1_3(seed: int) -> Survey:
    """One camera at heights of 1 : 3, so the footprints differ threefold."""
    low = catalogue.phantom4pro(project="rgb")
    return survey_of(
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
    survey = survey_of("rig-trouble", (rig, fly(rig, Plan(90.0, 2, 4), GROUND, seed)))
    survey = lies.lose(survey, "rededge/IMG_0003_3.tif")
    return lies.rename(survey, "rededge/IMG_0005_4.tif", "rededge/IMG_0055_4.tif")


def panels(seed: int) -> Survey:
    """A rig's flight between two panel captures, with three transit captures on the climb."""
    rig = catalogue.micasense()
    survey = survey_of("panels", (rig, fly(rig, Plan(90.0, 2, 4, transit=3), GROUND, seed)))
    return lies.panels(survey, "rededge", (0, -1))


def stale_tags(seed: int) -> Survey:
    """A compact camera's owner shrank the second half of the frames and kept every tag, focal plane included."""
    camera = catalogue.compact()
    survey = survey_of("stale-tags", (camera, fly(camera, Plan(55.0, 3, 4), GROUND, seed)))
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
    return survey_of(
        "obliques",
        (camera, fly(camera, Plan(60.0, 3, 5), GROUND, seed)),
        (camera, fly(camera, Plan(78.0, 2, 4, heading_deg=90.0, start_s=37200.0, first_number=51), GROUND, seed)),
        (camera, fly(camera, Plan(60.0, 2, 4, oblique_deg=30.0, start_s=38400.0, first_number=81), GROUND, seed)),
    )


def thermal_mixed(seed: int) -> Survey:
    """An RGB drone and a FLIR Vue Pro R over the same ground in one folder."""
    camera = small(catalogue.phantom4pro(project="rgb", folder=""))
    heat = catalogue.vue_pro(project="thermal", folder="")
    return survey_of(
        "thermal-mixed",
        (camera, fly(camera, Plan(50.0, 2, 5, side=0.6), GROUND, seed)),
        (heat, fly(heat, Plan(60.0, 2, 6, forward=0.78, side=0.62, start_s=39600.0), GROUND, seed)),
    )


def second_scene(seed: int) -> Survey:
    """Six frames of another field whose GPS claims this one."""
    camera = small(catalogue.phantom4pro(project="rgb"))
    other = small(catalogue.compact(folder="p4p", route="isolate", project="stranger"))
    elsewhere = Scene("elsewhere", HOME, key="elsewhere")
    return survey_of(
        "second-scene",
        (camera, fly(camera, Plan(50.0, 3, 5, side=0.6), GROUND, seed)),
        (other, fly(other, Plan(50.0, 2, 4, side=0.6, start_s=39600.0, first_number=501), elsewhere, seed)),
        scenes=(GROUND, elsewhere),
    )


def five_frames(seed: int) -> Survey:
    """A second drone that took five frames over the middle of the first one's block: too few to prove anything."""
    camera = small(catalogue.phantom4pro(project="rgb"))
    few = small(catalogue.anafi(route="unproven", project="few"))
    return survey_of(
        "five-frames",
        (camera, fly(camera, Plan(50.0, 3, 5, side=0.6), GROUND, seed)),
        (few, fly(few, Plan(50.0, 1, 5, heading_deg=90.0, start_s=39600.0), GROUND, seed)),
    )


def two_surveys(seed: int) -> Survey:
    """One camera's card with two jobs on it, three kilometres and two hours apart."""
    camera = small(catalogue.phantom4pro(project="first"))
    again = replace(camera, id="p4p-again", route="isolate", project="second")
    far = Scene("far", FAR, key="far")
    return survey_of(
        "two-surveys",
        (camera, fly(camera, Plan(50.0, 2, 5, side=0.6), GROUND, seed)),
        (again, fly(again, Plan(50.0, 2, 4, side=0.6, start_s=43200.0, first_number=101), far, seed)),
        scenes=(GROUND, far),
    )


def two_areas(seed: int) -> Survey:
    """One flight over two fields with two hundred metres between them."""
    camera = small(catalogue.phantom4pro(project="rgb"))
    here = Plan(40.0, 2, 4, side=0.6, name="both")
    there = Plan(40.0, 2, 4, center=(260.0, 20.0), side=0.6, start_s=36090.0, first_number=9, name="both")
    return survey_of("two-areas", (camera, fly(camera, here, GROUND, seed)), (camera, fly(camera, there, GROUND, seed)))


def digital_zoom(seed: int) -> Survey:
    """Every third frame of a block was taken with digital zoom at 1.6."""
    camera = small(catalogue.phantom4pro())
    survey = survey_of("digital-zoom", (camera, fly(camera, Plan(50.0, 3, 6, side=0.65, forward=0.8), GROUND, seed)))
    return lies.zoom(survey, "p4p", 1.6, lambda shot, index: index % 3 == 2)


def parrot_rig(seed: int) -> Survey:
    """A Sequoia: four bands and the RGB camera of one rig in one folder, the bands read a little apart in motion."""
    rig, colour = catalogue.sequoia(project="multispectral"), small(catalogue.sequoia_rgb(project="rgb"))
    bands = fly(rig, Plan(60.0, 2, 4, forward=0.8, side=0.65, speed_mps=10.0, every_s=1.5), GROUND, seed)
    return survey_of("parrot-rig", (rig, bands), (colour, beside(bands, colour, rig)))


def rolling_shutter(seed: int) -> Survey:
    """An ANAFI at 9 m/s whose rows are read one after another, with control on the ground."""
    camera = small(catalogue.anafi())
    flown = fly(camera, Plan(85.0, 3, 6, speed_mps=9.0), HILLS, seed)
    survey = survey_of("rolling-shutter", (camera, flown), scenes=(HILLS,))
    return replace(survey, points=targets(seed, (50.0, 36.0), 5, 3))


def wrong_sheet(seed: int) -> Survey:
    """A clean block with control; ``WRONG_SHEET`` says a focal 5 % too long."""
    camera = small(catalogue.phantom4pro())
    survey = survey_of("wrong-sheet", (camera, fly(camera, Plan(85.0, 3, 5), HILLS, seed)), scenes=(HILLS,))
    return replace(survey, points=targets(seed, (36.0, 26.0), 5, 3))


WRONG_SHEET = "make,model,width,height,sensor_width_mm,focal_mm\nDJI,FC6310,684,456,13.2,9.24\n"


def bowl(seed: int) -> Survey:
    """A lens that nothing straightens, calibrated in XMP, over a plain nadir block with RTK: set free, it bows."""
    camera = catalogue.with_band_size(catalogue.kestrel(calibration="dewarp"), 0.6)
    return survey_of("bowl", (camera, fly(camera, Plan(60.0, 3, 8, forward=0.7, side=0.6), GROUND, seed, RTK)))


def undefined_rationals(seed: int) -> Survey:
    """A camera that writes 0/0 for what it does not know: focal plane, zoom, exposure, and the focal of a few."""
    camera = small(catalogue.compact())
    survey = survey_of("undefined-rationals", (camera, fly(camera, Plan(50.0, 2, 5, side=0.6), GROUND, seed)))
    survey = lies.undefine(survey, "compact", ("focal-plane", "zoom", "exposure"))
    gone = ("focal-plane", "zoom", "exposure", "focal")
    return lies.undefine(survey, "compact", gone, only=lambda shot, index: index in (3, 6))


def swapped_captures(seed: int) -> Survey:
    """A rig whose NIR files of two captures carry each other's capture ids."""
    rig = small(catalogue.micasense())
    survey = survey_of("swapped-captures", (rig, fly(rig, Plan(60.0, 2, 4), GROUND, seed)))
    return lies.swap_captures(survey, "rededge", "NIR", 2, 5)


def offset_altitudes(seed: int) -> Survey:
    """The second flight of one drone counts its altitudes from another zero, 47 m higher."""
    camera = small(catalogue.phantom4pro())
    survey = survey_of(
        "offset-altitudes",
        (camera, fly(camera, Plan(50.0, 3, 5, side=0.6), GROUND, seed)),
        (camera, fly(camera, Plan(50.0, 2, 4, heading_deg=90.0, start_s=43200.0, first_number=101), GROUND, seed)),
    )
    return lies.offset_altitudes(survey, "p4p", 47.0, lambda shot, index: index >= 15)


STORIES: Dict[str, Callable[[int], Survey]] = {
    "tiny": tiny,
    "clean": clean,
    "demo": demo,
    "demo-nasty": demo_nasty,
    "two-lenses": two_lenses,
    "firmware-drift": firmware_drift,
    "gps-shift": gps_shift,
    "no-gps": no_gps,
    "control-alone": control_alone,
    "altitudes-1-3": altitudes_1_3,
    "broken-files": broken_files,
    "rig-trouble": rig_trouble,
    "panels": panels,
    "stale-tags": stale_tags,
    "one-other-size": one_other_size,
    "obliques": obliques,
    "thermal-mixed": thermal_mixed,
    "second-scene": second_scene,
    "five-frames": five_frames,
    "two-surveys": two_surveys,
    "two-areas": two_areas,
    "digital-zoom": digital_zoom,
    "parrot-rig": parrot_rig,
    "rolling-shutter": rolling_shutter,
    "wrong-sheet": wrong_sheet,
    "bowl": bowl,
    "undefined-rationals": undefined_rationals,
    "swapped-captures": swapped_captures,
    "offset-altitudes": offset_altitudes,
    **mixes.STORIES,
}


def build(name: str, seed: int = 0) -> Survey:
    """The survey of a named story."""
    if name not in STORIES:
        raise ValueError(f"There is no story named {name!r}. Stories: {', '.join(STORIES)}.")
    return STORIES[name](seed)
