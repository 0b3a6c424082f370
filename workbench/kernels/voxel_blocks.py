"""Which blocks of a voxel grid triangles touch, as lists in Morton order of the blocks."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.morton import morton_code
from workbench.kernels.voxel_clipping import MOST_CORNERS, slab_polygon

# In blocks: far more than rounding moves a cut and far less than a voxel. A block more than
# need be costs a look; one less would lose voxels.
_SLACK = 1e-6


@njit(cache=True, nogil=True)
def _range(polygon: NDArray[np.float64], corners: int, axis: int, blocks: int) -> tuple[int, int]:
    low = high = polygon[0, axis]
    for i in range(1, corners):
        low = min(low, polygon[i, axis])
        high = max(high, polygon[i, axis])
    return (
        max(math.floor(low - _SLACK), 0),
        min(math.floor(high + _SLACK), blocks - 1),
    )


@njit(cache=True, nogil=True)
def _blocks_of(
    triangle: NDArray[np.float64], blocks: int, slab: NDArray[np.float64],
    row: NDArray[np.float64], found: NDArray[np.int64],
) -> tuple[int, NDArray[np.int64]]:  # fmt: skip
    """Morton numbers of the blocks that a triangle (3, 3), in blocks, touches."""
    count = 0
    z0, z1 = _range(triangle, 3, 2, blocks)
    y0, y1 = _range(triangle, 3, 1, blocks)
    x0, x1 = _range(triangle, 3, 0, blocks)
    if x0 == x1 and y0 == y1 and z0 == z1:
        found[0] = morton_code(x0, y0, z0)
        return 1, found
    for z in range(z0, z1 + 1):
        in_slab = slab_polygon(triangle, 3, 2, z - _SLACK, z + 1 + _SLACK, slab)
        if in_slab == 0:
            continue
        y0, y1 = _range(slab, in_slab, 1, blocks)
        for y in range(y0, y1 + 1):
            in_row = slab_polygon(slab, in_slab, 1, y - _SLACK, y + 1 + _SLACK, row)
            if in_row == 0:
                continue
            x0, x1 = _range(row, in_row, 0, blocks)
            while count + x1 + 1 - x0 > len(found):
                found = np.append(found, np.empty(len(found), np.int64))
            for x in range(x0, x1 + 1):
                found[count] = morton_code(x, y, z)
                count += 1
    return count, found


@njit(cache=True, nogil=True)
def triangles_per_block(
    points: NDArray[np.float64], triangles: NDArray[np.int32], half: float, side: int, blocks: int
) -> NDArray[np.int64]:
    """How many triangles touch each block (blocks³,), blocks in Morton order.

    Parameters
    ----------
    points : (n, 3) corners in voxels, zero in the middle of the grid.
    triangles : (m, 3) indices of points.
    half : half the voxels along the grid's side.
    side : voxels along a block's side; ``blocks`` of them make the grid's.
    """
    counts = np.zeros(blocks * blocks * blocks, np.int64)
    corners = np.empty((3, 3))
    slab, row = np.empty((MOST_CORNERS, 3)), np.empty((MOST_CORNERS, 3))
    found = np.empty(64, np.int64)
    for t in range(len(triangles)):
        for k in range(3):
            for axis in range(3):
                corners[k, axis] = (points[triangles[t, k], axis] + half) / side
        count, found = _blocks_of(corners, blocks, slab, row, found)
        for i in range(count):
            counts[found[i]] += 1
    return counts


@njit(cache=True, nogil=True)
def triangles_by_block(
    points: NDArray[np.float64], triangles: NDArray[np.int32], half: float, side: int, blocks: int,
    first: int, starts: NDArray[np.int64],
) -> NDArray[np.int32]:  # fmt: skip
    """The triangles of some blocks, block after block, each in ascending order.

    Parameters
    ----------
    first : Morton number of the first of the blocks.
    starts : (b + 1,) where the list of each of the b blocks starts, from 0, and the end.
    points, triangles, half, side, blocks : as for `triangles_per_block`.
    """
    lists = np.empty(starts[-1], np.int32)
    place = starts[:-1].copy()
    last = first + len(place)
    corners = np.empty((3, 3))
    slab, row = np.empty((MOST_CORNERS, 3)), np.empty((MOST_CORNERS, 3))
    found = np.empty(64, np.int64)
    for t in range(len(triangles)):
        for k in range(3):
            for axis in range(3):
                corners[k, axis] = (points[triangles[t, k], axis] + half) / side
        count, found = _blocks_of(corners, blocks, slab, row, found)
        for i in range(count):
            if first <= found[i] < last:
                lists[place[found[i] - first]] = t
                place[found[i] - first] += 1
    return lists
