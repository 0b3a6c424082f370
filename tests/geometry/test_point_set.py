"""Points with attributes."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry.point_set import PointSet, joined


def some(n: int, **attributes: np.ndarray) -> PointSet:
    return PointSet(np.arange(3.0 * n).reshape(n, 3), **attributes)


def test_what_is_chosen_keeps_its_attributes() -> None:
    color = np.arange(12, dtype=np.uint8).reshape(4, 3)
    points = some(4, color=color, radius=np.arange(4, dtype=np.float32))
    for which in (np.array([2, 0]), np.array([True, False, True, False]), slice(1, 3)):
        few = points.chosen(which)
        np.testing.assert_array_equal(few.points, points.points[which])
        np.testing.assert_array_equal(few.color, color[which])
        np.testing.assert_array_equal(few.radius, np.arange(4)[which])
        assert few.normals is None
    low, high = points.bounds
    assert (low == [0, 1, 2]).all()
    assert (high == [9, 10, 11]).all()


def test_parts_are_joined_by_what_all_have() -> None:
    color = np.full((2, 3), 7, np.uint8)
    both = joined([some(2, color=color), some(2, color=color, radius=np.ones(2, np.float32))])
    assert len(both) == 4
    assert both.radius is None
    np.testing.assert_array_equal(both.color, np.full((4, 3), 7))
    assert joined([some(2, color=color), some(1)]).color is None
    with pytest.raises(ValueError, match="no points"):
        joined([])


@pytest.mark.parametrize(
    "wrong",
    [
        {"color": np.zeros((3, 3), np.uint8)},
        {"color": np.zeros((2, 3))},
        {"normals": np.zeros((2, 3))},
        {"radius": np.zeros((2, 1), np.float32)},
    ],
)
def test_wrong_shapes_and_types_are_refused(wrong: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        some(2, **wrong)
    with pytest.raises(ValueError, match="points"):
        PointSet(np.zeros((2, 3), np.float32))
