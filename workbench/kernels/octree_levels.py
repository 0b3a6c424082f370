"""Which level of an octree each point belongs to, so that every level is spread evenly.

Points are in the order of their Morton codes of 21 bits per axis. A node of level ``l`` is
what shares the upper ``3 l`` bits of a code; the cells of its grid share ``3 (l + grid)``.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.morton import BITS_PER_AXIS, morton_code


@njit(cache=True, nogil=True)
def cube_codes(
    whole: NDArray[np.int32], corner: NDArray[np.int64], side: int, codes: NDArray[np.uint64]
) -> None:
    """Codes (n,) of integer points (n, 3) in the cube of ``side`` integers from ``corner``."""
    for i in range(len(whole)):
        x = ((np.int64(whole[i, 0]) - corner[0]) << BITS_PER_AXIS) // side
        y = ((np.int64(whole[i, 1]) - corner[1]) << BITS_PER_AXIS) // side
        z = ((np.int64(whole[i, 2]) - corner[2]) << BITS_PER_AXIS) // side
        codes[i] = morton_code(x, y, z)


@njit(cache=True, nogil=True)
def leaf_levels(
    codes: NDArray[np.uint64], top: int, deepest: int, most: int, levels: NDArray[np.int8]
) -> None:
    """The level of the leaf (n,) of every point of one node of level ``top``.

    A node is a leaf when it has at most ``most`` points, all of them at one code, or when
    its level is ``deepest``.
    """
    starts = np.empty(8 * (deepest + 2), np.int64)
    ends = np.empty_like(starts)
    depths = np.empty_like(starts)
    starts[0], ends[0], depths[0], waiting = 0, len(codes), top, 1
    while waiting:
        waiting -= 1
        start, end, depth = starts[waiting], ends[waiting], depths[waiting]
        if end - start <= most or depth >= deepest or codes[start] == codes[end - 1]:
            levels[start:end] = depth
            continue
        shift = np.uint64(3 * (BITS_PER_AXIS - depth - 1))
        while start < end:
            child = codes[start] >> shift
            stop = start + np.searchsorted(codes[start:end] >> shift, child, side="right")
            starts[waiting], ends[waiting], depths[waiting] = start, stop, depth + 1
            waiting += 1
            start = stop


@njit(cache=True, nogil=True)
def lift_to_parents(
    codes: NDArray[np.uint64],
    whole: NDArray[np.int32],
    corner: NDArray[np.int64],
    side: int,
    grid: int,
    top: int,
    levels: NDArray[np.int8],
) -> None:
    """Move points from nodes to their parents, bottom up: one into every cell that has some.

    Of the points of level ``l + 1`` in a cell of a node of level ``l`` the nearest to the
    centre of the cell gets level ``l``, the first of several; so of the levels up to any
    each cell has exactly one point.

    Parameters
    ----------
    codes : (n,) ascending.
    whole : (n, 3) the integer points.
    corner, side : of the cube of the whole tree, in such integers.
    grid : a node has 2**grid cells a side.
    top : the highest level to fill.
    levels : (n,) at first those of the leaves; changed.
    """
    deepest = top
    for i in range(len(levels)):
        deepest = max(deepest, levels[i])
    for level in range(deepest - 1, top - 1, -1):
        fine = level + grid
        shift = np.uint64(3 * (BITS_PER_AXIS - fine))
        cell_side = side / 2.0**fine
        cell, best, nearest = np.uint64(0), -1, np.inf
        for i in range(len(levels)):
            if levels[i] != level + 1:
                continue
            if best < 0 or codes[i] >> shift != cell:
                if best >= 0:
                    levels[best] = level
                cell, best, nearest = codes[i] >> shift, -1, np.inf
            distance = 0.0
            for axis in range(3):
                # Exact: a point's own cell, by which the code was made, in whole numbers.
                place = np.int64(whole[i, axis]) - corner[axis]
                index = ((place << BITS_PER_AXIS) // side) >> (BITS_PER_AXIS - fine)
                off = place - (index + 0.5) * cell_side
                distance += off * off
            if best < 0 or distance < nearest:
                best, nearest = i, distance
        if best >= 0:
            levels[best] = level
