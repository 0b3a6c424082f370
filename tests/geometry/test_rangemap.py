from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry.rangemap import RangeMap


def small_map(offset: float = 0.0) -> RangeMap:
    grid = np.array([[0, 1, -1], [2, -1, 3], [-1, 4, 5]], np.int32)
    points = offset + np.arange(18, dtype=float).reshape(6, 3)
    return RangeMap(
        "a",
        points,
        grid,
        np.zeros(3),
        np.arange(6, dtype=np.float32),
        np.arange(18, dtype=np.uint8).reshape(6, 3),
        np.eye(4),
    )


@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_a_subset_has_the_same_sample_in_every_cell(offset: float) -> None:
    whole = small_map(offset)
    keep = np.array([True, False, True, True, False, True])
    part = whole.subset(keep)
    assert len(part) == 4
    for cell in np.ndindex(3, 3):
        before, after = whole.grid[cell], part.grid[cell]
        if before < 0 or not keep[before]:
            assert after == -1
        else:
            assert np.array_equal(part.points_in_scan[after], whole.points_in_scan[before])
            assert part.reflectance[after] == whole.reflectance[before]
            assert np.array_equal(part.color[after], whole.color[before])
    assert part.grid.dtype == np.int32
    assert np.array_equal(part.world_from_scan, whole.world_from_scan)


def test_a_subset_of_nothing_and_of_everything() -> None:
    whole = small_map()
    none = whole.subset(np.zeros(6, bool))
    assert len(none) == 0
    assert (none.grid == -1).all()
    assert np.array_equal(whole.subset(np.ones(6, bool)).grid, whole.grid)


def test_a_cloud_without_order_stays_one() -> None:
    cloud = RangeMap("a", np.zeros((3, 3)))
    assert cloud.subset(np.array([True, False, True])).grid is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"points_in_scan": np.zeros((6, 2))},
        {"points_in_scan": np.zeros((6, 3), np.float32)},
        {"grid": np.array([[6]], np.int32)},
        {"reflectance": np.zeros(5, np.float32)},
        {"color": np.zeros((6, 4), np.uint8)},
    ],
)
def test_arrays_that_do_not_fit_are_refused(wrong: dict[str, np.ndarray]) -> None:
    with pytest.raises(ValueError, match=r"^a: "):
        RangeMap("a", **{"points_in_scan": np.zeros((6, 3)), **wrong})
