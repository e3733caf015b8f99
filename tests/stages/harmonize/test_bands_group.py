"""Captures of a rig, height bins and samples: nothing lost, nothing in two, bounded."""

from __future__ import annotations

from typing import List, Optional

from hypothesis import given
from hypothesis import strategies as st
from sensorgate.stages.frame import Frame
from sensorgate.stages.harmonize.bands_group import RigCapture, height_bins, rig_captures, sample
from sensorgate.stages.intrinsics import Intrinsics
from sensorgate.stages.profile import Payload, SurveyFrame
from sensorgate.stages.thresholds import DEFAULTS

RIG = Payload("rig", "multispectral", ("rig/green", "rig/nir"), "rig/green", ("green", "nir"))


def placed(number: int, band: str, height: Optional[float] = None, **more: object) -> SurveyFrame:
    values = {
        "path": f"IMG_{number:04d}_{band}.tif",
        "profile": f"rig/{band}",
        "flight": f"rig/{band}|1",
        "payload": "rig",
        "capture": f"c{number}",
        "spectrum": "multispectral",
        "band": band,
        "spectrum_evidence": "band",
        "role": "survey",
        "intrinsics": Intrinsics(),
        "height_m": height,
        **more,
    }
    return SurveyFrame(**values)  # type: ignore[arg-type]


def captures(heights: List[Optional[float]]) -> List[RigCapture]:
    return [
        RigCapture(f"c{i}", placed(i, "green", h), (("rig/nir", placed(i, "nir", h)),)) for i, h in enumerate(heights)
    ]


@given(st.lists(st.one_of(st.none(), st.floats(5.0, 400.0)), min_size=1, max_size=60))
def test_bins_hold_every_capture_once_within_ten_percent(heights: List[Optional[float]]) -> None:
    bins = height_bins(captures(heights), DEFAULTS)
    inside = sorted(c.capture for b in bins for c in b.captures)
    assert inside == sorted(f"c{i}" for i in range(len(heights)))
    for item in bins:
        known = [c.primary.height_m for c in item.captures if c.primary.height_m]
        if item.low_m is None:
            assert not known
        else:
            assert len(known) == len(item.captures)
            assert max(known) <= min(known) * 1.1 + 1e-9
            assert (item.low_m, item.high_m) == (min(known), max(known))


@given(st.integers(1, 300), st.integers(1, 40))
def test_sample_is_bounded_and_in_order(total: int, count: int) -> None:
    everything = captures([50.0] * total)
    chosen = sample(everything, count)
    assert len(chosen) == min(total, count)
    places = [everything.index(c) for c in chosen]
    assert places == sorted(set(places))


def test_unknown_heights_stay_apart_by_flight() -> None:
    items = captures([None, None])
    other = placed(7, "green", None, flight="rig/green|2")
    items.append(RigCapture("c7", other, (("rig/nir", placed(7, "nir")),)))
    assert [len(b.captures) for b in height_bins(items, DEFAULTS)] == [2, 1]


def test_only_survey_frames_with_a_primary_count() -> None:
    frames = [
        placed(1, "green"),
        placed(1, "nir"),
        placed(2, "nir"),
        placed(3, "green", role="panel"),
        placed(3, "nir", role="panel"),
        placed(4, "green"),
        placed(5, "green"),
        placed(5, "nir", excluded="duplicate-file"),
    ]
    files = {f.path: Frame(f.path, 1, "TIFF", 64, 48) for f in frames}
    assert [c.capture for c in rig_captures(RIG, frames, files)] == ["c1"]
    assert rig_captures(RIG, list(reversed(frames)), files) == rig_captures(RIG, frames, files)
