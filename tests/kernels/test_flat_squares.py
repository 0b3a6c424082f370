"""Squares of a depth map that are merged where it is flat: no crack, no hole, nothing far off."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from workbench.kernels.flat_squares import merged_squares

LEVELS = 3


def merged(
    nearness: np.ndarray, free: np.ndarray | None = None, most: float = 1e-3
) -> tuple[np.ndarray, np.ndarray]:
    if free is None:
        free = np.ones((nearness.shape[0] - 1, nearness.shape[1] - 1), bool)
    return merged_squares(nearness, free, LEVELS, most)


def all_triangles(whole: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """The merged triangles and two of each whole square, rows of pixels numbered row by row."""
    width = whole.shape[1] + 1
    row, column = np.nonzero(whole)
    ul = row * width + column
    lower = np.stack([ul, ul + width, ul + width + 1], axis=1)
    upper = np.stack([ul, ul + width + 1, ul + 1], axis=1)
    return np.concatenate([lower, upper, corners])


def signed_areas(triangles: np.ndarray, width: int) -> np.ndarray:
    """Twice the areas in pixels, positive where counter-clockwise in the picture."""
    y, x = np.divmod(triangles, width)
    along, across = (x[:, 1] - x[:, 0], y[:, 1] - y[:, 0]), (x[:, 2] - x[:, 0], y[:, 2] - y[:, 0])
    return along[1] * across[0] - along[0] * across[1]


def assert_without_cracks(triangles: np.ndarray, shape: tuple[int, int]) -> None:
    """Edges that one triangle has lie on the picture's border; all others are of two."""
    h, w = shape
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    count = Counter(map(tuple, edges.tolist()))
    assert max(count.values()) == 1
    for one, other in count:
        if (other, one) not in count:
            (r, c), (s, d) = divmod(one, w), divmod(other, w)
            assert (r == s and r in (0, h - 1)) or (c == d and c in (0, w - 1)), (one, other)


def surface(kind: str, shape: tuple[int, int]) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    if kind == "plane":
        return np.asarray(1.0 + 0.002 * x - 0.001 * y)
    if kind == "hills":
        return np.asarray(2.0 + 0.04 * np.sin(x / 9.0) * np.cos(y / 11.0))
    return np.asarray(1.0 + 0.01 * np.random.default_rng(4).normal(size=shape))


@pytest.mark.parametrize("shape", [(9, 9), (17, 33), (20, 31), (2, 2), (5, 40)])
@pytest.mark.parametrize("kind", ["plane", "hills", "rough"])
def test_triangles_cover_the_picture_once_and_leave_no_crack(shape, kind: str):
    triangles = all_triangles(*merged(surface(kind, shape)))
    areas = signed_areas(triangles, shape[1])
    assert (areas > 0).all()
    assert areas.sum() == 2 * (shape[0] - 1) * (shape[1] - 1)
    assert_without_cracks(triangles, shape)


def test_a_plane_takes_two_triangles_a_square_of_eight():
    whole, corners = merged(surface("plane", (33, 65)))
    assert not whole.any()
    assert len(corners) == 2 * 4 * 8
    whole, corners = merged(surface("rough", (33, 65)), most=1e-6)
    assert whole.all()
    assert len(corners) == 0


def test_no_place_is_moved_by_much_more_than_allowed():
    shape, most = (65, 65), 2e-4
    nearness = surface("hills", shape)
    whole, corners = merged(nearness, most=most)
    assert len(corners) + 2 * whole.sum() < 0.3 * 2 * 64 * 64
    flat = nearness.ravel()
    y, x = np.mgrid[:65, :65]
    worst = 0.0
    for triangle in corners:
        (ty, tx) = np.divmod(triangle, 65)
        matrix = np.stack([tx, ty, np.ones(3)])
        share = np.linalg.solve(matrix, np.stack([x.ravel(), y.ravel(), np.ones(x.size)]))
        inside = (share > -1e-9).all(axis=0)
        told = flat[triangle] @ share[:, inside]
        worst = max(worst, float((np.abs(told - flat[inside]) / flat[inside]).max()))
    # Each halving may add what it is allowed: a bowl adds a half, a quarter, ... of it.
    assert most / 3 < worst < 2 * most


def test_squares_that_are_not_free_stay_as_they_are():
    shape = (40, 40)
    free = np.ones((39, 39), bool)
    free[11:14, 7] = free[30, 20:39] = False
    whole, corners = merged(surface("plane", shape), free)
    assert whole[~free].all()
    assert_without_cracks(all_triangles(whole, corners), shape)
    assert len(corners) + 2 * whole.sum() < 0.4 * 2 * 39 * 39


def test_where_nothing_is_seen_nothing_is_merged():
    nearness = surface("plane", (17, 17))
    nearness[8, 8] = 0.0
    whole, corners = merged(nearness)
    assert 8 * 17 + 8 not in corners
    assert whole[7:9, 7:9].all()
