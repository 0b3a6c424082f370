"""Thinning an oriented scan: fewer samples that speak for the same surface."""

import numpy as np
import pytest

from workbench.geometry.orientedscan import OrientationSettings, orient
from workbench.geometry.rangemap import RangeMap


@pytest.fixture(scope="module")
def wall():
    y, x = np.mgrid[0:80, 0:100] * 0.01
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    grid = np.arange(x.size, dtype=np.int32).reshape(x.shape)
    scan = RangeMap("wall", points, grid, np.array([0.5, 0.4, 2.0]))
    return orient(scan, OrientationSettings())


def test_a_quarter_of_the_samples_lie_twice_as_far_apart_and_cover_the_same(wall):
    few = wall.thinned(len(wall) // 4)
    assert len(few) == len(wall) // 4
    assert np.median(few.spacing_m) == pytest.approx(2 * np.median(wall.spacing_m), rel=1e-3)
    area = float(np.sum(wall.spacing_m * wall.reach_m))
    assert float(np.sum(few.spacing_m * few.reach_m)) == pytest.approx(area, rel=0.02)
    # Evenly: each quarter of the wall keeps a quarter of them.
    left, low = few.points[:, 0] < 0.495, few.points[:, 1] < 0.395
    for quarter in (left & low, left & ~low, ~left & low, ~left & ~low):
        assert quarter.sum() == pytest.approx(len(few) / 4, rel=0.1)


def test_thinning_is_the_same_each_time_and_leaves_small_scans_alone(wall):
    assert np.array_equal(wall.thinned(500).source, wall.thinned(500).source)
    assert (np.diff(wall.thinned(500).source) > 0).all()
    assert wall.thinned(len(wall)) is wall
