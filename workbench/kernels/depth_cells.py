"""Squares between four pixels of a depth map, each split into triangles where the surface goes on.

A pixel's nearness is 1 / depth, 0 where nothing is seen: on a plane it is linear over a pinhole's
picture. A square's code says which of its diagonals splits it and which triangles there are.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

# The diagonal runs from the upper right to the lower left, not from the upper left to the lower
# right; the triangle above it is there; the one below it is; no two of the corners that are seen
# have a step between them.
OTHER_DIAGONAL, UPPER, LOWER, NO_STEP = 1, 2, 4, 8

_SLOPE = 0.25


@njit(cache=True, nogil=True)
def _joined(
    before: float, one: float, other: float, after: float, step: float, steep: float
) -> bool:
    """Whether the surface goes on from one pixel to the next, those on either side known."""
    if one <= 0.0 or other <= 0.0:
        return False
    scale = max(one, other)
    change = other - one
    if abs(change) > steep * scale:
        return False
    if abs(change) <= step * scale:
        return True
    if before > 0.0 and abs(change - (one - before)) <= step * scale:
        return True
    return after > 0.0 and abs(change - (after - other)) <= step * scale


@njit(cache=True, nogil=True)
def joints(
    nearness: NDArray[np.float64], step: float, steep: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether the surface goes on to the right (h, w − 1) and down (h − 1, w) of pixels.

    Parameters
    ----------
    nearness : (h, w).
    step : what nearness may change by, from pixel to pixel, beyond what either side foretells;
        share of itself.
    steep : what it may change by at all.
    """
    h, w = nearness.shape
    right, down = np.zeros((h, w - 1), np.bool_), np.zeros((h - 1, w), np.bool_)
    for j in range(h):
        for i in range(w - 1):
            before = nearness[j, i - 1] if i > 0 else 0.0
            after = nearness[j, i + 2] if i + 2 < w else 0.0
            right[j, i] = _joined(before, nearness[j, i], nearness[j, i + 1], after, step, steep)
    for j in range(h - 1):
        for i in range(w):
            before = nearness[j - 1, i] if j > 0 else 0.0
            after = nearness[j + 2, i] if j + 2 < h else 0.0
            down[j, i] = _joined(before, nearness[j, i], nearness[j + 1, i], after, step, steep)
    return right, down


@njit(cache=True, nogil=True)
def depth_cells(
    nearness: NDArray[np.float64], right: NDArray[np.bool_], down: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """(h − 1, w − 1) codes of the squares; the diagonal is that along which depth changes less.

    A triangle is there where its two legs are joints.
    """
    h, w = nearness.shape
    cells = np.zeros((h - 1, w - 1), np.uint8)
    for j in range(h - 1):
        for i in range(w - 1):
            top, bottom, left, side = right[j, i], right[j + 1, i], down[j, i], down[j, i + 1]
            falling = (UPPER if top and side else 0) | (LOWER if left and bottom else 0)
            rising = (UPPER if top and left else 0) | (LOWER if side and bottom else 0)
            a = abs(nearness[j, i] - nearness[j + 1, i + 1])
            b = abs(nearness[j, i + 1] - nearness[j + 1, i])
            prefers_rising = b < a
            if (rising == (UPPER | LOWER)) != (falling == (UPPER | LOWER)):
                prefers_rising = rising == (UPPER | LOWER)
            elif (rising == 0) != (falling == 0):
                prefers_rising = falling == 0
            cells[j, i] = (rising | OTHER_DIAGONAL) if prefers_rising else falling
            ul, ur = nearness[j, i] > 0.0, nearness[j, i + 1] > 0.0
            ll, lr = nearness[j + 1, i] > 0.0, nearness[j + 1, i + 1] > 0.0
            steps = (ul and ur and not top) or (ll and lr and not bottom)
            if not (steps or (ul and ll and not left) or (ur and lr and not side)):
                cells[j, i] |= NO_STEP
    return cells


@njit(cache=True, nogil=True)
def _beyond(
    nearness: NDArray[np.float64],
    right: NDArray[np.bool_],
    down: NDArray[np.bool_],
    x: float,
    y: float,
) -> tuple[float, float]:
    """Nearness at a place, as the nearest of the square's pixels foretells it, and its spread.

    0 where that pixel shows nothing.
    """
    i, j = int(x + 0.5), int(y + 0.5)
    value = nearness[j, i]
    across, along = 0.0, 0.0
    if i < right.shape[1] and right[j, i]:
        across = nearness[j, i + 1] - value
    elif i > 0 and right[j, i - 1]:
        across = value - nearness[j, i - 1]
    if j < down.shape[0] and down[j, i]:
        along = nearness[j + 1, i] - value
    elif j > 0 and down[j - 1, i]:
        along = value - nearness[j - 1, i]
    if value <= 0.0:
        return 0.0, 0.0
    return value + (x - i) * across + (y - j) * along, abs(across) + abs(along)


@njit(cache=True, nogil=True)
def lie_on_cells(
    pixels: NDArray[np.float64],
    depths: NDArray[np.float64],
    nearness: NDArray[np.float64],
    right: NDArray[np.bool_],
    down: NDArray[np.bool_],
    cells: NDArray[np.uint8],
    usable: NDArray[np.bool_],
    near: float,
) -> NDArray[np.bool_]:
    """(n,) whether points at pixels (n, 2) and depths (n,) lie on the triangles of a depth map.

    Where the surface ends before nothing, it goes on to the edge of the last pixel that shows it;
    where it ends at a step, what is behind may be hidden, and the last triangle is the end.

    Parameters
    ----------
    usable : (h, w); a point at another pixel does not.
    near : share of its depth that a point may be away by, further to a quarter of what the
        triangle's own corners differ by.
    """
    h, w = nearness.shape
    lie = np.zeros(len(pixels), np.bool_)
    for k in range(len(pixels)):
        x, y = pixels[k, 0] - 0.5, pixels[k, 1] - 0.5
        if not (depths[k] > 0.0 and x >= 0.0 and y >= 0.0 and x < w - 1 and y < h - 1):
            continue
        i, j = int(x), int(y)
        if not usable[int(pixels[k, 1]), int(pixels[k, 0])]:
            continue
        u, v = x - i, y - j
        code = cells[j, i]
        ul, ur = nearness[j, i], nearness[j, i + 1]
        ll, lr = nearness[j + 1, i], nearness[j + 1, i + 1]
        if code & OTHER_DIAGONAL:
            if u + v <= 1.0:
                there, a, b, c = code & UPPER, ul, ur, ll
                value = ul + u * (ur - ul) + v * (ll - ul)
            else:
                there, a, b, c = code & LOWER, lr, ur, ll
                value = lr + (1.0 - u) * (ll - lr) + (1.0 - v) * (ur - lr)
        elif u >= v:
            there, a, b, c = code & UPPER, ul, ur, lr
            value = ul + u * (ur - ul) + v * (lr - ur)
        else:
            there, a, b, c = code & LOWER, ul, ll, lr
            value = ul + v * (ll - ul) + u * (lr - ll)
        spread = max(a, max(b, c)) - min(a, min(b, c))
        if there == 0:
            if not code & NO_STEP:
                continue
            value, spread = _beyond(nearness, right, down, x, y)
        away = math.fabs(1.0 / depths[k] - value)
        lie[k] = value > 0.0 and away <= near * value + _SLOPE * spread
    return lie
