"""Cell identification: cubes of points as cells of 2³ positions, empty ones in one bit.

Mallón, Bóo, Amor and Bruguera 2003, "Algorithms and hardware for data compression in point
rendering applications", sections 3.1 and 4.1: a cell is one bit (0: empty), and where that is
1, eight bits for its positions. Position 4 x + 2 y + z of a cell comes at that place, and
cells come in the order of z, y, x, z fastest: the index of a cell is the bits of x, y and z
one after another.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.bit_stream import bits_at, only_padding, put_bits

SOUND, CUT_OFF, WRONG_COUNT, LEFT_OVER, WRONG_PLACE = range(5)


@njit(cache=True, nogil=True)
def encode_cells(
    points: NDArray[np.int32],
    starts: NDArray[np.int64],
    level: int,
    data: NDArray[np.uint8],
    ends: NDArray[np.int64],
) -> None:
    """Write cubes one after another, each from a whole byte on.

    Parameters
    ----------
    points
        (n, 3) places in the cubes, each in [0, 2**level), cube by cube.
    starts
        (c + 1,) rows where the points of each cube begin, and where the last end.
    level
        1…8.
    data
        Zeros; at least `room_for_cells` of them.
    ends
        (c,) filled with the byte behind each cube.
    """
    half = level - 1
    positions = np.empty(1 << 3 * half, np.uint8)
    place = 0
    for cube in range(len(starts) - 1):
        positions[:] = 0
        for i in range(starts[cube], starts[cube + 1]):
            x, y, z = int(points[i, 0]), int(points[i, 1]), int(points[i, 2])
            cell = ((x >> 1) << half | y >> 1) << half | z >> 1
            label = (x & 1) << 2 | (y & 1) << 1 | z & 1
            positions[cell] |= np.uint8(128 >> label)
        for cell in range(len(positions)):
            if positions[cell]:
                place = put_bits(data, place, 256 | int(np.int64(positions[cell])), 9)
            else:
                place += 1
        place = place + 7 >> 3 << 3
        ends[cube] = place >> 3


def room_for_cells(points: int, cubes: int, level: int) -> int:
    """Bytes that `encode_cells` needs at most."""
    return cubes * ((1 << 3 * (level - 1)) // 8 + 1) + points


@njit(cache=True, nogil=True)
def decode_cells(
    data: NDArray[np.uint8],
    bytes_at: NDArray[np.int64],
    starts: NDArray[np.int64],
    level: int,
    points: NDArray[np.int32],
    status: NDArray[np.int64],
) -> None:
    """Read what `encode_cells` wrote.

    Parameters
    ----------
    data
        Its bytes and three more.
    bytes_at
        (c + 1,) bytes where each cube begins, and where the last ends.
    starts, level
        As they were written.
    points
        (n, 3), filled cube by cube, in the order of cells and of positions in them.
    status
        (c,) filled with ``SOUND``, or what is wrong with a cube.
    """
    half = level - 1
    cells, mask = 1 << 3 * half, (1 << half) - 1
    for cube in range(len(starts) - 1):
        place, end = 8 * bytes_at[cube], 8 * bytes_at[cube + 1]
        row, row_end = starts[cube], starts[cube + 1]
        cell, found = 0, SOUND
        while cell < cells and found == SOUND:
            # Only a sound cube runs to its end; one cut off stops within these few bits.
            if place >= end:
                found = CUT_OFF
                break
            bits = bits_at(data, place, 9)
            if bits < 256:
                # Cells left: eight empty ones are passed over at once.
                empty = 8 if bits < 2 and cells - cell >= 8 and end - place >= 8 else 1
                cell, place = cell + empty, place + empty
                continue
            if end - place < 9:
                found = CUT_OFF
                break
            place += 9
            x, y, z = cell >> 2 * half << 1, (cell >> half & mask) << 1, (cell & mask) << 1
            for label in range(8):
                if bits >> (7 - label) & 1:
                    if row == row_end:
                        found = WRONG_COUNT
                        break
                    points[row, 0] = x + (label >> 2)
                    points[row, 1] = y + (label >> 1 & 1)
                    points[row, 2] = z + (label & 1)
                    row += 1
            if bits == 256:
                found = LEFT_OVER
            cell += 1
        if found == SOUND and row != row_end:
            found = WRONG_COUNT
        if found == SOUND and not only_padding(data, place, end):
            found = LEFT_OVER
        status[cube] = found
