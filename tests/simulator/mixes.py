"""Named surveys whose payloads must part, or hold together by more than their matches."""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Dict

from . import catalogue
from .flight import RTK, Plan, Receiver, fly
from .places import GROUND, HILLS, HOME, small, survey_of, targets
from .survey import Scene, Survey


def several_guilty(seed: int) -> Survey:
    """One folder with a drone's block and two strangers from two other fields, whose GPS claims this one."""
    camera = small(catalogue.phantom4pro(project="rgb", folder=""))
    canon = small(catalogue.compact(route="isolate", project="stranger", folder=""))
    parrot = small(catalogue.anafi(route="isolate", project="other-stranger", folder=""))
    field, wood = Scene("field", HOME, key="field"), Scene("wood", HOME, key="wood")
    return survey_of(
        "several-guilty",
        (camera, fly(camera, Plan(50.0, 2, 5, side=0.6), GROUND, seed)),
        (canon, fly(canon, Plan(50.0, 2, 3, side=0.6, start_s=39600.0, first_number=501), field, seed)),
        (parrot, fly(parrot, Plan(50.0, 2, 3, heading_deg=90.0, side=0.6, start_s=43200.0), wood, seed)),
        scenes=(GROUND, field, wood),
    )


def two_in_one(seed: int) -> Survey:
    """One camera's card with two jobs on it, two hours apart, whose GPS claims one field for both."""
    camera = small(catalogue.phantom4pro(project="first"))
    again = replace(camera, id="p4p-again", route="isolate", project="second")
    elsewhere = Scene("elsewhere", HOME, key="elsewhere")
    return survey_of(
        "two-in-one",
        (camera, fly(camera, Plan(50.0, 2, 5, side=0.6), GROUND, seed)),
        (again, fly(again, Plan(50.0, 2, 3, side=0.6, start_s=43200.0, first_number=101), elsewhere, seed)),
        scenes=(GROUND, elsewhere),
    )


def areas_shared(seed: int) -> Survey:
    """Two fields with two hundred metres between them: one drone flew both, another only the far one."""
    both, far = small(catalogue.phantom4pro(project="rgb")), small(catalogue.phantom4(project="rgb"))
    east = (260.0, 20.0)
    here = Plan(40.0, 2, 4, side=0.6, name="both")
    there = Plan(40.0, 2, 4, east, side=0.6, start_s=36090.0, first_number=11, name="both")
    across = Plan(45.0, 2, 3, east, heading_deg=90.0, side=0.6, start_s=39600.0, first_number=201)
    return survey_of(
        "areas-shared",
        (both, fly(both, here, GROUND, seed)),
        (both, fly(both, there, GROUND, seed)),
        (far, fly(far, across, GROUND, seed)),
    )


def lock_beside_guess(seed: int) -> Survey:
    """A lens calibrated in XMP over a plain nadir block, and a camera that says nothing of its focal, over the same."""
    known = small(catalogue.kestrel("known", calibration="dewarp", project="held"))
    silent = small(catalogue.kestrel("silent", options={"no_focal": True}, serial="KX2001", route="isolate"))
    silent = replace(silent, model="Kestrel K2", project="free", name_pattern="KES_{number:04d}.JPG")
    return survey_of(
        "lock-beside-guess",
        (known, fly(known, Plan(50.0, 2, 6, side=0.6), GROUND, seed, RTK)),
        (silent, fly(silent, Plan(50.0, 2, 4, heading_deg=90.0, side=0.6, start_s=39600.0), GROUND, seed)),
    )


def river(seed: int) -> Survey:
    """Two drones on the two banks of a river that neither sees across; each bank has control of its own."""
    west = small(catalogue.phantom4pro(project="rgb", route="pairwise"))
    east = small(catalogue.phantom4(project="rgb", route="pairwise"))
    there = Plan(50.0, 2, 5, (63.0, 0.0), side=0.6, start_s=39600.0, first_number=101)
    survey = survey_of(
        "river",
        (west, fly(west, Plan(50.0, 2, 6, (-63.0, 0.0), side=0.6), HILLS, seed)),
        (east, fly(east, there, HILLS, seed)),
        scenes=(HILLS,),
    )
    banks = (
        *targets(seed, (20.0, 20.0), 6, 2, (-63.0, 0.0), "w"),
        *targets(seed, (20.0, 20.0), 6, 1, (63.0, 0.0), "e"),
    )
    return replace(survey, points=banks)


def two_heights(seed: int) -> Survey:
    """A camera of no sheet: one flight with RTK, a higher one across without, whose altitudes lie 6 m off."""
    camera = small(catalogue.kestrel())
    plain = Receiver(bias_m=(0.9, -0.7, 0.0), altitude_bias_m=6.0)
    across = Plan(75.0, 2, 3, heading_deg=90.0, start_s=43200.0, first_number=101)
    return survey_of(
        "two-heights",
        (camera, fly(camera, Plan(50.0, 2, 5, side=0.6), GROUND, seed, RTK)),
        (camera, fly(camera, across, GROUND, seed, plain)),
    )


def control_forced(seed: int) -> Survey:
    """Two drones with RTK at GSDs of 1 : 1.6 over hills with control: the coarser one's frames are resampled."""
    fine, coarse = small(catalogue.phantom4pro(project="rgb")), small(catalogue.phantom4(project="rgb"))
    across = Plan(82.0, 2, 5, heading_deg=90.0, start_s=39600.0, first_number=101)
    survey = survey_of(
        "control-forced",
        (fine, fly(fine, Plan(60.0, 3, 5), HILLS, seed, RTK)),
        (coarse, fly(coarse, across, HILLS, seed, RTK)),
        scenes=(HILLS,),
    )
    return replace(survey, points=targets(seed, (34.0, 28.0), 6, 3))


STORIES: Dict[str, Callable[[int], Survey]] = {
    "several-guilty": several_guilty,
    "two-in-one": two_in_one,
    "areas-shared": areas_shared,
    "lock-beside-guess": lock_beside_guess,
    "river": river,
    "two-heights": two_heights,
    "control-forced": control_forced,
}
