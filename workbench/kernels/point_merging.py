"""Points of one cell made one: mean colour in linear light, mean normal."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE, srgb_byte


@njit(cache=True, nogil=True)
def merge_colors(
    order: NDArray[np.int64],
    starts: NDArray[np.int64],
    color: NDArray[np.uint8],
    merged: NDArray[np.uint8],
) -> None:
    """Fill ``merged`` (c, 3) with means of sRGB colours (n, 3).

    Group k is the rows ``order[starts[k] : starts[k + 1]]``; so in `merge_normals`.
    """
    for cell in range(len(starts) - 1):
        count = starts[cell + 1] - starts[cell]
        for axis in range(3):
            total = 0.0
            for i in range(starts[cell], starts[cell + 1]):
                total += LINEAR_OF_BYTE[color[order[i], axis]]
            merged[cell, axis] = srgb_byte(total / count)


@njit(cache=True, nogil=True)
def merge_normals(
    order: NDArray[np.int64],
    starts: NDArray[np.int64],
    normals: NDArray[np.float32],
    merged: NDArray[np.float32],
) -> None:
    """Fill ``merged`` (c, 3) with unit means of normals (n, 3); zero where they cancel.

    Normals that are not finite count for nothing.
    """
    for cell in range(len(starts) - 1):
        x, y, z = 0.0, 0.0, 0.0
        for i in range(starts[cell], starts[cell + 1]):
            nx, ny, nz = normals[order[i]]
            if math.isfinite(nx) and math.isfinite(ny) and math.isfinite(nz):
                x, y, z = x + nx, y + ny, z + nz
        length = math.sqrt(x * x + y * y + z * z)
        # float32 normals that cancel leave no more than their rounding.
        if length > 1e-6 * (starts[cell + 1] - starts[cell]):
            merged[cell, 0], merged[cell, 1] = x / length, y / length
            merged[cell, 2] = z / length
        else:
            merged[cell] = 0.0
