"""Nearest neighbours, with result types that are always arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree


def nearest(
    tree: cKDTree, points: NDArray[np.float64], max_distance_m: float = np.inf
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distance and index (m,) of the closest entry; inf and ``tree.n`` beyond the limit."""
    distance, index = tree.query(
        points, distance_upper_bound=max_distance_m, workers=_workers(points)
    )
    return np.asarray(distance, np.float64), np.asarray(index, np.int64)


def k_nearest(
    tree: cKDTree, points: NDArray[np.float64], k: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distances and indices (m, k) of the closest entries, nearest first, also for k = 1.

    ``k`` must not exceed the number of entries.
    """
    distance, index = tree.query(points, k=list(range(1, k + 1)), workers=_workers(points))
    return np.asarray(distance, np.float64), np.asarray(index, np.int64)


def _workers(points: NDArray[np.float64]) -> int:
    """Threads for a query: starting them takes longer than answering a few points."""
    return -1 if len(points) > 4000 else 1
