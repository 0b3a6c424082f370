"""Depth pictures made smooth between their steps, for normals in screen space."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def smoothed_inverse_depths(
    inverse: NDArray[np.float64], step: NDArray[np.float64], radius: int, out: NDArray[np.float64]
) -> None:
    """Fill the mean of each pixel's window over what belongs to the same surface.

    The inverse of depth is linear over the picture of a plane, so that the mean of a window
    that is the same on both sides keeps planes as they are: of a pixel and the one opposite
    both count or none does.

    Parameters
    ----------
    inverse : (h, w) one over depth; 0 where there is nothing.
    step : (h, w) differences up to it are of one surface, for each pixel away from the middle.
    radius : of the window, pixels.
    out : (h, w) filled; 0 where there is nothing.
    """
    h, w = inverse.shape
    for y in range(h):
        for x in range(w):
            middle = inverse[y, x]
            out[y, x] = middle
            if middle == 0.0:
                continue
            total, weight = middle, 1.0
            for j in range(radius + 1):
                for i in range(-radius, radius + 1):
                    if j == 0 and i <= 0:
                        continue
                    if y - j < 0 or y + j >= h or min(x - i, x + i) < 0 or max(x - i, x + i) >= w:
                        continue
                    a, b = inverse[y + j, x + i], inverse[y - j, x - i]
                    reach = step[y, x] * (1 + max(j, abs(i)))
                    if a > 0.0 and b > 0.0 and max(abs(a - middle), abs(b - middle)) <= reach:
                        total += a + b
                        weight += 2.0
            out[y, x] = total / weight
