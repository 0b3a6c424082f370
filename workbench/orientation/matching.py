"""Features of two photographs that look alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.orientation.features import DESCRIPTOR_NORM

_ROWS_AT_ONCE = 1024


@dataclass(frozen=True)
class MatchSettings:
    """Which look alike.

    Attributes
    ----------
    max_ratio : of the distance to the closest descriptor to that of the second (Lowe 2004).
    max_distance : between descriptors of length 1.
    """

    max_ratio: float = 0.8
    max_distance: float = 0.7


def matched(
    a: NDArray[np.uint8], b: NDArray[np.uint8], settings: MatchSettings
) -> NDArray[np.uint32]:
    """Rows of ``a`` and ``b`` that are each other's closest, and clearly so.

    Parameters
    ----------
    a, b : (n, 128) and (m, 128) descriptors of length `DESCRIPTOR_NORM`.
    settings : which look alike.

    Returns
    -------
    (k, 2) uint32 rows of a and of b, by rising row of a.
    """
    if len(a) == 0 or len(b) < 2:
        return np.zeros((0, 2), np.uint32)
    # Whole numbers whose sums stay below 2²⁴: exact in float32, in whatever order they are added.
    among = b.astype(np.float32).T
    partner = np.empty(len(a), np.int64)
    best, second = np.empty(len(a), np.float32), np.empty(len(a), np.float32)
    best_of_b = np.zeros(len(b), np.float32)
    for first in range(0, len(a), _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        products = a[rows].astype(np.float32) @ among
        np.maximum(best_of_b, products.max(axis=0), out=best_of_b)
        closest = products.argmax(axis=1)
        here = np.arange(len(products))
        partner[rows], best[rows] = closest, products[here, closest]
        products[here, closest] = -1.0
        second[rows] = products.max(axis=1)
    norm = DESCRIPTOR_NORM**2
    gap, next_gap = np.maximum(norm - best, 0.0), np.maximum(norm - second, 0.0)
    good = (best >= best_of_b[partner]) & (gap < settings.max_ratio**2 * next_gap)
    good &= 2.0 * gap < norm * settings.max_distance**2
    rows_of_a = np.flatnonzero(good)
    rows_of_b, counts = np.unique(partner[rows_of_a], return_counts=True)
    once = np.isin(partner[rows_of_a], rows_of_b[counts == 1])
    return np.column_stack([rows_of_a[once], partner[rows_of_a[once]]]).astype(np.uint32)
