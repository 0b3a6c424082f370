"""Normals of points that have none, or none of use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.neighbours import k_nearest, tree_of

_NEIGHBOURS = 12
_AT_ONCE = 1 << 17
_LEAST_LENGTH = 1e-6


def sound_normals(
    points: NDArray[np.float64], normals: NDArray[np.float32] | None
) -> NDArray[np.float32]:
    """Unit normals (n, 3): the given ones, and those of `estimated_normals` where there is none.

    Programs write zeros, or no numbers at all, where they do not know the normal of a point.
    """
    if normals is None:
        return estimated_normals(points)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    known = np.isfinite(length[:, 0]) & (length[:, 0] > _LEAST_LENGTH)
    if known.all():
        return np.asarray(normals / length, np.float32)
    return np.where(
        known[:, None], normals / np.where(known[:, None], length, 1.0), estimated_normals(points)
    ).astype(np.float32)


def estimated_normals(points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Unit normals (n, 3) of the planes through each point's twelve nearest.

    Which of its two sides a normal is on is not known: they serve to draw discs, not to tell
    one side from the other. Where all neighbours lie in one place the normal is along z.
    """
    if len(points) < 3:
        return np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(points), 1))
    centered = points - 0.5 * (points.min(axis=0) + points.max(axis=0))
    tree = tree_of(centered)
    normals = np.empty((len(points), 3), np.float32)
    for first in range(0, len(points), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        _, rows = k_nearest(tree, centered[some], min(_NEIGHBOURS, len(points)))
        around = centered[rows] - centered[rows].mean(axis=1, keepdims=True)
        covariance = np.einsum("nki,nkj->nij", around, around)
        normals[some] = np.linalg.eigh(covariance)[1][:, :, 0]
    flat = np.linalg.norm(normals, axis=1) < 0.5
    normals[flat] = (0.0, 0.0, 1.0)
    return normals
