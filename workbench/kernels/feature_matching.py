"""Closest descriptors of two sets, by looking at every pair.

Descriptors have so many dimensions that a search tree visits nearly all of them; a plain
scan in float32 with the dimensions outside is faster and its result does not depend on the
number of threads or on how a linear algebra library splits its sums.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def closest_descriptors(
    asking: NDArray[np.float32], among: NDArray[np.float32], k: int
) -> NDArray[np.int64]:
    """The ``k`` closest rows of ``among`` for every row of ``asking``.

    Parameters
    ----------
    asking, among : (n, d) and (m, d) float32 descriptors, all finite; 1 ≤ k ≤ m.

    Returns
    -------
    (n, k) int64 indices by rising Euclidean distance; of equals the first comes first.

    Raises
    ------
    ValueError
        ``k`` is out of range or the dimensions differ.
    """
    if not 1 <= k <= len(among) or asking.shape[1] != among.shape[1]:
        raise ValueError(f"no {k} closest of {among.shape} for {asking.shape}")
    return np.asarray(
        _closest(np.ascontiguousarray(asking), np.ascontiguousarray(among.T), k), np.int64
    )


@njit(cache=True, nogil=True)
def _closest(
    asking: NDArray[np.float32], among_t: NDArray[np.float32], k: int
) -> NDArray[np.int64]:
    n, (dimensions, m) = len(asking), among_t.shape
    found = np.empty((n, k), np.int64)
    best = np.empty(k, np.float32)
    distance = np.empty(m, np.float32)
    for i in range(n):
        distance[:] = np.float32(0.0)
        for d in range(dimensions):
            value = asking[i, d]
            row = among_t[d]
            for j in range(m):
                gap = value - row[j]
                distance[j] += gap * gap
        filled = 0
        for j in range(m):
            if filled == k and distance[j] >= best[k - 1]:
                continue
            place = min(filled, k - 1)
            while place > 0 and best[place - 1] > distance[j]:
                best[place] = best[place - 1]
                found[i, place] = found[i, place - 1]
                place -= 1
            best[place] = distance[j]
            found[i, place] = j
            filled = min(filled + 1, k)
    return found
