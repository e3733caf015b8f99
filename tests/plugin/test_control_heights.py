"""Altitudes from two zeros in one project: the fewer keep their place in plan and lose their say in height."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sensorgate.plugin.control import Control
from sensorgate.plugin.odm.geo import read_geo
from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize.model import untouched
from sensorgate.stages.rules.flights import other_zero
from sensorgate.stages.survey import Survey
from sensorgate.stages.thresholds import DEFAULTS

PLAIN = Frame("a.jpg", 1, "jpeg", 4000, 3000, latitude=46.8, longitude=-91.9, altitude_m=300.0)


def frames(fewer: str, more: str, count: int = 5):
    kinds = [fewer if i < 2 else more for i in range(count)]
    return [replace(PLAIN, path=f"{i}.jpg", altitude_type=k, latitude=46.8 + i * 1e-4) for i, k in enumerate(kinds)]


def geo_of(files):
    survey = Survey(tuple(files), (), (), (), ())
    copies = untouched(files)
    paths = [f.path for f in files]
    told = Control(frames=tuple(files)).for_project("p", paths, copies, survey, DEFAULTS, set(paths)).geo_text
    return {} if told is None else {line.image: line.accuracies for line in read_geo(told).lines}


@pytest.mark.parametrize(("fewer", "more"), [("RtkAlt", "GpsFusionAlt"), ("Gps Fusion Alt", "Rtk Alt")])
def test_the_fewer_heights_are_hardly_believed(fewer, more):
    found = geo_of(frames(fewer, more))
    assert {name: float(up) for name, (_, up) in found.items()} == {
        f"{i}.jpg": DEFAULTS.altitude_zero_sigma_m if i < 2 else DEFAULTS.gps_sigma_vertical_m for i in range(5)
    }
    assert {float(flat) for flat, _ in found.values()} == {DEFAULTS.gps_sigma_horizontal_m}


@pytest.mark.parametrize("kinds", [("RtkAlt", "RtkAlt"), ("", ""), ("RtkAlt", ""), ("unheard of", "GpsFusionAlt")])
def test_one_zero_needs_no_file(kinds):
    assert geo_of(frames(*kinds)) == {} and other_zero(frames(*kinds)) == ()


def test_of_as_many_those_above_the_ellipsoid_are_believed():
    assert other_zero(frames("RtkAlt", "GpsFusionAlt", 4)) == ("2.jpg", "3.jpg")
