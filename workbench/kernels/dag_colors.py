"""Mean colours of runs of voxels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def _linear_of_srgb() -> NDArray[np.float64]:
    """Linear light in [0, 1] of the 256 sRGB values (IEC 61966-2-1)."""
    s = np.arange(256) / 255.0
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


_LINEAR = _linear_of_srgb()


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
                total += _LINEAR[colors[k, c]]
            mean = total / count[i]
            s = 12.92 * mean if mean <= 0.0031308 else 1.055 * mean ** (1.0 / 2.4) - 0.055
            out[i, c] = np.uint8(255.0 * s + 0.5)
