"""Triangles on texels, against every texel of the page asked in turn."""

import time

import numpy as np
import pytest

from workbench.kernels import patch_drawing
from workbench.kernels.patch_drawing import (
    BESIDE,
    COVERED,
    EMPTY,
    SUBTEXELS,
    draw_patches,
    overlapping,
)

NO_PICTURE = np.zeros((0, 0, 4), np.uint8)


def drawn(corners: np.ndarray, side: int) -> np.ndarray:
    """The states (side, side) of the page that triangles (m, 3, 2) are drawn on."""
    page, state = np.zeros((side, side, 3), np.uint8), np.zeros((side, side), np.uint8)
    rect = np.array([[0, 0, side, side]], np.int32)
    draw_patches(
        page, state, np.array([0]), np.array([0, len(corners)]), corners, rect,
        np.zeros((1, 2), np.int32), np.full((len(corners), 3, 3), 9.0, np.float32), NO_PICTURE,
    )  # fmt: skip
    assert (page[state != EMPTY] == 9).all()
    return state


def asked(corners: np.ndarray, side: int) -> np.ndarray:
    """The same, by asking every texel."""
    state = np.full((side, side), EMPTY, np.uint8)
    x, y = np.empty(3, np.int64), np.empty(3, np.int64)
    for within, kind in ((patch_drawing._owns, COVERED), (patch_drawing._touches, BESIDE)):
        for triangle in corners:
            patch_drawing._turned(triangle, x, y)
            for row, column in np.argwhere(state == EMPTY):
                at = np.array([column, row]) * SUBTEXELS + SUBTEXELS // 2
                if within(x, y, *at):
                    state[row, column] = kind
    return state


@pytest.mark.parametrize("seed", range(12))
def test_no_texel_is_missed(seed: int):
    rng = np.random.default_rng(seed)
    side = 24
    corners = rng.integers(2 * SUBTEXELS, (side - 2) * SUBTEXELS, (3, 3, 2)).astype(np.int32)
    # One thin, one on the grid, with edges along rows and columns.
    corners[0, 2] = corners[0, 1] + rng.integers(-90, 90, 2)
    corners[1] = corners[1] // SUBTEXELS * SUBTEXELS + SUBTEXELS // 2 * (seed % 2)
    corners[1, 1, seed // 2 % 2] = corners[1, 0, seed // 2 % 2]
    assert np.array_equal(drawn(corners, side), asked(corners, side))


def test_long_thin_triangles_cost_what_they_cover():
    """As those seen from the side, of which the rectangle around them is the whole picture."""
    side = 2000
    ends = np.array([[[10, 10], [side - 10, side - 12], [side - 10, side - 10]]], np.int32)
    thin = ends * SUBTEXELS
    rect = np.array([[0, 0, side, side]], np.int32)
    assert not overlapping(thin, np.array([0, 1]), rect).any()
    drawn(thin, side)
    start = time.process_time()
    state = drawn(np.repeat(thin, 100, axis=0), side)
    taken = time.process_time() - start
    assert 1000 < (state == COVERED).sum() < 5000
    start = time.process_time()
    drawn(thin, side)
    once = time.process_time() - start
    # The pages themselves cost most: a hundred more triangles cost less than a hundred pages.
    assert taken < 20.0 * max(once, 0.01)
