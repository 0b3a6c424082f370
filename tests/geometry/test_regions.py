from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.errors import SettingsError
from workbench.geometry.regions import EVERYWHERE, Box, Frustum, Region, Sphere
from workbench.geometry.transforms import from_twist


def regions(rng: np.random.Generator, offset: np.ndarray) -> list[Region]:
    a, b = rng.normal(size=(2, 3)) + offset
    pose = from_twist(np.r_[rng.normal(size=3), rng.normal(size=3) + offset])
    near = rng.choice([0.0, 0.3])
    return [
        Box(np.minimum(a, b), np.maximum(a, b)),
        Sphere(a, abs(rng.normal())),
        Frustum(pose, *rng.uniform(0.1, 2, 2), near, near + rng.uniform(0.1, 3)),
        EVERYWHERE,
    ]


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 5.2e6]))
@settings(max_examples=100, deadline=None)
def test_boxes_are_judged_as_their_points_are(seed: int, offset: float):
    rng = np.random.default_rng(seed)
    shift = np.array([0.1, 1.0, 0.0]) * offset
    ends = rng.normal(size=(2, 60, 3)) * rng.choice([0.05, 0.5, 2.0], (60, 1)) + shift
    low, high = ends.min(axis=0), ends.max(axis=0)
    for region in regions(rng, shift):
        meets, covers = region.meets(low, high), region.covers(low, high)
        assert not (covers & ~meets).any()
        for k in range(60):
            t = rng.integers(0, 2, (40, 3)) if k % 2 else rng.random((40, 3))
            inside = region.contains(np.clip(low[k] + t * (high[k] - low[k]), low[k], high[k]))
            assert meets[k] or not inside.any()
            assert not covers[k] or inside.all()


def test_far_boxes_are_dropped_and_inner_ones_covered():
    low, high = (
        np.array([[9.0, 9, 9], [-0.01, -0.01, 0.99]]),
        np.array([[10.0, 10, 10], [0.01] * 3]),
    )
    high[1, 2] = 1.01
    pose = np.eye(4)
    for region in (
        Box([-1, -1, 0], [1, 1, 2]),
        Sphere([0, 0, 1], 0.5),
        Frustum(pose, 0.5, 0.5, 0.1, 3.0),
    ):
        assert region.meets(low, high).tolist() == [False, True]
        assert region.covers(low, high).tolist() == [False, True]


def test_a_frustum_sees_what_its_camera_projects():
    rng = np.random.default_rng(0)
    pose = from_twist([0.2, -0.4, 1.0, 3.0, 2.0, 1.0])
    frustum = Frustum(pose, 0.7, 0.4, 0.5, 4.0)
    points = rng.normal(size=(5000, 3)) * 3 + [3, 2, 1]
    seen = (points - pose[:3, 3]) @ pose[:3, :3]
    x, y, z = seen.T
    expected = (z >= 0.5) & (z <= 4) & (np.abs(x / z) <= 0.7) & (np.abs(y / z) <= 0.4)
    assert expected.sum() > 50
    assert np.array_equal(frustum.contains(points), expected)


def test_shifted_regions_hold_shifted_points():
    rng = np.random.default_rng(2)
    points, offset = rng.integers(-8, 9, (500, 3)) / 4.0, np.array([1.0, -2.0, 4.0])
    for region in regions(rng, np.zeros(3))[:3]:
        moved = region.shifted(offset)
        assert np.allclose(moved.center, region.center + offset)
        assert np.array_equal(moved.contains(points + offset), region.contains(points))


@pytest.mark.parametrize(
    "make",
    [
        lambda: Box([0, 0, 1], [1, 1, 0]),
        lambda: Box([0, 0], [1, 1]),
        lambda: Box([0, np.nan, 0], [1, 1, 1]),
        lambda: Sphere([0, 0, 0], -1.0),
        lambda: Sphere([0, 0, 0], np.nan),
        lambda: Sphere([0, np.inf, 0], 1.0),
        lambda: Frustum(np.eye(4), 0.0, 1.0, 0.1, 1.0),
        lambda: Frustum(np.eye(4), 1.0, 1.0, 1.0, 1.0),
        lambda: Frustum(np.eye(3), 1.0, 1.0, 0.1, 1.0),
    ],
)
def test_regions_without_space_are_refused(make):
    with pytest.raises(SettingsError) as caught:
        make()
    assert caught.value.expected
