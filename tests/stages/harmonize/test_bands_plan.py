"""From control points to a rig's plan, without any pixel: which bin proves, borrows, refuses, and whom it names."""

from __future__ import annotations

from typing import Dict, List, Optional

import numpy as np
from sensorgate.stages.finding import WARNING
from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize.bands import _fit_rig, _rig_plan, _settled
from sensorgate.stages.harmonize.bands_findings import rig_findings
from sensorgate.stages.harmonize.bands_group import Rig, find_rig
from sensorgate.stages.harmonize.bands_lens import project, rotation
from sensorgate.stages.harmonize.bands_measure import user_points
from sensorgate.stages.harmonize.bands_model import BandFit, BandPlan
from sensorgate.stages.harmonize.control_points import ControlPair
from sensorgate.stages.thresholds import DEFAULTS

from .test_bands_group import RIG, placed

TURN = rotation((0.4, -0.3, 0.2))


def rig_at(heights: List[Optional[float]]) -> Rig:
    frames = [placed(i, band, h) for i, h in enumerate(heights) for band in ("green", "nir")]
    files = {f.path: Frame(f.path, 1, "TIFF", 1280, 960, bands=(f.band.title(),)) for f in frames}
    rig = find_rig(RIG, frames, files, DEFAULTS)
    assert rig is not None
    return rig


def points(rig: Rig, number: int, *, count: int = 300, noise: float = 0.2, chance: bool = False) -> np.ndarray:
    gen = np.random.default_rng(number)
    at = gen.uniform((20, 20), (1260, 940), (count, 2))
    lens = rig.optics["rig/nir"].lens
    there = lens.to_pixels(project(TURN, rig.primary_lens.to_rays(at))) + gen.normal(0, noise, (count, 2))
    if chance:
        there = at + gen.uniform(-128, 128, (count, 2))
    return np.hstack((at, there))


def fitted(rig: Rig, told: Dict[int, np.ndarray]) -> List[BandFit]:
    nothing = np.empty((0, 4))
    measured = {f"IMG_{i:04d}_nir.tif": {"area": p, "features": nothing} for i, p in told.items()}
    return _fit_rig(rig, measured, {}, DEFAULTS)


def test_each_bin_proves_itself() -> None:
    rig = rig_at([60.0, 61.0, 90.0])
    fits = fitted(rig, {i: points(rig, i) for i in range(3)})
    assert [(f.state, f.source, len(f.pairs)) for f in fits] == [("warp", "area", 2), ("warp", "area", 1)]


def test_an_empty_bin_takes_its_neighbours_where_parallax_allows() -> None:
    rig = rig_at([100.0, 115.0])
    fits = fitted(rig, {0: points(rig, 0)})
    assert [(f.state, f.source) for f in fits] == [("warp", "area"), ("warp", "neighbour")]
    assert fits[1].matrix == fits[0].matrix
    near = rig_at([12.0, 20.0])
    fits = fitted(near, {0: points(near, 0)})
    assert [f.state for f in fits] == ["warp", "refused"]


def test_a_bin_that_contradicts_borrows_nothing() -> None:
    rig = rig_at([100.0, 115.0])
    fits = fitted(rig, {0: points(rig, 0), 1: points(rig, 1, count=60, chance=True)})
    assert [f.state for f in fits] == ["warp", "refused"]


def test_one_refused_bin_refuses_the_band_and_says_why_once() -> None:
    rig = rig_at([30.0, 100.0])
    fits = fitted(rig, {0: points(rig, 0, noise=1.8), 1: points(rig, 1)})
    plan = _rig_plan(rig, fits, {}, DEFAULTS)
    fits = _settled(fits, plan)
    assert plan.refused == ("rig/nir",) and not plan.aligned and not plan.skip_band_alignment
    assert {f.state for f in fits} == {"refused"}
    assert BandPlan((plan,), tuple(fits)).warped() == ()
    (finding,) = rig_findings(plan, fits, {}, DEFAULTS)
    assert finding.code == "band-refused" and finding.severity == WARNING
    assert "lie off by" in finding.message and finding.measured is not None and finding.measured > 1.0


def test_unknown_heights_never_borrow() -> None:
    rig = rig_at([None, 100.0])
    fits = fitted(rig, {1: points(rig, 1)})
    assert sorted((f.low_m is None, f.state) for f in fits) == [(False, "warp"), (True, "refused")]


def test_names_of_control_points_in_either_order() -> None:
    rig = rig_at([50.0])
    pair = ControlPair("IMG_0000_nir.tif", "IMG_0000_green.tif", ((1.0, 2.0, 3.0, 4.0),))
    found, unused = user_points([rig], [pair, ControlPair("green", "NIR", ((5.0, 6.0, 7.0, 8.0),))])
    assert found[("rig", "rig/nir")].tolist() == [[3.0, 4.0, 1.0, 2.0], [5.0, 6.0, 7.0, 8.0]] and not unused
    _, unused = user_points([rig], [ControlPair("IMG_0000_nir.tif", "IMG_0001_green.tif", pair.points)])
    assert unused == ("IMG_0000_nir.tif / IMG_0001_green.tif",)
