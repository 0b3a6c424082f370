"""Nearest neighbours, with result types that are always arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.errors import InputError

# Squares of longer distances leave the range of numbers.
_FARTHEST = 1e150


def tree_of(points: NDArray[np.float64]) -> cKDTree:
    """A tree of points (n, 3) to ask for neighbours.

    Raises
    ------
    InputError
        A coordinate is not finite, or so large that distances are not.
    """
    # NaN is not below anything.
    sound = (np.abs(points) < _FARTHEST).all(axis=1)
    if not sound.all():
        row = int(np.argmin(sound))
        raise InputError(
            "points without a place have no neighbours",
            where=f"point {row}",
            expected=f"finite coordinates below {_FARTHEST:g}",
            found=f"{points[row]}, and {int((~sound).sum()) - 1} more",
            fix="leave such points out",
        )
    return cKDTree(points)


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

    Raises
    ------
    InputError
        A point is not finite, or so far away that distances are not.
    """
    try:
        distance, index = tree.query(points, k=list(range(1, k + 1)), workers=_workers(points))
    except ValueError as error:
        raise InputError("points without a place have no neighbours", found=str(error)) from error
    if not np.isfinite(distance).all():
        raise InputError("points are too far away to have neighbours", fix="leave them out")
    return np.asarray(distance, np.float64), np.asarray(index, np.int64)


def _workers(points: NDArray[np.float64]) -> int:
    """Threads for a query: starting them takes longer than answering a few points."""
    return -1 if len(points) > 4000 else 1
