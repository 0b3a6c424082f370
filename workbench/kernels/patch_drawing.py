"""Triangles on the texels of an atlas: which cover which, and their colours.

Positions are integers, 256 to a texel, so that two triangles beside each other never claim the
same texel and never leave one out: a texel belongs to the triangle its middle lies in, and on a
shared edge to the one to the right of it or below it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

SUBTEXELS = 256
_HALF = 128
EMPTY, COVERED, BESIDE, PADDED = 0, 1, 2, 3


@njit(cache=True, nogil=True)
def _turned(corners: NDArray[np.int32], x: NDArray[np.int64], y: NDArray[np.int64]) -> int:
    """Fill in the corners (3, 2) so that the area is positive; 1 or 2: which came second."""
    for k in range(3):
        x[k], y[k] = corners[k, 0], corners[k, 1]
    if (x[1] - x[0]) * (y[2] - y[0]) < (y[1] - y[0]) * (x[2] - x[0]):
        x[1], x[2] = x[2], x[1]
        y[1], y[2] = y[2], y[1]
        return 2
    return 1


@njit(cache=True, nogil=True)
def _edge(x: NDArray[np.int64], y: NDArray[np.int64], k: int, px: int, py: int) -> int:
    """Twice the area of the triangle between edge k and a point; positive inside."""
    n = (k + 1) % 3
    area: int = (x[n] - x[k]) * (py - y[k]) - (y[n] - y[k]) * (px - x[k])
    return area


@njit(cache=True, nogil=True)
def _owns(x: NDArray[np.int64], y: NDArray[np.int64], px: int, py: int) -> bool:
    """Whether the point is in the triangle, and on an edge only if that is a left or top one."""
    for k in range(3):
        n = (k + 1) % 3
        edge = _edge(x, y, k, px, py)
        if edge < 0:
            return False
        if edge == 0:
            right, down = x[n] - x[k], y[n] - y[k]
            if not (down < 0 or (down == 0 and right > 0)):
                return False
    return True


@njit(cache=True, nogil=True)
def _columns(x: NDArray[np.int64], y: NDArray[np.int64], row: int, beside: int) -> tuple[int, int]:
    """First and last column of a row whose texels may be in a triangle, or ``beside`` it.

    Of a long thin triangle these are few, of the rectangle around it many.
    """
    left, right = float(x.min() - _HALF), float(x.max() + _HALF)
    py = row * SUBTEXELS + _HALF
    for k in range(3):
        n = (k + 1) % 3
        dx, dy = x[n] - x[k], y[n] - y[k]
        inside = float(dx * (py - y[k]) + (abs(dx) + abs(dy)) * beside)
        if dy > 0:
            right = min(right, x[k] + inside / dy)
        elif dy < 0:
            left = max(left, x[k] + inside / dy)
        elif inside < 0.0:
            return 0, -1
    # Rounded outwards: whether a texel is in the triangle is told exactly, one by one.
    return int(np.floor(left / SUBTEXELS)), int(np.floor(right / SUBTEXELS))


@njit(cache=True, nogil=True)
def overlapping(
    corners: NDArray[np.int32], starts: NDArray[np.int64], rects: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Which triangles own a texel that an earlier one of their patch owns.

    Parameters
    ----------
    corners : (m, 3, 2) right and down, patch by patch.
    starts : (p + 1,) where each patch's triangles begin.
    rects : (p, 4) left, top, width and height in texels, around the patch.

    Returns
    -------
    (m,) bool. Those that overlap own nothing: later ones are asked only about the others.
    """
    found = np.zeros(len(corners), np.bool_)
    largest = 1
    for p in range(len(rects)):
        largest = max(largest, rects[p, 2] * rects[p, 3])
    owned = np.zeros(largest, np.int32)
    x, y = np.empty(3, np.int64), np.empty(3, np.int64)
    for p in range(len(rects)):
        left, top, width = rects[p, 0], rects[p, 1], rects[p, 2]
        stamp = np.int32(p + 1)
        for t in range(starts[p], starts[p + 1]):
            _turned(corners[t], x, y)
            rows = range(y.min() // SUBTEXELS, y.max() // SUBTEXELS + 1)
            for row in rows:
                first, last = _columns(x, y, row, 0)
                for column in range(first, last + 1):
                    if owned[(row - top) * width + column - left] != stamp:
                        continue
                    if _owns(x, y, column * SUBTEXELS + _HALF, row * SUBTEXELS + _HALF):
                        found[t] = True
            if found[t]:
                continue
            for row in rows:
                first, last = _columns(x, y, row, 0)
                for column in range(first, last + 1):
                    if _owns(x, y, column * SUBTEXELS + _HALF, row * SUBTEXELS + _HALF):
                        owned[(row - top) * width + column - left] = stamp
    return found


@njit(cache=True, nogil=True)
def _texel(value: float) -> int:
    return int(min(max(value, 0.0), 255.0) + 0.5)


@njit(cache=True, nogil=True)
def draw_patches(
    page: NDArray[np.uint8],
    state: NDArray[np.uint8],
    patches: NDArray[np.int64],
    starts: NDArray[np.int64],
    corners: NDArray[np.int32],
    rects: NDArray[np.int32],
    places: NDArray[np.int32],
    added: NDArray[np.float32],
    picture: NDArray[np.uint8],
) -> None:
    """Draw some patches of one photograph on a page, texel for pixel.

    First the texels the triangles cover, then those beside them that reading between texels
    touches; what is beside and not usable in the picture stays empty.

    Parameters
    ----------
    page : (H, W, 3), changed.
    state : (H, W), changed: `EMPTY`, `COVERED`, `BESIDE`.
    patches : (k,) which.
    starts, corners, rects : as of `overlapping`, in the picture's pixels.
    places : (p, 2) column and row of each rectangle on the page.
    added : (m, 3, 3) by corner, of 255; between corners as on a plane.
    picture : (h, w, 4) with alpha; or without pixels, and ``added`` is all there is.
    """
    height, width = picture.shape[:2]
    x, y = np.empty(3, np.int64), np.empty(3, np.int64)
    share = np.empty(3)
    for which in range(2):
        for p in patches:
            right, down = places[p, 0] - rects[p, 0], places[p, 1] - rects[p, 1]
            for t in range(starts[p], starts[p + 1]):
                second = _turned(corners[t], x, y)
                area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
                for row in range(
                    (y.min() - _HALF) // SUBTEXELS, (y.max() + _HALF) // SUBTEXELS + 1
                ):
                    py = row * SUBTEXELS + _HALF
                    first, last = _columns(x, y, row, which * SUBTEXELS)
                    for column in range(first, last + 1):
                        if state[row + down, column + right] == COVERED:
                            continue
                        px = column * SUBTEXELS + _HALF
                        if which == 0:
                            if not _owns(x, y, px, py):
                                continue
                        elif state[row + down, column + right] or not _touches(x, y, px, py):
                            continue
                        if height:
                            if row < 0 or column < 0 or row >= height or column >= width:
                                continue
                            # A covered texel that is not usable has no better colour elsewhere.
                            if which == 1 and picture[row, column, 3] != 255:
                                continue
                        total = 0.0
                        for k in range(3):
                            share[k] = max(_edge(x, y, (k + 1) % 3, px, py), 0)
                            total += share[k]
                        if area == 0 or total == 0.0:
                            share[:] = 1.0
                            total = 3.0
                        for c in range(3):
                            more = (
                                share[0] * added[t, 0, c]
                                + share[1] * added[t, second, c]
                                + share[2] * added[t, 3 - second, c]
                            ) / total
                            base = float(picture[row, column, c]) if height else 0.0
                            page[row + down, column + right, c] = _texel(base + more)
                        state[row + down, column + right] = COVERED if which == 0 else BESIDE


@njit(cache=True, nogil=True)
def _touches(x: NDArray[np.int64], y: NDArray[np.int64], px: int, py: int) -> bool:
    """Whether the triangle comes within less than a texel to the side of a texel's middle."""
    if px <= x.min() - SUBTEXELS or px >= x.max() + SUBTEXELS:
        return False
    if py <= y.min() - SUBTEXELS or py >= y.max() + SUBTEXELS:
        return False
    for k in range(3):
        n = (k + 1) % 3
        reach = (abs(x[n] - x[k]) + abs(y[n] - y[k])) * SUBTEXELS
        if _edge(x, y, k, px, py) + reach <= 0:
            return False
    return True


@njit(cache=True, nogil=True)
def pad_patches(
    page: NDArray[np.uint8],
    state: NDArray[np.uint8],
    rects: NDArray[np.int32],
    places: NDArray[np.int32],
    rings: int,
) -> None:
    """Continue the patches outwards, ring by ring, by the mean of the texels beside.

    ``page`` (H, W, 3) and ``state`` (H, W) are changed, the latter to `PADDED`; ``places`` (p, 2)
    and ``rects`` (p, 4) say which rectangle each patch may fill.
    """
    for p in range(len(rects)):
        left, top = places[p, 0], places[p, 1]
        right, bottom = left + rects[p, 2], top + rects[p, 3]
        for ring in range(rings):
            # Rings are told apart while they grow, so that none grows from itself.
            for row in range(top, bottom):
                for column in range(left, right):
                    if state[row, column] != EMPTY:
                        continue
                    count, red, green, blue = 0, 0, 0, 0
                    for v in range(max(row - 1, top), min(row + 2, bottom)):
                        for u in range(max(column - 1, left), min(column + 2, right)):
                            if state[v, u] != EMPTY and state[v, u] != PADDED + 1 + ring:
                                count += 1
                                red += page[v, u, 0]
                                green += page[v, u, 1]
                                blue += page[v, u, 2]
                    if count:
                        page[row, column, 0] = (red + count // 2) // count
                        page[row, column, 1] = (green + count // 2) // count
                        page[row, column, 2] = (blue + count // 2) // count
                        state[row, column] = PADDED + 1 + ring
        for row in range(top, bottom):
            for column in range(left, right):
                if state[row, column] > PADDED:
                    state[row, column] = PADDED


@njit(cache=True, nogil=True)
def read_between(picture: NDArray[np.uint8], places: NDArray[np.float64]) -> NDArray[np.float32]:
    """(n, 3) colours of 255 of a picture (h, w, 3 or 4) at (n, 2), the first middle at 0.5, 0.5."""
    height, width = picture.shape[:2]
    out = np.empty((len(places), 3), np.float32)
    for i in range(len(places)):
        u = min(max(places[i, 0] - 0.5, 0.0), width - 1.0)
        v = min(max(places[i, 1] - 0.5, 0.0), height - 1.0)
        column, row = min(int(u), max(width - 2, 0)), min(int(v), max(height - 2, 0))
        fu, fv = u - column, v - row
        next_column, next_row = min(column + 1, width - 1), min(row + 1, height - 1)
        for c in range(3):
            above = picture[row, column, c] * (1 - fu) + picture[row, next_column, c] * fu
            below = picture[next_row, column, c] * (1 - fu) + picture[next_row, next_column, c] * fu
            out[i, c] = above * (1 - fv) + below * fv
    return out
