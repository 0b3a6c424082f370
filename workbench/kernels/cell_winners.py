"""One point per cell of ever coarser grids, each grid's among the points of the finer one."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.morton import gathered_bits, morton_code


@njit(cache=True, nogil=True)
def cell_codes(
    whole: NDArray[np.int32],
    low: NDArray[np.int64],
    side: int,
    level: int,
    corner: NDArray[np.int64],
    bits: int,
    codes: NDArray[np.uint64],
) -> int:
    """Morton codes of the cells that points lie in, inside one node of an octree.

    Parameters
    ----------
    whole
        (n, 3) coordinates as integers.
    low, side
        Corner (3,) and side of the root cube, which ends before ``low + side``; at most 2³².
    level, corner
        The node: one of 2^level cells along each axis, its place (3,) among them.
    bits
        Cells along an axis of the node, as a power of two; ``level + bits`` at most 31.
    codes
        (n,), filled.

    Returns
    -------
    Number of points outside the node, whose codes are not filled.
    """
    outside = 0
    for i in range(len(whole)):
        cell = np.zeros(3, np.int64)
        inside = True
        for axis in range(3):
            away = np.int64(whole[i, axis]) - low[axis]
            cell[axis] = ((away << (level + bits)) // side) - (corner[axis] << bits)
            inside &= 0 <= cell[axis] < (np.int64(1) << bits)
        if inside:
            codes[i] = morton_code(cell[0], cell[1], cell[2])
        else:
            outside += 1
    return outside


@njit(cache=True, nogil=True)
def _distance(code: np.uint64, below: int) -> np.int64:
    """Square of the distance to the centre of the cell 2^below finest cells wide, in halves."""
    size = np.int64(1) << below
    total = np.int64(0)
    for axis in range(3):
        place = np.int64(gathered_bits(code >> np.uint64(axis))) & (size - 1)
        away = 2 * place + 1 - size
        total += away * away
    return total


@njit(cache=True, nogil=True)
def winning_levels(
    codes: NDArray[np.uint64], bits: int, coarsest: int, levels: NDArray[np.int8]
) -> None:
    """How coarse the grids are in which points are the one of their cell.

    In the finest grid, of 2^bits cells along an axis, the first point of each cell is its
    winner. In every grid of cells twice as large it is that of the up to eight winners
    before which lies nearest to the centre of the cell, the first of equals.

    Parameters
    ----------
    codes
        (n,) Morton codes in the finest grid, ascending.
    bits
        Its level.
    coarsest
        Level of the coarsest grid.
    levels
        (n,) filled with the coarsest level a point wins, ``bits + 1`` where it wins none.
    """
    count = len(codes)
    levels[:] = bits + 1
    alive = np.arange(count)
    for level in range(bits, coarsest - 1, -1):
        shift = np.uint64(3 * (bits - level))
        kept, i = 0, 0
        while i < count:
            best = alive[i]
            cell = codes[best] >> shift
            i += 1
            if i < count and codes[alive[i]] >> shift == cell:
                nearest = _distance(codes[best], bits - level)
                while i < count and codes[alive[i]] >> shift == cell:
                    distance = _distance(codes[alive[i]], bits - level)
                    if distance < nearest:
                        nearest, best = distance, alive[i]
                    i += 1
            levels[best] = level
            alive[kept] = best
            kept += 1
        count = kept
