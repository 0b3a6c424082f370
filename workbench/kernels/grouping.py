"""Small numbers sorted by counting them: where each stands, in time that grows with them alone."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def grouped(numbers: NDArray[np.int32], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Starts (count + 1,) and places (n,): k stands at ``places[starts[k]:starts[k + 1]]``.

    Places rise within each. Numbers are from 0 to below ``count``.
    """
    starts = np.zeros(count + 1, np.int64)
    for i in range(len(numbers)):
        starts[numbers[i] + 1] += 1
    for k in range(count):
        starts[k + 1] += starts[k]
    at = starts.copy()
    places = np.empty(len(numbers), np.int64)
    for i in range(len(numbers)):
        places[at[numbers[i]]] = i
        at[numbers[i]] += 1
    return starts, places
