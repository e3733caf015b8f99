"""Thresholds: set by name, refused where a value could decide nothing."""

from __future__ import annotations

import dataclasses

import pytest
from sensorgate.stages.errors import UsageError
from sensorgate.stages.thresholds import DEFAULTS, Thresholds


def test_every_threshold_has_a_unit_and_a_reason():
    for name, told in Thresholds.describe().items():
        assert told["unit"].strip() and len(told["why"]) > 15, name


def test_a_value_is_taken_in_the_kind_of_its_default():
    changed = DEFAULTS.replaced({"min_inliers": 40.0, "focal_variance": 1})
    assert changed.min_inliers == 40 and isinstance(changed.min_inliers, int)
    assert changed.focal_variance == 1.0 and isinstance(changed.focal_variance, float)
    assert DEFAULTS.replaced({}) == DEFAULTS


@pytest.mark.parametrize("value", [True, None, "1", [1], float("nan"), float("inf"), -float("inf"), 10**400])
def test_what_is_no_number_is_refused(value):
    with pytest.raises(UsageError, match="finite number"):
        DEFAULTS.replaced({"focal_variance": value})


def test_half_an_inlier_is_refused():
    with pytest.raises(UsageError, match="whole number"):
        DEFAULTS.replaced({"min_inliers": 30.5})


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(UsageError, match="focal_variance"):
        DEFAULTS.replaced({"focal_varience": 0.03})
    assert len({f.name for f in dataclasses.fields(Thresholds)}) == len(Thresholds.describe())
