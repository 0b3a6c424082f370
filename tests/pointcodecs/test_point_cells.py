"""Points as cells: where they go, what becomes of several in one cell, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.errors import InputError, SettingsError
from workbench.geometry.point_set import PointSet
from workbench.pointcodecs.point_cells import (
    CellFrame,
    cells_of_points,
    frame_of_cell_size,
    frame_of_resolution,
)

UNIT = CellFrame(np.zeros(3), 1.0, 3)


def test_points_of_one_cell_become_one():
    points = np.array([[2.1, 0.5, 7.9], [0.2, 0.2, 0.2], [2.9, 0.1, 7.1], [0.7, 0.9, 0.1]])
    normals = np.array([[1, 0, 0], [0, 0, 1], [0, 1, 0], [0, 0, -1]], np.float32)
    color = np.array([[0, 10, 255], [9, 9, 9], [255, 10, 255], [9, 9, 9]], np.uint8)

    cells = cells_of_points(PointSet(points, normals, color), UNIT)

    assert cells.merged == 2
    np.testing.assert_array_equal(cells.cells, [[0, 0, 0], [2, 0, 7]])
    # Half the light of white is the byte 188; normals that cancel are none.
    np.testing.assert_array_equal(cells.color, [[9, 9, 9], [188, 10, 255]])
    np.testing.assert_allclose(cells.normals, [[0, 0, 0], [0.5**0.5, 0.5**0.5, 0]], atol=1e-7)
    back = cells.point_set()
    np.testing.assert_array_equal(back.points, [[0.5, 0.5, 0.5], [2.5, 0.5, 7.5]])
    assert back.radius == pytest.approx(3**0.5 / 2)


def test_normals_that_are_not_finite_count_for_nothing():
    points = np.array([[0.5, 0.5, 0.5], [0.6, 0.5, 0.5], [3.5, 0.5, 0.5]])
    normals = np.array([[np.nan, 0, 0], [0, 2, 0], [np.inf, 0, 0]], np.float32)

    cells = cells_of_points(PointSet(points, normals), UNIT)

    np.testing.assert_array_equal(cells.normals, [[0, 1, 0], [0, 0, 0]])
    assert cells.color is None


@pytest.mark.parametrize("resolution", [2, 100, 1024, 1 << 21])
def test_no_point_moves_by_more_than_half_a_diagonal(resolution):
    rng = np.random.default_rng(resolution)
    # Eastings and northings: a float32 would be off by half a metre.
    points = np.array([482_000.0, 5_412_000.0, 300.0]) + rng.uniform(0, [30, 7, 11], (2000, 3))
    frame = frame_of_resolution(points, resolution)

    cells = cells_of_points(PointSet(points), frame)

    assert cells.cells.max() == resolution - 1
    assert len(cells) + cells.merged == 2000
    half = 0.5 * 3**0.5 * frame.cell_size
    # Rounding of coordinates of this size, beside it.
    inside = np.floor((points - frame.origin) / frame.cell_size).astype(int)
    moved = np.linalg.norm(frame.centers(inside) - points, axis=1)
    assert moved.max() < half + 4e-9
    assert frame.cell_size == pytest.approx(np.ptp(points, axis=0).max() / resolution, rel=2e-6)
    assert {tuple(c) for c in cells.cells.tolist()} == {tuple(c) for c in inside.tolist()}


def test_cells_of_a_size_hold_all_points():
    points = np.random.default_rng(1).uniform(-3, 5, (1000, 3))
    frame = frame_of_cell_size(points, 0.25)

    cells = cells_of_points(PointSet(points), frame)

    assert frame.cell_size == 0.25
    assert 1 << (frame.level - 1) < 33 <= cells.cells.max() + 2 <= 1 << frame.level
    alone = cells_of_points(PointSet(points[:1]), frame_of_cell_size(points[:1], 0.25))
    np.testing.assert_allclose(alone.point_set().points, points[:1])


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.array([[0, 0, np.nan], [1, 1, 1]]), np.array([[np.inf, 0, 0.0]])],
    ids=["none", "nan", "infinite"],
)
def test_points_without_a_place_are_refused(points):
    with pytest.raises(InputError, match="not finite"):
        frame_of_resolution(points, 64)
    with pytest.raises(InputError, match="not finite"):
        frame_of_cell_size(points, 1.0)
    with pytest.raises(InputError, match="not finite"):
        cells_of_points(PointSet(points), UNIT)


def test_points_in_one_place_need_the_size_of_a_cell():
    with pytest.raises(InputError, match="one place") as caught:
        frame_of_resolution(np.ones((5, 3)), 64)

    assert "size of a cell" in caught.value.fix


def test_points_outside_the_grid_are_counted_and_refused():
    with pytest.raises(InputError, match="outside the grid") as caught:
        cells_of_points(PointSet(np.array([[1, 1, 1], [8.0, 0, 0], [0, -0.1, 0]])), UNIT)

    assert "2 of 3" in caught.value.found


@pytest.mark.parametrize("resolution", [-1, 0, 1, (1 << 21) + 1])
def test_resolutions_out_of_bounds_are_refused(resolution):
    with pytest.raises(SettingsError, match="resolution"):
        frame_of_resolution(np.eye(3), resolution)


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan, np.inf, 1e-9])
def test_cell_sizes_out_of_bounds_are_refused(size):
    with pytest.raises(SettingsError, match="cell"):
        frame_of_cell_size(np.eye(3), size)
