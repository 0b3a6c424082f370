"""Occupied cells of a cube, level by level, each told by what is known of its neighbours.

A level is a list of occupied cells; each of their eight children is one bit of the next. The
children are met in the order of planes, rows and columns of the whole cube, not parent by
parent, so that 13 of the 26 neighbours of a child are always known, with more beyond them, and
of the others it is known whether their parents are occupied. Neighbours are read from a bitmap
of each level, three or five at a time. The list that comes out is in the same order, ready to
be the parents of the next level.

Five contexts tell the chance of a child. Neighbours before it are known; those after it are
known by their parents, the child's own among them, which counts as occupied:

1. the 13 neighbours before it, and which of the eight it is;
2. those of them that share a face or an edge in its row or in its plane's rows, and the parents
   of nine neighbours after it;
3. neighbours before it across faces, nine cells two steps before it, the parents of neighbours
   after it across faces, and one neighbour more;
4. the neighbours of its parent across faces, which of the eight it is, and the neighbours of 2;
5. how many are occupied of the 13, of the nine, and of the parents of 2.

The numbers of 5 also choose the weights with which the five are added up.

A bitmap holds (side + 4)² rows of side / 8 + 3 bytes: two empty rows and a byte around the
cells spare every test for the border.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.adaptive_bits import coded_bit

_MARGIN = 2
# Contexts of the five tables, one after another, and sets of weights.
_TABLES = (1 << 16, 1 << 16, 1 << 16, 1 << 16, 1 << 12)
CHANCES = sum(_TABLES)
_SECOND, _THIRD, _FOURTH, _FIFTH = 1 << 16, 2 << 16, 3 << 16, 4 << 16
WEIGHT_SETS = 30
_ONES = np.bitwise_count(np.arange(1 << 13)).astype(np.uint8)


def new_bitmap(side: int) -> NDArray[np.uint8]:
    """A bitmap of a cube without occupied cells."""
    return np.zeros((side + 2 * _MARGIN) ** 2 * _row_bytes(side), np.uint8)


@njit(cache=True, nogil=True)
def _row_bytes(side: int) -> int:
    return side // 8 + 3


@njit(cache=True, nogil=True)
def set_cells(bitmap: NDArray[np.uint8], side: int, cells: NDArray[np.int32]) -> None:
    """Mark cells (n, 3) of [0, side)."""
    row_bytes, rows = _row_bytes(side), side + 2 * _MARGIN
    for i in range(len(cells)):
        row = (cells[i, 2] + _MARGIN) * rows + cells[i, 1] + _MARGIN
        x = cells[i, 0] + 8
        bitmap[row * row_bytes + (x >> 3)] |= np.uint8(1 << (x & 7))


@njit(cache=True, nogil=True)
def _around(bitmap: NDArray[np.uint8], row: int, x: int) -> int:
    """Cells x − 2 … x + 3 of the row that starts at byte ``row``, x − 2 lowest."""
    place = x + 6
    byte = row + (place >> 3)
    two = int(np.int64(bitmap[byte]) | np.int64(bitmap[byte + 1]) << 8)
    return two >> (place & 7) & 63


@njit(cache=True, nogil=True)
def _neighbourhoods(
    parents: NDArray[np.int32], count: int, bitmap: NDArray[np.uint8], side: int
) -> NDArray[np.int32]:
    """27 bits for each of the parents: its neighbours, x lowest, then y, then z."""
    row_bytes, rows = _row_bytes(side), side + 2 * _MARGIN
    found = np.empty(count, np.int32)
    for i in range(count):
        row = ((parents[i, 2] + _MARGIN) * rows + parents[i, 1] + _MARGIN) * row_bytes
        bits = 0
        for k in range(9):
            near = row + ((k // 3 - 1) * rows + k % 3 - 1) * row_bytes
            bits |= (_around(bitmap, near, parents[i, 0]) >> 1 & 7) << 3 * k
        found[i] = bits
    return found


@njit(cache=True, nogil=True)
def _parents_beside(near: int) -> int:
    """The six neighbours across faces among the 27 bits of a parent's neighbourhood."""
    return (
        (near >> 12 & 1) | (near >> 14 & 1) << 1 | (near >> 16 & 1) << 2
        | (near >> 10 & 1) << 3 | (near >> 22 & 1) << 4 | (near >> 4 & 1) << 5
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _parents_ahead(near: int, dx: int, dy: int, dz: int) -> int:
    """The parents of nine neighbours after child ``dx, dy, dz``, from its parent's 27 bits.

    From the lowest bit on: (0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 1), (0, −1, 1), (1, 1, 0),
    (1, 0, 1), (−1, 1, 0) and (−1, 0, 1).
    """
    # Where the row above (y + 1), that behind (z + 1) and others have their three bits.
    up, back = near >> 12 + 3 * dy & 7, near >> 12 + 9 * dz & 7
    both = near >> 13 + 3 * dy + 9 * dz & 1
    back_and_down = near >> 13 + 9 * dz - 3 * (1 - dy) & 1
    beside = near >> 13 + dx & 1
    ahead = (up >> 1 & 1) | (back >> 1 & 1) << 1 | beside << 2 | both << 3 | back_and_down << 4
    ahead |= (up >> 1 + dx & 1) << 5 | (back >> 1 + dx & 1) << 6
    return ahead | (up >> dx & 1) << 7 | (back >> dx & 1) << 8


@njit(cache=True, nogil=True)
def _end_of_run(parents: NDArray[np.int32], start: int, count: int, axis: int) -> int:
    """The first parent after ``start`` with another coordinate."""
    end = start + 1
    while end < count and parents[end, axis] == parents[start, axis]:
        end += 1
    return end


@njit(cache=True, nogil=True)
def code_level(
    coder: NDArray[np.int64],
    data: NDArray[np.uint8],
    chances: NDArray[np.uint32],
    weights: NDArray[np.int64],
    parents: NDArray[np.int32],
    count: int,
    parent_bitmap: NDArray[np.uint8],
    side: int,
    wanted: NDArray[np.uint8],
    bitmap: NDArray[np.uint8],
    children: NDArray[np.int32],
) -> int:
    """Write or read the children of a level.

    Parameters
    ----------
    coder, data, chances, weights
        As in `workbench.kernels.adaptive_bits`; ``CHANCES`` contexts, ``WEIGHT_SETS`` weights.
    parents
        (n, 3) occupied cells in the order z, y, x; the first ``count`` are meant.
    parent_bitmap
        The same as a bitmap.
    side
        Children along a side of the cube.
    wanted
        A bitmap of the children to write; a reader has an empty array.
    bitmap
        An empty bitmap; becomes that of the children.
    children
        (m, 3), filled with the children in the order z, y, x.

    Returns
    -------
    The number of children, or −1 where there are more than ``children`` has room for.
    """
    known = _neighbourhoods(parents, count, parent_bitmap, side // 2)
    filled = np.zeros(count, np.bool_)
    row_bytes, rows = _row_bytes(side), side + 2 * _MARGIN
    made, plane = 0, 0
    while plane < count:
        plane_end = _end_of_run(parents, plane, count, 2)
        for dz in range(2):
            z = 2 * parents[plane, 2] + dz
            row = plane
            while row < plane_end:
                row_end = _end_of_run(parents, row, plane_end, 1)
                for dy in range(2):
                    y = 2 * parents[row, 1] + dy
                    made = _code_row(
                        coder, data, chances, weights, parents, row, row_end, known, filled,
                        ((z + _MARGIN) * rows + y + _MARGIN) * row_bytes, rows * row_bytes,
                        row_bytes, y, z, wanted, bitmap, children, made,
                    )  # fmt: skip
                    if made < 0:
                        return -1
                row = row_end
        plane = plane_end
    return made


@njit(cache=True, nogil=True)
def _code_row(
    coder: NDArray[np.int64],
    data: NDArray[np.uint8],
    chances: NDArray[np.uint32],
    weights: NDArray[np.int64],
    parents: NDArray[np.int32],
    first: int,
    end: int,
    known: NDArray[np.int32],
    filled: NDArray[np.bool_],
    here: int,
    plane_step: int,
    row_step: int,
    y: int,
    z: int,
    wanted: NDArray[np.uint8],
    bitmap: NDArray[np.uint8],
    children: NDArray[np.int32],
    made: int,
) -> int:
    """The children in one row; ``here`` is its byte in the bitmaps."""
    dy, dz = y & 1, z & 1
    for k in range(first, end):
        parent_x = parents[k, 0]
        near = np.int64(known[k])
        x = 2 * parent_x
        own = _around(bitmap, here, x)
        below = _around(bitmap, here - row_step, x)
        below_2 = _around(bitmap, here - 2 * row_step, x)
        front_below = _around(bitmap, here - plane_step - row_step, x)
        front = _around(bitmap, here - plane_step, x)
        front_above = _around(bitmap, here - plane_step + row_step, x)
        front_2 = _around(bitmap, here - 2 * plane_step, x)
        front_below_2 = _around(bitmap, here - plane_step - 2 * row_step, x)
        front_above_2 = _around(bitmap, here - plane_step + 2 * row_step, x)
        for dx in range(2):
            corner = dx | dy << 1 | dz << 2
            if corner == 7 and not filled[k]:
                # A parent has at least one child.
                bit = 1
            else:
                ahead = _parents_ahead(near, dx, dy, dz)
                b, f = below >> dx, front >> dx
                before = (
                    (own >> 1 & 1) | (b >> 1 & 7) << 1 | (front_below >> 1 + dx & 7) << 4
                    | (f >> 1 & 7) << 7 | (front_above >> 1 + dx & 7) << 10
                )  # fmt: skip
                faces = (own >> 1 & 1) | (b >> 2 & 1) << 1 | (f >> 2 & 1) << 2
                edges = (
                    faces | (b >> 1 & 1) << 3 | (b >> 3 & 1) << 4
                    | (f >> 1 & 1) << 5 | (f >> 3 & 1) << 6
                )  # fmt: skip
                beyond = (
                    (own & 1) | (below_2 >> 1 + dx & 7) << 1 | (front_2 >> 1 + dx & 7) << 4
                    | (front_below_2 >> 2 + dx & 1) << 7 | (front_above_2 >> 2 + dx & 1) << 8
                )  # fmt: skip
                met, awaited = np.int64(_ONES[before]), np.int64(_ONES[ahead])
                contexts = (
                    before | corner << 13,
                    _SECOND + (edges | ahead << 7),
                    _THIRD + (faces | beyond << 3 | (ahead & 7) << 12 | (f >> 3 & 1) << 15),
                    _FOURTH + (_parents_beside(near) | corner << 6 | edges << 9),
                    _FIFTH + (met | np.int64(_ONES[beyond]) << 4 | awaited << 8),
                )
                chosen = 3 * awaited + (0 if met < 2 else (1 if met < 5 else 2))
                place = x + dx + 8
                bit = np.int64(wanted[here + (place >> 3)]) >> (place & 7) & 1 if len(wanted) else 0
                bit = coded_bit(coder, data, chances, weights, chosen, contexts, bit)
            if bit:
                if made == len(children):
                    return -1
                filled[k] = True
                place = x + dx + 8
                bitmap[here + (place >> 3)] |= np.uint8(1 << (place & 7))
                children[made, 0], children[made, 1], children[made, 2] = x + dx, y, z
                made += 1
            # The child becomes the left neighbour of the next.
            own = own >> 1 | bit << 1
    return made
