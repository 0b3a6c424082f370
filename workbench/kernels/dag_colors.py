"""Mean colours of runs of voxels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE, srgb_byte


@njit(cache=True, nogil=True)
def mean_of_ranges(
    colors: NDArray[np.uint8],
    first: NDArray[np.int64],
    count: NDArray[np.int64],
    out: NDArray[np.uint8],
) -> None:
    """Fill the mean, in linear light, of ``count`` (m,) sRGB colours (n, 3) from ``first`` on."""
    for i in range(len(first)):
        if count[i] <= 0:
            continue
        for c in range(3):
            total = 0.0
            for k in range(first[i], first[i] + count[i]):
                total += LINEAR_OF_BYTE[colors[k, c]]
            out[i, c] = srgb_byte(total / count[i])
