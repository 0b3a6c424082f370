"""The place that lines pass by."""

import numpy as np

from workbench.geometry.lines import place_nearest_to

PLACE = np.array([4.0e6, 5.0e6, 300.0])


def test_lines_through_a_place_meet_there():
    ways = np.random.default_rng(2).normal(size=(5, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    found = place_nearest_to([(PLACE + 7.0 * k * way, way) for k, way in enumerate(ways)], 1e8)
    np.testing.assert_allclose(found, PLACE, atol=1e-7)


def test_between_two_that_miss_each_other_is_the_middle():
    x, y = np.eye(3)[:2]
    found = place_nearest_to([(np.array([5.0, 0.0, 1.0]), x), (np.array([0.0, 9.0, -1.0]), y)], 1e8)
    np.testing.assert_allclose(found, np.zeros(3), atol=1e-12)


def test_parallel_ones_a_single_one_and_none_tell_nothing():
    x = np.eye(3)[0]
    lines = [(np.zeros(3), x), (np.array([0.0, 1.0, 0.0]), x)]
    for count in range(3):
        assert place_nearest_to(lines[:count], 1e8) is None
    nearly = np.array([1.0, 1e-3, 0.0]) / np.hypot(1.0, 1e-3)
    assert place_nearest_to([lines[0], (lines[1][0], nearly)], 1e4) is None
    assert place_nearest_to([lines[0], (lines[1][0], nearly)], 1e8) is not None
