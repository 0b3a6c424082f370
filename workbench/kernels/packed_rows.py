"""Values of several arrays side by side in rows, and back."""

from __future__ import annotations

from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray


@nb.njit(cache=True, nogil=True)
def put_columns(rows: NDArray[Any], first: int, values: NDArray[Any]) -> None:
    """Copy ``values`` (n, k) to the columns from ``first`` on of ``rows`` (n, m), same type."""
    for i in range(len(values)):
        for c in range(values.shape[1]):
            rows[i, first + c] = values[i, c]


@nb.njit(cache=True, nogil=True)
def picked_columns(
    rows: NDArray[Any], order: NDArray[np.int32], first: int, count: int
) -> NDArray[Any]:
    """(n, count): the columns from ``first`` on of the rows that ``order`` (n,) names."""
    values = np.empty((len(order), count), rows.dtype)
    for i in range(len(order)):
        row = order[i]
        for c in range(count):
            values[i, c] = rows[row, first + c]
    return values
