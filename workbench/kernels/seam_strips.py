"""Differences at the seams of patches, faded out over a strip of texels beside them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.patch_drawing import BESIDE, COVERED

_FREE, _HELD = 1, 2


@njit(cache=True, nogil=True)
def _held_colors(
    places: NDArray[np.float64], steps: NDArray[np.float32], width: int, height: int
) -> NDArray[np.float32]:
    """(height, width, 4) mean step at the texels that reading at some places touches; last, 1."""
    held = np.zeros((height, width, 4), np.float32)
    for i in range(len(places)):
        u, v = places[i, 0] - 0.5, places[i, 1] - 0.5
        column, row = math.floor(u), math.floor(v)
        for k in range(4):
            x, y = column + (k & 1), row + (k >> 1)
            weight = (1.0 - abs(u - x)) * (1.0 - abs(v - y))
            if weight <= 0.0 or x < 0 or y < 0 or x >= width or y >= height:
                continue
            for c in range(3):
                held[y, x, c] += np.float32(weight) * steps[i, c]
            held[y, x, 3] += np.float32(weight)
    for y in range(height):
        for x in range(width):
            if held[y, x, 3] > 0.0:
                for c in range(3):
                    held[y, x, c] /= held[y, x, 3]
                held[y, x, 3] = 1.0
    return held


@njit(cache=True, nogil=True)
def _strip(
    state: NDArray[np.uint8], held: NDArray[np.float32], reach: int
) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """What each texel is, and the free ones (k, 2) row and column, in rising order.

    A texel is held at a seam, free within ``reach`` steps of one, and 0 otherwise.
    """
    height, width = state.shape
    kind = np.zeros((height, width), np.uint8)
    queue = np.empty((height * width, 2), np.int32)
    last = 0
    for y in range(height):
        for x in range(width):
            drawn = state[y, x] == COVERED or state[y, x] == BESIDE
            if drawn and held[y, x, 3] > 0.0:
                kind[y, x] = _HELD
                queue[last, 0], queue[last, 1] = y, x
                last += 1
    first = 0
    for _ in range(reach):
        end = last
        while first < end:
            y, x = queue[first]
            first += 1
            for k in range(4):
                v, u = y + (k == 0) - (k == 1), x + (k == 2) - (k == 3)
                if v < 0 or u < 0 or v >= height or u >= width or kind[v, u]:
                    continue
                if state[v, u] == COVERED or state[v, u] == BESIDE:
                    kind[v, u] = _FREE
                    queue[last, 0], queue[last, 1] = v, u
                    last += 1
    free = np.empty((last, 2), np.int32)
    count = 0
    for y in range(height):
        for x in range(width):
            if kind[y, x] == _FREE:
                free[count, 0], free[count, 1] = y, x
                count += 1
    return kind, free[:count]


@njit(cache=True, nogil=True)
def fade_steps(
    page: NDArray[np.uint8],
    state: NDArray[np.uint8],
    corner: tuple[int, int],
    size: tuple[int, int],
    places: NDArray[np.float64],
    steps: NDArray[np.float32],
    reach: int,
    sweeps: int,
) -> None:
    """Move the colours of one patch by ``steps`` at its seams, by nothing ``reach`` texels inside.

    Between, the movement is harmonic; where the patch ends without a seam it does not change
    towards the end. Solved by successive over-relaxation with the factor best for such a strip.

    Parameters
    ----------
    page : (H, W, 3), changed.
    state : (H, W) as drawing left it.
    corner, size : of the patch's rectangle: column and row, width and height.
    places : (n, 2) on the page, along the seams; ``steps`` (n, 3) of 255 are wanted there.
    """
    left, top = corner
    width, height = size
    here = state[top : top + height, left : left + width]
    offset = np.array([left, top], np.float64)
    held = _held_colors(places - offset, steps, width, height)
    kind, free = _strip(here, held, reach)
    # Along a straight strip nothing changes: its slowest wave is half as fast as in one dimension.
    factor = 2.0 / (1.0 + math.sin(math.pi / (math.sqrt(2.0) * (reach + 1))))
    for y in range(height):
        for x in range(width):
            if kind[y, x] != _HELD:
                held[y, x, :] = 0.0
    for _ in range(sweeps):
        for i in range(len(free)):
            y, x = free[i]
            count, red, green, blue = 0, 0.0, 0.0, 0.0
            for k in range(4):
                v, u = y + (k == 0) - (k == 1), x + (k == 2) - (k == 3)
                if v < 0 or u < 0 or v >= height or u >= width:
                    continue
                if here[v, u] == COVERED or here[v, u] == BESIDE:
                    count += 1
                    red += held[v, u, 0]
                    green += held[v, u, 1]
                    blue += held[v, u, 2]
            held[y, x, 0] += np.float32(factor * (red / count - held[y, x, 0]))
            held[y, x, 1] += np.float32(factor * (green / count - held[y, x, 1]))
            held[y, x, 2] += np.float32(factor * (blue / count - held[y, x, 2]))
    for y in range(height):
        for x in range(width):
            if kind[y, x]:
                for c in range(3):
                    value = float(page[top + y, left + x, c]) + held[y, x, c]
                    page[top + y, left + x, c] = int(min(max(value, 0.0), 255.0) + 0.5)


@njit(cache=True, nogil=True)
def fill_empty(page: NDArray[np.uint8], state: NDArray[np.uint8], side: int) -> None:
    """Give texels that nothing was drawn on the mean of what was, by squares of ``side``.

    Squares with nothing get the mean of the page. Coarse mip levels and JPEG's blocks then mix
    patches with colours like theirs. ``page`` (H, W, 3) is changed.
    """
    height, width = state.shape
    everywhere, total = np.zeros(3), 0
    for turn in range(2):
        for top in range(0, height, side):
            for left in range(0, width, side):
                bottom, right = min(top + side, height), min(left + side, width)
                mean, count = np.zeros(3), 0
                for y in range(top, bottom):
                    for x in range(left, right):
                        if state[y, x]:
                            count += 1
                            for c in range(3):
                                mean[c] += page[y, x, c]
                if turn == 0:
                    everywhere += mean
                    total += count
                    continue
                if count == (bottom - top) * (right - left):
                    continue
                color = mean / count if count else everywhere / max(total, 1)
                for y in range(top, bottom):
                    for x in range(left, right):
                        if not state[y, x]:
                            for c in range(3):
                                page[y, x, c] = int(color[c] + 0.5)
