from __future__ import annotations

import doctest
import json
import math

import numpy as np
import pytest

import workbench.metrics
from workbench.metrics import Metric


def test_doctests_hold():
    assert doctest.testmod(workbench.metrics).failed == 0


@pytest.mark.parametrize(
    ("comparison", "passes"),
    [("<=", True), (">=", True), ("==", True), ("<", False), (">", False)],
)
def test_bounds_at_equality(comparison, passes):
    assert Metric("m", 2.0, "", "d", bound=(comparison, 2.0)).passed is passes


def test_no_bound_is_neither_passed_nor_missed():
    assert Metric("m", 2.0, "", "d").passed is None


def test_nan_keeps_no_bound_and_is_null_in_json():
    metric = Metric("m", math.nan, "m", "d", bound=("<=", 1.0))
    assert metric.passed is False
    assert metric.as_dict()["value"] is None
    assert math.isnan(Metric.from_dict(metric.as_dict()).value)


@pytest.mark.parametrize("value", [np.float32(0.5), np.int64(3), np.bool_(True), 0.1, 7, False])
def test_a_metric_survives_json(value):
    metric = Metric("m", value, "m", "d", bound=(">", 0.05))
    plain = json.loads(json.dumps(metric.as_dict()))
    assert Metric.from_dict(plain) == metric
    assert type(plain["value"]) in (bool, int, float)


def test_unknown_comparison_is_refused():
    with pytest.raises(ValueError, match="unknown comparison"):
        Metric("m", 1.0, "", "d", bound=("≤", 1.0))
