"""Fewer triangles for a depth map where the surface is flat: a hierarchy of right triangles.

Squares of a power of two pixels a side are halved along a diagonal, and triangles along the
middle of their longest side, as often as the surface asks for. A vertex that one triangle needs is
needed by the one across the same edge, too, so that no cracks open.

Source: Evans, Kirkpatrick and Townsend 2001, right-triangulated irregular networks.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def _triangle(
    number: int, splits: int, top: int, left: int, side: int
) -> tuple[int, int, int, int, int, int]:
    """Rows and columns of a triangle's ends of its longest side and of its right angle.

    Bit 0 of ``number`` says which half of the square it is in, the others which half at each of
    its ``splits``.
    """
    if number & 1:
        aj, ai, bj, bi, cj, ci = top + side, left + side, top, left, top, left + side
    else:
        aj, ai, bj, bi, cj, ci = top, left, top + side, left + side, top + side, left
    for k in range(1, splits + 1):
        mj, mi = (aj + bj) // 2, (ai + bi) // 2
        if number >> k & 1:
            aj, ai, bj, bi, cj, ci = bj, bi, cj, ci, mj, mi
        else:
            aj, ai, bj, bi, cj, ci = cj, ci, aj, ai, mj, mi
    return aj, ai, bj, bi, cj, ci


@njit(cache=True, nogil=True)
def _bent(nearness: NDArray[np.float64], aj: int, ai: int, bj: int, bi: int) -> float:
    """How far the middle of an edge lies from the surface, share of its depth."""
    h, w = nearness.shape
    if max(aj, bj) >= h or max(ai, bi) >= w:
        return np.inf
    middle = nearness[(aj + bj) // 2, (ai + bi) // 2]
    if middle <= 0.0 or nearness[aj, ai] <= 0.0 or nearness[bj, bi] <= 0.0:
        return np.inf
    return float(abs(middle - 0.5 * (nearness[aj, ai] + nearness[bj, bi])) / middle)


@njit(cache=True, nogil=True)
def _is_free(free: NDArray[np.bool_], aj: int, ai: int, bj: int, bi: int, cj: int, ci: int) -> bool:
    """Whether both squares that a triangle of two halves of them lies in may be merged."""
    mj, mi = (aj + bj) // 2, (ai + bi) // 2
    for ej, ei in ((aj, ai), (bj, bi)):
        j, i = min(ej, mj, cj), min(ei, mi, ci)
        if j >= free.shape[0] or i >= free.shape[1] or not free[j, i]:
            return False
    return True


@njit(cache=True, nogil=True)
def _errors(
    nearness: NDArray[np.float64], free: NDArray[np.bool_], levels: int
) -> NDArray[np.float64]:
    """What leaving out each vertex, and all below it, costs: share of the depth."""
    h, w = nearness.shape
    side = 1 << levels
    rows, columns = (h - 2) // side + 1, (w - 2) // side + 1
    errors = np.zeros((rows * side + 1, columns * side + 1))
    last = 2 * levels - 1
    # All triangles of a size before the next: those across an edge know of each other.
    for splits in range(last, -1, -1):
        for tile in range(rows * columns):
            top, left = tile // columns * side, tile % columns * side
            for number in range(2 << splits):
                aj, ai, bj, bi, cj, ci = _triangle(number, splits, top, left, side)
                mj, mi = (aj + bj) // 2, (ai + bi) // 2
                error = max(errors[mj, mi], _bent(nearness, aj, ai, bj, bi))
                if splits == last:
                    if not _is_free(free, aj, ai, bj, bi, cj, ci):
                        error = np.inf
                else:
                    error = max(error, errors[(aj + cj) // 2, (ai + ci) // 2])
                    error = max(error, errors[(bj + cj) // 2, (bi + ci) // 2])
                errors[mj, mi] = error
    return errors


@njit(cache=True, nogil=True)
def merged_squares(
    nearness: NDArray[np.float64], free: NDArray[np.bool_], levels: int, most: float
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Squares that stay as they are, and the triangles that stand for all others.

    Parameters
    ----------
    nearness : (h, w) 1 / depth, 0 where nothing is seen; linear over a plane.
    free : (h − 1, w − 1) squares between pixels that may be merged with others.
    levels : a merged square has sides of at most ``2 ** levels`` pixels; 1 at least.
    most : what the surface may be moved by at a vertex that is left out, share of its depth.

    Returns
    -------
    whole : (h − 1, w − 1) bool, squares that no triangle stands for.
    corners : (k, 3) int64 pixels, numbered row by row, counter-clockwise in the picture.
    """
    h, w = nearness.shape
    side = 1 << levels
    errors = _errors(nearness, free, levels)
    halves = np.zeros((h - 1, w - 1), np.int8)
    found = np.empty((2 * (h - 1) * (w - 1), 3), np.int64)
    leaf = np.empty(len(found), np.bool_)
    stack = np.empty((4 * levels + 4, 6), np.int64)
    count = 0
    for top in range(0, h - 1, side):
        for left in range(0, w - 1, side):
            for half in range(2):
                stack[0] = _triangle(half, 0, top, left, side)
                height = 1
                while height:
                    height -= 1
                    aj, ai, bj, bi, cj, ci = stack[height]
                    mj, mi = (aj + bj) // 2, (ai + bi) // 2
                    smallest = abs(aj - cj) + abs(ai - ci) == 1
                    if not smallest and errors[mj, mi] > most:
                        stack[height] = (cj, ci, aj, ai, mj, mi)
                        stack[height + 1] = (bj, bi, cj, ci, mj, mi)
                        height += 2
                        continue
                    if max(aj, bj, cj) >= h or max(ai, bi, ci) >= w:
                        continue
                    if smallest:
                        halves[min(aj, bj, cj), min(ai, bi, ci)] += 1
                    found[count] = (bj * w + bi, aj * w + ai, cj * w + ci)
                    if (bj - aj) * (ci - ai) - (bi - ai) * (cj - aj) > 0:
                        found[count] = (aj * w + ai, bj * w + bi, cj * w + ci)
                    leaf[count] = smallest
                    count += 1
    kept = 0
    for k in range(count):
        j, i = found[k].min() // w, (found[k] % w).min()
        if leaf[k] and halves[j, i] == 2:
            continue
        found[kept] = found[k]
        kept += 1
    return halves == 2, found[:kept].copy()
