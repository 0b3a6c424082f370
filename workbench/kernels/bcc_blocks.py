"""Triangles of many cubic blocks of a body-centred lattice whose node values are given."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.bcc_isosurface import block_triangles, mixed_signs


@njit(cache=True, nogil=True)
def triangles_of_blocks(
    firsts: NDArray[np.int64],
    even: NDArray[np.float64],
    odd: NDArray[np.float64],
    stride: int,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]]:
    """Triangles of blocks of n³ cells and the faces of the blocks that the surface crosses.

    Parameters
    ----------
    firsts : (b, 3) even node of each block's corner, non-negative.
    even, odd : (b, n + 1, n + 1, n + 1) values as `block_triangles` takes them, negative inside.
    stride : larger than any node coordinate.

    Returns
    -------
    keys, fractions : (t, 3) crossed edges and where they are crossed.
    owner : (t,) the block of each triangle.
    crossed : (b, 6) faces in the order −x, +x, −y, +y, −z, +z.
    """
    blocks, n = len(firsts), even.shape[1] - 1
    room = 24 * n**3
    keys = np.empty((4 * room, 3), np.int64)
    fractions = np.empty((4 * room, 3))
    owner = np.empty(4 * room, np.int64)
    crossed = np.zeros((blocks, 6), np.bool_)
    count = 0
    for b in range(blocks):
        if count + room > len(keys):
            size = 2 * len(keys)
            more_keys, more_fractions = np.empty((size, 3), np.int64), np.empty((size, 3))
            more_owner = np.empty(size, np.int64)
            more_keys[:count], more_fractions[:count] = keys[:count], fractions[:count]
            more_owner[:count] = owner[:count]
            keys, fractions, owner = more_keys, more_fractions, more_owner
        for side in range(2):
            layer = n * side
            crossed[b, side] = mixed_signs(even[b, layer], odd[b, layer])
            crossed[b, 2 + side] = mixed_signs(even[b, :, layer], odd[b, :, layer])
            crossed[b, 4 + side] = mixed_signs(even[b, :, :, layer], odd[b, :, :, layer])
        before = count
        count = block_triangles(even[b], odd[b], firsts[b], stride, keys, fractions, count)
        owner[before:count] = b
    return keys[:count].copy(), fractions[:count].copy(), owner[:count].copy(), crossed
